//! The shape of a person that all windows of a motion say together.

use super::context::FitContext;
use super::minimisation::{DAMPING_FROM_FIT, FittedMotion};
use super::objective::Objective;
use super::observations::Observations;
use super::pixel_residuals::DetectedPixels;
use super::terms::border_priors::ShapePrior;
use super::terms::unknowns::{MotionState, Shape};
use super::thinned_motion::{carry_along, rough_stride};
use super::window_fit::FittedWindow;
use crate::body::model::Betas;
use crate::progress::Canceled;
use nalgebra::DVector;
use rayon::prelude::*;

/// Windows that were fitted each with a shape of its own, with the one at which all of them together cost least. From the observations of
/// one window alone, the best one, joints of 30 to 50 s of realistic noise came 2 to 9 % farther from the truth.
pub(super) fn with_common_shape(
    context: &FitContext,
    observations: &Observations,
    windows: Vec<FittedWindow>,
) -> Result<Vec<FittedWindow>, Canceled> {
    if windows.len() == 1 {
        return Ok(windows);
    }
    let betas = common_betas(context, &windows).unwrap_or(windows[0].whole.state.betas);
    windows.into_par_iter().map(|window| with_betas(context, observations, window, &betas)).collect()
}

/// The betas at which all windows together cost least, each of which costs least at its own `b` and has the prior `P` in its information
/// `H`, but all of them only once: `(sum H - (n - 1) P)^-1 sum H b`. Windows that took no step, such as those that the person is absent
/// from, say nothing; `None` where none took one.
fn common_betas(context: &FitContext, windows: &[FittedWindow]) -> Option<Betas> {
    let prior = ShapePrior::new(context.config.shape_priors(), context.model).hessian();
    let says = |FittedWindow { whole, .. }: &FittedWindow| Some((whole.beta_information?, whole.state.betas));
    let said: Vec<_> = windows.iter().filter_map(says).collect();
    let information = said.iter().fold(prior, |sum, (of_window, _)| sum + (of_window - prior));
    let pull: Betas = said.iter().map(|(of_window, betas)| of_window * betas).sum();
    if said.is_empty() { None } else { Some(information.cholesky()?.solve(&pull)) }
}

/// The window with other betas, which its poses follow to where they cost least given these, by one linearisation. They do so slowly over
/// time: the poses of every few frames, whose pixels count for those of the frames between, carry these along.
fn with_betas(
    context: &FitContext,
    observations: &Observations,
    FittedWindow { whole, frames }: FittedWindow,
    betas: &Betas,
) -> Result<FittedWindow, Canceled> {
    context.progress.check()?;
    let stride = rough_stride(context.frame_interval);
    let observations = observations.thinned(frames.clone(), stride);
    let few = whole.state.thinned(0..frames.len(), stride);
    let MotionState { betas: own, mut poses } = whole.state;
    let noise = context.noise.map(|noise| noise.thinned(stride));
    let context = FitContext { noise: noise.as_ref(), ..context.thinned(stride) };
    let pixels = DetectedPixels::new(&context, &observations, &few);
    let objective = Objective::new(&context, context.config, &observations, pixels.source(), Shape::Free);
    let problem = Objective { speeds: Some(&few), ..objective }.problem();
    let mut system = context.systems.take();
    if problem.eliminate(&few, DAMPING_FROM_FIT, &mut system).is_some() {
        let eliminated = system.into_eliminated();
        let moved_betas = DVector::from_column_slice((betas - own).as_slice());
        if let Some(step) = eliminated.step(moved_betas, 0.0) {
            carry_along(&mut poses, &problem.moved(&few, &step).poses, stride);
        }
        system = eliminated.into_system();
    }
    context.systems.put_back([system]);
    let state = MotionState { betas: *betas, poses };
    Ok(FittedWindow { whole: FittedMotion { state, ..whole }, frames })
}

