//! Settings of the fit.

use crate::geometry::Rigid;
use crate::geometry::free_network::CameraCovariance;
use crate::residuals::pose_likelihood::PoseWeights;

/// Every number of the fit.
#[derive(Debug, Clone, PartialEq)]
pub struct BodyFitConfig {
    /// Standard deviation of a triangulated keypoint about the body's landmark, m per axis.
    pub point_sigma: f64,
    /// Bounds of a detector's standard deviation per axis as a share of the person's apparent size; within them it is
    /// measured on the person's own residuals after the fit to points.
    pub pixel_share_bounds: [f64; 2],
    /// Unknowns that a frame's pixels determine: half of a pose's 69, the rest comes from the frames around it.
    pub unknowns_per_frame: f64,
    /// Scale of Geman-McClure's cost: residuals of this many standard deviations cost half of their squared value.
    pub robust_scale: f64,
    /// Standard deviation of the pelvis's accelerations at its typical speed, m/s^2.
    pub pelvis_acceleration_sigma: f64,
    /// Standard deviation of the joints' angular accelerations at their typical speeds over the table of joint ranges.
    pub angular_acceleration_factor: f64,
    /// Whether the fit uses knowledge of human motion: the pose prior in place of each joint's own rest, foot contact, and
    /// speed-scaled smoothness.
    pub motion_prior: bool,
    /// Whether the motion prior only refines a motion that was first fitted without it. From a rough start the prior draws
    /// limbs that a single view sees to the wrong side in depth.
    pub motion_prior_refines: bool,
    /// Whether the motion prior completes joints that no camera shows for a while from the rest of the motion.
    pub completes_gaps: bool,
    /// Whether the last fit is that of the paper, to latent codes of the motions.
    pub latent_motions: bool,
    /// Weight and knee of the pose prior.
    pub pose_weights: PoseWeights,
    /// Standard deviation of the ankles' accelerations in the world at their typical speed, m/s^2.
    pub ankle_acceleration_sigma: f64,
    /// Accelerations below this share of their sigma cost their square, those above it grow linearly: their distribution is
    /// Laplace's, mostly near zero and large at contacts.
    pub acceleration_knee: f64,
    /// Weight of the pull towards the natural rest pose.
    pub rest_weight: f64,
    /// Weight of the prior of the betas against the data.
    pub shape_prior: f64,
    /// Weight of the prior of girths at a given stature, besides that of the betas.
    pub girth_prior: f64,
    /// Standard deviation of the logarithm of the scene's scale, part of the standard deviations of shapes.
    pub sigma_log_scale: f64,
    /// Width of the walls at the ends of the joints' ranges, degrees.
    pub limit_width_deg: f64,
    /// Whether overlaps between bodies are resolved.
    pub resolve_collisions: bool,
    /// Standard deviation of the distance between two bodies' capsules at a collision, m.
    pub overlap_sigma: f64,
    /// Resolving a collision is rejected where it raises the cost of the other terms by more than the first of these per
    /// frame of the collision and by more than the second in sum (halves of squared standard deviations).
    pub max_resolution_cost: [f64; 2],
    /// Frames in a gap without detections longer than this are interpolated, but not valid, s.
    pub gap_limit_secs: f64,
    /// Frames solved at once; longer takes are cut into such windows, which have one shape.
    pub window_frames: usize,
    /// How far a window reaches beyond its own frames on each side, s.
    pub halo_secs: f64,
    /// Whether the last fit takes the detector's errors as correlated in time.
    pub correlated_errors: bool,
    /// Rounds in which the cameras are adjusted together with the motions under these errors; 0: they are held.
    pub camera_rounds: usize,
    /// Covariance of cameras that are not adjusted, because they were before.
    pub known_covariance: Option<CameraCovariance>,
    /// What is known of the cameras that are adjusted.
    pub known_cameras: KnownCameras,
    /// Whether the keypoint bias of the detector is estimated.
    pub estimate_keypoint_bias: bool,
    /// Most frames of one person, and of all together, that the estimate of the keypoint bias uses.
    pub bias_frames: [usize; 2],
    /// Most steps of a fit.
    pub max_iterations: usize,
    /// A step that lowers the cost by less than this share is the last.
    pub min_decrease: f64,
}

