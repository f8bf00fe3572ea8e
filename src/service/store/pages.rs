//! Digests of the database pages, which detect any changed byte, whether the service is running, was killed or has stopped.
//!
//! The database file changes only at checkpoints, which are made here: while other writers are locked out, the pages of the
//! write-ahead log are copied and their digests stored. Until the log restarts it still holds those pages, so after a crash
//! at any point each page is either in the log, which has checksums, or has a digest.
//!
//! Why not SQLite's own means: `integrity_check` and `quick_check` verify the structure, not the bytes of a text or number;
//! the checksum VFS is C code that sqlx's bundled SQLite does not contain and that safe Rust cannot register; digests in
//! backups do not cover a data folder in use. So this module and [`super::log`] stay.

use super::database::Store;
use super::error::StoreError;
use super::folders::{Folders, PAGES, publish};
use super::log::Log;
use super::private;
use sha2::{Digest, Sha256};
use std::fs::File;
use std::io::{self, Write};
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::time::{Duration, SystemTime};

/// First words of the file; the number increases with every change of the format.
const MAGIC: &str = "wandless-pages 1";

/// Interval between two checks whether the log has grown.
const CHECK_INTERVAL: Duration = Duration::from_secs(2);

/// Bytes of a page digest: enough to detect damage, not tampering.
const DIGEST_BYTES: usize = 8;

/// Repetitions of a comparison that finds damage while the service is running.
const TRIES: usize = 4;

/// Digests of all pages, in order.
#[derive(Debug, Clone, PartialEq, Eq)]
struct PageDigests {
    page_bytes: usize,
    digests: Vec<[u8; DIGEST_BYTES]>,
}

/// Result of comparing a database with its digests.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Compared {
    /// There are no digests to compare with.
    Unknown,
    /// All pages are unchanged; their number.
    Intact(usize),
    /// Description of the damage.
    Damaged(String),
}

/// Makes checkpoints until the service stops.
pub(crate) async fn run_checkpointer(store: Store, draining: tokio_util::sync::CancellationToken) {
    let mut seen = None;
    loop {
        tokio::select! {
            () = tokio::time::sleep(CHECK_INTERVAL) => {}
            () = draining.cancelled() => return,
        }
        let written = written_at(&store.folders.log());
        if written == seen {
            continue;
        }
        if let Err(error) = store.shrink().await {
            tracing::warn!(%error, "the free part of the database was not returned to the disk; trying again");
        }
        match store.checkpoint().await {
            Ok(()) => seen = written,
            Err(error) => tracing::warn!(%error, "the checkpoint of the database failed; trying again"),
        }
    }
}

fn written_at(log: &Path) -> Option<SystemTime> {
    std::fs::metadata(log).and_then(|log| log.modified()).ok()
}

impl Store {
    /// Copies the write-ahead log into the database and stores the digests of the changed pages.
    ///
    /// # Errors
    /// When the database fails; a failure to store the digests removes them and is only logged.
    pub(crate) async fn checkpoint(&self) -> Result<(), StoreError> {
        let Some(checkpointer) = self.checkpointer() else { return Ok(()) };
        let lock = self.write_relaxed().await?; // from here on there are no other writers, and the log does not restart
        let log = self.folders.log();
        let log = tokio::task::spawn_blocking(move || Log::read(&log));
        let log = log.await.map_err(io::Error::other).and_then(|log| log);
        sqlx::query("PRAGMA wal_checkpoint(PASSIVE)").execute(checkpointer).await?;
        let (database, pages) = (self.folders.database(), self.folders.pages());
        let updated = tokio::task::spawn_blocking(move || {
            let updated = log.and_then(|log| update_digests(&database, &pages, &log));
            if updated.is_err() {
                let _ = std::fs::remove_file(&pages); // no digests are better than wrong ones
            }
            updated
        });
        let updated = updated.await.map_err(io::Error::other).and_then(|updated| updated);
        lock.rollback().await?;
        if let Err(error) = updated {
            tracing::warn!(%error, "the digests of the database pages cannot be stored");
        }
        Ok(())
    }
}

/// Updates the digests of the pages in the log, or computes all digests if there are none.
fn update_digests(database: &Path, path: &Path, log: &Log) -> io::Result<()> {
    let mut now = PageDigests::of(database, PageDigests::read(path).as_ref().map(|known| (known, log)))?;
    if log.damage.is_some() {
        now.digests.clear(); // a damaged log leaves no reference to compare with
    }
    now.write(path)
}