#[cfg(test)]
mod tests {
    use super::super::terms::border_priors::BetaInformation;
    use super::super::test_fixtures::{Surroundings, detected};
    use super::super::window_fit::{Pass, fit_window};
    use super::*;
    use crate::body::joint_ranges::natural_pose;
    use crate::body::kinematics::{Pose, posed};
    use nalgebra::{SMatrix, Vector3};
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    /// The shape of a long take came from its best window alone. Two quadratic costs, each of which has the prior in it: the betas of least
    /// cost together, with the prior counted once.
    #[test]
    fn the_shape_comes_from_all_windows() {
        let surroundings = Surroundings::new();
        let context = surroundings.context();
        let prior = ShapePrior::new(context.config.shape_priors(), context.model).hessian();
        let data = |k: usize| {
            let root = SMatrix::<f64, 12, 10>::from_fn(|i, j| ((7 * i + 3 * j * j + 5 * k) % 11) as f64 - 5.0);
            (root.tr_mul(&root), Betas::from_fn(|i, _| 40.0 - (9 * i + 3 * k) as f64))
        };
        let least = |hessian: BetaInformation, pull: Betas| hessian.cholesky().unwrap().solve(&pull);
        let window = |k: usize| {
            let (hessian, pull) = data(k);
            let state = MotionState { betas: least(hessian + prior, pull), poses: Vec::new() };
            let whole = FittedMotion { beta_information: Some(hessian + prior), ..FittedMotion::initial(state) };
            FittedWindow { whole, frames: 0..0 }
        };
        let ((first, of_first), (second, of_second)) = (data(0), data(1));
        let expected = least(first + second + prior, of_first + of_second);
        let absent = || {
            let state = MotionState { betas: Betas::repeat(9.0), poses: Vec::new() };
            FittedWindow { whole: FittedMotion::initial(state), frames: 0..0 }
        };
        let found = common_betas(&context, &[window(0), absent(), window(1)]).unwrap();
        assert!((found - expected).norm() < 1e-9, "{found} {expected}");
        assert_eq!(
            common_betas(&context, &[absent()]),
            None,
            "where the person is absent nothing is said of the shape"
        );
    }

    /// A longer person in the same images: joints are where a fit with these betas has them, which with poses as before they are not.
    #[test]
    fn poses_follow_the_shape() {
        let rotations = natural_pose(&mut ChaCha8Rng::seed_from_u64(0), 0.0).rotations;
        let at = |t: usize| Pose { rotations, translation: Vector3::new(0.01 * t as f64, 0.0, 0.0) };
        let poses: Vec<Pose> = (0..60).map(at).collect();
        let surroundings = Surroundings::new();
        let context = surroundings.context();
        let observations = detected(&surroundings.model, &poses);
        let fitted = |betas: Betas| {
            let start = MotionState { betas, poses: poses.clone() };
            fit_window(&context, &observations, &start, &(0..60), &[(Pass::Last, Shape::Held)]).unwrap()
        };
        let betas = Betas::from_fn(|k, _| if k < 3 { 0.1 } else { 0.0 });
        let (before, wanted) = (fitted(Betas::zeros()), fitted(betas));
        let followed = with_betas(&context, &observations, before.clone(), &betas).unwrap();
        let body = surroundings.model.shaped(&betas);
        let farthest = |window: &FittedWindow| {
            let joints = |window: &FittedWindow, t: usize| posed(&body, window.pose(t)).joints;
            let apart = |t: usize| joints(window, t).into_iter().zip(joints(&wanted, t)).map(|(a, b)| (a - b).norm());
            (0..60).flat_map(apart).fold(0.0, f64::max)
        };
        assert_eq!(followed.whole.state.betas, betas);
        let [unmoved, followed] = [&before, &followed].map(farthest);
        assert!(unmoved > 5e-3 && followed < 0.1 * unmoved, "{unmoved} {followed}");
    }
}
