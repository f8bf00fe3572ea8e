//! Bundle adjustment on selected keyframes, and the association under the adjusted cameras.

use crate::body::bones::LENGTH_SIGMA;
use crate::geometry::Rigid;
use crate::optim::robust::median;
use crate::pipeline::calibration::{Adjusted, Calibration, CameraFreedom};
use crate::pipeline::capture::Capture;
use crate::pipeline::config::{IntrinsicsMode, Options};
use crate::pipeline::stages::association::associate;
use crate::pipeline::stages::bundle_adjustment::adjust;
use crate::pipeline::stages::bundle_adjustment::input::{AdjustmentConfig, AdjustmentInput, Bone};
use crate::pipeline::stages::joint_trajectories::joint_trajectories;
use crate::pipeline::stages::keyframe_selection::{FrameFilter, noise_factor, select_keyframes, set_image_velocities};
use crate::progress::{Canceled, Progress};

/// Effort of one bundle adjustment.
#[derive(Debug, Clone, Copy)]
pub struct Effort {
    /// Largest number of keyframes. Errors of one person's detections are correlated over half a second, so more cost
    /// time and add hardly any information.
    pub max_keyframes: usize,
    /// Relative decrease of the cost below which the solver stops: the next association changes more than the last
    /// digits would.
    relative_decrease: f64,
    /// Seconds of one person that count as one independent block in the cameras' uncertainty; `None`: not computed.
    uncertainty_block_secs: Option<f64>,
    /// Whether delays of the cameras are estimated.
    refine_delays: bool,
    /// Whether these change linearly over the take.
    refine_drifts: bool,
    /// Standard deviation of the logarithms of the factors on the focal lengths; `None`: they are held.
    focal_sigma: Option<f64>,
}

impl Effort {
    /// For a candidate arrangement of the cameras.
    pub const TRIAL: Self = Self {
        max_keyframes: 120,
        relative_decrease: 1e-3,
        uncertainty_block_secs: None,
        refine_delays: false,
        refine_drifts: false,
        focal_sigma: None,
    };
    /// For a round that an association and another adjustment follow.
    pub const ROUND: Self = Self { max_keyframes: 250, relative_decrease: 1e-4, ..Self::TRIAL };
    /// For the cameras of the result. Detector errors are correlated over a third of a second (AR(0.9) at 30 Hz); a
    /// block must span several such times.
    pub const FINAL: Self =
        Self { max_keyframes: 500, relative_decrease: 1e-6, uncertainty_block_secs: Some(2.0), ..Self::TRIAL };
    /// For cameras that are adjusted once more together with the bodies: on fifteen captures of all presets and Shelf their angles
    /// are then within 1 % of those after [`Self::FINAL`], errors of joints within 0.1 %, in 7 % less time of the whole solve.
    const BEFORE_BODIES: Self = Self { max_keyframes: 250, relative_decrease: 1e-4, ..Self::FINAL };
    /// With delays: only moving points show them, and there are fewer of those.
    const DELAYS: Self = Self { max_keyframes: 1500, relative_decrease: 1e-5, refine_delays: true, ..Self::FINAL };
    /// With focal lengths: a focal length trades against distance, so convergence is slow and matters.
    pub const FOCAL_LENGTHS: Self = Self { focal_sigma: Some(GUESSED_ANGLE), ..Self::FINAL };
    /// With focal lengths of which the order of magnitude is known, for a candidate and for the last rounds.
    pub const UNKNOWN_FOCAL: Self = Self { focal_sigma: Some(UNKNOWN_ANGLE), relative_decrease: 1e-4, ..Self::TRIAL };
    /// See [`Self::UNKNOWN_FOCAL`].
    pub const LAST_UNKNOWN_FOCAL: Self = Self { focal_sigma: Some(UNKNOWN_ANGLE), ..Self::FINAL };

    /// With delays, and with focal lengths where the options leave them open: held to wrong ones, points that move find their place
    /// by delays.
    pub fn delays(intrinsics: IntrinsicsMode) -> Self {
        let focal_sigma = match intrinsics {
            IntrinsicsMode::Fixed => None,
            IntrinsicsMode::RefineFocal => Some(GUESSED_ANGLE),
            IntrinsicsMode::Estimate => Some(UNKNOWN_ANGLE),
        };
        Self { focal_sigma, ..Self::DELAYS }
    }

    /// The same with drifts.
    pub fn with_drifts(self) -> Self {
        Self { refine_drifts: true, ..self }
    }

    /// Whether there are any, which a sixth of the keyframes shows to a tenth of a frame.
    pub fn testing_drifts(self) -> Self {
        Self { max_keyframes: Self::ROUND.max_keyframes, ..self.with_drifts() }
    }

