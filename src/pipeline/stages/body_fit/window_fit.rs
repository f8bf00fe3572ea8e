//! The fit of one window of a person's motion, pass by pass.

use super::averaging::averaged;
use super::completed_joints::GapCompletion;
use super::config::BodyFitConfig;
use super::context::FitContext;
use super::depth_sides::on_cheapest_sides;
use super::gap_completion::{Purpose, completed_gaps};
use super::minimisation::{Budget, DAMPING_FROM_FIT, DAMPING_FROM_ROUGH, FittedMotion, minimised};
use super::objective::Objective;
use super::observations::Observations;
use super::pixel_residuals::DetectedPixels;
use super::single_camera::SingleCamera;
use super::terms::data::DataSource;
use super::terms::unknowns::{MotionState, Shape};
use super::thinned_motion::{carry_along, lead_through, rough_stride};
use super::trunk_sides::with_trunk_on_its_side;
use crate::body::kinematics::Pose;
use crate::optim::block_banded::BlockBanded;
use crate::progress::Canceled;
use std::ops::Range;

/// Fewest frames that are left by thinning; shorter windows are fitted whole.
const MIN_THINNED: usize = 30;

/// A pass of the fit of a window, from a rough start to the end. The first four take every few frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Pass {
    /// Triangulated points, since a fit from closed form straight to pixels gets stuck.
    Points,
    /// Pixels, with the settings of the first fit ([`FitContext::first_config`]), of windows that only the last pass goes on from.
    Rough,
    /// The same of the window with most observations, which determines the shape, and on which the detector's errors are measured.
    First,
    /// Pixels of every few frames that are [`averaged`] over those between, with all terms.
    Averaged,
    /// Pixels, with all terms, from the first fit to the end.
    Last,
    /// The same from averaged frames: what single frames say beside these.
    Finish,
}

impl Pass {
    /// Later passes start from where the first ones end, and come out the same whether those take 1 to 3 steps or twice as many:
    /// cameras within 0.6 %, joints within 0.3 % on 43 captures. With all frames in place of every third, cameras move by less than
    /// 2 % over 51 captures, and joints come no closer.
    fn budget(self, config: &BodyFitConfig) -> Budget {
        let BodyFitConfig { max_iterations, min_decrease, .. } = *config;
        let (from_rough, from_fit) = (DAMPING_FROM_ROUGH, DAMPING_FROM_FIT);
        match self {
            Self::Points => Budget { max_iterations: 2, min_decrease: 3e-2, damping: from_rough },
            Self::Rough => Budget { max_iterations, min_decrease: 3e-2, damping: from_rough },
            Self::First => Budget { max_iterations, min_decrease: 3e-3, damping: from_rough },
            Self::Averaged => Budget { max_iterations: 3, min_decrease, damping: from_fit },
            Self::Last => Budget { max_iterations, min_decrease, damping: from_fit },
            Self::Finish => Budget { max_iterations, min_decrease: FINISHED, damping: from_fit },
        }
    }

    /// Whether it takes all frames.
    fn is_full(self) -> bool {
        matches!(self, Self::Last | Self::Finish)
    }

    /// Whether it has the terms of the last fit, under the errors that have been measured.
    fn is_last(self) -> bool {
        self.is_full() || self == Self::Averaged
    }
}

/// A step from averaged frames that lowers the cost by a smaller share is the last where nothing is completed or guided; the first lowers
/// it by 12 to 24 % under slow errors, by 3 % under white ones. With a second joints of realistic noise come 0.5 % worse, and single errors
/// of frames show in the motion: jitter is 2 % more.
const FINISHED: f64 = 0.3;

/// Most steps of the last pass before gaps are completed again: with four, joints come out the same to 0.1 % on 131 captures, hidden ones
/// as well; with two, single captures differ by 3 %.
const STEPS_FROM_ROUGH: usize = 3;

/// The fit of a window and its halo.
#[derive(Clone)]
pub(super) struct FittedWindow {
    pub whole: FittedMotion,
    /// The frames fitted.
    pub frames: Range<usize>,
}

impl FittedWindow {
    /// At a frame of the track.
    pub(super) fn pose(&self, t: usize) -> &Pose {
        &self.whole.state.poses[t - self.frames.start]
    }
}

