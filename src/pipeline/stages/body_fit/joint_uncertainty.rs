//! Standard deviations of the joints of a fitted motion.
//!
//! The covariance of a joint at `x` in a frame is a sum over what it depends on,
//!
//! `f (J Z J^T + R_b C_b R_b^T) + sigma^2 R_o R_o^T + R_c C_c R_c^T`
//!
//! with `J = dx/d(frame)`, `Z` the frame's block of the inverse of the motion's system, and `R = dx/d(border) + J X` the movement
//! by an unknown that all frames share while the frames follow it by `X = -H_ff^-1 H_fb`: by the betas, whose covariance `C_b` is
//! that of the window; by proportions that the betas do not span, which the fit leaves out (bone offsets of standard deviation
//! `sigma`); and by the cameras. What one camera alone shows is less sure than that: keypoints share errors, which other cameras would
//! show, and bones may be mirrored in depth ([`super::single_camera`]). What bodies define differently is added. `f = n / (n - p)`: n
//! equations a frame determine p unknowns, and leave residuals, by which errors are measured, smaller than these. What no view sees is
//! as uncertain as smoothness and the pose prior leave it, a limb that the whole window does not show as poses are
//! ([`super::unseen_limbs`]); behind joints that are hidden for a while `J Z J^T` counts [`HIDDEN`] times, of absent people [`ABSENT`]
//! times as often. Collision resolution is left out.
//!
//! Standard deviations change no faster than poses: they are those of every few frames, whose pixels count for those of the frames
//! between, and linear between them.

use super::camera_adjustment::BONE_SIGMA;
use super::context::FitContext;
use super::gap_completion::{Purpose, completed_gaps};
use super::motion_problem::MotionProblem;
use super::objective::Objective;
use super::observations::Observations;
use super::person_motion::PersonFit;
use super::pixel_residuals::{DetectedPixels, shared_error_variance};
use super::single_camera::SingleCamera;
use super::terms::camera_unknowns::CameraUnknowns;
use super::terms::unknowns::{CameraColumns, Shape, Unknowns};
use super::thinned_motion::rough_stride;
use super::unseen_limbs::UnseenLimbs;
use crate::body::anthropometry::N_BETAS;
use crate::body::bone_offsets::joint_by_bones;
use crate::body::kinematics::{PosedSkeleton, joint_by_rotation, joints_by_betas, posed};
use crate::body::measures::BetaCovariance;
use crate::body::model::ShapeDirections;
use crate::body::skeleton::{JOINT_NAMES, N_JOINTS};
use crate::geometry::free_network::CameraCovariance;
use crate::optim::block_banded::Eliminated;
use crate::optim::robust::variance_per_residual;
use crate::pipeline::time_windows::windows;
use crate::session::people::JointSigmas;
use nalgebra::{DMatrix, Matrix3};
use rayon::prelude::*;
use std::ops::Range;

/// Variance of joints that no camera shows over that of smoothness and motion prior, which state each frame's accelerations and each joint
/// of a limb as independent: of 112 gaps of 15 to 90 frames 86 % of the errors lay inside the stated 95 % ellipsoids without it, 90 % with
/// 1.5 and 92 % with this.
const HIDDEN: f64 = 2.0;

/// The same, beside [`HIDDEN`], of all joints of a person that no camera shows: real accelerations, such as those of a turn, last longer than a
/// frame. Of 12 absences of 2 s 72 % of the errors lay inside without it, 93 % with this.
const ABSENT: f64 = 4.0;

/// Correlation of slow errors of two landmarks of a region, where one camera alone shows a person: limbs exchanged with those of others and
/// half bodies, which err together, add to the fifth that is measured (docs/method.md 15). Joints of 18 stretches are as far off as
/// stated with it.
const SHARED: f64 = 0.25;

/// How sure a person's motion and shape are.
pub(super) struct MotionUncertainty {
    /// By frame of the motion.
    pub joint_sigmas: Vec<JointSigmas>,
    /// Of the betas, apart from the scale of the scene.
    pub betas: BetaCovariance,
}

/// `None` where the detector's errors over time were not measured.
///
/// `cameras`: of the observations' cameras; without it these are exact. The betas' covariance is that of the window that says most.
pub(super) fn motion_uncertainty(
    context: &FitContext,
    person: &PersonFit,
    cameras: Option<&CameraCovariance>,
) -> Option<MotionUncertainty> {
    context.noise?;
    let windows = windows(person.valid.len(), context.window_frames());
    let of_window = |window: &Range<usize>| window_uncertainty(context, person, cameras, window);
    let of_windows: Vec<MotionUncertainty> = windows.par_iter().map(of_window).collect::<Option<_>>()?;
    let betas = of_windows.iter().map(|window| window.betas).min_by(|a, b| a.trace().total_cmp(&b.trace()))?;
    Some(MotionUncertainty {
        joint_sigmas: of_windows.into_iter().flat_map(|window| window.joint_sigmas).collect(),
        betas,
    })
}

