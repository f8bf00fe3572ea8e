//! The least-squares problem: linearisation of one instant, one damped step, and what is read off a state.

use super::gauge::Gauge;
use super::variables::{self, Layout, Variables};
use super::{AdjustmentConfig, AdjustmentInput, Instant, ViewFit, median};
use crate::geometry::{Intrinsics, Rigid};
use crate::optim::arrow::{self, Block, Column};
use crate::optim::levenberg_marquardt::{LeastSquares, Trial};
use crate::optim::robust::{geman_mcclure, geman_mcclure_ceiling};
use crate::progress::Progress;
use crate::residuals::{bone_length, reprojection};
use crate::session::reconstruction::ErrorSummary;
use nalgebra::{DMatrix, DVector, Vector3};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// A camera as far as it is unknown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Camera {
    pub(super) intrinsics: Intrinsics,
    pub(super) log_focal: f64,
    pub(super) camera_from_world: Rigid,
}

/// All unknowns.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct State {
    /// `None` for views that take no part.
    pub(super) cameras: Vec<Option<Camera>>,
    /// [person, bone], flat.
    pub(super) log_lengths: Vec<f64>,
    /// [instant][slot]
    pub(super) points: Vec<Vec<Vector3<f64>>>,
}

/// How far an observation lies from its reprojection; infinite where the point is behind the camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Misfit {
    pub(super) view: usize,
    pub(super) distance_px: f64,
    pub(super) sigmas: f64,
}

/// The problem at one robust scale.
pub(super) struct Problem<'a> {
    pub(super) variables: Vec<Variables>,
    pub(super) layout: Layout,
    pub(super) gauge: Gauge,
    /// In standard deviations; the only thing that changes between runs of the solver.
    pub(super) robust_scale: f64,
    intrinsics: &'a [Intrinsics],
    focal_sigma: f64,
    progress: &'a Progress,
}

/// Turns the input into a problem and its start.
pub(super) fn formulate<'a>(
    input: &AdjustmentInput<'a>,
    config: &AdjustmentConfig,
    progress: &'a Progress,
) -> (Problem<'a>, State) {
    let mut placed: Vec<bool> =
        input.cameras.iter().enumerate().map(|(v, c)| c.is_some() && v < input.intrinsics.len()).collect();
    let (layout, variables) = variables::choose(input, &mut placed);
    let camera = |(view, given): (usize, &Option<Rigid>)| {
        let camera_from_world = given.filter(|_| placed[view])?;
        Some(Camera { intrinsics: input.intrinsics[view], log_focal: 0.0, camera_from_world })
    };
    let cameras: Vec<_> = input.cameras.iter().enumerate().map(camera).collect();
    let start_of = |(instant, variables): (&Instant, &Variables)| {
        variables.keypoints.iter().filter_map(|&k| instant.points[k]).collect::<Vec<_>>()
    };
    let points: Vec<_> = input.instants.iter().zip(&variables).map(start_of).collect();
    let log_lengths = median_log_lengths(&layout, &variables, &points);
    let gauge = Gauge::choose(&layout, &variables, &cameras);
    let problem = Problem {
        variables,
        layout,
        gauge,
        robust_scale: config.scale.end,
        intrinsics: input.intrinsics,
        focal_sigma: config.focal_sigma,
        progress,
    };
    (problem, State { cameras, log_lengths, points })
}

/// Each bone's median length over its person's instants.
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
    samples.into_iter().map(|s| median(s).unwrap_or(0.0)).collect()
}

impl LeastSquares for Problem<'_> {
    type State = State;

    fn cost(&self, state: &State) -> f64 {
        let costs: Vec<f64> =
            (0..self.variables.len()).into_par_iter().map(|i| self.instant_cost(i, state, &state.points[i])).collect();
        costs.iter().sum::<f64>() + self.focal_cost(state)
    }

    fn step(&self, state: &State, damping: f64) -> Option<Trial<State>> {
        let n_instants = self.variables.len();
        let linearize = |i: usize, block: &mut Block| self.linearize(i, state, block);
        let mut reduced = arrow::reduce(n_instants, self.layout.n_border, damping, linearize);
        self.add_focal_prior(state, &mut reduced.hessian, &mut reduced.gradient);
        let border_step = self.gauge.basis(&self.layout, state).solve(&reduced.hessian, &reduced.gradient)?;
        let mut moved = self.move_border(state, &border_step);
        let instants = arrow::back_substitute(n_instants, damping, &border_step, linearize, |i, step| {
            let points: Vec<_> = state.points[i]
                .iter()
                .zip(step.chunks_exact(3))
                .map(|(x, d)| x + Vector3::new(d[0], d[1], d[2]))
                .collect();
            let cost = self.instant_cost(i, &moved, &points);
            (points, cost)
        });
        let cost = instants.iter().map(|(_, cost)| cost).sum::<f64>() + self.focal_cost(&moved);
        moved.points = instants.into_iter().map(|(points, _)| points).collect();
        Some(Trial { state: moved, cost })
    }
}

