//! Body models registered by the operator: `<data>/bodies/<name>.json` maps a name to a converted body file.
//!
//! The bodies are licensed to the operator only: files have mode 0600, and no result or response contains them.

use crate::body::BodyModel;
use crate::body::loader::{BodyFileError, LandmarkTable, body_from_bytes, load_body_cached, write_private};
use crate::pipeline::config::DEFAULT_BODY;
use serde::{Deserialize, Serialize};
use std::io;
use std::path::{Path, PathBuf};

/// Maximal length of a name, characters.
const MAX_NAME: usize = 64;

/// A registered body.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RegisteredBody {
    /// Name that jobs use.
    pub name: String,
    /// File name of the converted body in the same folder.
    pub file: String,
}

/// Why a body cannot be registered or found.
#[derive(Debug, thiserror::Error)]
pub enum BodyRegistryError {
    /// The name is invalid.
    #[error(
        "{name:?} is not a valid body name; use 1 to {MAX_NAME} of the characters a-z, 0-9, - and _, but not \"{DEFAULT_BODY}\""
    )]
    Name {
        /// The given name.
        name: String,
    },
    /// No body is registered under this name.
    #[error("no body is registered as {name:?}; register it with `wandless body add`")]
    Unknown {
        /// The name.
        name: String,
    },
    /// The body file is invalid.
    #[error(transparent)]
    File(#[from] BodyFileError),
    /// The registry cannot be read or written.
    #[error("{path}: {source}", path = .path.display())]
    Registry {
        /// Path of the file or folder.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
}

/// Returns the folder of bodies in a data folder.
pub fn folder(data: &Path) -> PathBuf {
    data.join("bodies")
}

/// Converts a body file and registers it; an existing name then refers to the new body.
///
/// # Errors
/// [`BodyRegistryError`] for an invalid name, file or folder.
pub fn add(
    folder: &Path,
    name: &str,
    source: &Path,
    landmarks: &LandmarkTable,
) -> Result<BodyModel, BodyRegistryError> {
    check_name(name)?;
    let cached = load_body_cached(source, landmarks, folder)?;
    let file = cached.file.file_name().map_or_else(String::new, |file| file.to_string_lossy().into_owned());
    let body = RegisteredBody { name: name.to_owned(), file };
    let path = entry(folder, name);
    let json = serde_json::to_vec(&body).map_err(io::Error::from);
    json.and_then(|json| write_private(&path, &json)).map_err(|source| BodyRegistryError::Registry { path, source })?;
    Ok(BodyModel { name: name.to_owned(), ..cached.model })
}

/// Lists the registered bodies by name; none if the folder is missing.
///
/// # Errors
/// [`BodyRegistryError::Registry`] when the folder cannot be read.
pub fn list(folder: &Path) -> Result<Vec<RegisteredBody>, BodyRegistryError> {
    names(folder)?.iter().map(|name| find(folder, name)).collect()
}

fn names(folder: &Path) -> Result<Vec<String>, BodyRegistryError> {
    let fail = |source| BodyRegistryError::Registry { path: folder.to_owned(), source };
    let entries = match std::fs::read_dir(folder) {
        Ok(entries) => entries.collect::<io::Result<Vec<_>>>().map_err(fail)?,
        Err(error) if error.kind() == io::ErrorKind::NotFound => Vec::new(),
        Err(error) => return Err(fail(error)),
    };
    let files = entries.iter().map(|entry| entry.path()).filter(|path| path.extension().is_some_and(|e| e == "json"));
    let mut names: Vec<String> = files.filter_map(|path| Some(path.file_stem()?.to_str()?.to_owned())).collect();
    names.sort();
    Ok(names)
}

/// Names of the files that describe the registered bodies, below the folder, without their converted bodies.
///
/// # Errors
/// [`BodyRegistryError::Registry`] when the folder cannot be read.
pub(super) fn entry_files(folder: &Path) -> Result<Vec<String>, BodyRegistryError> {
    Ok(names(folder)?.iter().map(|name| format!("{name}.json")).collect())
}

/// Loads the body model of a name.
///
/// # Errors
/// [`BodyRegistryError::Unknown`], or why its file cannot be read.
pub fn load(folder: &Path, name: &str) -> Result<BodyModel, BodyRegistryError> {
    let path = folder.join(find(folder, name)?.file);
    let bytes = std::fs::read(&path).map_err(|source| BodyRegistryError::Registry { path, source })?;
    Ok(body_from_bytes(name.to_owned(), &bytes, &LandmarkTable::default())?)
}

fn find(folder: &Path, name: &str) -> Result<RegisteredBody, BodyRegistryError> {
    let unknown = || BodyRegistryError::Unknown { name: name.to_owned() };
    check_name(name).map_err(|_| unknown())?;
    let path = entry(folder, name);
    let read = std::fs::read(&path).and_then(|json| Ok(serde_json::from_slice(&json)?));
    read.map_err(|source| match source.kind() {
        io::ErrorKind::NotFound => unknown(),
        _ => BodyRegistryError::Registry { path, source },
    })
}

fn entry(folder: &Path, name: &str) -> PathBuf {
    folder.join(format!("{name}.json"))
}

/// Checks a name; only characters that are safe in file names are allowed.
fn check_name(name: &str) -> Result<(), BodyRegistryError> {
    let is_plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-' || c == '_';
    let fits = (1..=MAX_NAME).contains(&name.len()) && name.chars().all(is_plain) && name != DEFAULT_BODY;
    if fits { Ok(()) } else { Err(BodyRegistryError::Name { name: name.to_owned() }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::default_body;
    use crate::body::loader::body_npz;

    #[test]
    fn finds_registered_bodies_by_name() {
        let data = tempfile::tempdir().unwrap();
        let bodies = folder(data.path());
        assert_eq!(list(&bodies).unwrap(), []);
        let source = data.path().join("some.npz");
        std::fs::write(&source, body_npz(&default_body().surface, true).unwrap()).unwrap();
        let added = add(&bodies, "studio", &source, &LandmarkTable::default()).unwrap();
        add(&bodies, "again", &source, &LandmarkTable::default()).unwrap();
        assert!(load(&bodies, "studio").unwrap() == added);
        let listed = list(&bodies).unwrap();
        assert_eq!(listed.iter().map(|body| body.name.as_str()).collect::<Vec<_>>(), ["again", "studio"]);
        assert_eq!(listed[0].file, listed[1].file, "one file, converted once");
        for entry in std::fs::read_dir(&bodies).unwrap() {
            let mode = std::os::unix::fs::PermissionsExt::mode(&entry.unwrap().metadata().unwrap().permissions());
            assert_eq!(mode & 0o777, 0o600);
        }
    }

    #[test]
    fn rejects_names_that_leave_the_folder() {
        let data = tempfile::tempdir().unwrap();
        std::fs::write(data.path().join("outside.json"), r#"{"name": "outside", "file": "x"}"#).unwrap();
        for name in ["", "default", "../outside", "Studio", "a/b", "a.b", &"x".repeat(65)] {
            assert!(matches!(load(&folder(data.path()), name), Err(BodyRegistryError::Unknown { .. })), "{name}");
            let added = add(&folder(data.path()), name, Path::new("none"), &LandmarkTable::default());
            assert!(matches!(added, Err(BodyRegistryError::Name { .. })), "{name}");
        }
    }
}
