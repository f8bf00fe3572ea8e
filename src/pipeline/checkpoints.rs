//! What finished stages found, kept on disk: work that was interrupted goes on after its last finished stage.
//!
//! A file is `wandless-checkpoint 1`, the key of the work, the SHA-256 of the rest, and the rest as JSON, in lines. Numbers
//! are written so that they are read as the same numbers: a resumed run gives the bytes of an uninterrupted one. Whatever is
//! damaged, of another release, or of other work is not used; whatever cannot be written is done without.

use crate::body::BodyModel;
use crate::pipeline::Options;
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
const MAGIC: &str = "wandless-checkpoint 1";

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
        Self { place: Some(Place { folder: folder.to_owned(), key: hex(&Sha256::digest(work.as_bytes())) }) }
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

impl Place {
    fn read<T: DeserializeOwned>(&self, path: &Path) -> Option<T> {
        let text = std::fs::read_to_string(path).ok()?;
        let mut parts = text.splitn(4, '\n');
        let is_ours = parts.next()? == MAGIC && parts.next()? == self.key;
        let digest = parts.next()?;
        let rest = parts.next()?;
        let is_whole = is_ours && hex(&Sha256::digest(rest.as_bytes())) == digest;
        if is_whole { serde_json::from_str(rest).ok() } else { None }
    }

    /// Under another name first: a file is there whole or not at all.
    fn write<T: Serialize>(&self, path: &Path, found: &T) -> io::Result<()> {
        let rest = serde_json::to_string(found)?;
        let digest = hex(&Sha256::digest(rest.as_bytes()));
        let staging = path.with_extension("tmp");
        let mut file = File::create(&staging)?;
        write!(file, "{MAGIC}\n{}\n{digest}\n{rest}", self.key)?;
        file.sync_all()?;
        std::fs::rename(&staging, path)
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
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
