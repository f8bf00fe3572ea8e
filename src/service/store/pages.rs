//! Digests of the database's pages, so that a changed byte is noticed even where SQLite cannot know it (inside of a text),
//! whether the service is at work, was killed, or has stopped.
//!
//! The database file changes at checkpoints alone, and those are made here: while nobody else may write, the log's pages are
//! copied and their digests kept. Until the log begins anew it still holds those pages, so that death at any moment
//! leaves every page either in the log, which has checksums of its own, or with its digest.

use super::log::Log;
use super::{Folders, Store, StoreError};
use sha2::{Digest, Sha256};
use std::fs::File;
use std::io::{self, BufReader, Read, Write};
use std::path::Path;
use std::time::{Duration, SystemTime};

/// Name of the digests in a data folder.
pub(super) const PAGES: &str = "wandless.db.pages";

/// First words of the file; grows with every change of its form.
const MAGIC: &str = "wandless-pages 1";

/// Between two looks whether the log has grown.
const LOOK: Duration = Duration::from_secs(2);

/// Bytes of a page's digest: enough to notice, no signature.
const DIGEST_BYTES: usize = 8;

/// Further looks at a database that seems damaged while its service is at work.
const TRIES: usize = 4;

/// Every page in order.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Pages {
    page_bytes: usize,
    digests: Vec<[u8; DIGEST_BYTES]>,
}

/// What comparing the database with its digests has shown.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Compared {
    /// There are no digests.
    Unknown,
    /// So many pages are as they were written.
    Whole(usize),
    /// What is not.
    Damaged(String),
}

/// Makes the checkpoints until the service stops.
pub(crate) async fn keep(store: Store, draining: tokio_util::sync::CancellationToken) {
    let mut seen = None;
    loop {
        tokio::select! {
            () = tokio::time::sleep(LOOK) => {}
            () = draining.cancelled() => return,
        }
        let written = written_at(&store.folders.log());
        if written == seen {
            continue;
        }
        match store.checkpoint().await {
            Ok(()) => seen = written,
            Err(error) => tracing::warn!(%error, "the log could not be copied into the database; trying again"),
        }
    }
}

fn written_at(log: &Path) -> Option<SystemTime> {
    std::fs::metadata(log).and_then(|log| log.modified()).ok()
}

impl Store {
    /// Copies the log into the database and keeps the digests of what has changed.
    ///
    /// # Errors
    /// When the database does not answer; a digest that cannot be kept is none.
    pub(crate) async fn checkpoint(&self) -> Result<(), StoreError> {
        let hold = self.note().await?; // from here on nobody writes, and the log does not begin anew
        let log = self.folders.log();
        let waiting = tokio::task::spawn_blocking(move || Log::read(&log));
        let waiting = waiting.await.map_err(io::Error::other).and_then(|log| log);
        sqlx::query("PRAGMA wal_checkpoint(PASSIVE)").execute(&self.keeper).await?;
        let (database, pages) = (self.folders.database(), self.folders.pages());
        let kept = tokio::task::spawn_blocking(move || {
            let kept = waiting.and_then(|log| renew(&database, &pages, &log));
            if kept.is_err() {
                let _ = std::fs::remove_file(&pages); // none at all is better than a wrong one
            }
            kept
        });
        let kept = kept.await.map_err(io::Error::other).and_then(|kept| kept);
        hold.rollback().await?;
        if let Err(error) = kept {
            tracing::warn!(%error, "the digests of the database's pages could not be kept");
        }
        Ok(())
    }
}

/// Brings the digests of the log's pages up to date, or makes all of them.
fn renew(database: &Path, path: &Path, log: &Log) -> io::Result<()> {
    let mut now = Pages::of(database, Pages::read(path).as_ref().map(|known| (known, log)))?;
    if log.damage.is_some() {
        now.digests.clear(); // whatever was read is no truth to compare with
    }
    now.write(path)
}

/// Compares a database with the digests beside it.
///
/// # Errors
/// When a file cannot be read.
pub(crate) fn compare(database: &Path) -> io::Result<Compared> {
    let is_at_work = database.parent().is_some_and(Folders::are_in_use);
    let mut found = compare_once(database)?;
    for _ in 0..TRIES {
        if !is_at_work || !matches!(found, Compared::Damaged(_)) {
            break;
        }
        std::thread::sleep(LOOK / 4); // the service may just have been at a checkpoint
        found = compare_once(database)?;
    }
    Ok(found)
}

