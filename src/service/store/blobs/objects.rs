//! The object store itself: put, get, list, remove, each under the prefix of the URL.

use super::super::error::StoreError;
use super::versions::Versions;
use futures_util::{StreamExt, TryStreamExt};
use object_store::aws::{AmazonS3Builder, Checksum};
use object_store::local::LocalFileSystem;
use object_store::path::Path as Key;
use object_store::prefix::PrefixStore;
use object_store::{ClientOptions, GetOptions, ObjectMeta, ObjectStore, ObjectStoreExt, RetryConfig, WriteMultipart};
use sha2::{Digest, Sha256};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio_util::bytes::BytesMut;

/// Bytes of one part of an upload; parts in flight. 46 MiB are resident with these.
const PART_BYTES: usize = 8 << 20;
const PARTS_IN_FLIGHT: usize = 4;

/// Bytes that are read from a file at once.
const READ_BYTES: usize = 1 << 20;

/// A request whose answer sends nothing for this time is repeated. The crate's limit on the whole request would end the fetch of a
/// large upload.
const READ_TIMEOUT: Duration = Duration::from_secs(20);
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);

/// Time in which a failing request is repeated.
const RETRY_TIME: Duration = Duration::from_secs(60);

/// Key whose time of writing is the clock of the object store.
const CLOCK: &str = "clock";

/// The objects below the prefix of a URL.
#[derive(Debug, Clone)]
pub(super) struct Objects {
    store: Arc<dyn ObjectStore>,
    /// Earlier versions of objects; `None` where the objects are files of a folder.
    pub(super) versions: Option<Versions>,
}

/// One object of a list.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Listed {
    /// Its key.
    pub(crate) key: String,
    /// Time of writing by the clock of the object store, Unix seconds.
    pub(crate) written_at: i64,
}

impl Objects {
    /// Opens `s3://bucket/prefix` or `file:///folder`. Keys, region and endpoint of S3 come from the variables `AWS_*`.
    pub(super) fn open(url: &str) -> Result<Self, StoreError> {
        let invalid = |reason: String| StoreError::BlobsUrl { url: url.to_owned(), reason };
        if let Some(folder) = url.strip_prefix("file://").filter(|folder| folder.starts_with('/')) {
            std::fs::create_dir_all(folder).map_err(|error| invalid(error.to_string()))?;
            let store = LocalFileSystem::new_with_prefix(folder).map_err(|error| invalid(error.to_string()))?;
            return Ok(Self::new(Arc::new(store.with_fsync(true))));
        }
        let Some((bucket, prefix)) = url.strip_prefix("s3://").map(|rest| rest.split_once('/').unwrap_or((rest, "")))
        else {
            return Err(invalid("expected `file:`, `file:///folder` or `s3://bucket/prefix`".to_owned()));
        };
        if bucket.is_empty() {
            return Err(invalid("the name of the bucket is missing".to_owned()));
        }
        // Fails if a provider is set already, which serves as well.
        let _ = rustls::crypto::ring::default_provider().install_default();
        let is_plain = std::env::var("AWS_ALLOW_HTTP").is_ok_and(|value| value.eq_ignore_ascii_case("true"));
        let client = ClientOptions::new()
            .with_allow_http(is_plain)
            .with_timeout_disabled()
            .with_connect_timeout(CONNECT_TIMEOUT)
            .with_read_timeout(READ_TIMEOUT);
        let store = AmazonS3Builder::from_env()
            .with_bucket_name(bucket)
            .with_checksum_algorithm(Checksum::SHA256)
            .with_retry(RetryConfig { retry_timeout: RETRY_TIME, ..RetryConfig::default() })
            .with_client_options(client)
            .build();
        let store = Arc::new(store.map_err(|error| invalid(error.to_string()))?);
        let prefix = prefix.trim_end_matches('/');
        let versions = Some(Versions::new(store.clone(), prefix));
        Ok(match prefix {
            "" => Self { store, versions },
            prefix => Self { store: Arc::new(PrefixStore::new(store, prefix)), versions },
        })
    }

    pub(super) fn new(store: Arc<dyn ObjectStore>) -> Self {
        Self { store, versions: None }
    }

    /// Time of the object store's clock, Unix seconds; also proof that it can be written and read.
    pub(super) async fn now(&self) -> Result<i64, StoreError> {
        let key = Key::from(CLOCK);
        let written = self.store.put(&key, "wandless\n".into()).await;
        written.map_err(|error| failed(CLOCK, error))?;
        let meta = self.store.head(&key).await.map_err(|error| failed(CLOCK, error))?;
        Ok(meta.last_modified.timestamp())
    }

