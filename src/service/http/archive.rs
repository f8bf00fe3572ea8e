//! `GET /v1/jobs/{id}/archive`: all files of a result as one zip, which is written while it is sent.

use super::access::Caller;
use super::conditions::{is_unchanged, require_match};
use super::error::Problem;
use super::extract::{ApiPath, JobPath};
use super::results::{FileRequest, disposition, no_such_file, published_fence, replaced};
use crate::service::metrics::Held;
use crate::service::store::artifacts::{self, Artifact};
use axum::body::{Body, Bytes};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use futures_util::stream::poll_fn;
use sha2::{Digest, Sha256};
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use tokio::sync::mpsc;
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

/// Bytes that are sent at once.
const CHUNK_BYTES: usize = 256 << 10;
/// Chunks that wait for the client; the writer then waits, too.
const WAITING_CHUNKS: usize = 2;

/// Get all files of a result as one zip.
///
/// The archive is made while it is sent, so its length is not known beforehand. The connection is closed before the end if a
/// file on the disk of the service is damaged.
#[utoipa::path(get, path = "/v1/jobs/{id}/archive", operation_id = "getArchive", tag = "results", params(JobPath),
    responses((status = 200, description = "The archive", body = Value, content_type = "application/zip",
            headers(("ETag" = String))),
        (status = 304, description = "Unchanged"), (status = 409), (status = 412)))]
pub(super) async fn get(ApiPath(JobPath { id }): ApiPath<JobPath>, request: FileRequest) -> Result<Response, Problem> {
    let FileRequest { app, caller: Caller { tenant }, headers } = request;
    let result_fence = published_fence(&app, &tenant, &id).await?;
    let files = artifacts::list(&app.store, &id).await?;
    if published_fence(&app, &tenant, &id).await? != result_fence {
        return Err(replaced()); // the list can be that of the result with further formats
    }
    // The manifest lists the digests of all other files.
    let manifest = files.iter().find(|file| file.name == "manifest.json").ok_or_else(|| no_such_file(&id))?;
    let tag = format!("\"{}.zip\"", manifest.sha256);
    require_match(&headers, &tag)?;
    if is_unchanged(&headers, &tag) {
        return Ok((StatusCode::NOT_MODIFIED, [(header::ETAG, tag)]).into_response());
    }
    let turn = app.archives.clone().try_acquire_owned();
    let turn = turn.map_err(|_| Problem::unavailable("busy", "other archives are being sent"))?;
    let folder = app.store.blobs.result(&id, result_fence, &files).await?;
    let (sender, mut receiver) = mpsc::channel(WAITING_CHUNKS);
    tokio::task::spawn_blocking(move || {
        let folder = folder; // the whole value: the folder exists as long as it does
        if let Err(error) = write_archive(&folder.path, &files, Chunks::new(sender.clone())) {
            // A client may leave early.
            if !sender.is_closed() {
                tracing::error!(%error, folder = %folder.path.display(), "an archive ended early");
                let _ = sender.blocking_send(Err(error)); // fails if the client leaves now
            }
        }
        drop(turn);
    });
    let held = Held::new(&app.metrics);
    let body = Body::from_stream(poll_fn(move |context| {
        _ = &held; // counted until the last byte is sent or the client disconnects
        receiver.poll_recv(context)
    }));
    let headers = [
        (header::CONTENT_TYPE, "application/zip".to_owned()),
        (header::ETAG, tag),
        (header::CONTENT_DISPOSITION, disposition(&format!("{id}.zip"))),
    ];
    Ok((headers, body).into_response())
}

/// Writes the files into a zip and compares their digests. Members have a fixed time: the same result gives the same bytes.
fn write_archive(folder: &Path, files: &[Artifact], chunks: Chunks) -> io::Result<()> {
    let mut zip = ZipWriter::new_stream(chunks);
    // Results are mostly text and halve at the fastest level, which is faster than the network.
    let options = SimpleFileOptions::default().compression_level(Some(1)).last_modified_time(zip::DateTime::default());
    for file in files {
        zip.start_file(file.name.as_str(), options.large_file(file.bytes > u64::from(u32::MAX)))?;
        copy_checked(folder.join(&file.name), &mut zip, &file.sha256)?;
    }
    zip.finish()?.into_inner().flush()
}

fn copy_checked(path: PathBuf, to: &mut impl Write, sha256: &str) -> io::Result<()> {
    let mut file = File::open(&path)?;
    let mut hasher = Sha256::new();
    let mut buffer = vec![0; 1 << 16];
    loop {
        match file.read(&mut buffer)? {
            0 => break,
            n => {
                hasher.update(&buffer[..n]);
                to.write_all(&buffer[..n])?;
            }
        }
    }
    if hex::encode(hasher.finalize()) == sha256 {
        return Ok(());
    }
    Err(io::Error::other(format!("{}: the digest differs from the published one", path.display())))
}

/// A writer whose bytes become chunks of a body; it waits while the client does not read.
struct Chunks {
    sender: mpsc::Sender<io::Result<Bytes>>,
    waiting: Vec<u8>,
}

impl Chunks {
    fn new(sender: mpsc::Sender<io::Result<Bytes>>) -> Self {
        Self { sender, waiting: Vec::with_capacity(CHUNK_BYTES) }
    }
}

impl Write for Chunks {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.waiting.extend_from_slice(bytes);
        if self.waiting.len() >= CHUNK_BYTES {
            self.flush()?;
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        if self.waiting.is_empty() {
            return Ok(());
        }
        let chunk = std::mem::replace(&mut self.waiting, Vec::with_capacity(CHUNK_BYTES));
        let gone = |_| io::Error::new(io::ErrorKind::BrokenPipe, "the client has left");
        self.sender.blocking_send(Ok(chunk.into())).map_err(gone)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn archived(sha256: &str) -> (io::Result<()>, Vec<u8>) {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("smpl")).unwrap();
        std::fs::write(folder.path().join("smpl/0.npz"), b"abc").unwrap();
        let media_type = "application/octet-stream".to_owned();
        let file = Artifact { name: "smpl/0.npz".to_owned(), media_type, bytes: 3, sha256: sha256.to_owned() };
        let (sender, mut receiver) = mpsc::channel(64);
        let written = write_archive(folder.path(), &[file], Chunks::new(sender));
        let mut bytes = Vec::new();
        while let Some(chunk) = receiver.blocking_recv() {
            bytes.extend(chunk.unwrap());
        }
        (written, bytes)
    }

    /// FIPS 180-2, appendix B.1.
    const ABC: &str = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";

    #[test]
    fn archive_holds_the_files_and_is_reproducible() {
        let (written, bytes) = archived(ABC);
        written.unwrap();
        assert_eq!(bytes, archived(ABC).1);
        let mut archive = zip::ZipArchive::new(io::Cursor::new(bytes)).unwrap();
        let mut content = String::new();
        archive.by_name("smpl/0.npz").unwrap().read_to_string(&mut content).unwrap();
        assert_eq!(content, "abc");
    }

    #[test]
    fn damaged_file_ends_the_archive() {
        let error = archived(&"0".repeat(64)).0.unwrap_err();
        assert!(error.to_string().contains("smpl/0.npz"), "{error}");
    }
}
