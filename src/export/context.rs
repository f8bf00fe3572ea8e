//! Provenance of a result, as the manifest states it.

use crate::session::reconstruction::ExportFormat;
use std::io;

/// Provenance of a result.
#[derive(Clone)]
pub struct ResultContext<'a> {
    /// SHA-256 digest of the input (`LoadedSession::sha256`).
    pub input_sha256: &'a str,
    /// The options of the solve.
    pub options: serde_json::Value,
    /// Version of the program.
    pub solver_version: &'a str,
    /// Formats to write beside the JSON files.
    pub exports: &'a [ExportFormat],
    /// Makes the content of the file [`CONTINUATION`](super::CONTINUATION); without it no such file is written.
    pub continuation: Option<&'a (dyn Fn() -> io::Result<String> + Sync)>,
}
