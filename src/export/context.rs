//! What a result states about how it was made.

use crate::session::reconstruction::ExportFormat;

/// What a result says of its own making.
#[derive(Debug, Clone, PartialEq)]
pub struct ResultContext<'a> {
    /// Digest of the input (`LoadedSession::sha256`).
    pub input_sha256: &'a str,
    /// The options as they were in force.
    pub options: serde_json::Value,
    /// Version of the program.
    pub solver_version: &'a str,
    /// Formats to write beside the JSON files.
    pub exports: &'a [ExportFormat],
}
