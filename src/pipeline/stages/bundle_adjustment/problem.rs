//! The least-squares problem: linearisation of one keyframe and one damped step.

use super::gauge::Gauge;
use super::input::{AdjustmentConfig, AdjustmentInput};
use super::variables::{self, CameraState, Layout, POSE_UNKNOWNS, SlotObservation, State, Variables};
use crate::geometry::{Intrinsics, Rigid};
use crate::optim::arrow::{self, Block, Column, Span};
use crate::optim::levenberg_marquardt::{LeastSquares, Trial};
use crate::optim::robust::{geman_mcclure, geman_mcclure_ceiling, median};
use crate::optim::vectors::vectorised;
use crate::pipeline::keyframe::Keyframe;
use crate::progress::Progress;
use crate::residuals::bone_length;
use crate::residuals::reprojection::{self, Reprojection};
use nalgebra::{DMatrix, DVector, Vector2, Vector3};
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

/// Shares of a local step that are tried where the whole step raises the cost.
const SHORTENED: [f64; 3] = [0.5, 0.1, 0.0];

/// The problem at one robust scale.
pub(super) struct Problem<'a> {
    pub(super) variables: Vec<Variables>,
    pub(super) layout: Layout,
    pub(super) gauge: Gauge,
    /// In standard deviations; the only value that changes between runs of the solver.
    pub(super) robust_scale: f64,
    intrinsics: &'a [Intrinsics],
    focal_sigma: f64,
    delay_sigma: f64,
    radial_sigma: f64,
    progress: &'a Progress,
}

/// Builds the problem and its start from the input.
pub(super) fn formulate<'a>(
    input: &AdjustmentInput<'a>,
    config: &AdjustmentConfig,
    progress: &'a Progress,
) -> (Problem<'a>, State) {
    let is_finite = |pose: Rigid| pose.rotation.iter().chain(&pose.translation).all(|x| x.is_finite());
    let is_placed =
        |(view, pose): (usize, &Option<Rigid>)| view < input.intrinsics.len() && pose.is_some_and(is_finite);
    let mut placed: Vec<bool> = input.cameras.iter().enumerate().map(is_placed).collect();
    let (layout, mut variables) = variables::choose(input, &mut placed);
    let camera = |(view, given): (usize, &Option<Rigid>)| {
        let camera_from_world = given.filter(|_| placed[view])?;
        let intrinsics = input.intrinsics[view];
        Some(CameraState { intrinsics, log_focal: 0.0, delay: 0.0, drift: 0.0, radial: 0.0, camera_from_world })
    };
    let cameras: Vec<_> = input.cameras.iter().enumerate().map(camera).collect();
    let start_of = |(keyframe, variables): (&Keyframe, &Variables)| {
        variables.keypoints.iter().filter_map(|&k| keyframe.points[k]).collect::<Vec<_>>()
    };
    let points: Vec<_> = input.keyframes.iter().zip(&variables).map(start_of).collect();
    let log_lengths = median_log_lengths(&layout, &variables, &points);
    let gauge = Gauge::choose(&layout, &variables, &cameras);
    // The anchor keeps its pose: the sums over its unknowns would be dropped, unless it has others.
    if let Some(anchor) = gauge.anchor.filter(|_| layout.per_camera == POSE_UNKNOWNS) {
        variables.iter_mut().for_each(|variables| variables.hold(anchor, POSE_UNKNOWNS));
    }
    let problem = Problem {
        variables,
        layout,
        gauge,
        robust_scale: config.scale.end,
        intrinsics: input.intrinsics,
        focal_sigma: config.focal_sigma,
        delay_sigma: config.delay_sigma,
        radial_sigma: config.radial_sigma,
        progress,
    };
    (problem, State { cameras, log_lengths, points })
}

/// Logarithm of each bone's median length over its person's keyframes.
fn median_log_lengths(layout: &Layout, variables: &[Variables], points: &[Vec<Vector3<f64>>]) -> Vec<f64> {
    let mut samples = vec![Vec::new(); layout.n_border - layout.first_length];
    for (variables, points) in variables.iter().zip(points) {
        for limb in &variables.limbs {
            let length = (points[limb.slot_a] - points[limb.slot_b]).norm();
            if length > 0.0 {
                samples[limb.length].push(length.ln());
            }
        }
    }
    samples.iter_mut().map(|s| median(s).unwrap_or(0.0)).collect()
}

