//! `manifest.json`: the files of the result, and the input, options and models it was solved with.

use super::context::ResultContext;
use super::files::FileEntry;
use super::formats::Representation;
use super::take::Take;
use crate::session::formats::time::ratio;
use crate::session::reconstruction::BodyModelId;
use crate::session::recording::UpAxis;
use crate::session::{BodyMotion, Reconstruction, Session};
use serde::Serialize;

/// The file.
#[derive(Serialize)]
pub(super) struct Manifest<'a> {
    input: Input<'a>,
    options: &'a serde_json::Value,
    solver_version: &'a str,
    models: Models<'a>,
    publish: Publish<'a>,
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

/// Description of the published take for a studio's asset system.
#[derive(Serialize)]
struct Publish<'a> {
    up_axis: UpAxis,
    handedness: &'static str,
    metres_per_unit: f64,
    frame_range: [i64; 2],
    fps: f64,
    /// The frame rate as numerator and denominator.
    frame_rate: [u64; 2],
    /// SMPTE time code of frame number 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    start_timecode: Option<&'a str>,
    people: Vec<Presence>,
    representations: Vec<Representation>,
}

/// Frames in which a person is present. Scenes (`bvh`, `fbx`, `glb`, `usd`, `blender`) have all frames of the take for every person,
/// other files the person's own.
#[derive(Serialize)]
struct Presence {
    id: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    name: Option<String>,
    frame_range: [i64; 2],
}

/// The files that have been written.
pub(super) struct Written {
    /// The requested formats.
    pub(super) representations: Vec<Representation>,
    /// All files except the manifest.
    pub(super) files: Vec<FileEntry>,
}

/// The content of `manifest.json`.
pub(super) fn manifest<'a>(
    session: &'a Session,
    context: &'a ResultContext<'_>,
    reconstruction: &'a Reconstruction,
    take: &Take,
    written: Written,
) -> Manifest<'a> {
    let present = |motion: &BodyMotion| Presence {
        id: motion.person.0,
        name: take.names.get(&motion.person).cloned(),
        frame_range: take.presence(motion),
    };
    Manifest {
        input: Input { name: &session.name, sha256: context.input_sha256 },
        options: &context.options,
        solver_version: context.solver_version,
        models: Models { body: &reconstruction.body_model },
        publish: Publish {
            up_axis: take.up_axis,
            handedness: "right",
            metres_per_unit: 1.0,
            frame_range: take.frame_range(),
            fps: take.fps,
            frame_rate: ratio(take.fps),
            start_timecode: session.start_timecode.as_deref(),
            people: take.motions.iter().map(present).collect(),
            representations: written.representations,
        },
        files: written.files,
    }
}
