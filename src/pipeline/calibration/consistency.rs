//! Cameras and clean detections in turn: each makes the other better.

use super::{Calibration, FINAL, associated, improved};
use crate::pipeline::bundle_adjustment::CameraFreedom;
use crate::pipeline::denoising::{Denoised, DenoisingInput, denoise};
use crate::pipeline::{Capture, result};
use crate::progress::{Canceled, Progress};

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
) -> Result<(Calibration, Denoised), Canceled> {
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
    Ok((calibration, second))
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
