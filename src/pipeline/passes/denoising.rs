//! Repair of detections and adjustment of the cameras to the repaired detections, in alternation.

use crate::pipeline::calibration::{Association, Calibration, CameraFreedom};
use crate::pipeline::capture::Capture;
use crate::pipeline::passes::adjustment::{ALL_FRAMES, Effort, adjusted, adjusted_and_associated};
use crate::pipeline::stages::association::{associate, from_tracks, identities};
use crate::pipeline::stages::denoising::{Denoised, denoise, without_rejected};
use crate::pipeline::stages::detector_noise::measured_noise;
use crate::pipeline::stages::joint_trajectories::joint_trajectories;
use crate::progress::{Canceled, Progress};
use crate::session::reconstruction::{ConsistencyReport, DetectionRepairs, NoiseAtConfidence, RepairedDetection};
use crate::session::{Detection, FrameIndex, Keypoint, PersonId, PersonTrack, Session};
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::cmp::Reverse;
use std::collections::BTreeMap;

/// Outcome of the pass. The repaired session is stored as its differences from the original one, so that checkpoints
/// stay small.
#[derive(Debug, Serialize, Deserialize)]
pub struct DenoisedCapture {
    calibration: Calibration,
    report: ConsistencyReport,
    identities_before: Vec<Vec<Vec<Option<PersonId>>>>,
    changes: Vec<Change>,
}

/// The session with repaired detections, and the record of the repairs.
pub struct RepairedSession {
    /// The repaired session.
    pub session: Session,
    /// For the report.
    pub report: ConsistencyReport,
    /// The last repair, detection by detection.
    pub repairs: DetectionRepairs,
}

/// One detection with exchanged or rejected keypoints.
#[derive(Debug, Serialize, Deserialize)]
struct Change {
    view: usize,
    frame: usize,
    detection: usize,
    /// x and y in pixels, confidence.
    keypoints: Vec<[f64; 3]>,
}

impl Change {
    /// The keypoints of `before` after the repair: where each lies and how sure the detector was of it move together.
    fn repaired(&self, before: &Detection) -> Vec<Keypoint> {
        let point = |(k, [x, y, confidence]): (usize, &[f64; 3])| {
            let pixel = Vector2::new(*x, *y);
            let is_source = |from: &&Keypoint| from.pixel == pixel;
            let same = before.keypoints.get(k).filter(is_source).or_else(|| before.keypoints.iter().find(is_source));
            Keypoint { covariance: same.and_then(|from| from.covariance), ..Keypoint::new(pixel, *confidence) }
        };
        self.keypoints.iter().enumerate().map(point).collect()
    }
}

/// Repairs the detections under the cameras so far, measures the detector noise on the residuals, adjusts the cameras
/// (unless they are held) and re-associates the detections, then repairs the original detections once more.
pub fn denoised_capture(
    capture: &Capture,
    mut calibration: Calibration,
    freedom: CameraFreedom,
    progress: &Progress,
) -> Result<DenoisedCapture, Canceled> {
    let mut steps = progress.steps([0.3, 0.4, 0.3]);
    let first = repaired(capture, capture.session, &calibration, &steps.begin("repairing detections"))?;
    calibration.association.tracks = first.tracks;
    let session = without_rejected(first.unflipped.clone(), &first.rejected);
    measure_noise(&mut calibration, &session);
    let repaired_capture = Capture::new(&session, capture.options);
    match freedom {
        CameraFreedom::Adjusted => {
            let step = steps.begin("adjusting cameras to the repaired detections");
            let effort = Effort::last(capture.options);
            calibration = adjusted_and_associated(&repaired_capture, calibration, effort, &step)?;
        }
        CameraFreedom::Held => {
            let step = steps.begin("re-associating detections");
            let (association, report) = associate(&repaired_capture, &calibration.cameras, &step)?;
            calibration.association = association;
            calibration.stages.push(report);
        }
    }
    finally_repaired(capture, &first.unflipped, calibration, &steps.begin("repairing detections under the new cameras"))
}

/// Repairs the detections of people whose identities are known; before that the cameras are adjusted to them, unless they are
/// held.
pub fn corrected_capture(
    capture: &Capture,
    mut calibration: Calibration,
    freedom: CameraFreedom,
    progress: &Progress,
) -> Result<DenoisedCapture, Canceled> {
    let mut steps = progress.steps(if freedom == CameraFreedom::Held { [0.0, 0.0, 1.0] } else { [0.3, 0.4, 0.3] });
    let mut known = Cow::Borrowed(capture.session);
    if freedom == CameraFreedom::Adjusted {
        let first = repaired(capture, capture.session, &calibration, &steps.begin("repairing detections"))?;
        calibration.association.tracks = first.tracks;
        let session = without_rejected(first.unflipped.clone(), &first.rejected);
        measure_noise(&mut calibration, &session);
        let repaired_capture = Capture::new(&session, capture.options);
        let step = steps.begin("adjusting cameras to the repaired detections");
        calibration = adjusted(&repaired_capture, &calibration, Effort::FINAL, ALL_FRAMES, &step)?;
        let scene = repaired_capture.scene(&calibration.cameras);
        let n_left_out = calibration.association.n_left_out;
        let tracks = std::mem::take(&mut calibration.association.tracks);
        calibration.association = Association { n_left_out, ..from_tracks(&scene, tracks) };
        known = Cow::Owned(first.unflipped);
    }
    finally_repaired(capture, &known, calibration, &steps.begin("repairing detections under the new cameras"))
}

