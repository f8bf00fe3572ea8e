//! `wandless read-upload`: validates or inspects one upload in a child process of the service.

use super::child::{Kind, begin, send};
use super::confinement::Access;
use crate::service::protocol::{READ_UPLOAD, UploadTask};
use crate::service::validation;
use std::process::ExitCode;

const KIND: Kind = Kind { command: READ_UPLOAD, oom_score: 1000 };

fn access(task: &UploadTask) -> Access<'_> {
    Access { reads: vec![&task.upload], writes: Vec::new() }
}

/// Runs the child.
pub(super) fn run() -> ExitCode {
    // The number of cores depends on files of the system, which the child cannot read later.
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let order = match begin(&KIND, access) {
        Ok(order) => order,
        Err(code) => return code,
    };
    match validation::read(&order.task, cores) {
        Ok(verdict) => {
            send(&verdict);
            ExitCode::SUCCESS
        }
        Err(error) => {
            tracing::error!(%error, "the upload cannot be opened");
            ExitCode::FAILURE
        }
    }
}