/// Fits a window and its halo in `passes`, each with the shape free or held; to points alone where there are no pixels.
pub(super) fn fit_window(
    context: &FitContext,
    observations: &Observations,
    start: &MotionState,
    window: &Range<usize>,
    passes: &[(Pass, Shape)],
) -> Result<FittedWindow, Canceled> {
    let frames = context.with_halo(window, start.poses.len());
    let observations = observations.slice(frames.clone());
    let state = start.of(&frames);
    let has_pixels = observations.pixels.iter().any(|frame| !frame.is_empty());
    let (mut whole, mut system) = (FittedMotion::initial(state), context.systems.take());
    let to_points = passes.first().map(|(_, shape)| (Pass::Points, *shape));
    let passes = if has_pixels { passes } else { to_points.as_slice() };
    for &(pass, shape) in passes {
        let is_rough = has_pixels && !pass.is_full();
        let fitted = match if is_rough { stride(context, &observations) } else { 1 } {
            1 => fit_pass(context, &observations, whole.state, shape, pass, &mut system)?,
            stride => fit_thinned(context, &observations, whole.state, shape, pass, stride, &mut system)?,
        };
        whole = FittedMotion { iterations: whole.iterations + fitted.iterations, ..fitted };
    }
    context.systems.put_back([system]);
    Ok(FittedWindow { whole, frames })
}

/// Every how many frames a rough pass takes one. A single camera leaves so much open that its fit wants all of them.
pub(super) fn stride(context: &FitContext, observations: &Observations) -> usize {
    let stride = rough_stride(context.frame_interval);
    let has_enough = observations.cameras.len() > 1 && observations.pixels.len() >= MIN_THINNED * stride;
    if has_enough { stride } else { 1 }
}

/// A pass over every `stride`-th frame; those between follow.
fn fit_thinned(
    context: &FitContext,
    observations: &Observations,
    start: MotionState,
    shape: Shape,
    pass: Pass,
    stride: usize,
    system: &mut BlockBanded,
) -> Result<FittedMotion, Canceled> {
    let thinned = match pass {
        Pass::Averaged => averaged(context.model, observations, &start, stride),
        _ => observations.thinned(0..observations.pixels.len(), stride),
    };
    let context = FitContext { noise: context.averaged_noise, ..context.thinned(stride) };
    let few = start.thinned(0..start.poses.len(), stride);
    let mut poses = start.poses;
    let fitted = fit_pass(&context, &thinned, few, shape, pass, system)?;
    match pass {
        Pass::Averaged => carry_along(&mut poses, &fitted.state.poses, stride),
        _ => lead_through(&mut poses, &fitted.state.poses, stride),
    }
    Ok(FittedMotion { state: MotionState { poses, ..fitted.state }, ..fitted })
}