impl LeastSquares for Problem<'_> {
    type State = State;

    fn cost(&self, state: &State) -> f64 {
        let costs: Vec<f64> =
            (0..self.variables.len()).into_par_iter().map(|i| self.keyframe_cost(i, state, &state.points[i])).collect();
        costs.iter().sum::<f64>() + self.prior_cost(state)
    }

    fn step(&self, state: &State, damping: f64) -> Option<Trial<State>> {
        let n_keyframes = self.variables.len();
        let linearize = |i: usize, block: &mut Block| self.linearize(i, state, block);
        let mut reduced = arrow::reduce(n_keyframes, self.layout.n_border, damping, linearize);
        reduced.hessian += self.prior_information();
        reduced.gradient += self.prior_gradient(state);
        let border_step = self.gauge.basis(&self.layout, state).solve(&reduced.hessian, &reduced.gradient)?;
        let mut moved = self.move_border(state, &border_step);
        let keyframes = arrow::back_substitute(n_keyframes, damping, &border_step, linearize, |i, cost, step| {
            self.move_points(i, &state.points[i], cost, &moved, step)
        });
        let cost = keyframes.iter().map(|(_, cost)| cost).sum::<f64>() + self.prior_cost(&moved);
        moved.points = keyframes.into_iter().map(|(points, _)| points).collect();
        Some(Trial { state: moved, cost })
    }
}