fn window_uncertainty(
    context: &FitContext,
    person: &PersonFit,
    cameras: Option<&CameraCovariance>,
    window: &Range<usize>,
) -> Option<MotionUncertainty> {
    let frames = context.with_halo(window, person.valid.len());
    let stride = telling_stride(&person.observations, &frames, rough_stride(context.frame_interval));
    let observations = person.observations.thinned(frames.clone(), stride);
    let state = person.fitted.state.thinned(frames.clone(), stride);
    let slow = context.noise.map_or(0.0, |noise| noise.typical().autocorrelation);
    let noise = context.noise.map(|noise| noise.thinned(stride));
    let context = &FitContext { noise: noise.as_ref(), ..context.thinned(stride) };
    let pixels = DetectedPixels::new(context, &observations, &state);
    let DetectedPixels::Correlated(paths) = &pixels else { return None };
    let shared = shared_error_variance(paths.landmarks.len(), SHARED * slow);
    let alone = SingleCamera::new(context.model, &observations, context.frame_interval);
    let is_open = alone.open_frames();
    let objective = Objective::new(context, context.config, &observations, pixels.source(), Shape::Free);
    let n_cameras = cameras.map_or(0, CameraCovariance::n_cameras);
    let columns = CameraColumns { n_cameras, unknowns: CameraUnknowns::default() };
    let completed = || completed_gaps(context, &observations, &alone, &state, Purpose::Uncertainty);
    let completion = context.config.completes_gaps.then(completed).flatten();
    let completion = completion.as_ref();
    let problem = Objective {
        has_bones: true,
        cameras: columns,
        speeds: Some(&state),
        is_open: &is_open,
        completion,
        ..objective
    }
    .problem();
    let (unknowns, border) = (&problem.unknowns, problem.unknowns.border);
    let unseen = UnseenLimbs::new(context.model, unknowns);
    let mut system = context.systems.take();
    problem.eliminate(&state, 0.0, &mut system)?;
    let eliminated = system.into_eliminated();
    let of_betas = eliminated.corner.view_range(border.betas(), border.betas()).into_owned().cholesky()?.inverse();
    let errors = variance_per_residual(observations.equations_per_frame(), (3 * unknowns.n_groups()) as f64);
    let body = context.model.shaped(&state.betas);

    let mut sigmas = vec![[0.0; N_JOINTS]; state.poses.len()];
    eliminated.for_each_inverse_block(|t, of_frame, response| {
        let skeleton = posed(&body, &state.poses[t]);
        let by_frame = joints_by_frame(unknowns, &skeleton);
        let by_border =
            joints_by_border(unknowns, &joints_by_betas(context.model, &skeleton), &skeleton) + &by_frame * response;
        let of_pose = variances(&by_frame, of_frame);
        let of_shape = variances(&by_border.columns_range(border.betas()).into_owned(), &of_betas);
        let of_sides = alone.mirrored_variances(t, &skeleton);
        let of_unseen = unseen.as_ref().map_or([0.0; N_JOINTS], |limbs| limbs.variances(&state.poses[t], &skeleton));
        let of_sharing = if alone.shows_person(t) { shared } else { 1.0 };
        let of_absence = if completion.is_some_and(|completion| completion.hides_person(t)) { ABSENT } else { 1.0 };
        let of_gap = |joint: usize| {
            let is_behind = completion.is_some_and(|completion| completion.hides_before(t, joint));
            of_absence * if is_behind { HIDDEN } else { 1.0 }
        };
        let mut by_cameras = Vec::with_capacity(N_JOINTS);
        for joint in 0..N_JOINTS {
            let rows = by_border.fixed_rows::<3>(3 * joint);
            let of_bones = BONE_SIGMA * BONE_SIGMA * rows.columns_range(border.bones()).norm_squared();
            let of_definition = 3.0 * definition_sigma(joint).powi(2);
            by_cameras.push((skeleton.joints[joint], rows.columns_range(border.camera_columns()).into_owned()));
            let of_errors = errors * (of_sharing * of_gap(joint) * of_pose[joint] + of_shape[joint]);
            sigmas[t][joint] = of_errors + of_sides[joint] + of_unseen[joint] + of_bones + of_definition;
        }
        let of_cameras = cameras.map_or_else(|| vec![0.0; N_JOINTS], |cameras| cameras.point_variances(&by_cameras));
        for (sigma, of_cameras) in sigmas[t].iter_mut().zip(of_cameras) {
            *sigma = (*sigma + of_cameras).max(0.0).sqrt();
        }
    });
    let joint_sigmas = window.clone().map(|t| between(&sigmas, t - frames.start, stride)).collect();
    let betas = beta_covariance(&problem, &eliminated)?;
    context.systems.put_back([eliminated.into_system()]);
    Some(MotionUncertainty { joint_sigmas, betas })
}

