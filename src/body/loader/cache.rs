//! Cache of converted bodies: a user's file is converted once to our own layout, named by the digest of its source.
//!
//! The cached files contain the user's licensed model: they have mode 0600, in a folder of the operator's. Single
//! precision (0.1 micrometres); the first reading returns the same body as all later ones.

use super::error::BodyFileError;
use super::landmark_table::LandmarkTable;
use super::read::{body_from_bytes, file_bytes, stem};
use super::write::body_npz;
use crate::body::model::BodyModel;
use sha2::{Digest, Sha256};
use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// A body and its file in the cache.
#[derive(Debug, Clone, PartialEq)]
pub struct CachedBody {
    /// The model as read from the cache.
    pub model: BodyModel,
    /// Path of its file.
    pub file: PathBuf,
}

/// [`super::load_body`] through a cache in `folder`, which is created if it does not exist.
///
/// # Errors
/// As [`super::load_body`], and when the folder cannot be written.
pub fn load_body_cached(path: &Path, landmarks: &LandmarkTable, folder: &Path) -> Result<CachedBody, BodyFileError> {
    let bytes = file_bytes(path)?;
    let name = stem(path);
    let file = folder.join(format!("{}.npz", key(&bytes, landmarks)));
    if !file.exists() {
        let surface = &body_from_bytes(name.clone(), &bytes, landmarks)?.surface;
        std::fs::create_dir_all(folder)?;
        write_private(&file, &body_npz(surface, false)?)?;
    }
    drop(bytes);
    let model = body_from_bytes(name, &file_bytes(&file)?, &LandmarkTable::default())?;
    Ok(CachedBody { model, file })
}

/// Writes a file that only its owner can read (mode 0600), completely or not at all.
///
/// # Errors
/// When the file system fails.
pub fn write_private(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let partial = path.with_extension(format!("{}.part", std::process::id()));
    let written = private_file(&partial).and_then(|mut file| {
        file.write_all(bytes)?;
        file.sync_all()?;
        std::fs::rename(&partial, path)
    });
    if written.is_err() {
        let _ = std::fs::remove_file(&partial); // do not leave an incomplete file
    }
    written
}

fn private_file(path: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.write(true).create(true).truncate(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    options.open(path)
}

/// SHA-256 over the file and the landmarks added to it.
fn key(bytes: &[u8], landmarks: &LandmarkTable) -> String {
    let mut hash = Sha256::new();
    hash.update(bytes);
    for point in &landmarks.points {
        hash.update(point.name.as_bytes());
        for share in &point.vertices {
            hash.update((share.vertex as u64).to_le_bytes());
            hash.update(share.weight.to_le_bytes());
        }
    }
    hex::encode(hash.finalize())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::default_body;

    #[test]
    fn cached_body_is_unchanged_and_private() {
        let folder = tempfile::tempdir().unwrap();
        let (source, cache) = (folder.path().join("own.npz"), folder.path().join("cache"));
        std::fs::write(&source, body_npz(&default_body().surface, true).unwrap()).unwrap();
        let first = load_body_cached(&source, &LandmarkTable::default(), &cache).unwrap();
        // Skin weights are normalised again when read, which may change their last bit.
        let joints = first.model.rest_joints.iter().zip(default_body().rest_joints);
        assert!(joints.map(|(a, b)| (a - b).norm()).fold(0.0, f64::max) < 1e-6);
        assert!(first.model.surface.vertices == default_body().surface.vertices);
        assert_eq!(first.model.name, "own");
        let written = std::fs::metadata(&first.file).unwrap().modified().unwrap();
        let second = load_body_cached(&source, &LandmarkTable::default(), &cache).unwrap();
        assert!(second == first);
        assert_eq!(std::fs::metadata(&first.file).unwrap().modified().unwrap(), written, "read, not written again");
        #[cfg(unix)]
        {
            let mode = std::os::unix::fs::PermissionsExt::mode(&std::fs::metadata(&first.file).unwrap().permissions());
            assert_eq!(mode & 0o777, 0o600);
        }
        let nose = LandmarkTable::from_json(br#"{"nose": [{"vertex": 5, "weight": 1.0}]}"#).unwrap();
        let other = load_body_cached(&source, &nose, &cache).unwrap();
        assert_ne!(other.file, first.file, "other landmarks, another body");
        assert!(load_body_cached(&folder.path().join("none.npz"), &nose, &cache).is_err());
    }
}
