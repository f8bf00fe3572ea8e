//! `.npz` archives: named NumPy arrays in a zip. The same arrays give the same bytes: members have no timestamps.

use super::npy::{Array, Limits, NpyError};
use std::io::{self, Read, Seek, Write};
use zip::write::SimpleFileOptions;
use zip::{DateTime, System, ZipArchive, ZipWriter};

pub use zip::CompressionMethod;

/// Reads the arrays of an archive.
pub struct NpzReader<R>(ZipArchive<R>);

impl<R: Read + Seek> NpzReader<R> {
    /// Opens an archive.
    ///
    /// # Errors
    /// [`NpyError::Archive`].
    pub fn new(file: R) -> Result<Self, NpyError> {
        Ok(Self(ZipArchive::new(file)?))
    }

    /// The array of a name, of at most `limit` numbers; `None` where the archive has none of that name.
    ///
    /// # Errors
    /// [`NpyError`].
    pub fn array(&mut self, name: &str, limit: usize) -> Result<Option<Array>, NpyError> {
        self.leading(name, usize::MAX, Limits { read: limit, kept: limit })
    }

    /// The array of a name with the first `n_leading` entries of its last axis; `None` where the archive has none of that name.
    ///
    /// # Errors
    /// [`NpyError`].
    pub fn leading(&mut self, name: &str, n_leading: usize, limits: Limits) -> Result<Option<Array>, NpyError> {
        match self.0.by_name(&format!("{name}.npy")) {
            Err(zip::result::ZipError::FileNotFound) => Ok(None),
            Err(error) => Err(error.into()),
            Ok(mut member) => Array::read_leading(&mut member, n_leading, limits).map(Some),
        }
    }
}

/// Writes arrays one after the other.
pub struct NpzWriter<W: Write + Seek> {
    zip: ZipWriter<W>,
    compression: CompressionMethod,
}

impl<W: Write + Seek> NpzWriter<W> {
    /// An empty archive.
    pub fn new(file: W, compression: CompressionMethod) -> Self {
        Self { zip: ZipWriter::new(file), compression }
    }

    /// Adds an array in C order.
    ///
    /// # Errors
    /// What the writer reports, and values whose number is not the product of the shape.
    pub fn array<T: Number>(
        &mut self,
        name: &str,
        shape: &[usize],
        values: impl IntoIterator<Item = T>,
    ) -> io::Result<()> {
        let mut bytes = Vec::new();
        let n_values = values.into_iter().map(|value| value.append(&mut bytes)).count();
        if n_values != shape.iter().product::<usize>() {
            return Err(io::Error::other(format!("array {name}: {n_values} values for shape {shape:?}")));
        }
        self.member(name, shape, T::TYPE, &bytes)
    }

    /// Adds a string as a scalar array of numpy's unicode type.
    ///
    /// # Errors
    /// What the writer reports.
    pub fn text(&mut self, name: &str, text: &str) -> io::Result<()> {
        let bytes: Vec<u8> = text.chars().flat_map(|c| u32::from(c).to_le_bytes()).collect();
        self.member(name, &[], &format!("<U{}", text.chars().count()), &bytes)
    }

    /// Writes the directory and returns the file.
    ///
    /// # Errors
    /// What the writer reports.
    pub fn finish(self) -> io::Result<W> {
        Ok(self.zip.finish()?)
    }

    fn member(&mut self, name: &str, shape: &[usize], number_type: &str, values: &[u8]) -> io::Result<()> {
        let options = SimpleFileOptions::default()
            .compression_method(self.compression)
            .last_modified_time(DateTime::default())
            .system(System::Unix)
            .unix_permissions(0o644);
        let lengths: String = shape.iter().map(|n| format!("{n}, ")).collect();
        let text = format!("{{'descr': '{number_type}', 'fortran_order': False, 'shape': ({lengths}), }}");
        // Spaces and a line break end the header at a multiple of 64 bytes, 10 bytes of version and length included.
        let length = (text.len() + 11).next_multiple_of(64) - 10;
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend(u16::try_from(length).map_err(io::Error::other)?.to_le_bytes());
        bytes.extend(format!("{text:<0$}\n", length - 1).into_bytes());
        bytes.extend(values);
        self.zip.start_file(format!("{name}.npy"), options)?;
        self.zip.write_all(&bytes)
    }
}

/// A number type that archives are written with.
pub trait Number {
    /// numpy's name of the type.
    const TYPE: &'static str;
    /// Appends the number in little-endian order.
    fn append(self, bytes: &mut Vec<u8>);
}

macro_rules! number {
    ($($number:ty, $name:literal;)*) => {$(
        impl Number for $number {
            const TYPE: &'static str = $name;
            fn append(self, bytes: &mut Vec<u8>) {
                bytes.extend(self.to_le_bytes());
            }
        }
    )*};
}

number! { f64, "<f8"; f32, "<f4"; i64, "<i8"; u32, "<u4"; u8, "|u1"; }

impl Number for bool {
    const TYPE: &'static str = "|b1";
    fn append(self, bytes: &mut Vec<u8>) {
        bytes.push(u8::from(self));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use npyz::WriterBuilder;
    use std::io::Cursor;

    /// The members of an archive with one array have the bytes that an independent writer gives.
    fn assert_bytes<T: Number + npyz::AutoSerialize + Copy>(shape: &[usize], values: &[T]) {
        let mut npz = NpzWriter::new(Cursor::new(Vec::new()), CompressionMethod::Stored);
        npz.array("a", shape, values.iter().copied()).unwrap();
        let mut ours = Vec::new();
        ZipArchive::new(npz.finish().unwrap()).unwrap().by_name("a.npy").unwrap().read_to_end(&mut ours).unwrap();
        let (mut expected, lengths) = (Vec::new(), shape.iter().map(|n| *n as u64).collect::<Vec<_>>());
        let options = npyz::WriteOptions::new().default_dtype().shape(&lengths);
        let mut writer = options.writer(&mut expected).begin_nd().unwrap();
        writer.extend(values.iter().copied()).unwrap();
        writer.finish().unwrap();
        assert_eq!(ours, expected);
    }

    #[test]
    fn bytes_match_an_independent_writer() {
        assert_bytes(&[2, 3], &[1.5_f64, -0.0, f64::NAN, 1e300, 2.0, 3.0]);
        assert_bytes(&[], &[2.5_f32]);
        assert_bytes(&[2], &[i64::MIN, 7]);
        assert_bytes(&[1, 1, 1, 1, 1, 1, 1, 1, 2], &[u32::MAX, 1]);
        assert_bytes(&[3], &[0_u8, 10, 255]);
        assert_bytes(&[0], &[true; 0]);
        let wrong_count = NpzWriter::new(Cursor::new(Vec::new()), CompressionMethod::Stored).array("a", &[3], [1.0]);
        assert!(wrong_count.is_err());
    }
}