fn compare_once(database: &Path) -> io::Result<Compared> {
    let (log, pages) = (database.with_extension("db-wal"), database.with_file_name(PAGES));
    let kept = Pages::read(&pages);
    let log = Log::read(&log)?;
    if let Some(damage) = log.damage {
        return Ok(Compared::Damaged(format!("its log: {damage}")));
    }
    let Some(kept) = kept.filter(|kept| !kept.digests.is_empty()) else {
        let is_there = pages.exists() && log.pages.is_empty();
        let damaged = || Compared::Damaged("the digests of its pages are not whole".to_owned());
        return Ok(if is_there { damaged() } else { Compared::Unknown });
    };
    let now = Pages::of(database, None)?;
    let length = now.digests.len().max(kept.digests.len());
    let is_same = |i: &usize| now.digests.get(*i) == kept.digests.get(*i) || log.pages.contains(&(*i as u32 + 1));
    let changed: Vec<String> = (0..length).filter(|i| !is_same(i)).map(|i| (i + 1).to_string()).collect();
    Ok(match changed.is_empty() && now.page_bytes == kept.page_bytes {
        true => Compared::Whole(length),
        false => Compared::Damaged(format!("page {} has changed since it was written", changed.join(", "))),
    })
}

impl Pages {
    /// The digests of a database file; where some are known, only those of the log's pages and of new ones are made.
    fn of(database: &Path, known: Option<(&Pages, &Log)>) -> io::Result<Self> {
        let file = File::open(database)?;
        let mut reader = BufReader::with_capacity(1 << 20, file);
        let mut header = [0; 100];
        reader.read_exact(&mut header)?;
        let page_bytes = match u16::from_be_bytes([header[16], header[17]]) {
            1 => 65536,
            bytes => usize::from(bytes).max(512),
        };
        let known = known.filter(|(pages, _)| pages.page_bytes == page_bytes);
        let mut page = vec![0; page_bytes];
        page[..100].copy_from_slice(&header);
        reader.read_exact(&mut page[100..])?;
        let mut digests = Vec::new();
        loop {
            let number = digests.len() as u32 + 1;
            let old = known.and_then(|(pages, log)| {
                let old = pages.digests.get(digests.len()).copied();
                old.filter(|_| !log.pages.contains(&number))
            });
            digests.push(old.unwrap_or_else(|| digest(&page)));
            match reader.read_exact(&mut page) {
                Ok(()) => {}
                Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => return Ok(Self { page_bytes, digests }),
                Err(error) => return Err(error),
            }
        }
    }

    /// `None` where there is no such file or it is not whole.
    fn read(path: &Path) -> Option<Self> {
        let bytes = std::fs::read(path).ok()?;
        let split = bytes.iter().position(|byte| *byte == b'\n')?;
        let (head, rest) = (std::str::from_utf8(&bytes[..split]).ok()?, &bytes[split + 1..]);
        let mut words = head.strip_prefix(MAGIC)?.split_whitespace();
        let page_bytes: usize = words.next()?.parse().ok()?;
        let is_whole = words.next()? == hex::encode(summed(page_bytes, rest));
        let (digests, _) = rest.as_chunks();
        is_whole.then(|| Self { page_bytes, digests: digests.to_vec() })
    }

    /// Under another name first, and durable before the log may begin anew.
    fn write(&self, path: &Path) -> io::Result<()> {
        let rest = self.digests.as_flattened();
        let staging = path.with_extension("pages.tmp");
        let mut file = File::create(&staging)?;
        let sum = hex::encode(summed(self.page_bytes, rest));
        file.write_all(format!("{MAGIC} {} {sum}\n", self.page_bytes).as_bytes())?;
        file.write_all(rest)?;
        file.sync_all()?;
        super::folders::publish(&staging, path)
    }
}

fn digest(page: &[u8]) -> [u8; DIGEST_BYTES] {
    std::array::from_fn({
        let whole = Sha256::digest(page);
        move |i| whole[i]
    })
}

fn summed(page_bytes: usize, rest: &[u8]) -> Vec<u8> {
    Sha256::new().chain_update(page_bytes.to_string()).chain_update(rest).finalize().to_vec()
}

#[cfg(test)]
mod tests;
