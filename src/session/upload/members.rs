//! The files of an upload by name: those of a folder or of a zip.
//!
//! Names of members are looked up in a list that was read beforehand; a member's name is never joined to a path.

use super::error::{Fault, UploadError, shown};
use super::limits::UploadLimits;
use super::zip_index::index_zip;
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{BufReader, Read, Seek};
use std::path::{Path, PathBuf};
use zip::ZipArchive;

/// Files by name.
pub(crate) enum Members<R> {
    /// Files of a folder on this machine.
    Folder(BTreeMap<String, PathBuf>),
    /// Members of an archive, by position.
    Zip(Box<ZipArchive<BufReader<R>>>, BTreeMap<String, usize>),
}

impl Members<File> {
    /// Every file below the folder except hidden ones; links are followed, for the folder belongs to the user. Of `gt/`
    /// (ground truth) only the name is listed: its content is never read.
    pub(super) fn of_folder(dir: &Path, limits: &UploadLimits) -> Result<Self, UploadError> {
        let mut files = BTreeMap::new();
        add_files(&mut files, dir, "", limits, 0)?;
        Ok(Self::Folder(files))
    }
}

/// Largest depth: tools nest take, camera and kind of file. It also ends cycles of links.
const MAX_FOLDER_DEPTH: usize = 6;

fn add_files(
    files: &mut BTreeMap<String, PathBuf>,
    dir: &Path,
    prefix: &str,
    limits: &UploadLimits,
    depth: usize,
) -> Result<(), UploadError> {
    let unreadable = |e: std::io::Error| UploadError {
        file: Some(dir.display().to_string()),
        ..Fault::FileUnreadable.with(e.to_string())
    };
    for entry in fs::read_dir(dir).map_err(unreadable)? {
        let entry = entry.map_err(unreadable)?;
        // Camera names are Unicode; a file with another name is ignored.
        let Ok(name) = entry.file_name().into_string() else { continue };
        if name.starts_with('.') && depth == 0 {
            continue;
        }
        let (path, name) = (entry.path(), format!("{prefix}{name}"));
        if name == "gt" && path.is_dir() {
            files.insert("gt/".to_owned(), path);
        } else if path.is_dir() && depth < MAX_FOLDER_DEPTH {
            add_files(files, &path, &format!("{name}/"), limits, depth + 1)?;
        } else if path.is_file() {
            files.insert(name, path);
        }
        if files.len() > limits.max_members {
            return Err(Fault::TooManyMembers.with(format!("the folder has more than {} files", limits.max_members)));
        }
    }
    Ok(())
}

impl<R: Read + Seek> Members<R> {
    /// The members of a zip whose directory has passed every check.
    pub(super) fn of_zip(reader: R, limits: &UploadLimits) -> Result<Self, UploadError> {
        let index = index_zip(BufReader::new(reader), limits)?;
        Ok(Self::Zip(Box::new(index.archive), index.positions))
    }

    /// All names, sorted.
    pub(crate) fn names(&self) -> Box<dyn Iterator<Item = &str> + '_> {
        match self {
            Self::Folder(files) => Box::new(files.keys().map(String::as_str)),
            Self::Zip(_, positions) => Box::new(positions.keys().map(String::as_str)),
        }
    }

    /// Whether a file of this name exists.
    pub(crate) fn contains(&self, name: &str) -> bool {
        match self {
            Self::Folder(files) => files.contains_key(name),
            Self::Zip(_, positions) => positions.contains_key(name),
        }
    }

    /// Opens a file for reading.
    pub(crate) fn open(&mut self, name: &str) -> Result<Box<dyn Read + '_>, UploadError> {
        let missing = || Fault::FileUnreadable.with(format!("file {} does not exist", shown(name)));
        let failed = |detail: String| UploadError { file: Some(name.to_owned()), ..Fault::ZipCorrupt.with(detail) };
        match self {
            Self::Folder(files) => {
                let file = File::open(files.get(name).ok_or_else(missing)?);
                let unreadable = |e: std::io::Error| Fault::FileUnreadable.with(e.to_string());
                Ok(Box::new(file.map_err(|e| UploadError { file: Some(name.to_owned()), ..unreadable(e) })?))
            }
            Self::Zip(archive, positions) => {
                let position = *positions.get(name).ok_or_else(missing)?;
                Ok(Box::new(archive.by_index(position).map_err(|e| failed(e.to_string()))?))
            }
        }
    }
}
