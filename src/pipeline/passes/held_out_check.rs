//! Cross-validation of the cameras: estimated from every other block of frames, judged on the rest.

use crate::geometry::Rigid;
use crate::pipeline::calibration::{Calibration, CameraFreedom};
use crate::pipeline::capture::Capture;
use crate::pipeline::passes::adjustment::{Effort, adjusted};
use crate::pipeline::stages::bundle_adjustment::adjust;
use crate::pipeline::stages::bundle_adjustment::input::{AdjustmentConfig, AdjustmentInput};
use crate::pipeline::stages::keyframe_selection::{FrameFilter, select_keyframes};
use crate::progress::{Canceled, Progress};

/// Length of a block of frames that is used for estimation or for judging as a whole, s: neighbouring frames share their errors.
const BLOCK_SECS: f64 = 0.5;

/// Errors beyond this are wrong detections and count as this much, px.
const CLIP_PX: f64 = 25.0;

/// Mean reprojection error (px) of cameras that were estimated from every other block of frames, on the other blocks.
///
/// `None` where a half of the frames is not enough. Held cameras are the same on both halves.
pub fn heldout_px(
    capture: &Capture,
    calibration: &Calibration,
    freedom: CameraFreedom,
    progress: &Progress,
) -> Result<Option<f64>, Canceled> {
    let block = ((BLOCK_SECS * capture.session.fps).round() as usize).max(1);
    let halves = [0, 1].map(|half| move |frame: usize| (frame / block) % 2 == half);
    let mut steps = progress.steps([3.0, 1.0, 3.0, 1.0]);
    let mut sum = 0.0;
    for (estimated, judged) in [(&halves[0], &halves[1]), (&halves[1], &halves[0])] {
        let step = steps.begin("adjusting cameras to every other block of frames");
        let cameras = match freedom {
            CameraFreedom::Held => calibration.cameras.clone(),
            CameraFreedom::Adjusted => adjusted(capture, calibration, Effort::TRIAL, estimated, &step)?.cameras,
        };
        let step = steps.begin("judging cameras on the other blocks");
        let Some(error) = error_px(capture, calibration, &cameras, judged, &step)? else { return Ok(None) };
        sum += 0.5 * error;
    }
    Ok(Some(sum))
}

/// Mean clipped reprojection error of points seen by at least three views, after an adjustment of the points alone.
fn error_px(
    capture: &Capture,
    calibration: &Calibration,
    cameras: &[Option<Rigid>],
    allowed: FrameFilter,
    progress: &Progress,
) -> Result<Option<f64>, Canceled> {
    let max_keyframes = Effort::TRIAL.max_keyframes;
    let mut keyframes = select_keyframes(capture.session, calibration, cameras, max_keyframes, allowed);
    for keyframe in &mut keyframes {
        let mut n_views = vec![0u8; keyframe.points.len()];
        keyframe.observations.iter().for_each(|o| n_views[o.keypoint] += 1);
        keyframe.observations.retain(|o| n_views[o.keypoint] >= 3);
    }
    let intrinsics = capture.intrinsics();
    let input = AdjustmentInput {
        intrinsics: &intrinsics,
        cameras: cameras.to_vec(),
        keyframes,
        bones: &[],
        camera_freedom: CameraFreedom::Held,
        refine_focal: false,
        refine_delays: false,
        drift_over: None,
        refine_radial: false,
    };
    let config =
        AdjustmentConfig { relative_decrease: 1e-4, uncertainty_block_frames: None, ..AdjustmentConfig::default() };
    let (adjusted, _) = adjust(&input, &config, progress)?;
    let (mut sum, mut n) = (0.0, 0usize);
    for (keyframe, points) in input.keyframes.iter().zip(&adjusted.points) {
        for o in &keyframe.observations {
            let (Some(point), Some(camera)) = (points[o.keypoint], &cameras[o.view]) else { continue };
            let pixel = intrinsics[o.view].pixel_from_camera(&camera.transform(&point));
            sum += pixel.map_or(CLIP_PX, |p| (p - o.pixel).norm().min(CLIP_PX));
            n += 1;
        }
    }
    Ok((n >= 100).then(|| sum / n as f64))
}
