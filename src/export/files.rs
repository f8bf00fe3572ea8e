//! The files of a result and what has been written of them.

use crate::session::digest::sha256_of_reader;
use crate::session::formats::rounded;
use nalgebra::Vector3;
use serde::Serialize;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// A result folder being written.
pub(super) struct ResultFiles {
    dir: PathBuf,
    written: Vec<FileEntry>,
}

/// One file of the result, as the manifest lists it.
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

    /// Writes a JSON file. A number that is not finite becomes null: JSON has no word for it.
    pub(super) fn json(&mut self, name: &str, value: &impl Serialize) -> io::Result<()> {
        let mut bytes = serde_json::to_vec(value)?;
        bytes.push(b'\n');
        self.bytes(name, "application/json", &bytes)
    }

    /// Writes a file; `name` may hold slashes.
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

    /// The names of what has been written from the `n`th file on.
    pub(super) fn names_from(&self, n: usize) -> Vec<String> {
        self.written.iter().skip(n).map(|file| file.name.clone()).collect()
    }

    /// What has been written, in order.
    pub(super) fn written(&self) -> &[FileEntry] {
        &self.written
    }
}

/// Metres or radians as they are written: a micrometre and a microradian are below every error of ours.
pub(super) fn micro(value: f64) -> f64 {
    rounded(value, 6)
}

/// A point or an axis-angle vector as it is written.
pub(super) fn micro_entries(vector: &Vector3<f64>) -> [f64; 3] {
    [micro(vector.x), micro(vector.y), micro(vector.z)]
}