/// Covariance of the betas, bones free within [`BONE_SIGMA`]: with the information I of the window without the prior of girths, and
/// the weight w of the betas' prior, by which I counts too much, the betas' block of `(I / w + precision of bones)^-1`.
fn beta_covariance(problem: &MotionProblem, eliminated: &Eliminated) -> Option<BetaCovariance> {
    let (border, prior) = (problem.unknowns.border, &problem.shape_prior);
    let own = border.person();
    let mut information = eliminated.corner.view_range(own.clone(), own).into_owned();
    let mut of_betas = information.fixed_view_mut::<N_BETAS, N_BETAS>(0, 0);
    of_betas -= prior.girths * prior.girths.transpose() * prior.girth_weight;
    information /= prior.weight;
    border.bones().for_each(|bone| information[(bone, bone)] += BONE_SIGMA.powi(-2));
    Some(information.cholesky()?.inverse().fixed_view::<N_BETAS, N_BETAS>(0, 0).into_owned())
}

/// Every how many frames one is taken: `stride`, or all where these show less than half of what all do, such as detections of every third
/// frame alone.
fn telling_stride(observations: &Observations, frames: &Range<usize>, stride: usize) -> usize {
    let n_pixels =
        |stride: usize| observations.pixels[frames.clone()].iter().step_by(stride).map(Vec::len).sum::<usize>();
    if 2 * stride * n_pixels(stride) < n_pixels(1) { 1 } else { stride }
}

/// At frame `t` between two of every `stride`-th frame.
fn between(sigmas: &[JointSigmas], t: usize, stride: usize) -> JointSigmas {
    let (k, part) = (t / stride, (t % stride) as f64 / stride as f64);
    let next = &sigmas[(k + 1).min(sigmas.len() - 1)];
    std::array::from_fn(|joint| sigmas[k][joint] + part * (next[joint] - sigmas[k][joint]))
}

/// Standard deviation per axis of where a joint lies in another body of the same person, beside [`BONE_SIGMA`], m: no keypoint
/// shows these joints, and bodies place them by definitions of their own. Between the default body and skeletons of recorded people
/// upper spine and collars lie 65 mm apart, hands 50 mm, the middle of the spine 40 mm, toes and head 20 mm.
fn definition_sigma(joint: usize) -> f64 {
    match JOINT_NAMES[joint] {
        "spine3" | "left_collar" | "right_collar" => 0.035,
        "spine2" | "left_hand" | "right_hand" => 0.02,
        "spine1" | "head" | "left_foot" | "right_foot" => 0.01,
        _ => 0.0,
    }
}

/// By joint, the trace of `by covariance by^T` over its three rows of `by`.
fn variances(by: &DMatrix<f64>, covariance: &DMatrix<f64>) -> [f64; N_JOINTS] {
    let products = (by * covariance).component_mul(by).column_sum();
    std::array::from_fn(|joint| products.fixed_rows::<3>(3 * joint).sum())
}

/// Derivatives of the joints' positions by the unknowns of their frame, three rows a joint.
fn joints_by_frame(unknowns: &Unknowns, skeleton: &PosedSkeleton) -> DMatrix<f64> {
    let mut by_frame = DMatrix::zeros(3 * N_JOINTS, 3 * unknowns.n_groups());
    for joint in 0..N_JOINTS {
        let mut rows = by_frame.fixed_rows_mut::<3>(3 * joint);
        rows.fixed_columns_mut::<3>(3 * unknowns.translation()).copy_from(&Matrix3::identity());
        for (group, ancestor) in unknowns.rotations() {
            rows.fixed_columns_mut::<3>(3 * group).copy_from(&joint_by_rotation(skeleton, joint, ancestor));
        }
    }
    by_frame
}

/// The same by the unknowns of the border, the frames held.
fn joints_by_border(
    unknowns: &Unknowns,
    by_betas: &[ShapeDirections; N_JOINTS],
    skeleton: &PosedSkeleton,
) -> DMatrix<f64> {
    let border = unknowns.border;
    let mut by_border = DMatrix::zeros(3 * N_JOINTS, border.len());
    for joint in 0..N_JOINTS {
        let mut rows = by_border.fixed_rows_mut::<3>(3 * joint);
        rows.columns_range_mut(border.betas()).copy_from(&by_betas[joint]);
        for (bone, block) in joint_by_bones(joint, &skeleton.rotations) {
            let mut columns = rows.fixed_columns_mut::<3>(border.bones().start + 3 * bone);
            columns += block;
        }
    }
    by_border
}

#[cfg(test)]
mod tests {
    use super::super::test_fixtures::seen;
    use super::*;

    /// Where people are detected in every third frame, every third frame from another one on shows nothing: all joints were stated to
    /// lie anywhere within 10 m.
    #[test]
    fn detections_of_every_third_frame_are_not_skipped() {
        let observations = |is_seen: fn(usize) -> bool| {
            let frame = |t: usize| if is_seen(t) { vec![seen(0, 0)] } else { Vec::new() };
            Observations { cameras: Vec::new(), points: vec![Vec::new(); 90], pixels: (0..90).map(frame).collect() }
        };
        let stride = |is_seen, from: usize| telling_stride(&observations(is_seen), &(from..90), 3);
        assert_eq!([0, 1].map(|from| stride(|_| true, from)), [3, 3]);
        assert_eq!([0, 1, 2].map(|from| stride(|t| t.is_multiple_of(3), from)), [3, 1, 1]);
        assert_eq!(stride(|t| t > 60, 0), 3);
    }
}
