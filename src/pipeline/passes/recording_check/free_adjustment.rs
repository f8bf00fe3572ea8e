//! The adjustment that tests parameters of the recording: all cameras at once, each with a delay and a focal length of its own.

use super::solved::{MAX_KEYFRAMES, Solved};
use crate::geometry::Intrinsics;
use crate::pipeline::calibration::{Adjusted, AdjustedCamera, CameraFreedom};
use crate::pipeline::keyframe::Keyframe;
use crate::pipeline::passes::adjustment::ALL_FRAMES;
use crate::pipeline::stages::bundle_adjustment::adjust;
use crate::pipeline::stages::bundle_adjustment::input::{AdjustmentConfig, AdjustmentInput};
use crate::pipeline::stages::keyframe_selection::{select_keyframes, set_image_velocities};
use crate::pipeline::stages::recording_check::lens::Lens;
use crate::progress::{Canceled, Progress};

/// Cameras and points with a delay and a factor on the focal length of every camera.
pub(super) struct FreeAdjustment {
    /// With the adjusted focal lengths.
    pub(super) intrinsics: Vec<Intrinsics>,
    /// With the adjusted points.
    pub(super) keyframes: Vec<Keyframe>,
    pub(super) adjusted: Adjusted,
}

impl FreeAdjustment {
    /// From the resections on; with a drift of every camera's clock over a take of `drift_over` frames, if given.
    pub(super) fn from_resections(
        solved: &Solved,
        resections: &[Option<Lens>],
        drift_over: Option<usize>,
        progress: &Progress,
    ) -> Result<Self, Canceled> {
        // A camera that has a name already would spoil the others.
        let unnamed = solved.unnamed(&[]);
        let mut cameras = solved.calibration.cameras.clone();
        (0..cameras.len()).filter(|view| !unnamed.contains(view)).for_each(|view| cameras[view] = None);
        let mut keyframes = select_keyframes(solved.repaired, solved.calibration, &cameras, MAX_KEYFRAMES, ALL_FRAMES);
        set_image_velocities(&mut keyframes, solved.repaired, &cameras, solved.paths);
        let (intrinsics, cameras) = solved.resected(resections, cameras);
        let input = AdjustmentInput {
            intrinsics: &intrinsics,
            cameras,
            keyframes,
            bones: &solved.bones(),
            camera_freedom: CameraFreedom::Adjusted,
            refine_focal: true,
            refine_delays: true,
            drift_over,
            refine_radial: false,
        };
        let block = solved.independent_frames();
        let defaults = AdjustmentConfig::default();
        let config = AdjustmentConfig { relative_decrease: 1e-6, uncertainty_block_frames: Some(block), ..defaults };
        let (adjusted, _) = adjust(&input, &config, progress)?;
        let mut keyframes = input.keyframes;
        keyframes.iter_mut().zip(&adjusted.points).for_each(|(keyframe, points)| keyframe.points.clone_from(points));
        let lens = |(lens, camera): (&Intrinsics, &AdjustedCamera)| lens.with_focal_factor(camera.focal_factor);
        let intrinsics = intrinsics.iter().zip(&adjusted.cameras).map(lens).collect();
        Ok(Self { intrinsics, keyframes, adjusted })
    }
}