/// What is known of the placed cameras, by camera.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct KnownCameras {
    /// Given focal lengths, px, where they are refined; `None`: they are held.
    pub focal_px: Option<Vec<f64>>,
    /// Whether these are guesses without any measurement.
    pub is_focal_guessed: bool,
    /// Given `camera_from_world`; `None`: nothing is known of the poses.
    pub poses: Option<Vec<Rigid>>,
}

impl Default for BodyFitConfig {
    fn default() -> Self {
        Self {
            // Detector noise of 5 px at 4 m, seen from a few sides, and the body's own misfit.
            point_sigma: 0.03,
            // 0.4 % is better than any detector; above 4 % a keypoint is a guess.
            pixel_share_bounds: [0.004, 0.04],
            unknowns_per_frame: 34.0,
            // On the simulated captures 4 beats 3 (17.1 -> 16.1 mm on `hard`) and 2.2 (20.5 mm).
            robust_scale: 4.0,
            // Laplace's scale is then twice the typical accelerations of the table of joint ranges and three times the pelvis's
            // median of 1.5 m/s^2; the knee lies at a seventh and a fifth of them. With the knee at one and a half times, all
            // was worse: `hard` 17.1 against 16.5 mm, `paper` 10.3 against 10.0, two views 26.8 against 25.5; jitter 1.2, 1.4
            // and 1.05 of the truth against 0.96, 1.19, 0.95.
            pelvis_acceleration_sigma: 1.2,
            angular_acceleration_factor: 0.52,
            acceleration_knee: 0.25,
            motion_prior: true,
            // `paper` cut to two views, mean of ten: 16.9 mm, 17.8 with the prior from the start, 17.2 without it.
            motion_prior_refines: true,
            completes_gaps: true,
            latent_motions: false,
            // Two new poses a second, at 30 frames a second. `hard` (10 seeds) 17.2 mm with it and with half of it, 17.5 without
            // the prior; `paper` 9.3 and 9.6; two views (5 seeds) 17.9 with half, 17.8 with one and a half times, 18.2 with
            // 4.5 times of it.
            pose_weights: PoseWeights { weight: 1.0 / 15.0, knee: 2.0 },
            // Half of the pelvis's: jitter over the truth's on `hard` and `paper` is 0.93 and 1.01 with it (1.13 and 1.35 without
            // the term), 0.96 and 1.04 with the pelvis's, with which joints come 0.4 % worse.
            ankle_acceleration_sigma: 0.6,
            // One frame's pull is then a hundredth of one keypoint's at the end of its bone.
            rest_weight: 0.1,
            // Frames count for less than they are: errors last longer than the process that whitens them, neighbouring keypoints share
            // them, and detectors define joints in their own way. The cameras' plain covariance is too small by 4 to 15 on realistic
            // noise. On the Shelf recording, whose detector has hips 43 mm wider than adults, betas reach 4.0 with 1, 2.1 with 5, 1.7
            // with 15, and limbs are off by 62.7, 62.5, 62.2 mm; on mocap skeletons, whose forearms are 7 standard deviations from
            // those of adults, limbs come 0 to 1 % worse with 5, 1 to 3 % with 15.
            shape_prior: 5.0,
            // No keypoint shows girths. Bones tell of them by the population's correlations, but a joint's centre is defined to 20 mm,
            // three times the population's deviation of a hip: people of 1.79 m came out with 140 litres, with 15 with 98,
            // with 30 with 94. Hips of unusual width come out nearer to the mean: 7 mm off, 8 with 30, where detections have no
            // definition of their own.
            girth_prior: 15.0,
            sigma_log_scale: 0.0,
            limit_width_deg: 5.0,
            resolve_collisions: true,
            // The accuracy of the capsules against the skin at rest. With 10 mm dancers remain 72 mm deep in each other (94 mm
            // before), with 5 mm 20 to 30 mm; with 2.5 mm 13 mm, but joints come 3 % off instead of 1 %.
            overlap_sigma: 0.005,
            // Touching dancers are separated at 0 to 2 a frame, and at 60 at most in sum; people simulated walking through each
            // other at 2 to 9 a frame, 500 to 1,000 in sum. Errors are alike over some ten frames: 200 are 20 independent ones.
            max_resolution_cost: [1.0, 200.0],
            gap_limit_secs: 0.5,
            // Some 70 MB a window; the factor of a frame is 0.12 MB.
            window_frames: 480,
            halo_secs: 0.5,
            correlated_errors: true,
            camera_rounds: 0,
            known_covariance: None,
            known_cameras: KnownCameras::default(),
            estimate_keypoint_bias: true,
            // Six seconds of walking or talking turn every limb; offsets are shared, so that more people need less of each.
            bias_frames: [180, 360],
            max_iterations: 8,
            // Joints come within 0.5 % of where steps end that lower the cost by 0.2 %; at 1 % up to 1.5 % farther from the truth.
            min_decrease: 5e-3,
        }
    }
}