/// One pass over all frames of `observations`.
fn fit_pass(
    context: &FitContext,
    observations: &Observations,
    start: MotionState,
    shape: Shape,
    pass: Pass,
    system: &mut BlockBanded,
) -> Result<FittedMotion, Canceled> {
    let FitContext { config, first_config, .. } = *context;
    let pixels = match pass {
        Pass::Points => None,
        Pass::Rough | Pass::First => Some(DetectedPixels::independent(context, observations, &start)),
        Pass::Averaged | Pass::Last | Pass::Finish => Some(DetectedPixels::new(context, observations, &start)),
    };
    let data = pixels.as_ref().map_or(DataSource::Points { sigma: config.point_sigma }, DetectedPixels::source);
    let budget = pass.budget(config);
    let config = if pass.is_last() { config } else { first_config };
    let alone = pass.is_last().then(|| SingleCamera::new(context.model, observations, context.frame_interval));
    let is_open = alone.as_ref().map_or_else(Vec::new, SingleCamera::open_frames);
    let minimised_within =
        |budget: Budget, completion: Option<&GapCompletion>, start: MotionState, system: &mut BlockBanded| {
            let speeds = (pass != Pass::Points).then_some(&start);
            let objective = Objective {
                speeds,
                completion,
                is_open: &is_open,
                ..Objective::new(context, config, observations, data, shape)
            };
            minimised(context, &objective.problem(), start.clone(), budget, system)
        };
    let completed = |state: &MotionState, purpose: Purpose| {
        let alone = alone.as_ref().filter(|_| config.completes_gaps)?;
        completed_gaps(context, observations, alone, state, purpose)
    };
    let finished = |state: MotionState, system: &mut BlockBanded| {
        let good = completed(&state, Purpose::FromGood);
        let start = match &good {
            Some(gaps) => on_cheapest_sides(context, observations, gaps, gaps.applied_to(state)),
            None => state,
        };
        // What is completed or guided now lies elsewhere than averaged frames had it, and has farther to go.
        let is_near = good.is_none() && !is_open.contains(&true);
        let min_decrease = if is_near { budget.min_decrease } else { context.config.min_decrease };
        minimised_within(Budget { min_decrease, ..budget }, good.as_ref(), start, system)
    };
    // The first fit has no pose prior, so that what it states at the edges of gaps (twists about bones above all) is rough.
    let start = match &alone {
        Some(alone) => with_trunk_on_its_side(context, observations, alone, start),
        None => start,
    };
    if pass == Pass::Finish {
        return finished(start, system);
    }
    let Some(rough) = completed(&start, Purpose::FromRough) else {
        return minimised_within(budget, None, start, system);
    };
    // Which only has to be good enough to start from: with all steps hidden joints come no closer.
    let few = Budget {
        max_iterations: STEPS_FROM_ROUGH.min(budget.max_iterations),
        min_decrease: context.config.min_decrease,
        ..budget
    };
    let fitted = minimised_within(few, Some(&rough), rough.applied_to(start), system)?;
    if pass == Pass::Averaged {
        return Ok(fitted);
    }
    let again = finished(fitted.state, system)?;
    Ok(FittedMotion { iterations: fitted.iterations + again.iterations, cost_before: fitted.cost_before, ..again })
}

#[cfg(test)]
mod tests {
    use super::super::observations::PointObservation;
    use super::super::test_fixtures::{Surroundings, detected};
    use super::*;
    use crate::body::model::Betas;
    use nalgebra::Vector3;

    /// A window from which a person is absent has paths that lead through it, but nothing to average.
    #[test]
    fn windows_without_pixels_follow_their_points_alone() {
        let surroundings = Surroundings::new();
        let poses = vec![Pose::rest(); 90];
        let points = vec![vec![PointObservation { landmark: 0, position: Vector3::new(0.3, 1.0, 0.0) }]; 90];
        let observations = Observations { cameras: Vec::new(), points, pixels: vec![Vec::new(); 90] };
        let start = MotionState { betas: Betas::zeros(), poses };
        let fitted = |pass| {
            let window = fit_window(&surroundings.context(), &observations, &start, &(0..90), &[(pass, Shape::Held)]);
            window.unwrap().whole
        };
        assert_ne!(fitted(Pass::Finish).state, start);
    }

    /// One step from averaged frames left limbs of runners on the wrong side in depth where one camera alone showed them: joints were
    /// up to 80 % farther off. From some starts one step is enough beside two cameras.
    #[test]
    fn windows_with_a_single_camera_are_fitted_to_the_end() {
        let mut surroundings = Surroundings::new();
        surroundings.config.completes_gaps = false;
        let poses = vec![Pose::rest(); 60];
        let beside_two = detected(&surroundings.model, &poses);
        let mut beside_one = beside_two.clone();
        beside_one.pixels[20..40].iter_mut().for_each(|frame| frame.retain(|pixel| pixel.camera == 0));
        let fitted = |observations: &Observations, poses: Vec<Pose>, pass: Pass| {
            let start = MotionState { betas: Betas::zeros(), poses };
            fit_window(&surroundings.context(), observations, &start, &(0..60), &[(pass, Shape::Held)]).unwrap().whole
        };
        let both = [&beside_two, &beside_one];
        let settled = both.map(|observations| fitted(observations, poses.clone(), Pass::Last).state.poses);
        let steps_from = |by: f64, k: usize| {
            let moved = |pose: &Pose| Pose { translation: pose.translation + Vector3::x() * by, ..*pose };
            fitted(both[k], settled[k].iter().map(moved).collect(), Pass::Finish).iterations
        };
        let found = [5e-4, 1e-3, 2e-3, 4e-3].map(|by| [0, 1].map(|k| steps_from(by, k)));
        assert!(found.iter().any(|[two, one]| *two == 1 && *one > 1), "{found:?}");
        assert!(found.iter().all(|[two, one]| two <= one), "{found:?}");
    }
}
