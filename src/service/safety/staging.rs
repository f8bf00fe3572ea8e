//! A folder beside the target in which a backup is collected until it is complete.
//!
//! Its name is new for every run, so that backups with similar names do not meet. A lock on the folder, which the kernel
//! releases with the process, distinguishes the folder of a killed run, which the next run removes.

use super::error::BackupError;
use crate::service::store::{folders, new_id, private};
use rustix::fs::FlockOperation;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

const SUFFIX: &str = ".partial";

/// The folder; removed on drop unless it was published.
pub(super) struct Staging {
    path: PathBuf,
    target: PathBuf,
    is_published: bool,
    _lock: File,
}

impl Staging {
    /// Creates the folder and removes those that killed runs for the same target have left.
    pub(super) fn create(target: &Path) -> Result<Self, BackupError> {
        let Some(name) = target.file_name() else {
            return Err(BackupError::Unnamed { path: target.to_owned() });
        };
        let parent = target.parent().filter(|parent| *parent != Path::new("")).unwrap_or(Path::new("."));
        let failed = |source| BackupError::File { path: parent.to_owned(), source };
        std::fs::create_dir_all(parent).map_err(failed)?;
        let prefix = format!(".{}.", name.to_string_lossy());
        remove_stale(parent, &prefix).map_err(failed)?;
        let path = parent.join(format!("{prefix}{}{SUFFIX}", new_id("staging")));
        let created = private::create_folder(&path).and_then(|()| lock(&path));
        let lock = created.map_err(|source| BackupError::File { path: path.clone(), source })?;
        Ok(Self { path, target: target.to_owned(), is_published: false, _lock: lock })
    }

    /// Path of the folder.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Renames the complete folder to its final name; an empty folder of that name is replaced.
    pub(super) fn publish(mut self) -> Result<(), BackupError> {
        let failed = |source| BackupError::File { path: self.target.clone(), source };
        if self.target.exists() {
            std::fs::remove_dir(&self.target).map_err(failed)?;
        }
        folders::publish(&self.path, &self.target).map_err(failed)?;
        self.is_published = true;
        Ok(())
    }
}

impl Drop for Staging {
    fn drop(&mut self) {
        if !self.is_published
            && let Err(error) = std::fs::remove_dir_all(&self.path)
        {
            tracing::warn!(path = %self.path.display(), %error, "cannot be removed; the next backup tries again");
        }
    }
}

fn lock(folder: &Path) -> io::Result<File> {
    let folder = File::open(folder)?;
    rustix::fs::flock(&folder, FlockOperation::NonBlockingLockExclusive)?;
    Ok(folder)
}

fn remove_stale(parent: &Path, prefix: &str) -> io::Result<()> {
    for entry in std::fs::read_dir(parent)? {
        let entry = entry?;
        let name = entry.file_name().to_string_lossy().into_owned();
        let id = name.strip_prefix(prefix).and_then(|rest| rest.strip_suffix(SUFFIX));
        if id.is_some_and(|id| id.starts_with("staging_"))
            && let Ok(_unused) = lock(&entry.path())
        {
            std::fs::remove_dir_all(entry.path())?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = std::fs::read_dir(folder).unwrap();
        entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect()
    }

    #[test]
    fn similar_targets_do_not_meet_and_stale_folders_vanish() {
        let place = tempfile::tempdir().unwrap();
        let [first, second] = ["nightly.2026-11-21", "nightly.2026-11-22"].map(|name| place.path().join(name));
        let killed = place.path().join(".nightly.2026-11-22.staging_0.partial");
        std::fs::create_dir(&killed).unwrap();
        std::fs::write(killed.join("wandless.db"), b"half").unwrap();
        let [a, b] = [&first, &second].map(|target| Staging::create(target).unwrap());
        let again = Staging::create(&second).unwrap(); // a second backup to the same name leaves the first alone
        assert!(b.path().exists() && again.path().exists() && !killed.exists());
        drop(again);
        a.publish().unwrap();
        drop(b);
        assert_eq!(names(place.path()), ["nightly.2026-11-21"]);
    }

    #[test]
    fn refuses_a_target_without_a_name() {
        assert!(matches!(Staging::create(Path::new("..")), Err(BackupError::Unnamed { .. })));
    }
}