impl Problem<'_> {
    /// Normal equations of one instant at `state`.
    pub(super) fn linearize(&self, i: usize, state: &State, block: &mut Block) {
        let (variables, points) = (&self.variables[i], &state.points[i]);
        block.reset(3 * variables.keypoints.len(), &variables.columns);
        if self.progress.check().is_err() {
            return; // The solver looks at the flag before it looks at the step.
        }
        for sighting in &variables.sightings {
            let (o, slot) = (&sighting.observation, sighting.slot);
            let Some(camera) = &state.cameras[o.view] else { continue };
            let linear = reprojection::linearize(
                &camera.intrinsics,
                &camera.camera_from_world,
                &points[slot],
                &o.pixel,
                o.sigma_px,
            );
            let Some(linear) = linear else {
                block.add_cost(geman_mcclure_ceiling(self.robust_scale));
                continue;
            };
            let robust = geman_mcclure(linear.residual.norm_squared(), self.robust_scale);
            block.add_cost(robust.cost);
            let local: [Column<2>; 3] = std::array::from_fn(|k| Column {
                index: 3 * slot + k,
                derivative: linear.by_point.column(k).into_owned().into(),
            });
            let first = sighting.column.unwrap_or(0);
            let border: [Column<2>; 7] = std::array::from_fn(|k| Column {
                index: first + k,
                derivative: if k < 6 {
                    linear.by_camera.column(k).into_owned().into()
                } else {
                    linear.by_log_focal.into()
                },
            });
            let n_border = sighting.column.map_or(0, |_| self.layout.per_camera);
            block.add_residual(robust.weight, &linear.residual.into(), &local, &border[..n_border]);
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

    /// Cost of one instant with the border of `state` and these points.
    fn instant_cost(&self, i: usize, state: &State, points: &[Vector3<f64>]) -> f64 {
        let charge = |squared: Option<f64>| {
            squared.map_or(geman_mcclure_ceiling(self.robust_scale), |e2| geman_mcclure(e2, self.robust_scale).cost)
        };
        let variables = &self.variables[i];
        let sightings = variables.sightings.iter().map(|sighting| {
            let o = &sighting.observation;
            let residual = state.cameras[o.view].and_then(|camera| {
                let point = &points[sighting.slot];
                reprojection::residual(&camera.intrinsics, &camera.camera_from_world, point, &o.pixel, o.sigma_px)
            });
            charge(residual.map(|r| r.norm_squared()))
        });
        let limbs = variables.limbs.iter().map(|limb| {
            let (a, b) = (&points[limb.slot_a], &points[limb.slot_b]);
            let linear = bone_length::linearize(a, b, state.log_lengths[limb.length], limb.sigma);
            charge(linear.map(|l| l.residual * l.residual))
        });
        sightings.sum::<f64>() + limbs.sum::<f64>()
    }

    /// Focal factors stay near 1: `(log_focal / focal_sigma)^2 / 2` each.
    fn focal_cost(&self, state: &State) -> f64 {
        state.cameras.iter().flatten().map(|c| 0.5 * (c.log_focal / self.focal_sigma).powi(2)).sum()
    }

    /// Normal equations of [`Self::focal_cost`].
    pub(super) fn add_focal_prior(&self, state: &State, hessian: &mut DMatrix<f64>, gradient: &mut DVector<f64>) {
        if self.layout.per_camera == 6 {
            return;
        }
        let information = self.focal_sigma.powi(-2);
        for (camera, first) in state.cameras.iter().zip(&self.layout.camera_columns) {
            if let (Some(camera), Some(first)) = (camera, first) {
                hessian[(first + 6, first + 6)] += information;
                gradient[first + 6] += information * camera.log_focal;
            }
        }
    }

    /// Cameras and bone lengths after a step; the gauge is kept exactly. Points stay.
    fn move_border(&self, state: &State, step: &DVector<f64>) -> State {
        let move_camera = |(view, camera): (usize, &Option<Camera>)| {
            let (camera, Some(first)) = ((*camera)?, self.layout.camera_columns[view]) else { return *camera };
            let rho = Vector3::new(step[first], step[first + 1], step[first + 2]);
            let phi = Vector3::new(step[first + 3], step[first + 4], step[first + 5]);
            let log_focal = camera.log_focal + if self.layout.per_camera == 7 { step[first + 6] } else { 0.0 };
            Some(Camera {
                camera_from_world: camera.camera_from_world.perturbed_left(&rho, &phi),
                log_focal,
                intrinsics: with_focal_factor(&self.intrinsics[view], log_focal.exp()),
            })
        };
        let mut cameras: Vec<_> = state.cameras.iter().enumerate().map(move_camera).collect();
        self.gauge.restore(&mut cameras);
        let first = self.layout.first_length;
        let log_lengths = state.log_lengths.iter().enumerate().map(|(k, l)| l + step[first + k]).collect();
        State { cameras, log_lengths, points: Vec::new() }
    }

    /// Every observation against its reprojection.
    pub(super) fn misfits<'s>(&'s self, state: &'s State) -> impl Iterator<Item = Misfit> + 's {
        self.variables.iter().zip(&state.points).flat_map(move |(variables, points)| {
            variables.sightings.iter().filter_map(move |sighting| {
                let o = &sighting.observation;
                let camera = state.cameras[o.view].as_ref()?;
                let point = camera.camera_from_world.transform(&points[sighting.slot]);
                let predicted = camera.intrinsics.pixel_from_camera(&point);
                let distance_px = predicted.map_or(f64::INFINITY, |p| (p - o.pixel).norm());
                Some(Misfit { view: o.view, distance_px, sigmas: distance_px / o.sigma_px })
            })
        })
    }

    /// Reprojection per view.
    pub(super) fn view_fits(&self, state: &State) -> Vec<ViewFit> {
        let mut fits = vec![ViewFit::default(); state.cameras.len()];
        let mut explained = vec![Vec::new(); state.cameras.len()];
        for misfit in self.misfits(state) {
            fits[misfit.view].n_observations += 1;
            if misfit.sigmas <= self.robust_scale {
                explained[misfit.view].push(misfit.distance_px);
            }
        }
        for (fit, distances) in fits.iter_mut().zip(explained) {
            fit.n_explained = distances.len();
            let mean = distances.iter().sum::<f64>() / distances.len() as f64;
            fit.reprojection_px = median(distances).map(|median| ErrorSummary { mean, median });
        }
        fits
    }

    /// Points in the input's shape; those that were not adjusted as given.
    pub(super) fn points_by_keypoint(&self, instants: &[Instant], state: &State) -> Vec<Vec<Option<Vector3<f64>>>> {
        let mut points: Vec<_> = instants.iter().map(|i| i.points.clone()).collect();
        for ((points, variables), adjusted) in points.iter_mut().zip(&self.variables).zip(&state.points) {
            for (&keypoint, point) in variables.keypoints.iter().zip(adjusted) {
                points[keypoint] = Some(*point);
            }
        }
        points
    }

    /// Lengths per person and bone.
    pub(super) fn bone_lengths(&self, state: &State) -> BTreeMap<usize, Vec<Option<f64>>> {
        let n_bones = self.layout.n_bones;
        let mut lengths: BTreeMap<_, _> = self.layout.persons.iter().map(|&p| (p, vec![None; n_bones])).collect();
        for variables in &self.variables {
            if let Some(of_person) = lengths.get_mut(&self.layout.persons[variables.person]) {
                for limb in &variables.limbs {
                    of_person[limb.length % n_bones] = Some(state.log_lengths[limb.length].exp());
                }
            }
        }
        lengths
    }
}

/// The same lens with `fx`, `fy` and the skew times `factor`.
fn with_focal_factor(intrinsics: &Intrinsics, factor: f64) -> Intrinsics {
    Intrinsics { fx: intrinsics.fx * factor, fy: intrinsics.fy * factor, skew: intrinsics.skew * factor, ..*intrinsics }
}
