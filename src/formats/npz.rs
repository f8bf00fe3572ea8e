//! `.npz` archives: named NumPy arrays in a zip. The same arrays give the same bytes: members carry no clock.

use super::npy::{Array, NpyError};
use npyz::npz::file_name_from_array_name;
use npyz::{AutoSerialize, DType, Serialize, WriterBuilder};
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
        match self.0.by_name(&file_name_from_array_name(name)) {
            Err(zip::result::ZipError::FileNotFound) => Ok(None),
            Err(error) => Err(error.into()),
            Ok(mut member) => Array::read(&mut member, limit).map(Some),
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
    pub fn array<T: AutoSerialize>(
        &mut self,
        name: &str,
        shape: &[usize],
        values: impl IntoIterator<Item = T>,
    ) -> io::Result<()> {
        self.typed(name, shape, T::default_dtype(), values)
    }

    /// Adds a string as a scalar array of numpy's unicode type.
    ///
    /// # Errors
    /// What the writer reports.
    pub fn text(&mut self, name: &str, text: &str) -> io::Result<()> {
        let type_text = format!("<U{}", text.chars().count());
        let dtype = type_text.parse().map(DType::Plain);
        let dtype = dtype.map_err(|_| io::Error::other(format!("{type_text} is not a numpy type")))?;
        self.typed(name, &[], dtype, [text.to_owned()])
    }

    /// Writes the directory and returns the file.
    ///
    /// # Errors
    /// What the writer reports.
    pub fn finish(self) -> io::Result<W> {
        Ok(self.zip.finish()?)
    }

    fn typed<T: Serialize>(
        &mut self,
        name: &str,
        shape: &[usize],
        dtype: DType,
        values: impl IntoIterator<Item = T>,
    ) -> io::Result<()> {
        let options = SimpleFileOptions::default()
            .compression_method(self.compression)
            .last_modified_time(DateTime::default())
            .system(System::Unix)
            .unix_permissions(0o644);
        let shape: Vec<u64> = shape.iter().map(|n| *n as u64).collect();
        let mut bytes = Vec::new();
        let mut writer = npyz::WriteOptions::new().dtype(dtype).shape(&shape).writer(&mut bytes).begin_nd()?;
        writer.extend(values)?;
        writer.finish()?;
        self.zip.start_file(file_name_from_array_name(name), options)?;
        self.zip.write_all(&bytes)
    }
}
