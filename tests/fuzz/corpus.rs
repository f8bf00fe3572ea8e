//! Fuzz inputs: the bytes of one file or the files of an upload, and the seed inputs in the repository.

use std::io::{Cursor, Write};
use std::path::{Path, PathBuf};
use wandless::session::digest::sha256_of_reader;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// Input of a reader.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(crate) struct Input {
    /// Name and bytes of each file; the name of a single file is empty.
    pub(crate) members: Vec<(String, Vec<u8>)>,
}

/// Start of the line that introduces a member in a text seed.
const MEMBER: &str = "=== ";

impl Input {
    /// Input of one file.
    pub(crate) fn file(bytes: Vec<u8>) -> Self {
        Self { members: vec![(String::new(), bytes)] }
    }

    /// Parses a seed: a text whose members follow lines `=== name`, or otherwise one file.
    pub(crate) fn parse(bytes: Vec<u8>) -> Self {
        let Some(text) = std::str::from_utf8(&bytes).ok().filter(|text| text.starts_with(MEMBER)) else {
            return Self::file(bytes);
        };
        let next = format!("\n{MEMBER}");
        let parts = text[MEMBER.len()..].split(&next);
        let member = |part: &str| {
            let (name, content) = part.split_once('\n').unwrap_or((part, ""));
            (name.to_owned(), content.as_bytes().to_vec())
        };
        Self { members: parts.map(member).collect() }
    }

    /// Bytes of the first file.
    pub(crate) fn bytes(&self) -> &[u8] {
        self.members.first().map_or(&[], |(_, bytes)| bytes)
    }

    /// All members as a zip. Members that a writer rejects (repeated names) are left out.
    pub(crate) fn zipped(&self) -> Vec<u8> {
        let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
        for (i, (name, content)) in self.members.iter().enumerate() {
            let method = if i % 2 == 0 { CompressionMethod::Stored } else { CompressionMethod::Deflated };
            let options = SimpleFileOptions::default().compression_method(method);
            if zip.start_file(name, options).is_ok() {
                let _ = zip.write_all(content); // writing to memory does not fail
            }
        }
        zip.finish().map(Cursor::into_inner).unwrap_or_default()
    }

    /// Writes the input into `folder` as a seed named by its digest.
    ///
    /// # Errors
    /// Errors of the file system.
    pub(crate) fn write(&self, folder: &Path) -> std::io::Result<PathBuf> {
        let mut text = Vec::new();
        for (name, bytes) in &self.members {
            if !name.is_empty() {
                text.extend_from_slice(format!("{MEMBER}{name}\n").as_bytes());
            }
            text.extend_from_slice(bytes);
            if !name.is_empty() {
                text.push(b'\n');
            }
        }
        std::fs::create_dir_all(folder)?;
        let path = folder.join(&sha256_of_reader(&mut text.as_slice())?[..16]);
        std::fs::write(&path, text)?;
        Ok(path)
    }
}

/// Reads all seeds of a folder in the order of their names. At least one is expected.
pub(crate) fn read_seeds(folder: &Path) -> Vec<Input> {
    let entries = std::fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let mut paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    paths.sort();
    assert!(!paths.is_empty(), "{}: the folder contains no seeds", folder.display());
    paths.iter().map(|path| Input::parse(std::fs::read(path).unwrap())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_round_trip() {
        let members = vec![("a.json".to_owned(), b"{}".to_vec()), ("b/c.txt".to_owned(), b"1\n2".to_vec())];
        let folder = tempfile::tempdir().unwrap();
        for input in [Input { members }, Input::file(b"\xff\x00=== x".to_vec())] {
            let mut read = Input::parse(std::fs::read(input.write(folder.path()).unwrap()).unwrap());
            if let Some((_, last)) = read.members.last_mut().filter(|(name, _)| !name.is_empty()) {
                assert_eq!(last.pop(), Some(b'\n'));
            }
            assert_eq!(read, input);
        }
    }
}
