//! Smooth trajectories of all persons' keypoints under a calibration's cameras.

use crate::pipeline::calibration::Calibration;
use crate::pipeline::capture::Capture;
use crate::pipeline::stages::joint_trajectories::{Damping, TrajectoryConfig, TrajectoryInput, joint_trajectories};
use crate::progress::{Canceled, Progress};
use crate::session::JointTrajectory;

/// One trajectory per track, in the unit of the calibration.
///
/// # Errors
/// [`Canceled`].
pub fn trajectories(
    capture: &Capture,
    calibration: &Calibration,
    progress: &Progress,
) -> Result<Vec<JointTrajectory>, Canceled> {
    let input = TrajectoryInput {
        session: capture.session,
        noise: &calibration.noise,
        cameras: &calibration.cameras,
        tracks: &calibration.association.tracks,
        start: &calibration.association.points,
        metres_per_unit: 1.0,
        damping: if capture.session.views.len() == 1 { Damping::Strong } else { Damping::Weak },
    };
    joint_trajectories(&input, &TrajectoryConfig::default(), progress)
}
