//! Writing of a result's files, with the list of what has been written.

use crate::session::digest::sha256_of_reader;
use crate::session::formats::rounded;
use nalgebra::Vector3;
use serde::Serialize;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// A result folder that is being written.
pub(super) struct ResultFiles {
    dir: PathBuf,
    written: Vec<FileEntry>,
}

/// A file of the result, as the manifest lists it.
#[derive(Debug, Clone, Serialize)]
pub(super) struct FileEntry {
    name: String,
    media_type: &'static str,
    bytes: usize,
    sha256: String,
}

impl ResultFiles {
    pub(super) fn create(dir: &Path) -> io::Result<Self> {
        fs::create_dir_all(dir)?;
        Ok(Self { dir: dir.to_owned(), written: Vec::new() })
    }

    /// Writes a JSON file. Numbers that are not finite become null, since JSON cannot represent them.
    pub(super) fn json(&mut self, name: &str, value: &impl Serialize) -> io::Result<()> {
        let mut bytes = serde_json::to_vec(value)?;
        bytes.push(b'\n');
        self.bytes(name, "application/json", &bytes)
    }

    /// Writes a file; `name` may contain slashes.
    pub(super) fn bytes(&mut self, name: &str, media_type: &'static str, bytes: &[u8]) -> io::Result<()> {
        let path = self.dir.join(name);
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent)?;
        }
        fs::write(path, bytes)?;
        let sha256 = sha256_of_reader(&mut &bytes[..])?;
        self.written.push(FileEntry { name: name.to_owned(), media_type, bytes: bytes.len(), sha256 });
        Ok(())
    }

    /// The names of the written files from the `n`th on.
    pub(super) fn names_from(&self, n: usize) -> Vec<String> {
        self.written.iter().skip(n).map(|file| file.name.clone()).collect()
    }

    /// The written files, in order.
    pub(super) fn written(&self) -> &[FileEntry] {
        &self.written
    }
}

/// Rounds metres or radians for a file to 1e-6, which is below every error of a result.
pub(super) fn micro(value: f64) -> f64 {
    rounded(value, 6)
}

/// Rounds a point or an axis-angle vector for a file.
pub(super) fn micro_entries(vector: &Vector3<f64>) -> [f64; 3] {
    [micro(vector.x), micro(vector.y), micro(vector.z)]
}
