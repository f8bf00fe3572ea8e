//! What finished stages found, kept on disk: work that was interrupted goes on after its last finished stage.
//!
//! A file is `wandless-checkpoint 3`, the key of the work, the SHA-256 of key and rest, and the rest as JSON, in lines. Numbers
//! are written so that they are read as the same numbers: a resumed run gives the bytes of an uninterrupted one. Whatever is
//! damaged, of another release, or of other work is not used; whatever cannot be written is done without.

use crate::body::BodyModel;
use crate::pipeline::config::Options;
use serde::Serialize;
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Where finished stages are kept, if at all.
#[derive(Debug, Clone, Default)]
pub struct Checkpoints {
    place: Option<Place>,
}

#[derive(Debug, Clone)]
struct Place {
    folder: PathBuf,
    key: String,
}

/// First line of a file; grows with every change of what is stored.
const MAGIC: &str = "wandless-checkpoint 3";

impl Checkpoints {
    /// Keeps nothing.
    pub fn none() -> Self {
        Self::default()
    }

    /// Keeps stages in `folder`, which must exist, for one piece of work: this session, these options, this body, this
    /// release.
    pub fn in_folder(folder: &Path, session_sha256: &str, options: &Options, body: &BodyModel) -> Self {
        let options = serde_json::to_string(options).unwrap_or_default(); // always serialises; a key of less would be refused
        let work = [env!("CARGO_PKG_VERSION"), session_sha256, &options, &body.sha256()].join("\n");
        Self { place: Some(Place { folder: folder.to_owned(), key: hex::encode(Sha256::digest(work.as_bytes())) }) }
    }

    /// What the stage found before, or what it finds now.
    ///
    /// # Errors
    /// Those of the stage.
    pub fn stage<T, E>(&self, name: &str, run: impl FnOnce() -> Result<T, E>) -> Result<T, E>
    where
        T: Serialize + DeserializeOwned,
    {
        let Some(place) = &self.place else { return run() };
        let path = place.folder.join(format!("{name}.ckpt"));
        if let Some(found) = place.read(&path) {
            tracing::info!(stage = name, "the stage was finished before and is not run again");
            return Ok(found);
        }
        let found = run()?;
        if let Err(error) = place.write(&path, &found) {
            tracing::warn!(stage = name, %error, "the stage's end could not be kept; an interrupted job runs it again");
        }
        Ok(found)
    }
}

/// Whether a file is a stage as it was kept, of whatever work.
pub fn is_whole(path: &Path) -> bool {
    std::fs::read_to_string(path).is_ok_and(|text| contents(&text).is_some())
}

/// Key and rest of a file that is whole.
fn contents(text: &str) -> Option<(&str, &str)> {
    let (key, digested) = text.strip_prefix(MAGIC)?.strip_prefix('\n')?.split_once('\n')?;
    let (digest, rest) = digested.split_once('\n')?;
    (digest_of(key, rest) == digest).then_some((key, rest))
}

fn digest_of(key: &str, rest: &str) -> String {
    hex::encode(Sha256::new().chain_update(key).chain_update(rest).finalize())
}

impl Place {
    fn read<T: DeserializeOwned>(&self, path: &Path) -> Option<T> {
        let text = std::fs::read_to_string(path).ok()?;
        let (key, rest) = contents(&text)?;
        if key == self.key { serde_json::from_str(rest).ok() } else { None }
    }

    /// Under another name first: a file is there whole or not at all.
    fn write<T: Serialize>(&self, path: &Path, found: &T) -> io::Result<()> {
        let rest = serde_json::to_string(found)?;
        let digest = digest_of(&self.key, &rest);
        let staging = path.with_extension("tmp");
        let mut file = File::create(&staging)?;
        write!(file, "{MAGIC}\n{}\n{digest}\n{rest}", self.key)?;
        file.sync_all()?;
        std::fs::rename(&staging, path)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::default_body;
    use std::cell::Cell;

    fn resumed(checkpoints: &Checkpoints, runs: &Cell<u32>) -> Vec<f64> {
        let found = checkpoints.stage("cameras", || {
            runs.set(runs.get() + 1);
            Ok::<_, ()>(vec![0.1, 1.0 / 3.0, f64::MIN_POSITIVE])
        });
        found.unwrap()
    }

    #[test]
    fn a_finished_stage_is_not_run_again_and_finds_the_same_bits() {
        let folder = tempfile::tempdir().unwrap();
        let body = default_body();
        let runs = Cell::new(0);
        let of = |seed| Checkpoints::in_folder(folder.path(), "00", &Options { seed, ..Options::default() }, &body);
        let first = resumed(&of(0), &runs);
        let again = resumed(&of(0), &runs);
        assert_eq!(runs.get(), 1);
        assert!(first.iter().zip(&again).all(|(a, b)| a.to_bits() == b.to_bits()));
        resumed(&of(1), &runs);
        assert_eq!(runs.get(), 2, "other options are other work");
    }

    #[test]
    fn a_damaged_checkpoint_is_not_used() {
        let folder = tempfile::tempdir().unwrap();
        let checkpoints = Checkpoints::in_folder(folder.path(), "00", &Options::default(), &default_body());
        let runs = Cell::new(0);
        let expected = resumed(&checkpoints, &runs);
        let path = folder.path().join("cameras.ckpt");
        let whole = std::fs::read(&path).unwrap();
        for at in 0..whole.len() {
            let mut bytes = whole.clone();
            bytes[at] ^= 1 << (at % 8);
            std::fs::write(&path, bytes).unwrap();
            let before = runs.get();
            assert_eq!(resumed(&checkpoints, &runs), expected);
            assert_eq!(runs.get(), before + 1, "byte {at}");
            std::fs::write(&path, &whole[..at]).unwrap();
            assert_eq!(resumed(&checkpoints, &runs), expected);
            assert_eq!(runs.get(), before + 2, "cut at {at}");
        }
    }
}
