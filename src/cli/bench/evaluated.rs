//! A solve whose result is written and compared with the truth.

use crate::cli::bad_input::BadInput;
use crate::evaluation::alignment::Alignment;
use crate::evaluation::{Evaluation, EvaluationOptions, evaluate};
use crate::export::{ResultContext, write_result};
use crate::pipeline::{Options, as_solved, reconstruct};
use crate::progress::Progress;
use crate::session::{Reconstruction, Session};
use anyhow::Context;
use std::path::Path;

/// A result with its errors.
pub(super) struct Evaluated {
    pub(super) errors: Evaluation,
    pub(super) result: Reconstruction,
}

/// Solves `session`, writes the result into the folder `out` and compares it with the folder `truth`.
pub(super) fn evaluated(
    session: &Session,
    options: &Options,
    input_sha256: &str,
    truth: &Path,
    align: Alignment,
    out: &Path,
) -> anyhow::Result<Evaluated> {
    let result = reconstruct(session, options, &Progress::silent())?;
    write_into(out, session, options, input_sha256, &result)?;
    let options = EvaluationOptions { align: Some(align), ..EvaluationOptions::default() };
    let errors = evaluate(out, truth, &options).map_err(|e| BadInput(e.to_string()))?;
    Ok(Evaluated { errors, result })
}

/// Writes a result into the folder `out`.
pub(super) fn write_into(
    out: &Path,
    session: &Session,
    options: &Options,
    input_sha256: &str,
    result: &Reconstruction,
) -> anyhow::Result<()> {
    let context = ResultContext {
        input_sha256,
        options: serde_json::to_value(options)?,
        solver_version: env!("CARGO_PKG_VERSION"),
        exports: &[],
        continuation: None,
    };
    std::fs::create_dir_all(out).with_context(|| out.display().to_string())?;
    Ok(write_result(out, &as_solved(session, options, result), &context, result)?)
}