    /// For the last adjustment of cameras and points.
    pub fn last(options: &Options) -> Self {
        if options.adjust_with_bodies { Self::BEFORE_BODIES } else { Self::FINAL }
    }
}

/// A guessed angle of view. How far the focal lengths really are off is decided afterwards.
pub const GUESSED_ANGLE: f64 = 0.1;

/// Angles of view of phones, action cameras and portrait lenses: focal lengths from 0.5 to 2.5 image widths within two.
const UNKNOWN_ANGLE: f64 = 0.4;

/// All frames may be used.
pub const ALL_FRAMES: FrameFilter = &|_| true;

/// One round: bundle adjustment, then association under the new cameras. Returns `before` if less is explained then.
pub fn adjusted_and_associated(
    capture: &Capture,
    before: Calibration,
    effort: Effort,
    progress: &Progress,
) -> Result<Calibration, Canceled> {
    let mut steps = progress.steps([3.0, 1.0]);
    let mut after = adjusted(capture, &before, effort, ALL_FRAMES, &steps.begin("adjusting cameras and points"))?;
    let (association, report) = associate(capture, &after.cameras, &steps.begin("re-associating detections"))?;
    // A wrong association after a right start is the real danger: a round that explains less is discarded.
    let is_comparable = before.n_placed() == before.association.n_views_placed;
    if is_comparable && association.explained < before.association.explained - 0.01 {
        return Ok(before);
    }
    after.association = association;
    after.stages.push(report);
    Ok(after)
}

/// The cameras after bundle adjustment on selected keyframes, rescaled so that bones keep adult lengths.
pub fn adjusted(
    capture: &Capture,
    before: &Calibration,
    effort: Effort,
    allowed: FrameFilter,
    progress: &Progress,
) -> Result<Calibration, Canceled> {
    let session = capture.session;
    let mut keyframes = select_keyframes(session, before, &before.cameras, effort.max_keyframes, allowed);
    if keyframes.is_empty() {
        return Ok(before.clone());
    }
    if effort.refine_delays {
        let trajectories = joint_trajectories(&before.people(session, &before.association.points), progress)?;
        set_image_velocities(&mut keyframes, session, &before.cameras, &trajectories);
    }
    let bones: Vec<Bone> = capture.bones.iter().map(|b| Bone { a: b.a, b: b.b, sigma: LENGTH_SIGMA }).collect();
    let input = AdjustmentInput {
        intrinsics: &capture.intrinsics(),
        cameras: before.cameras.clone(),
        keyframes,
        bones: &bones,
        camera_freedom: CameraFreedom::Adjusted,
        refine_focal: effort.focal_sigma.is_some(),
        refine_delays: effort.refine_delays,
        drift_over: effort.refine_drifts.then_some(session.n_frames),
        refine_radial: false,
    };
    let uncertainty_block_frames = effort.uncertainty_block_secs.map(|s| ((s * session.fps).round() as usize).max(1));
    let relative_decrease = effort.relative_decrease;
    let defaults = AdjustmentConfig::default();
    let focal_sigma = effort.focal_sigma.unwrap_or(defaults.focal_sigma);
    let config = AdjustmentConfig { relative_decrease, uncertainty_block_frames, focal_sigma, ..defaults };
    let (adjusted, report) = adjust(&input, &config, progress)?;
    let cameras: Vec<Option<Rigid>> = adjusted.cameras.iter().map(|c| c.camera_from_world).collect();
    let mut keyframes = input.keyframes;
    for (keyframe, points) in keyframes.iter_mut().zip(&adjusted.points) {
        keyframe.points.clone_from(points);
    }
    let noise = before.noise.clone().scaled(noise_factor(session, &cameras, &keyframes));
    let scale = bone_scale(capture, &adjusted);
    let cameras = cameras.into_iter().map(|c| c.map(|c| Rigid { translation: c.translation * scale, ..c })).collect();
    let mut stages = before.stages.clone();
    stages.push(report);
    Ok(Calibration { cameras, adjusted: Some(adjusted), noise, stages, ..before.clone() })
}

/// Metres per unit of the adjusted world, from the median bone; keeps the tracker's gates in metres.
fn bone_scale(capture: &Capture, adjusted: &Adjusted) -> f64 {
    let mut logs = Vec::new();
    for lengths in adjusted.bone_lengths.values() {
        for (length, bone) in lengths.iter().zip(&capture.bones) {
            logs.extend(length.map(|l| (bone.length / l).ln()));
        }
    }
    median(&mut logs).map_or(1.0, f64::exp)
}
