//! The judge: cameras from every other block of frames, scored on the frames they have not seen.

use super::instants::{FrameFilter, InstantBudget, instants};
use super::{Calibration, FINAL, ROUND, adjusted, quick};
use crate::geometry::{Intrinsics, Rigid};
use crate::pipeline::Capture;
use crate::pipeline::stages::bundle_adjustment::{self as ba, AdjustmentInput, CameraFreedom};
use crate::progress::{Canceled, Progress};

/// Mean reprojection distance (px) of cameras from every other block of frames, judged on the rest.
///
/// `None` where a half of the frames is not enough. With held cameras both halves are judged with the same ones.
///
/// # Errors
/// [`Canceled`].
pub fn heldout_px(
    capture: &Capture,
    calibration: &Calibration,
    freedom: CameraFreedom,
    progress: &Progress,
) -> Result<Option<f64>, Canceled> {
    let halves = [0, 1].map(|half| move |frame: usize| (frame / BLOCK) % 2 == half);
    let mut sum = 0.0;
    for (trained, judged) in [(&halves[0], &halves[1]), (&halves[1], &halves[0])] {
        let cameras = match freedom {
            CameraFreedom::Held => calibration.cameras.clone(),
            CameraFreedom::Adjusted => adjusted(capture, calibration, ROUND, trained, progress)?.cameras,
        };
        let Some(error) = judged_px(capture, calibration, &cameras, judged, progress)? else { return Ok(None) };
        sum += 0.5 * error;
    }
    Ok(Some(sum))
}

/// Frames of a block that is trained on or judged as a whole: neighbouring frames share their errors.
const BLOCK: usize = 15;

/// Distances beyond this are wrong detections, and count as this much, px.
const CLIP_PX: f64 = 25.0;

/// Mean clipped distance of points seen by at least three views to their reprojection, points alone adjusted.
fn judged_px(
    capture: &Capture,
    calibration: &Calibration,
    cameras: &[Option<Rigid>],
    allowed: FrameFilter,
    progress: &Progress,
) -> Result<Option<f64>, Canceled> {
    let session = capture.session;
    let budget = InstantBudget { max_instants: FINAL.max_instants, noise: &calibration.noise, metres_per_unit: 1.0 };
    let mut chosen = instants(session, cameras, &calibration.association, budget, allowed);
    for instant in &mut chosen {
        let mut seen = vec![0u8; instant.points.len()];
        instant.observations.iter().for_each(|o| seen[o.keypoint] += 1);
        instant.observations.retain(|o| seen[o.keypoint] >= 3);
    }
    let intrinsics: Vec<Intrinsics> = session.views.iter().map(|v| v.intrinsics).collect();
    let input = AdjustmentInput {
        intrinsics: &intrinsics,
        cameras: cameras.to_vec(),
        instants: chosen,
        bones: &[],
        camera_freedom: CameraFreedom::Held,
        refine_focal: false,
        refine_delays: false,
    };
    let (judged, _) = ba::adjust(&input, &quick(), progress)?;
    let (mut sum, mut n) = (0.0, 0usize);
    for (instant, points) in input.instants.iter().zip(&judged.points) {
        for o in &instant.observations {
            let (Some(point), Some(camera)) = (points[o.keypoint], &cameras[o.view]) else { continue };
            let pixel = intrinsics[o.view].pixel_from_camera(&camera.transform(&point));
            sum += pixel.map_or(CLIP_PX, |p| (p - o.pixel).norm().min(CLIP_PX));
            n += 1;
        }
    }
    Ok((n >= 100).then(|| sum / n as f64))
}
