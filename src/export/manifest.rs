//! `manifest.json`: what lies in the result, and what it was made from.

use super::ResultContext;
use super::files::FileEntry;
use crate::session::reconstruction::BodyModelId;
use crate::session::recording::UpAxis;
use crate::session::{FrameIndex, Reconstruction, Session};
use serde::Serialize;

/// The file.
#[derive(Serialize)]
pub(super) struct Manifest<'a> {
    input: Input<'a>,
    options: &'a serde_json::Value,
    solver_version: &'a str,
    models: Models<'a>,
    publish: Publish,
    files: Vec<FileEntry>,
}

#[derive(Serialize)]
struct Input<'a> {
    name: &'a str,
    sha256: &'a str,
}

#[derive(Serialize)]
struct Models<'a> {
    body: &'a BodyModelId,
}

/// What a studio's asset system asks of a published take.
#[derive(Serialize)]
struct Publish {
    up_axis: UpAxis,
    handedness: &'static str,
    metres_per_unit: f64,
    frame_range: [i64; 2],
    fps: f64,
}

/// The content of `manifest.json`; `files` is every file but itself.
pub(super) fn manifest<'a>(
    session: &'a Session,
    context: &'a ResultContext<'_>,
    reconstruction: &'a Reconstruction,
    files: Vec<FileEntry>,
) -> Manifest<'a> {
    let last = FrameIndex(session.n_frames.saturating_sub(1));
    Manifest {
        input: Input { name: &session.name, sha256: context.input_sha256 },
        options: &context.options,
        solver_version: context.solver_version,
        models: Models { body: &reconstruction.body_model },
        publish: Publish {
            up_axis: reconstruction.up_axis,
            handedness: "right",
            metres_per_unit: 1.0,
            frame_range: [session.first_frame, session.frame_number(last)],
            fps: session.fps,
        },
        files,
    }
}
