//! Writing of a result's files, with the list of what has been written.

use crate::session::digest::sha256_of_reader;
use crate::session::formats::rounded;
use nalgebra::Vector3;
use rayon::prelude::*;
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
        self.bytes(name, JSON, &json_bytes(value)?)
    }

    /// Writes a file; `name` may contain slashes.
    pub(super) fn bytes(&mut self, name: &str, media_type: &'static str, bytes: &[u8]) -> io::Result<()> {
        self.written.push(written(&self.dir, name, media_type, bytes)?);
        Ok(())
    }

    /// Makes and writes files side by side; they are listed in the order of the drafts.
    pub(super) fn drafts(&mut self, drafts: &[Draft<'_>]) -> io::Result<()> {
        let write = |draft: &Draft<'_>| written(&self.dir, draft.name, draft.media_type, &(draft.content)()?);
        let entries: Vec<FileEntry> = drafts.par_iter().map(write).collect::<io::Result<_>>()?;
        self.written.extend(entries);
        Ok(())
    }

    /// The same folder with an empty list.
    pub(super) fn beside(&self) -> Self {
        Self { dir: self.dir.clone(), written: Vec::new() }
    }

    /// Lists the files of another list after those of this one.
    pub(super) fn append(&mut self, other: Self) {
        self.written.extend(other.written);
    }

    /// The names of the written files, in order.
    pub(super) fn names(&self) -> Vec<String> {
        self.written.iter().map(|file| file.name.clone()).collect()
    }

    /// The written files, in order.
    pub(super) fn written(&self) -> &[FileEntry] {
        &self.written
    }
}

/// A file whose content is made when it is written.
pub(super) struct Draft<'a> {
    name: &'static str,
    media_type: &'static str,
    content: Content<'a>,
}

type Content<'a> = Box<dyn Fn() -> io::Result<Vec<u8>> + Send + Sync + 'a>;

impl<'a> Draft<'a> {
    /// A JSON file, as [`ResultFiles::json`] writes it.
    pub(super) fn json<T: Serialize>(name: &'static str, value: impl Fn() -> T + Send + Sync + 'a) -> Self {
        Self { name, media_type: JSON, content: Box::new(move || json_bytes(&value())) }
    }

    /// A file of bytes.
    pub(super) fn bytes(
        name: &'static str,
        media_type: &'static str,
        content: impl Fn() -> io::Result<Vec<u8>> + Send + Sync + 'a,
    ) -> Self {
        Self { name, media_type, content: Box::new(content) }
    }
}

const JSON: &str = "application/json";

fn json_bytes(value: &impl Serialize) -> io::Result<Vec<u8>> {
    let mut bytes = serde_json::to_vec(value)?;
    bytes.push(b'\n');
    Ok(bytes)
}

fn written(dir: &Path, name: &str, media_type: &'static str, bytes: &[u8]) -> io::Result<FileEntry> {
    let path = dir.join(name);
    if let Some(parent) = path.parent() {
        fs::create_dir_all(parent)?;
    }
    fs::write(path, bytes)?;
    let sha256 = sha256_of_reader(&mut &bytes[..])?;
    Ok(FileEntry { name: name.to_owned(), media_type, bytes: bytes.len(), sha256 })
}

/// Rounds metres or radians for a file to 1e-6, which is below every error of a result.
pub(super) fn micro(value: f64) -> f64 {
    rounded(value, 6)
}

/// Rounds a point or an axis-angle vector for a file.
pub(super) fn micro_entries(vector: &Vector3<f64>) -> [f64; 3] {
    [micro(vector.x), micro(vector.y), micro(vector.z)]
}