/// Compares a database with its digests.
///
/// # Errors
/// When a file cannot be read.
pub(crate) fn compare(database: &Path) -> io::Result<Compared> {
    let is_running = database.parent().is_some_and(Folders::are_in_use);
    let mut found = compare_once(database)?;
    for _ in 0..TRIES {
        if !is_running || !matches!(found, Compared::Damaged(_)) {
            break;
        }
        std::thread::sleep(CHECK_INTERVAL / 4); // the service may have been in the middle of a checkpoint
        found = compare_once(database)?;
    }
    Ok(found)
}

fn compare_once(database: &Path) -> io::Result<Compared> {
    let (log, pages) = (database.with_extension("db-wal"), database.with_file_name(PAGES));
    let stored = PageDigests::read(&pages);
    let log = Log::read(&log)?;
    if let Some(damage) = log.damage {
        return Ok(Compared::Damaged(format!("write-ahead log: {damage}")));
    }
    let Some(stored) = stored.filter(|stored| !stored.digests.is_empty()) else {
        let has_file = pages.exists() && log.pages.is_empty();
        let damaged = || Compared::Damaged("the file of the page digests is damaged".to_owned());
        return Ok(if has_file { damaged() } else { Compared::Unknown });
    };
    let now = PageDigests::of(database, None)?;
    let length = now.digests.len().max(stored.digests.len());
    let is_same = |i: &usize| now.digests.get(*i) == stored.digests.get(*i) || log.pages.contains(&(*i as u32 + 1));
    let changed: Vec<String> = (0..length).filter(|i| !is_same(i)).map(|i| (i + 1).to_string()).collect();
    Ok(match changed.is_empty() && now.page_bytes == stored.page_bytes {
        true => Compared::Intact(length),
        false => Compared::Damaged(format!("changed since written: page {}", changed.join(", "))),
    })
}

impl PageDigests {
    /// Computes the digests of a database file; pages with a `known` digest that are not in the log are not read.
    fn of(database: &Path, known: Option<(&PageDigests, &Log)>) -> io::Result<Self> {
        let file = File::open(database)?;
        let mut header = [0; 100];
        file.read_exact_at(&mut header, 0)?;
        let page_bytes = match u16::from_be_bytes([header[16], header[17]]) {
            1 => 65536,
            bytes => usize::from(bytes).max(512),
        };
        let n_pages = file.metadata()?.len() / page_bytes as u64;
        let known = known.filter(|(pages, _)| pages.page_bytes == page_bytes);
        let mut page = vec![0; page_bytes];
        let mut digests = Vec::with_capacity(n_pages as usize);
        for index in 0..n_pages {
            let old = known.and_then(|(pages, log)| {
                let old = pages.digests.get(index as usize).copied();
                old.filter(|_| !log.pages.contains(&(index as u32 + 1)))
            });
            digests.push(match old {
                Some(old) => old,
                None => match file.read_exact_at(&mut page, index * page_bytes as u64) {
                    Ok(()) => digest(&page),
                    Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => break, // the file was shortened meanwhile
                    Err(error) => return Err(error),
                },
            });
        }
        Ok(Self { page_bytes, digests })
    }

    /// Reads stored digests; `None` if the file is missing or damaged.
    fn read(path: &Path) -> Option<Self> {
        let bytes = std::fs::read(path).ok()?;
        let split = bytes.iter().position(|byte| *byte == b'\n')?;
        let (head, rest) = (std::str::from_utf8(&bytes[..split]).ok()?, &bytes[split + 1..]);
        let mut words = head.strip_prefix(MAGIC)?.split_whitespace();
        let page_bytes: usize = words.next()?.parse().ok()?;
        let is_intact = words.next()? == hex::encode(checksum(page_bytes, rest));
        let (digests, _) = rest.as_chunks();
        is_intact.then(|| Self { page_bytes, digests: digests.to_vec() })
    }

    /// Writes the digests under a temporary name and renames it; durable before the log can restart.
    fn write(&self, path: &Path) -> io::Result<()> {
        let rest = self.digests.as_flattened();
        let staging = path.with_extension("pages.tmp");
        let mut file = private::create_file(&staging)?;
        let sum = hex::encode(checksum(self.page_bytes, rest));
        file.write_all(format!("{MAGIC} {} {sum}\n", self.page_bytes).as_bytes())?;
        file.write_all(rest)?;
        file.sync_all()?;
        publish(&staging, path)
    }
}

fn digest(page: &[u8]) -> [u8; DIGEST_BYTES] {
    std::array::from_fn({
        let sha256 = Sha256::digest(page);
        move |i| sha256[i]
    })
}

fn checksum(page_bytes: usize, rest: &[u8]) -> Vec<u8> {
    Sha256::new().chain_update(page_bytes.to_string()).chain_update(rest).finalize().to_vec()
}

#[cfg(test)]
mod tests;
