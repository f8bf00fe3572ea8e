//! Cameras and clean detections in turn: each makes the other better.

use super::{Calibration, FINAL, associated, improved};
use crate::pipeline::stages::association::identities;
use crate::pipeline::stages::bundle_adjustment::CameraFreedom;
use crate::pipeline::stages::denoising::{Denoised, DenoisingInput, denoise};
use crate::pipeline::{Capture, result};
use crate::progress::{Canceled, Progress};
use crate::session::reconstruction::{ConsistencyReport, DetectionRepairs, NoiseAtConfidence, RepairedDetection};
use crate::session::{Detection, FrameIndex, Keypoint, PersonId, PersonTrack, Session};
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};
use std::cmp::Reverse;
use std::collections::BTreeMap;

/// Cameras and detections that agree. The cleaned session is kept as what differs from the session as it came: little, and
/// a checkpoint holds it.
#[derive(Debug, Serialize, Deserialize)]
pub struct Consistent {
    calibration: Calibration,
    told: ConsistencyReport,
    identities_before: Vec<Vec<Vec<Option<PersonId>>>>,
    changes: Vec<Change>,
}

/// The session with clean detections, and what was done to it.
pub struct Cleaned {
    /// The detections that agree.
    pub session: Session,
    /// For the report.
    pub told: ConsistencyReport,
    /// The last cleaning, detection by detection.
    pub cleaning: DetectionRepairs,
}

/// One detection whose keypoints were turned round or rejected.
#[derive(Debug, Serialize, Deserialize)]
struct Change {
    view: usize,
    frame: usize,
    detection: usize,
    /// x and y in pixels, confidence.
    keypoints: Vec<[f64; 3]>,
}

impl Consistent {
    fn of(original: &Session, calibration: Calibration, before: &[PersonTrack], denoised: Denoised) -> Self {
        let identities_before = taken_for(original, before, &denoised.tracks);
        let mut changes = Vec::new();
        for (view, (before, after)) in original.views.iter().zip(&denoised.session.views).enumerate() {
            for (frame, (before, after)) in before.frames.iter().zip(&after.frames).enumerate() {
                let pairs = before.iter().zip(after).enumerate();
                let changed = pairs.filter(|(_, (before, after))| before != after);
                changes.extend(changed.map(|(detection, (_, after))| Change::of(view, frame, detection, after)));
            }
        }
        let level = |(confidence, sigma_m)| NoiseAtConfidence { confidence, sigma_mm: 1e3 * sigma_m };
        let told =
            ConsistencyReport { detector_noise: calibration.noise.levels().map(level).collect(), ..denoised.told };
        Self { calibration, told, identities_before, changes }
    }

    /// The cameras and who is who; the session `original` with clean detections.
    pub fn over(self, original: &Session) -> (Calibration, Option<Cleaned>) {
        let mut session = original.clone();
        let n_keypoints = original.convention.names().len();
        let mut mended = Vec::with_capacity(self.changes.len());
        for Change { view, frame, detection, keypoints } in self.changes {
            let points =
                keypoints.into_iter().map(|[x, y, confidence]| Keypoint { pixel: Vector2::new(x, y), confidence });
            let clean = &mut session.views[view].frames[frame][detection];
            clean.keypoints = points.collect();
            let sources = sources(&original.views[view].frames[frame][detection], clean, n_keypoints);
            mended.push(RepairedDetection { view, frame: FrameIndex(frame), detection, sources });
        }
        let cleaning = DetectionRepairs { identities_before: self.identities_before, repaired: mended };
        (self.calibration, Some(Cleaned { session, told: self.told, cleaning }))
    }
}

impl Change {
    fn of(view: usize, frame: usize, detection: usize, after: &Detection) -> Self {
        let keypoints = after.keypoints.iter().map(|point| [point.pixel.x, point.pixel.y, point.confidence]).collect();
        Self { view, frame, detection, keypoints }
    }
}

/// Cleans the detections under the cameras so far, measures how far the detector errs by what is left, adjusts the cameras
/// to that, and cleans the detections as they came once more under these.
///
/// # Errors
/// [`Canceled`].
pub fn made_consistent(
    capture: &Capture,
    mut calibration: Calibration,
    freedom: CameraFreedom,
    progress: &Progress,
) -> Result<Consistent, Canceled> {
    let first = denoised(capture, &calibration, progress)?;
    calibration.association.tracks = first.tracks;
    calibration.measure_noise(&first.session);
    let clean = Capture::new(&first.session, capture.options);
    progress.report(0.3, "detections made consistent");
    match freedom {
        CameraFreedom::Adjusted => calibration = improved(&clean, calibration, FINAL, progress)?,
        CameraFreedom::Held => {
            let (association, report) = associated(&clean, &calibration.cameras, progress)?;
            calibration.association = association;
            calibration.stages.push(report);
        }
    }
    progress.report(0.7, "cameras adjusted to consistent detections");
    let second = denoised(capture, &calibration, progress)?;
    let before = std::mem::replace(&mut calibration.association.tracks, second.tracks.clone());
    calibration.stages.push(second.report.clone());
    calibration.measure_noise(&second.session);
    Ok(Consistent::of(capture.session, calibration, &before, second))
}

/// Whom every detection would show if nothing were repaired: whoever its track id mostly names by what was found in the
/// end, and without a track id whom `before` gave it to.
fn taken_for(session: &Session, before: &[PersonTrack], found: &[PersonTrack]) -> Vec<Vec<Vec<Option<PersonId>>>> {
    let (mut taken, found) = (identities(session, before), identities(session, found));
    for ((view, taken), found) in session.views.iter().zip(&mut taken).zip(&found) {
        let mut named: BTreeMap<i64, BTreeMap<PersonId, usize>> = BTreeMap::new();
        for (detection, person) in view.frames.iter().flatten().zip(found.iter().flatten()) {
            if let (Some(id), Some(person)) = (detection.track_id, person) {
                *named.entry(id).or_default().entry(*person).or_default() += 1;
            }
        }
        for (detection, taken) in view.frames.iter().flatten().zip(taken.iter_mut().flatten()) {
            let people = detection.track_id.and_then(|id| named.get(&id));
            let usual = people.and_then(|people| people.iter().max_by_key(|(person, n)| (**n, Reverse(**person))));
            *taken = usual.map_or(*taken, |(person, _)| Some(*person));
        }
    }
    taken
}

/// Where every keypoint of a cleaned detection comes from.
fn sources(before: &Detection, after: &Detection, n_keypoints: usize) -> Vec<Option<usize>> {
    let source = |k: usize| {
        let is_source = |from: &usize| before.keypoints[*from].pixel == after.keypoints[k].pixel;
        let from = Some(k).filter(is_source).or_else(|| (0..n_keypoints).find(is_source))?;
        let is_rejected = before.keypoints[from].is_present() && !after.keypoints[k].is_present();
        Some(from).filter(|_| !is_rejected)
    };
    (0..n_keypoints.min(before.keypoints.len()).min(after.keypoints.len())).map(source).collect()
}

fn denoised(capture: &Capture, calibration: &Calibration, progress: &Progress) -> Result<Denoised, Canceled> {
    let paths = result::paths(capture, calibration, progress)?;
    let input = DenoisingInput {
        session: capture.session,
        views: &capture.views,
        cameras: &calibration.cameras,
        tracks: &calibration.association.tracks,
        paths: &paths,
        noise: &calibration.noise,
    };
    denoise(input, progress)
}
