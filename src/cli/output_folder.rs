//! Output folders: checked before the work, written aside, published when complete.

use super::bad_input::BadInput;
use anyhow::Context;
use std::io;
use std::path::{Path, PathBuf};

/// Rejects an output path that exists and is not an empty folder: a result is never mixed with other files.
pub(super) fn require_free(out: &Path) -> anyhow::Result<()> {
    let what = match std::fs::read_dir(out) {
        Ok(mut entries) => entries.next().map(|entry| match entry {
            Ok(entry) => format!("the folder is not empty ({})", entry.file_name().to_string_lossy()),
            Err(error) => format!("the folder cannot be read ({error})"),
        }),
        // A link to nothing exists, too: no folder could take its name.
        Err(error) => {
            out.symlink_metadata().is_ok().then(|| format!("this is not a folder that can be read ({error})"))
        }
    };
    let Some(what) = what else { return Ok(()) };
    let remedy = "choose a folder that does not exist or is empty";
    Err(BadInput(format!("{}: {what}; {remedy}", out.display())).into())
}

/// Names a folder that [`publish`] turns into `out` when it is complete, so that `out` never holds a partial result: inside an
/// existing `out`, which can be the working folder of a shell or a mounted disk and so cannot be replaced, else beside it. Its name
/// is new: a folder of the user never has to give way. It is made for a moment, to see whether it can be, and again with the
/// first file: work that is interrupted before leaves nothing behind.
pub(super) fn staging_folder(out: &Path) -> anyhow::Result<PathBuf> {
    let (folder, name) = match (out.is_dir(), out.file_name()) {
        (true, _) => (out, "wandless".to_owned()),
        (false, Some(name)) => (out.parent().unwrap_or(Path::new("")), name.to_string_lossy().into_owned()),
        (false, None) => {
            let detail = "the path ends with no name, and there is nothing of it";
            return Err(BadInput(format!("{}: {detail}; write the path of a folder", out.display())).into());
        }
    };
    std::fs::create_dir_all(folder_or_here(folder)).with_context(|| folder.display().to_string())?;
    let process = std::process::id();
    for number in 0..1000 {
        let staging = folder.join(format!(".{name}.{process}-{number}.tmp"));
        match std::fs::create_dir(&staging) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {} // left by an earlier process of this number
            created => {
                created.and_then(|()| std::fs::remove_dir(&staging)).with_context(|| staging.display().to_string())?;
                return Ok(staging);
            }
        }
    }
    anyhow::bail!("{}: the names of 1000 temporary folders are taken; remove .{name}.*.tmp", folder.display())
}

/// Makes an output folder that is filled while the work goes on.
pub(super) fn make_free(out: &Path) -> anyhow::Result<()> {
    require_free(out)?;
    std::fs::create_dir_all(out).with_context(|| out.display().to_string())
}

/// Publishes a complete staging folder as `out`, or removes it after a failure.
pub(super) fn publish<T>(staging: &Path, out: &Path, work: anyhow::Result<T>) -> anyhow::Result<T> {
    if work.is_err() {
        let _ = std::fs::remove_dir_all(staging); // the error of the work matters more
        return work;
    }
    let is_inside = staging.parent() == Some(out);
    let published = if is_inside { move_up(staging, out) } else { std::fs::rename(staging, out) };
    published.with_context(|| format!("{}: the complete result stays in {}", out.display(), staging.display()))?;
    work
}

/// Moves everything in `staging` into the folder around it.
fn move_up(staging: &Path, out: &Path) -> io::Result<()> {
    for entry in std::fs::read_dir(staging)? {
        let entry = entry?;
        std::fs::rename(entry.path(), out.join(entry.file_name()))?;
    }
    std::fs::remove_dir(staging)
}

/// The parent of a bare name is empty, which no call of the system takes.
fn folder_or_here(folder: &Path) -> &Path {
    if folder.as_os_str().is_empty() { Path::new(".") } else { folder }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn publish_report(out: &Path) {
        require_free(out).unwrap();
        let staging = staging_folder(out).unwrap();
        std::fs::create_dir_all(staging.join("smpl")).unwrap();
        std::fs::write(staging.join("report.json"), "{}").unwrap();
        publish(&staging, out, Ok(())).unwrap();
    }

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            folder.read_dir().unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn an_existing_empty_folder_is_filled_and_not_replaced() {
        use std::os::unix::fs::MetadataExt;
        let place = tempfile::tempdir().unwrap();
        let (out, link) = (place.path().join("take"), place.path().join("link"));
        std::fs::create_dir(&out).unwrap();
        std::os::unix::fs::symlink(&out, &link).unwrap();
        let before = out.metadata().unwrap().ino(); // a shell in this folder stays in it
        publish_report(&link);
        assert_eq!((names(&out), out.metadata().unwrap().ino()), (vec!["report.json".into(), "smpl".into()], before));
        assert_eq!(names(place.path()), ["link", "take"]);
        assert!(require_free(&out).unwrap_err().to_string().contains("is not empty ("));
    }

    #[test]
    fn a_folder_of_the_user_named_tmp_is_kept() {
        let place = tempfile::tempdir().unwrap();
        std::fs::create_dir(place.path().join("take.tmp")).unwrap();
        std::fs::write(place.path().join("take.tmp/notes.txt"), "mine").unwrap();
        publish_report(&place.path().join("take"));
        publish_report(&place.path().join("new/take"));
        assert_eq!(names(place.path()), ["new", "take", "take.tmp"]);
        assert_eq!(names(&place.path().join("take.tmp")), ["notes.txt"]);
    }

    #[test]
    fn a_failure_leaves_nothing_behind() {
        let place = tempfile::tempdir().unwrap();
        for out in [place.path().to_owned(), place.path().join("take")] {
            let staging = staging_folder(&out).unwrap();
            assert!(names(place.path()).is_empty(), "an interrupted solve blocked its own folder");
            std::fs::create_dir(&staging).unwrap();
            std::fs::write(staging.join("report.json"), "{}").unwrap();
            assert!(publish(&staging, &out, Err::<(), _>(anyhow::anyhow!("canceled"))).is_err());
            assert!(names(place.path()).is_empty());
        }
        let dangling = place.path().join("dangling");
        std::os::unix::fs::symlink("nowhere", &dangling).unwrap();
        assert!(require_free(&dangling).is_err() && require_free(&place.path().join("none")).is_ok());
        assert!(staging_folder(Path::new("none-at-all/..")).is_err());
    }
}