    /// Stores a file under a key. Nothing is there under the key before the last byte was received.
    pub(super) async fn put_file(&self, key: &str, file: &Path) -> Result<(), StoreError> {
        let unreadable = |source| StoreError::Folder { path: file.to_owned(), source };
        let mut from = tokio::fs::File::open(file).await.map_err(unreadable)?;
        let bytes = from.metadata().await.map_err(unreadable)?.len();
        if bytes <= PART_BYTES as u64 {
            let mut whole = Vec::with_capacity(bytes as usize);
            from.read_to_end(&mut whole).await.map_err(unreadable)?;
            let put = self.store.put(&Key::from(key), whole.into()).await;
            return put.map(drop).map_err(|error| failed(key, error));
        }
        let parts = self.store.put_multipart(&Key::from(key)).await.map_err(|error| failed(key, error))?;
        let mut parts = WriteMultipart::new_with_chunk_size(parts, PART_BYTES);
        if let Err(error) = write_parts(&mut from, &mut parts, key, file).await {
            let _ = parts.abort().await; // parts that stay are removed by the lifecycle rule of the bucket
            return Err(error);
        }
        parts.finish().await.map(drop).map_err(|error| failed(key, error))
    }

    /// Writes an object into a new file. Returns its SHA-256, hex, which is computed while it is written.
    pub(super) async fn get_file(&self, key: &str, file: &Path) -> Result<String, StoreError> {
        let to = super::super::private::create_file(file);
        let to = to.map_err(|source| StoreError::Folder { path: file.to_owned(), source })?;
        self.read(key, None, &mut tokio::fs::File::from_std(to), file).await
    }

    /// The SHA-256 of an object, hex; reads all of it.
    pub(super) async fn digest(&self, key: &str) -> Result<String, StoreError> {
        self.read(key, None, &mut tokio::io::sink(), Path::new(key)).await
    }

    /// Writes a version of an object into a new file. Returns its SHA-256, hex.
    pub(super) async fn get_version(&self, key: &str, version: String, file: &Path) -> Result<String, StoreError> {
        let to = super::super::private::create_file(file);
        let to = to.map_err(|source| StoreError::Folder { path: file.to_owned(), source })?;
        self.read(key, Some(version), &mut tokio::fs::File::from_std(to), file).await
    }

    /// Reads an object, or one of its versions. Returns its SHA-256, hex. `name` is that of the place in errors.
    async fn read(
        &self,
        key: &str,
        version: Option<String>,
        to: &mut (impl AsyncWrite + Unpin),
        name: &Path,
    ) -> Result<String, StoreError> {
        let unwritable = |source| StoreError::Folder { path: name.to_owned(), source };
        let options = GetOptions { version, ..GetOptions::default() };
        let object = self.store.get_opts(&Key::from(key), options).await.map_err(|error| failed(key, error))?;
        let mut to = tokio::io::BufWriter::with_capacity(READ_BYTES, to);
        let mut hasher = Sha256::new();
        let mut bytes = object.into_stream();
        while let Some(part) = bytes.next().await {
            let part = part.map_err(|error| failed(key, error))?;
            hasher.update(&part);
            to.write_all(&part).await.map_err(unwritable)?;
        }
        to.flush().await.map_err(unwritable)?;
        Ok(hex::encode(hasher.finalize()))
    }

    /// All objects below a folder.
    pub(super) async fn list(&self, folder: &str) -> Result<Vec<Listed>, StoreError> {
        let listed = |meta: ObjectMeta| Listed {
            key: meta.location.as_ref().to_owned(),
            written_at: meta.last_modified.timestamp(),
        };
        let objects = self.store.list(Some(&Key::from(folder))).map_ok(listed);
        objects.try_collect().await.map_err(|error| failed(folder, error))
    }

    /// Removes one object; a missing one is not an error.
    pub(super) async fn remove(&self, key: &str) -> Result<(), StoreError> {
        match self.store.delete(&Key::from(key)).await {
            Err(object_store::Error::NotFound { .. }) | Ok(()) => Ok(()),
            Err(error) => Err(failed(key, error)),
        }
    }
}

async fn write_parts(
    from: &mut tokio::fs::File,
    parts: &mut WriteMultipart,
    key: &str,
    file: &Path,
) -> Result<(), StoreError> {
    loop {
        let mut part = BytesMut::with_capacity(READ_BYTES);
        let read = from.read_buf(&mut part).await;
        if read.map_err(|source| StoreError::Folder { path: file.to_owned(), source })? == 0 {
            return Ok(());
        }
        parts.wait_for_capacity(PARTS_IN_FLIGHT).await.map_err(|error| failed(key, error))?;
        parts.put(part.freeze());
    }
}

fn failed(key: &str, error: object_store::Error) -> StoreError {
    let key = key.to_owned();
    match error {
        object_store::Error::NotFound { .. } => StoreError::BlobDamaged { key, reason: "the object is missing" },
        error => StoreError::Blobs { key, source: Box::new(error) },
    }
}
