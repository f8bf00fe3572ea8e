//! Records of a binary FBX file, version 7.4.
//!
//! A file is a magic number, a tree of records, and a footer. A record is `end: u32, n_properties: u32, n_property_bytes: u32,
//! n_name: u8`, the name, the properties, and its children, closed by a record of zeros (A. Gessler, "FBX binary file format
//! specification", code.blender.org 2013). Little endian; `end` counts from the start of the file.

use flate2::Compression;
use flate2::write::ZlibEncoder;
use std::io::{self, Write};

/// First bytes of every file.
const MAGIC: &[u8; 23] = b"Kaydara FBX Binary  \x00\x1a\x00";
/// Version 7.4, the newest that all programs read.
pub(super) const VERSION: u32 = 7400;
/// Bytes of a record of zeros.
const N_HEADER: usize = 13;
/// Arrays of fewer bytes are not deflated: that would make them longer.
const MIN_DEFLATED: usize = 128;

/// Digest of the file in `FileId`, the time in `CreationTime` and the first bytes of the footer belong together. Readers check
/// at most that; these are the values of a file that was made at the start of 1970.
pub(super) const FILE_ID: [u8; 16] =
    [0x28, 0xb3, 0x2a, 0xeb, 0xb6, 0x24, 0xcc, 0xc2, 0xbf, 0xc8, 0xb0, 0x2a, 0xa9, 0x2b, 0xfc, 0xf1];
/// See [`FILE_ID`].
pub(super) const CREATION_TIME: &str = "1970-01-01 10:00:00:000";
const FOOTER_ID: [u8; 16] =
    [0xfa, 0xbc, 0xab, 0x09, 0xd0, 0xc8, 0xd4, 0x66, 0xb1, 0x76, 0xfb, 0x83, 0x1c, 0xf7, 0x26, 0x7e];
/// Last bytes of every file.
const END: [u8; 16] = [0xf8, 0x5a, 0x8c, 0x6a, 0xde, 0xf5, 0xd9, 0x7e, 0xec, 0xe9, 0x0c, 0xe3, 0x75, 0x8f, 0x29, 0x0b];

/// A record.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Node {
    pub(super) name: &'static str,
    pub(super) properties: Vec<Property>,
    pub(super) children: Vec<Node>,
}

/// A value of a record.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Property {
    Bool(bool),
    I32(i32),
    I64(i64),
    F64(f64),
    Text(String),
    Bytes(Vec<u8>),
    I32s(Vec<i32>),
    I64s(Vec<i64>),
    F32s(Vec<f32>),
    F64s(Vec<f64>),
}

impl Node {
    /// A record with values and without children.
    pub(super) fn leaf(name: &'static str, properties: impl Into<Vec<Property>>) -> Self {
        Self { name, properties: properties.into(), children: Vec::new() }
    }

    /// A record with values and children.
    pub(super) fn new(name: &'static str, properties: impl Into<Vec<Property>>, children: Vec<Self>) -> Self {
        Self { name, properties: properties.into(), children }
    }

    fn write(&self, bytes: &mut Vec<u8>) -> io::Result<()> {
        let start = bytes.len();
        bytes.extend([0; N_HEADER - 1]);
        bytes.push(self.name.len() as u8);
        bytes.extend(self.name.as_bytes());
        let values = bytes.len();
        self.properties.iter().try_for_each(|property| property.write(bytes))?;
        let n_value_bytes = bytes.len() - values;
        self.children.iter().try_for_each(|child| child.write(bytes))?;
        if !self.children.is_empty() || self.properties.is_empty() {
            bytes.extend([0; N_HEADER]);
        }
        let header = [counted(bytes.len())?, counted(self.properties.len())?, counted(n_value_bytes)?];
        let header: Vec<u8> = header.iter().flat_map(|word| word.to_le_bytes()).collect();
        bytes[start..start + header.len()].copy_from_slice(&header);
        Ok(())
    }
}

impl Property {
    fn write(&self, bytes: &mut Vec<u8>) -> io::Result<()> {
        match self {
            Self::Bool(value) => bytes.extend([b'C', u8::from(*value)]),
            Self::I32(value) => add(bytes, b'I', value.to_le_bytes()),
            Self::I64(value) => add(bytes, b'L', value.to_le_bytes()),
            Self::F64(value) => add(bytes, b'D', value.to_le_bytes()),
            Self::Text(text) => add_sized(bytes, b'S', text.as_bytes())?,
            Self::Bytes(raw) => add_sized(bytes, b'R', raw)?,
            Self::I32s(values) => add_array(bytes, b'i', values.iter().map(|v| v.to_le_bytes()))?,
            Self::I64s(values) => add_array(bytes, b'l', values.iter().map(|v| v.to_le_bytes()))?,
            Self::F32s(values) => add_array(bytes, b'f', values.iter().map(|v| v.to_le_bytes()))?,
            Self::F64s(values) => add_array(bytes, b'd', values.iter().map(|v| v.to_le_bytes()))?,
        }
        Ok(())
    }
}

/// The whole file with these records at its top.
///
/// # Errors
/// Beyond 4 GiB, the limit of 32-bit positions.
pub(super) fn file(nodes: &[Node]) -> io::Result<Vec<u8>> {
    let mut bytes = MAGIC.to_vec();
    bytes.extend(VERSION.to_le_bytes());
    nodes.iter().try_for_each(|node| node.write(&mut bytes))?;
    bytes.extend([0; N_HEADER]);
    bytes.extend(FOOTER_ID);
    bytes.extend([0; 4]);
    // Zeros up to a multiple of 16 bytes, at least one.
    bytes.resize((bytes.len() + 1).next_multiple_of(16), 0);
    bytes.extend(VERSION.to_le_bytes());
    bytes.extend([0; 120]);
    bytes.extend(END);
    Ok(bytes)
}

fn add<const N: usize>(bytes: &mut Vec<u8>, code: u8, value: [u8; N]) {
    bytes.push(code);
    bytes.extend(value);
}

fn add_sized(bytes: &mut Vec<u8>, code: u8, value: &[u8]) -> io::Result<()> {
    add(bytes, code, counted(value.len())?.to_le_bytes());
    bytes.extend(value);
    Ok(())
}

/// Number of values, encoding (1: deflated), number of bytes, bytes.
fn add_array<const N: usize>(bytes: &mut Vec<u8>, code: u8, values: impl Iterator<Item = [u8; N]>) -> io::Result<()> {
    let plain: Vec<u8> = values.flatten().collect();
    let n_values = counted(plain.len() / N)?;
    let (encoding, stored) = if plain.len() < MIN_DEFLATED { (0_u32, plain) } else { (1, deflated(&plain)?) };
    add(bytes, code, n_values.to_le_bytes());
    bytes.extend(encoding.to_le_bytes());
    bytes.extend(counted(stored.len())?.to_le_bytes());
    bytes.extend(stored);
    Ok(())
}

fn deflated(plain: &[u8]) -> io::Result<Vec<u8>> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(plain)?;
    encoder.finish()
}

fn counted(n: usize) -> io::Result<u32> {
    u32::try_from(n).map_err(|_| io::Error::other("the scene exceeds 4 GiB, the limit of an FBX file of version 7.4"))
}

#[cfg(test)]
mod tests;
