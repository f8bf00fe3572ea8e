//! Files and folders that can be read as long as a value exists.

#[cfg(feature = "scale")]
use super::cache::Pin;
use std::path::PathBuf;

/// A file that can be read as long as this value exists.
#[derive(Debug)]
pub(crate) struct LocalFile {
    /// Path of the file.
    pub(crate) path: PathBuf,
    #[cfg(feature = "scale")]
    #[allow(dead_code)] // ends with this value
    pub(super) pin: Option<Pin>,
}

/// A result folder that can be read as long as this value exists.
#[derive(Debug)]
pub(crate) struct LocalResult {
    /// Path of the folder.
    pub(crate) path: PathBuf,
    #[cfg(feature = "scale")]
    #[allow(dead_code)] // ends with this value
    pub(super) copy: Option<Assembled>,
}

impl LocalFile {
    pub(super) fn in_folder(path: PathBuf) -> Self {
        Self {
            path,
            #[cfg(feature = "scale")]
            pin: None,
        }
    }
}

impl LocalResult {
    pub(super) fn in_folder(path: PathBuf) -> Self {
        Self {
            path,
            #[cfg(feature = "scale")]
            copy: None,
        }
    }
}

/// A folder that was put together from copies; removed on drop.
#[cfg(feature = "scale")]
#[derive(Debug)]
pub(crate) struct Assembled(pub(super) PathBuf);

#[cfg(feature = "scale")]
impl Drop for Assembled {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0); // the next start clears `tmp/`
    }
}