impl BodyFitConfig {
    /// The settings of the first fit: without the motion prior if that only refines.
    pub(super) fn without_refinement(&self) -> Self {
        Self { motion_prior: self.motion_prior && !self.motion_prior_refines, ..self.clone() }
    }

    /// Weights of the prior of the betas against the data: of each, and of girths.
    pub(super) fn shape_priors(&self) -> [f64; 2] {
        [self.shape_prior, self.girth_prior]
    }

    /// The settings of the fits that take errors as correlated in time, by `autocorrelation` from frame to frame.
    ///
    /// Slow errors and fast motion differ in their course, so that a pixel decides more over some frames and less over many;
    /// smoothness has to decide more in turn. At an autocorrelation of 0.87 (realistic noise) jitter over the truth's is 1.0 to
    /// 1.1 with half the accelerations, 1.2 to 1.4 with those of independent errors, and joints come 1 to 2 % closer; at 0.3 (the
    /// presets) half the accelerations make joints 1 to 3 % worse.
    ///
    /// An outlier that lasts shows in its first innovation alone, so that innovations of slow errors are trusted less far. At 0.3 joints
    /// come 3 % closer with 6 and 3 to 4 % with 8 in place of 4 (`paper`, `hard`), and 5 % worse with 3; at 0.87 (realistic noise)
    /// 4 % worse with 6 and 1 % closer with 3; Shelf has 0.83.
    pub(super) fn under_correlated_errors(&self, autocorrelation: f64) -> Self {
        let share = 1.0 - 0.6 * autocorrelation;
        Self {
            robust_scale: (2.0 - 1.2 * autocorrelation) * self.robust_scale,
            pelvis_acceleration_sigma: share * self.pelvis_acceleration_sigma,
            angular_acceleration_factor: share * self.angular_acceleration_factor,
            ankle_acceleration_sigma: share * self.ankle_acceleration_sigma,
            ..self.clone()
        }
    }

    /// The settings for a session of a single camera.
    pub fn monocular() -> Self {
        Self {
            // A limb that points at the camera looks as short as a short limb does: under the usual prior people shrink, one of
            // twenty by a third. On ten simulated captures 113 mm with 1, 84 with 10, 79 with 30, 83 with 300, 85 with 3000.
            shape_prior: 30.0,
            // A single ray leaves depth open in every frame: on the same captures 72.3 mm with 0.1, 70.9 with 0.3 (55.0
            // instead of 58.7 after Procrustes alignment), 71.7 with 1.
            pose_weights: PoseWeights { weight: 0.3, ..Self::default().pose_weights },
            // Observations determine only half of the unknowns: 69.0 mm with the prior from the start, 70.7 with it as refinement.
            motion_prior_refines: false,
            // A single view cannot separate the keypoint bias from the poses.
            estimate_keypoint_bias: false,
            correlated_errors: false,
            // With fewer equations than unknowns the residuals do not show the errors. On four captures 72.9 mm with 0, 77.9
            // with the largest possible value.
            unknowns_per_frame: 0.0,
            ..Self::default()
        }
    }
}
