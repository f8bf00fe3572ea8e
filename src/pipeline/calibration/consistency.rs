//! Cameras and clean detections in turn: each makes the other better.

use super::{Calibration, FINAL, associated, improved};
use crate::pipeline::bundle_adjustment::CameraFreedom;
use crate::pipeline::denoising::{Denoised, DenoisingInput, denoise};
use crate::pipeline::{Capture, result};
use crate::progress::{Canceled, Progress};
use crate::session::reconstruction::ConsistencyReport;
use crate::session::{Detection, Keypoint, Session};
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

/// Cameras and detections that agree. The cleaned session is kept as what differs from the session as it came: little, and
/// a checkpoint holds it.
#[derive(Debug, Serialize, Deserialize)]
pub struct Consistent {
    calibration: Calibration,
    told: ConsistencyReport,
    changes: Vec<Change>,
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
    fn of(original: &Session, calibration: Calibration, denoised: Denoised) -> Self {
        let mut changes = Vec::new();
        for (view, (before, after)) in original.views.iter().zip(&denoised.session.views).enumerate() {
            for (frame, (before, after)) in before.frames.iter().zip(&after.frames).enumerate() {
                let pairs = before.iter().zip(after).enumerate();
                let changed = pairs.filter(|(_, (before, after))| before != after);
                changes.extend(changed.map(|(detection, (_, after))| Change::of(view, frame, detection, after)));
            }
        }
        Self { calibration, told: denoised.told, changes }
    }

    /// The cameras and who is who; the session `original` with clean detections, and what was done to it.
    pub fn over(self, original: &Session) -> (Calibration, Option<(Session, ConsistencyReport)>) {
        let mut session = original.clone();
        for Change { view, frame, detection, keypoints } in self.changes {
            let points =
                keypoints.into_iter().map(|[x, y, confidence]| Keypoint { pixel: Vector2::new(x, y), confidence });
            session.views[view].frames[frame][detection].keypoints = points.collect();
        }
        (self.calibration, Some((session, self.told)))
    }
}

impl Change {
    fn of(view: usize, frame: usize, detection: usize, after: &Detection) -> Self {
        let keypoints = after.keypoints.iter().map(|point| [point.pixel.x, point.pixel.y, point.confidence]).collect();
        Self { view, frame, detection, keypoints }
    }
}

/// Cleans the detections under the cameras so far, adjusts the cameras to what is left, and cleans the detections as they
/// came once more under these.
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
    let clean = Capture::new(&first.session, capture.options);
    calibration.association.tracks = first.tracks;
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
    calibration.association.tracks.clone_from(&second.tracks);
    calibration.stages.push(second.report.clone());
    Ok(Consistent::of(capture.session, calibration, second))
}

fn denoised(capture: &Capture, calibration: &Calibration, progress: &Progress) -> Result<Denoised, Canceled> {
    let paths = result::paths(capture, calibration, progress)?;
    let input = DenoisingInput {
        session: capture.session,
        views: &capture.views,
        cameras: &calibration.cameras,
        tracks: &calibration.association.tracks,
        paths: &paths,
        noise: calibration.noise,
    };
    denoise(input, progress)
}