impl Problem<'_> {
    /// Normal equations of one keyframe at `state`.
    pub(super) fn linearize(&self, i: usize, state: &State, block: &mut Block) {
        vectorised(Linearization { problem: self, i, state, block });
    }

    #[inline(always)]
    fn add_residuals(&self, i: usize, state: &State, block: &mut Block) {
        let (variables, points) = (&self.variables[i], &state.points[i]);
        block.reset(3 * variables.keypoints.len(), &variables.columns);
        if self.progress.check().is_err() {
            return; // The solver checks the flag before it uses the step.
        }
        for observed in &variables.observations {
            let (o, slot) = (&observed.observation, observed.slot);
            let Some(camera) = &state.cameras[o.view] else { continue };
            let linear = reprojection::linearize(
                &camera.intrinsics,
                &camera.camera_from_world,
                &points[slot],
                &o.pixel_without(camera.delay_at(variables.time)),
                o.sigma_px,
            );
            let Some(linear) = linear else {
                block.add_cost(geman_mcclure_ceiling(self.robust_scale));
                continue;
            };
            let robust = geman_mcclure(linear.residual.norm_squared(), self.robust_scale);
            block.add_cost(robust.cost);
            let by_radial = self.layout.radial.map_or_else(Vector2::zeros, |_| {
                reprojection::by_radial(&camera.intrinsics, &camera.camera_from_world, &points[slot], o.sigma_px)
            });
            self.add_observation(block, robust.weight, (&linear, &by_radial), variables.time, observed);
        }
        for limb in &variables.limbs {
            let (a, b) = (&points[limb.slot_a], &points[limb.slot_b]);
            let Some(linear) = bone_length::linearize(a, b, state.log_lengths[limb.length], limb.sigma) else {
                block.add_cost(geman_mcclure_ceiling(self.robust_scale));
                continue;
            };
            let robust = geman_mcclure(linear.residual * linear.residual, self.robust_scale);
            block.add_cost(robust.cost);
            let local: [Column<1>; 6] = std::array::from_fn(|k| {
                let (slot, sign) = if k < 3 { (limb.slot_a, 1.0) } else { (limb.slot_b, -1.0) };
                Column { index: 3 * slot + k % 3, derivative: [sign * linear.by_a[k % 3]] }
            });
            let border = [Column { index: limb.column, derivative: [linear.by_log_length] }];
            block.add_residual(robust.weight, &[linear.residual], &local, &border);
        }
    }

    /// Adds an observation to the normal equations: its point, and its camera with the unknowns that this has.
    #[inline(always)]
    fn add_observation(
        &self,
        block: &mut Block,
        weight: f64,
        (linear, by_radial): (&Reprojection, &Vector2<f64>),
        time: f64,
        observed: &SlotObservation,
    ) {
        let o = &observed.observation;
        let by_unknown = |k: usize| match k {
            0..6 => [linear.by_camera[(0, k)], linear.by_camera[(1, k)]],
            _ if self.layout.focal == Some(k) => linear.by_log_focal.into(),
            _ if self.layout.radial == Some(k) => (*by_radial).into(),
            _ if self.layout.drift == Some(k) => (o.velocity * (time / o.sigma_px)).into(),
            _ => (o.velocity / o.sigma_px).into(),
        };
        let residual = linear.residual.into();
        let local = span::<3>(3 * observed.slot, |k| [linear.by_point[(0, k)], linear.by_point[(1, k)]]);
        match (observed.column, self.layout.per_camera) {
            (None, _) => block.add_spans(weight, &residual, &local, &span::<0>(0, by_unknown)),
            (Some(first), 6) => block.add_spans(weight, &residual, &local, &span::<6>(first, by_unknown)),
            (Some(first), 7) => block.add_spans(weight, &residual, &local, &span::<7>(first, by_unknown)),
            (Some(first), 8) => block.add_spans(weight, &residual, &local, &span::<8>(first, by_unknown)),
            (Some(first), 9) => block.add_spans(weight, &residual, &local, &span::<9>(first, by_unknown)),
            (Some(first), _) => block.add_spans(weight, &residual, &local, &span::<10>(first, by_unknown)),
        }
    }

    /// The points of one keyframe after a step, with their cost. The step is shortened where the whole one raises the
    /// cost of the keyframe; otherwise a few badly observed points would cause the whole step to be rejected.
    fn move_points(
        &self,
        i: usize,
        before: &[Vector3<f64>],
        cost_before: f64,
        border: &State,
        step: &[f64],
    ) -> (Vec<Vector3<f64>>, f64) {
        let by = |share: f64| {
            let moved = |(x, d): (&Vector3<f64>, &[f64])| x + Vector3::new(d[0], d[1], d[2]) * share;
            let points: Vec<_> = before.iter().zip(step.chunks_exact(3)).map(moved).collect();
            let cost = self.keyframe_cost(i, border, &points);
            (points, cost)
        };
        let whole = by(1.0);
        if whole.1 <= cost_before {
            return whole;
        }
        SHORTENED.iter().map(|&share| by(share)).fold(whole, |best, next| if best.1 <= next.1 { best } else { next })
    }

    /// Cost of one keyframe with the border of `state` and these points; summed as [`Self::linearize`] does, to be compared.
    fn keyframe_cost(&self, i: usize, state: &State, points: &[Vector3<f64>]) -> f64 {
        vectorised(Evaluation { problem: self, i, state, points })
    }

    #[inline(always)]
    fn sum_costs(&self, i: usize, state: &State, points: &[Vector3<f64>]) -> f64 {
        let charge = |squared: Option<f64>| {
            squared.map_or(geman_mcclure_ceiling(self.robust_scale), |e2| geman_mcclure(e2, self.robust_scale).cost)
        };
        let variables = &self.variables[i];
        let observations = variables.observations.iter().map(|observed| {
            let o = &observed.observation;
            let residual = state.cameras[o.view].as_ref().and_then(|camera| {
                let point = &points[observed.slot];
                let pixel = o.pixel_without(camera.delay_at(variables.time));
                reprojection::residual(&camera.intrinsics, &camera.camera_from_world, point, &pixel, o.sigma_px)
            });
            charge(residual.map(|r| r.norm_squared()))
        });
        let limbs = variables.limbs.iter().map(|limb| {
            let (a, b) = (&points[limb.slot_a], &points[limb.slot_b]);
            let linear = bone_length::linearize(a, b, state.log_lengths[limb.length], limb.sigma);
            charge(linear.map(|l| l.residual * l.residual))
        });
        observations.chain(limbs).sum()
    }

    /// Priors of the cameras' further unknowns: column, value and standard deviation about 0.
    fn priors<'s>(&'s self, state: &'s State) -> impl Iterator<Item = (usize, f64, f64)> + 's {
        state.cameras.iter().zip(&self.layout.camera_columns).flat_map(|(camera, first)| {
            let of = |place: Option<usize>, value: fn(&CameraState) -> f64, sigma: f64| {
                Some(((*first)? + place?, value(camera.as_ref()?), sigma))
            };
            let focal = of(self.layout.focal, |c| c.log_focal, self.focal_sigma);
            let delay = of(self.layout.delay, |c| c.delay, self.delay_sigma);
            let radial = of(self.layout.radial, |c| c.radial, self.radial_sigma);
            let drift = of(self.layout.drift, |c| c.drift, self.delay_sigma);
            focal.into_iter().chain(delay).chain(drift).chain(radial)
        })
    }

    /// Cost of the priors, focal factors near 1, delays, drifts and changes of lenses near 0: `(value / sigma)^2 / 2` each.
    fn prior_cost(&self, state: &State) -> f64 {
        self.priors(state).map(|(_, value, sigma)| 0.5 * (value / sigma).powi(2)).sum()
    }

    /// Hessian of [`Self::prior_cost`], the same at every state. [border, border]
    pub(super) fn prior_information(&self) -> DMatrix<f64> {
        let mut information = DMatrix::zeros(self.layout.n_border, self.layout.n_border);
        for first in self.layout.camera_columns.iter().flatten() {
            let Layout { focal, delay, drift, radial, .. } = self.layout;
            let of_clock = [delay, drift].map(|place| (place, self.delay_sigma));
            for (place, sigma) in [(focal, self.focal_sigma), (radial, self.radial_sigma)].into_iter().chain(of_clock) {
                if let Some(place) = place {
                    information[(first + place, first + place)] = sigma.powi(-2);
                }
            }
        }
        information
    }

    /// Gradient of [`Self::prior_cost`]: its diagonal Hessian times the values.
    fn prior_gradient(&self, state: &State) -> DVector<f64> {
        let mut gradient = DVector::zeros(self.layout.n_border);
        self.priors(state).for_each(|(column, value, sigma)| gradient[column] = value * sigma.powi(-2));
        gradient
    }

    /// Cameras and bone lengths after a step, with the gauge restored exactly; without points.
    fn move_border(&self, state: &State, step: &DVector<f64>) -> State {
        let move_camera = |(view, camera): (usize, &Option<CameraState>)| {
            let (camera, Some(first)) = ((*camera)?, self.layout.camera_columns[view]) else { return *camera };
            let rho = Vector3::new(step[first], step[first + 1], step[first + 2]);
            let phi = Vector3::new(step[first + 3], step[first + 4], step[first + 5]);
            let moved_by = |place: Option<usize>| place.map_or(0.0, |place| step[first + place]);
            let log_focal = camera.log_focal + moved_by(self.layout.focal);
            let radial = camera.radial + moved_by(self.layout.radial);
            Some(CameraState {
                delay: camera.delay + moved_by(self.layout.delay),
                drift: camera.drift + moved_by(self.layout.drift),
                camera_from_world: camera.camera_from_world.perturbed_left(&rho, &phi),
                log_focal,
                radial,
                intrinsics: self.intrinsics[view].with_focal_factor(log_focal.exp()).with_radial(radial),
            })
        };
        let mut cameras: Vec<_> = state.cameras.iter().enumerate().map(move_camera).collect();
        self.gauge.restore(&mut cameras);
        let first = self.layout.first_length;
        let log_lengths = state.log_lengths.iter().enumerate().map(|(k, l)| l + step[first + k]).collect();
        State { cameras, log_lengths, points: Vec::new() }
    }
}

/// Normal equations of one keyframe, with the vectors of the processor.
struct Linearization<'a, 'p> {
    problem: &'a Problem<'p>,
    i: usize,
    state: &'a State,
    block: &'a mut Block,
}

impl WithSimd for Linearization<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.problem.add_residuals(self.i, self.state, self.block);
    }
}

/// Cost of one keyframe, likewise.
struct Evaluation<'a, 'p> {
    problem: &'a Problem<'p>,
    i: usize,
    state: &'a State,
    points: &'a [Vector3<f64>],
}

impl WithSimd for Evaluation<'_, '_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> f64 {
        self.problem.sum_costs(self.i, self.state, self.points)
    }
}

/// Derivatives of a residual by `N` unknowns from `first` on.
#[inline(always)]
fn span<const N: usize>(first: usize, by_unknown: impl Fn(usize) -> [f64; 2]) -> Span<2, N> {
    let mut derivatives = [[0.0; N]; 2];
    for k in 0..N {
        [derivatives[0][k], derivatives[1][k]] = by_unknown(k);
    }
    Span { first, derivatives }
}
