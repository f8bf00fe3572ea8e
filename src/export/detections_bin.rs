//! `stages/detections.bin`: the detections and the people they are assigned to, in the layout of [`super::buffers`].
//!
//! The viewer loads it when it shows the view of a camera. Header: `format: "wandless.detections"`, `version: 1` and
//! `cameras`, each with
//!
//! - `id`
//! - `starts` `[n_frames + 1]`: the detections of frame index `f` are `starts[f]..starts[f + 1]`
//! - `person` `[detections]`: the person that each is assigned to, -1 for none
//! - `pixels` `[detections, K, 2]`: px as detected (distorted), NaN where the detector gave no point
//! - `confidence` `[detections, K]`: 0 to 255 for 0 to 1
//!
//! and, where the consistency stage ran, its changes:
//!
//! - `before` `[detections]`: the person of each without any repair, -1 for none
//! - `repaired` `[M]`: detections with exchanged or rejected keypoints
//! - `sources` `[M, K]`: for every keypoint of those the index of the detected one that shows it, 255 where it is rejected

use super::buffers::{Array, Payload};
use crate::session::reconstruction::{DetectionRepairs, RepairedDetection};
use crate::session::{Detection, Keypoint, PersonId, Reconstruction, Session, View};
use serde::Serialize;
use std::io;

/// Version of the layout described above.
const VERSION: u32 = 1;

#[derive(Serialize)]
struct Header<'a> {
    format: &'static str,
    version: u32,
    cameras: Vec<Camera<'a>>,
}

#[derive(Serialize)]
struct Camera<'a> {
    id: &'a str,
    starts: Array,
    person: Array,
    pixels: Array,
    confidence: Array,
    #[serde(flatten)]
    repairs: Option<RepairArrays>,
}

#[derive(Serialize)]
struct RepairArrays {
    before: Array,
    repaired: Array,
    sources: Array,
}

/// The bytes of the file.
///
/// # Errors
/// See [`Payload::file`].
pub(super) fn detections_bin(session: &Session, reconstruction: &Reconstruction) -> io::Result<Vec<u8>> {
    let mut payload = Payload::default();
    let n_keypoints = session.convention.names().len();
    let camera = |(index, view)| camera(view, index, n_keypoints, reconstruction, &mut payload);
    let cameras = session.views.iter().enumerate().map(camera).collect();
    payload.file(&Header { format: "wandless.detections", version: VERSION, cameras })
}

fn camera<'a>(
    view: &'a View,
    index: usize,
    n_keypoints: usize,
    reconstruction: &Reconstruction,
    payload: &mut Payload,
) -> Camera<'a> {
    let given = assigned_people(view, reconstruction.identities.get(index));
    let detections = || view.frames.iter().flatten();
    let n_detections = detections().count();
    let mut starts = vec![0];
    for frame in &view.frames {
        starts.push(starts[starts.len() - 1] + frame.len() as u32);
    }
    let repairs = reconstruction.repairs.as_ref();
    Camera {
        id: &view.id,
        starts: payload.u32(&[view.frames.len() + 1], starts.iter().copied()),
        person: payload.i16(&[n_detections], given),
        pixels: payload.f32(
            &[n_detections, n_keypoints, 2],
            detections().flat_map(|d| keypoints(d, n_keypoints)).flat_map(|point| match point {
                Some(point) if point.is_present() => [point.pixel.x, point.pixel.y],
                _ => [f64::NAN; 2],
            }),
        ),
        confidence: payload.u8(
            &[n_detections, n_keypoints],
            detections()
                .flat_map(|d| keypoints(d, n_keypoints))
                .map(|point| point.map_or(0, |point| (255.0 * point.confidence.clamp(0.0, 1.0)).round() as u8)),
        ),
        repairs: repairs.map(|repairs| repair_arrays(view, index, n_keypoints, repairs, &starts, payload)),
    }
}

/// The person of every detection of a view, frame by frame; -1 for none.
fn assigned_people(view: &View, identities: Option<&Vec<Vec<Option<PersonId>>>>) -> Vec<i16> {
    let given = |frame: usize, detection: usize| {
        let person = (*identities?.get(frame)?.get(detection)?)?;
        i16::try_from(person.0).ok()
    };
    let of_frame = |(frame, detections): (usize, &Vec<Detection>)| {
        (0..detections.len()).map(|detection| given(frame, detection).unwrap_or(-1)).collect::<Vec<_>>()
    };
    view.frames.iter().enumerate().flat_map(of_frame).collect()
}

fn repair_arrays(
    view: &View,
    index: usize,
    n_keypoints: usize,
    repairs: &DetectionRepairs,
    starts: &[u32],
    payload: &mut Payload,
) -> RepairArrays {
    let repaired: Vec<&RepairedDetection> =
        repairs.repaired.iter().filter(|repair| repair.view == index && repair.frame.0 < view.frames.len()).collect();
    let before = assigned_people(view, repairs.identities_before.get(index));
    let source = |repair: &RepairedDetection, k: usize| repair.sources.get(k).copied().flatten();
    RepairArrays {
        before: payload.i16(&[before.len()], before),
        repaired: payload
            .u32(&[repaired.len()], repaired.iter().map(|repair| starts[repair.frame.0] + repair.detection as u32)),
        sources: payload.u8(
            &[repaired.len(), n_keypoints],
            repaired.iter().flat_map(|repair| {
                (0..n_keypoints).map(move |k| source(repair, k).and_then(|k| u8::try_from(k).ok()).unwrap_or(u8::MAX))
            }),
        ),
    }
}

/// The leading, named keypoints of a detection.
fn keypoints(detection: &Detection, n_keypoints: usize) -> impl Iterator<Item = Option<&Keypoint>> {
    (0..n_keypoints).map(|k| detection.keypoints.get(k))
}
