//! A `.usdz` package: a zip archive of stored files, each of which starts at a multiple of 64 bytes (OpenUSD, "Usdz File Format
//! Specification").

use std::io::{self, Cursor, Write};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, System, ZipWriter};

/// Alignment that the specification requires, bytes: readers map files into memory.
const ALIGNMENT: u16 = 64;

/// The package of one layer. The same layer gives the same bytes.
///
/// # Errors
/// Beyond 4 GiB: the specification excludes 64-bit archives.
pub(super) fn package(name: &str, layer: &[u8]) -> io::Result<Vec<u8>> {
    if u32::try_from(layer.len()).is_err() {
        return Err(io::Error::other("the scene exceeds 4 GiB, the limit of a usdz package"));
    }
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Stored)
        .last_modified_time(DateTime::default())
        .system(System::Unix)
        .unix_permissions(0o644)
        .with_alignment(ALIGNMENT);
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    zip.start_file(name, options)?;
    zip.write_all(layer)?;
    Ok(zip.finish()?.into_inner())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_layer_is_stored_at_a_multiple_of_64_bytes() {
        for n in [0, 1, 1000] {
            let layer = vec![b'x'; n];
            let bytes = package("scene.usda", &layer).unwrap();
            let word = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
            // Local file header: method at 8, lengths of name and extra field at 26 and 28.
            assert_eq!((&bytes[..4], word(8)), (&b"PK\x03\x04"[..], 0));
            let start = 30 + usize::from(word(26)) + usize::from(word(28));
            assert_eq!((start % 64, &bytes[start..start + n]), (0, layer.as_slice()));
        }
    }
}
