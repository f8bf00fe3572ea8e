//! Uploads, results and checkpoints: stored under their keys, each read back and compared with its digest.

use super::error::TransferError;
use super::moved::{FileProgress, Moved};
use super::source::Source;
use crate::service::store::Store;
use crate::service::store::artifacts::digest_file;
use futures_util::StreamExt;
use std::path::{Path, PathBuf};

/// Files that are stored at the same time.
const AT_ONCE: usize = 4;

/// A file of the data folder.
struct File {
    path: PathBuf,
    /// Key in the object store.
    key: String,
    /// SHA-256 that its row states; a checkpoint has none.
    sha256: Option<String>,
}

/// What became of a file.
enum Stored {
    /// It is in the object store; `was_known`: before.
    There { bytes: u64, was_known: bool },
    /// It is missing or damaged in the data folder.
    Damaged(String),
}

/// Stores every file that a row names, and the checkpoints of the open jobs.
///
/// # Errors
/// When the object store fails, or files of the data folder are missing or damaged.
pub(super) async fn store(
    source: &Source,
    folder: &Path,
    target: &Store,
    moved: &mut Moved,
    progress: impl Fn(FileProgress),
) -> Result<(), TransferError> {
    let mut files = named_files(source, folder).await?;
    files.extend(checkpoints(source, folder).await?);
    let total = files.len();
    let mut stored =
        futures_util::stream::iter(files.into_iter().map(|file| store_one(target, file))).buffer_unordered(AT_ONCE);
    let mut damages = Vec::new();
    while let Some(file) = stored.next().await {
        match file? {
            Stored::There { bytes, was_known } => {
                moved.files += 1;
                moved.bytes += bytes;
                moved.known_files += usize::from(was_known);
            }
            Stored::Damaged(damage) => damages.push(damage),
        }
        progress(FileProgress { done: moved.files, total, bytes: moved.bytes });
    }
    match damages.into_iter().enumerate().reduce(|(_, first), (n, _)| (n, first)) {
        Some((last, first)) => Err(TransferError::Damaged { n: last + 1, first }),
        None => Ok(()),
    }
}

async fn store_one(target: &Store, file: File) -> Result<Stored, TransferError> {
    let path = file.path.clone();
    let digest = tokio::task::spawn_blocking(move || digest_file(&path)).await.map_err(std::io::Error::other);
    let digest = match digest.and_then(std::convert::identity) {
        Ok(digest) => digest,
        Err(error) => return Ok(Stored::Damaged(format!("{}: {error}", file.path.display()))),
    };
    if file.sha256.is_some_and(|sha256| sha256 != digest.sha256) {
        return Ok(Stored::Damaged(format!("{}: the digest differs from that of its row", file.path.display())));
    }
    let was_known = target.blobs.import(&file.key, &file.path, &digest.sha256).await?;
    Ok(Stored::There { bytes: digest.bytes, was_known })
}

/// The uploads and results that rows name. Files of one result with the same bytes share a key.
async fn named_files(source: &Source, folder: &Path) -> Result<Vec<File>, TransferError> {
    let rows: Vec<(String, String, String)> = sqlx::query_as(
        "SELECT 'sessions/' || id, 'sessions/' || id, sha256 FROM sessions
         UNION ALL
         SELECT min('results/' || jobs.id || '/' || result_fence || '/' || name),
                'results/' || jobs.id || '/' || result_fence || '/' || sha256, sha256
         FROM artifacts JOIN jobs ON jobs.id = artifacts.job_id GROUP BY 2, 3",
    )
    .fetch_all(&source.database)
    .await?;
    let file = |(path, key, sha256)| File { path: folder.join::<String>(path), key, sha256: Some(sha256) };
    Ok(rows.into_iter().map(file).collect())
}

/// The checkpoints of the jobs that go on.
async fn checkpoints(source: &Source, folder: &Path) -> Result<Vec<File>, TransferError> {
    let open = sqlx::query_scalar("SELECT id FROM jobs WHERE state = 'queued'");
    let open: Vec<String> = open.fetch_all(&source.database).await?;
    let mut files = Vec::new();
    for job in open {
        let place = format!("checkpoints/{job}");
        for entry in std::fs::read_dir(folder.join(&place)).into_iter().flatten().flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            if name.ends_with(".ckpt") {
                files.push(File { path: entry.path(), key: format!("{place}/{name}"), sha256: None });
            }
        }
    }
    Ok(files)
}
