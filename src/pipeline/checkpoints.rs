//! Checkpoints: results of finished stages on disk, so that an interrupted run resumes after its last finished stage.
//!
//! A file has four lines: `wandless-checkpoint 7`, the key of the run, the SHA-256 of key and result, and the result as JSON.
//! Numbers are read back exactly, so a resumed run gives the bytes of an uninterrupted one. A file that is damaged, of another
//! release or of another run is ignored; a checkpoint that cannot be written is skipped with a warning.

use crate::body::BodyModel;
use crate::pipeline::config::Options;
use serde::Serialize;
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Storage of finished stages.
#[derive(Debug, Clone, Default)]
pub struct Checkpoints {
    folder: Option<RunFolder>,
}

/// Folder of one run and the key of that run.
#[derive(Debug, Clone)]
struct RunFolder {
    path: PathBuf,
    key: String,
    /// Number of repairs before the run.
    n_repairs: usize,
}

/// First line of a file; the number grows with every change of the stored types.
const MAGIC: &str = "wandless-checkpoint 7";

impl Checkpoints {
    /// Stores nothing.
    pub fn none() -> Self {
        Self::default()
    }

    /// Stores stages in `folder`, which must exist, for one run: this session, these options, this body, this release, this instruction
    /// set.
    pub fn in_folder(folder: &Path, session_sha256: &str, options: &Options, body: &BodyModel) -> Self {
        let key = run_key(instruction_set(), session_sha256, options, body);
        Self { folder: Some(RunFolder { path: folder.to_owned(), key, n_repairs: 0 }) }
    }

    /// Those of the same run after `n_repairs` repairs of its recording, which are found anew when it is resumed.
    pub fn after_repairs(&self, n_repairs: usize) -> Self {
        Self { folder: self.folder.clone().map(|folder| RunFolder { n_repairs, ..folder }) }
    }

    /// The stored result of a stage, or the result of running it.
    ///
    /// # Errors
    /// Those of the stage.
    pub fn stage<T, E>(&self, name: &str, run: impl FnOnce() -> Result<T, E>) -> Result<T, E>
    where
        T: Serialize + DeserializeOwned,
    {
        let Some(folder) = &self.folder else { return run() };
        let attempt = if folder.n_repairs == 0 { String::new() } else { format!("-repaired{}", folder.n_repairs) };
        let path = folder.path.join(format!("{name}{attempt}.ckpt"));
        if let Some(result) = folder.read(&path) {
            tracing::info!(stage = name, "stage resumed from its checkpoint");
            return Ok(result);
        }
        let result = run()?;
        if let Err(error) = folder.write(&path, &result) {
            tracing::warn!(stage = name, %error, "checkpoint not written; an interrupted job runs this stage again");
        }
        Ok(result)
    }
}

/// Key of a run on a machine with these vector instructions.
fn run_key(instructions: &str, session_sha256: &str, options: &Options, body: &BodyModel) -> String {
    let options = serde_json::to_string(options).unwrap_or_default(); // always serialises
    let run = [env!("CARGO_PKG_VERSION"), instructions, session_sha256, &options, &body.sha256()].join("\n");
    hex::encode(Sha256::digest(run.as_bytes()))
}

/// The vector instructions with which this processor computes: products are fused and summed in another order with others, so that a run
/// that continues on another kind of machine would give other bytes.
fn instruction_set() -> &'static str {
    #[cfg(target_arch = "x86_64")]
    return match (is_x86_feature_detected!("avx512f"), is_x86_feature_detected!("fma")) {
        (true, _) => "x86_64 avx512",
        (false, true) => "x86_64 fma",
        (false, false) => "x86_64",
    };
    #[cfg(not(target_arch = "x86_64"))]
    std::env::consts::ARCH
}

/// Whether a file is an undamaged checkpoint, of any run.
pub fn is_whole(path: &Path) -> bool {
    std::fs::read_to_string(path).is_ok_and(|text| contents(&text).is_some())
}

/// Key and result of an undamaged file.
fn contents(text: &str) -> Option<(&str, &str)> {
    let (key, digested) = text.strip_prefix(MAGIC)?.strip_prefix('\n')?.split_once('\n')?;
    let (digest, rest) = digested.split_once('\n')?;
    (digest_of(key, rest) == digest).then_some((key, rest))
}

/// The text of a file with a key and a result, from which [`opened`] reads it.
///
/// # Errors
/// Where the result cannot be written as JSON.
pub fn sealed<T: Serialize>(key: &str, result: &T) -> Result<String, serde_json::Error> {
    let rest = serde_json::to_string(result)?;
    Ok(format!("{MAGIC}\n{key}\n{}\n{rest}", digest_of(key, &rest)))
}

/// The result in a text of [`sealed`]; `None` where it is damaged, of another release or has another key.
pub fn opened<T: DeserializeOwned>(text: &str, key: &str) -> Option<T> {
    let (found, rest) = contents(text)?;
    if found == key { serde_json::from_str(rest).ok() } else { None }
}

fn digest_of(key: &str, rest: &str) -> String {
    hex::encode(Sha256::new().chain_update(key).chain_update(rest).finalize())
}

impl RunFolder {
    fn read<T: DeserializeOwned>(&self, path: &Path) -> Option<T> {
        opened(&std::fs::read_to_string(path).ok()?, &self.key)
    }

    /// Writes to a temporary name and renames, so that a file is complete or absent.
    fn write<T: Serialize>(&self, path: &Path, result: &T) -> io::Result<()> {
        let text = sealed(&self.key, result)?;
        let staging = path.with_extension("tmp");
        let mut file = File::create(&staging)?;
        file.write_all(text.as_bytes())?;
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
    fn a_finished_stage_is_not_run_again() {
        let folder = tempfile::tempdir().unwrap();
        let body = default_body();
        let runs = Cell::new(0);
        let of = |seed| Checkpoints::in_folder(folder.path(), "00", &Options { seed, ..Options::default() }, &body);
        let first = resumed(&of(0), &runs);
        let again = resumed(&of(0), &runs);
        assert_eq!(runs.get(), 1);
        assert!(first.iter().zip(&again).all(|(a, b)| a.to_bits() == b.to_bits()));
        resumed(&of(1), &runs);
        assert_eq!(runs.get(), 2, "other options are another run");
    }

    #[test]
    fn machines_with_other_instructions_run_their_stages_themselves() {
        let key = |instructions| run_key(instructions, "00", &Options::default(), &default_body());
        assert_eq!(key(instruction_set()), key(instruction_set()));
        assert_ne!(key("x86_64 fma"), key("x86_64 avx512"));
    }

    #[test]
    fn ignores_a_damaged_checkpoint() {
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
