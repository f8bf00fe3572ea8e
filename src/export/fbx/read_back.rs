//! A reader of binary FBX for tests, which shares no code with the writer.

use super::node::{Node, Property};
use flate2::read::ZlibDecoder;
use std::io::Read;

/// A record as read; names are not static.
#[derive(Debug, PartialEq)]
pub(super) struct Record {
    pub(super) name: String,
    pub(super) properties: Vec<Property>,
    pub(super) children: Vec<Record>,
}

impl From<&Node> for Record {
    fn from(node: &Node) -> Self {
        let children = node.children.iter().map(Self::from).collect();
        Self { name: node.name.to_owned(), properties: node.properties.clone(), children }
    }
}

struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Reader<'_> {
    fn take(&mut self, n: usize) -> Vec<u8> {
        self.at += n;
        self.bytes[self.at - n..self.at].to_vec()
    }

    fn array<const N: usize>(&mut self) -> [u8; N] {
        self.take(N).try_into().unwrap()
    }

    fn word(&mut self) -> usize {
        u32::from_le_bytes(self.array()) as usize
    }

    /// The values of an array property.
    fn values<const N: usize>(&mut self) -> Vec<[u8; N]> {
        let [n_values, encoding, n_bytes] = [self.word(), self.word(), self.word()];
        let mut stored = self.take(n_bytes);
        if encoding == 1 {
            let mut plain = Vec::new();
            ZlibDecoder::new(stored.as_slice()).read_to_end(&mut plain).unwrap();
            stored = plain;
        }
        assert_eq!(stored.len(), N * n_values);
        stored.chunks_exact(N).map(|chunk| chunk.try_into().unwrap()).collect()
    }

    fn property(&mut self) -> Property {
        match self.take(1)[0] {
            b'C' => Property::Bool(self.take(1)[0] != 0),
            b'I' => Property::I32(i32::from_le_bytes(self.array())),
            b'L' => Property::I64(i64::from_le_bytes(self.array())),
            b'D' => Property::F64(f64::from_le_bytes(self.array())),
            b'S' => {
                let n = self.word();
                Property::Text(String::from_utf8(self.take(n)).unwrap())
            }
            b'R' => {
                let n = self.word();
                Property::Bytes(self.take(n))
            }
            b'i' => Property::I32s(self.values().into_iter().map(i32::from_le_bytes).collect()),
            b'l' => Property::I64s(self.values().into_iter().map(i64::from_le_bytes).collect()),
            b'f' => Property::F32s(self.values().into_iter().map(f32::from_le_bytes).collect()),
            b'd' => Property::F64s(self.values().into_iter().map(f64::from_le_bytes).collect()),
            code => panic!("property code {code}"),
        }
    }

    /// The next record; `None` for one of zeros.
    fn record(&mut self) -> Option<Record> {
        let [end, n_properties, n_value_bytes] = [self.word(), self.word(), self.word()];
        let n_name = usize::from(self.take(1)[0]);
        if end == 0 {
            assert_eq!([n_properties, n_value_bytes, n_name], [0; 3]);
            return None;
        }
        let name = String::from_utf8(self.take(n_name)).unwrap();
        let values = self.at;
        let properties = (0..n_properties).map(|_| self.property()).collect();
        assert_eq!(self.at, values + n_value_bytes, "{name}");
        let mut children = Vec::new();
        while self.at < end {
            match self.record() {
                Some(child) => children.push(child),
                None => assert_eq!(self.at, end, "{name}"),
            }
        }
        assert_eq!(self.at, end, "{name}");
        Some(Record { name, properties, children })
    }
}

/// The records at the top of a file, and the position of its footer.
pub(super) fn read(bytes: &[u8]) -> (Vec<Record>, usize) {
    let mut reader = Reader { bytes, at: 27 };
    let mut records = Vec::new();
    while let Some(record) = reader.record() {
        records.push(record);
    }
    (records, reader.at)
}

impl Record {
    /// The first child of a name.
    pub(super) fn child(&self, name: &str) -> &Self {
        self.children.iter().find(|child| child.name == name).unwrap_or_else(|| panic!("{}: {name}", self.name))
    }

    /// The text of a property.
    pub(super) fn text(&self, i: usize) -> &str {
        match &self.properties[i] {
            Property::Text(text) => text,
            other => panic!("{other:?}"),
        }
    }

    /// The number of a property.
    pub(super) fn number(&self, i: usize) -> f64 {
        match &self.properties[i] {
            Property::I32(value) => f64::from(*value),
            Property::I64(value) => *value as f64,
            Property::F64(value) => *value,
            other => panic!("{other:?}"),
        }
    }

    /// The numbers of an array.
    pub(super) fn numbers(&self) -> Vec<f64> {
        match &self.properties[0] {
            Property::I32s(values) => values.iter().copied().map(f64::from).collect(),
            Property::I64s(values) => values.iter().map(|value| *value as f64).collect(),
            Property::F32s(values) => values.iter().copied().map(f64::from).collect(),
            Property::F64s(values) => values.clone(),
            other => panic!("{other:?}"),
        }
    }
}