/// The last repair of the original detections, and the detector noise on what it leaves; `known`: see [`repaired`].
fn finally_repaired(
    capture: &Capture,
    known: &Session,
    mut calibration: Calibration,
    progress: &Progress,
) -> Result<DenoisedCapture, Canceled> {
    let Denoised { unflipped, rejected, tracks, report, stage_report } =
        repaired(capture, known, &calibration, progress)?;
    let session = without_rejected(unflipped, &rejected);
    let before = std::mem::replace(&mut calibration.association.tracks, tracks);
    calibration.stages.push(stage_report);
    measure_noise(&mut calibration, &session);
    Ok(DenoisedCapture::new(capture.session, calibration, &before, &session, report))
}

/// Repairs the original detections by trajectories through those of `known`, the session as far as it is repaired: where most views
/// have exchanged left and right, original ones would lead astray.
fn repaired(
    capture: &Capture,
    known: &Session,
    calibration: &Calibration,
    progress: &Progress,
) -> Result<Denoised, Canceled> {
    let start = calibration.people(known, &calibration.association.points);
    let trajectories = joint_trajectories(&start, progress)?;
    denoise(calibration.people(capture.session, &trajectories), &capture.views, progress)
}

/// Replaces the detector noise by the one measured on `session`; with too few detections the known one stays.
fn measure_noise(calibration: &mut Calibration, session: &Session) {
    if let Some(noise) = measured_noise(session, &calibration.cameras, &calibration.association.tracks) {
        calibration.noise = noise;
    }
}

impl DenoisedCapture {
    fn new(
        original: &Session,
        calibration: Calibration,
        before: &[PersonTrack],
        repaired: &Session,
        report: ConsistencyReport,
    ) -> Self {
        let identities_before = identities_without_repair(original, before, &calibration.association.tracks);
        let numbers = |point: &Keypoint| [point.pixel.x, point.pixel.y, point.confidence];
        let mut changes = Vec::new();
        for (view, (before, after)) in original.views.iter().zip(&repaired.views).enumerate() {
            for (frame, (before, after)) in before.frames.iter().zip(&after.frames).enumerate() {
                for (detection, (_, after)) in before.iter().zip(after).enumerate().filter(|(_, (a, b))| a != b) {
                    let keypoints = after.keypoints.iter().map(numbers).collect();
                    changes.push(Change { view, frame, detection, keypoints });
                }
            }
        }
        let level = |(confidence, sigma_m)| NoiseAtConfidence { confidence, sigma_mm: 1e3 * sigma_m };
        let detector_noise = calibration.noise.levels().map(level).collect();
        let report = ConsistencyReport { detector_noise, ..report };
        Self { calibration, report, identities_before, changes }
    }

    /// Cameras and people.
    pub fn calibration(&self) -> &Calibration {
        &self.calibration
    }

    /// The session `original` with repaired detections.
    pub fn session(&self, original: &Session) -> Session {
        let mut session = original.clone();
        for change in &self.changes {
            let detection = &mut session.views[change.view].frames[change.frame][change.detection];
            detection.keypoints = change.repaired(detection);
        }
        session
    }

    /// The calibration, and the session `original` with repaired detections.
    pub fn applied_to(self, original: &Session) -> (Calibration, RepairedSession) {
        let session = self.session(original);
        let n_keypoints = original.convention.names().len();
        let mut repaired_detections = Vec::with_capacity(self.changes.len());
        for Change { view, frame, detection, .. } in self.changes {
            let repaired = &session.views[view].frames[frame][detection];
            let sources = sources(&original.views[view].frames[frame][detection], repaired, n_keypoints);
            repaired_detections.push(RepairedDetection { view, frame: FrameIndex(frame), detection, sources });
        }
        let repairs = DetectionRepairs { identities_before: self.identities_before, repaired: repaired_detections };
        (self.calibration, RepairedSession { session, report: self.report, repairs })
    }
}

/// The person of every detection if nothing were repaired: the person that most detections of its track id show after
/// the repair (`repaired`); without a track id the person of `before`.
fn identities_without_repair(
    session: &Session,
    before: &[PersonTrack],
    repaired: &[PersonTrack],
) -> Vec<Vec<Vec<Option<PersonId>>>> {
    let (mut table, repaired) = (identities(session, before), identities(session, repaired));
    for ((view, table), repaired) in session.views.iter().zip(&mut table).zip(&repaired) {
        let mut counts: BTreeMap<i64, BTreeMap<PersonId, usize>> = BTreeMap::new();
        for (detection, person) in view.frames.iter().flatten().zip(repaired.iter().flatten()) {
            if let (Some(id), Some(person)) = (detection.track_id, person) {
                *counts.entry(id).or_default().entry(*person).or_default() += 1;
            }
        }
        for (detection, identity) in view.frames.iter().flatten().zip(table.iter_mut().flatten()) {
            let people = detection.track_id.and_then(|id| counts.get(&id));
            let usual = people.and_then(|people| people.iter().max_by_key(|(person, n)| (**n, Reverse(**person))));
            *identity = usual.map_or(*identity, |(person, _)| Some(*person));
        }
    }
    table
}

/// For every keypoint of a repaired detection the original keypoint it was taken from; `None` where it was rejected.
fn sources(before: &Detection, after: &Detection, n_keypoints: usize) -> Vec<Option<usize>> {
    let source = |k: usize| {
        let is_source = |from: &usize| before.keypoints[*from].pixel == after.keypoints[k].pixel;
        let from = Some(k).filter(is_source).or_else(|| (0..n_keypoints).find(is_source))?;
        let is_rejected = before.keypoints[from].is_present() && !after.keypoints[k].is_present();
        Some(from).filter(|_| !is_rejected)
    };
    (0..n_keypoints.min(before.keypoints.len()).min(after.keypoints.len())).map(source).collect()
}
