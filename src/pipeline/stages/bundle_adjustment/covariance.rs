//! Uncertainty of the adjusted cameras.
//!
//! Detector errors are correlated in time, so the inverse Hessian is far too small (an eighth of the variance at AR(0.9)).
//! The delete-one-block jackknife over blocks of one person's consecutive frames remains valid:
//!
//! `(B - 1) / B sum_b d_b d_b^T`, `d_b = (A - A_b)^-1 g_b`
//!
//! with `A` the border's reduced Hessian, `A_b`, `g_b` the block's share of it and of the gradient: `d_b` is the
//! movement of the border, in one Newton step, when the block is left out. To first order it is the sandwich
//! `A^-1 (sum_b g_b g_b^T) A^-1` (Huber 1967; Liang and Zeger 1986), which is too small with few blocks (MacKinnon and
//! White 1985). The solver's Hessian uses a residual's weight in place of its curvature; `A` is that Hessian times the mean
//! ratio of the two (Huber 1981, section 7.6). The result is transformed to the free-network gauge, in which cameras
//! are compared after a similarity.
//!
//! With few blocks the estimate is noisy, so it is shrunk towards the inverse Hessian, scaled to the same mean size over
//! all `n` unknowns of the border, with a weight of `n / (n + B)`.
//!
//! Known limits: constant errors (a biased detector, wrong intrinsics) do not show. At AR(0.9) a block
//! of 50 frames sees 80 % of the long-run variance.

use super::gauge::hold_idle;
use super::problem::Problem;
use super::variables::State;
use crate::geometry::Rigid;
use crate::geometry::free_network::CameraCovariance;
use crate::optim::arrow::{self, Block};
use crate::optim::robust::{Curvature, geman_mcclure};
use crate::pipeline::calibration::{CameraUncertainty, FocalEstimate};
use nalgebra::{DMatrix, DVector, Vector3};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Smallest number of blocks: fewer do not show their own spread.
const MIN_BLOCKS: usize = 8;

/// An unknown keeps its value when the block left out holds all but this share of its information.
const MIN_REST: f64 = 0.05;

/// Ridge relative to the diagonal: far above rounding, far below the information of any block.
const RIDGE: f64 = 1e-9;

/// Uncertainties of the cameras.
pub(super) struct Uncertainties {
    /// Per view; `None` for views that did not move, and for all views where one of them is undetermined.
    pub(super) cameras: Vec<Option<CameraUncertainty>>,
    /// Focal factors of the views that moved, where they were refined and are determined.
    pub(super) focal: Option<FocalEstimate>,
}

/// Estimates the uncertainties from blocks of `block_frames` frames.
pub(super) fn camera_uncertainties(problem: &Problem, state: &State, block_frames: usize) -> Uncertainties {
    let moving: Vec<(usize, usize, Rigid)> = (state.cameras.iter().zip(&problem.layout.camera_columns).enumerate())
        .filter_map(|(view, (camera, first))| Some((view, (*first)?, camera.as_ref()?.camera_from_world)))
        .collect();
    let mut uncertainties = vec![None; state.cameras.len()];
    let poses: Vec<Rigid> = moving.iter().map(|&(_, _, pose)| pose).collect();
    let border = border_covariance(problem, state, block_frames);
    let rows: Vec<usize> = moving.iter().flat_map(|&(_, first, _)| first..first + 6).collect();
    let points = || state.points.iter().flatten();
    let scene = points().sum::<Vector3<f64>>() / points().count().max(1) as f64;
    let of_cameras =
        |border: &DMatrix<f64>| CameraCovariance::new(poses, border.select_rows(&rows).select_columns(&rows), &scene);
    if let Some((border, covariance)) = border.as_ref().and_then(|border| Some((border, of_cameras(border)?))) {
        for (&(view, first, _), sigma) in moving.iter().zip(covariance.pose_sigmas()) {
            let [sigma_delay, sigma_drift] = [problem.layout.delay, problem.layout.drift]
                .map(|place| sigma_of_difference(border, place, moving[0].1, first));
            let variance = |column: usize| border[(column, column)];
            let sigma_radial = problem.layout.radial.map(|place| variance(first + place).max(0.0).sqrt());
            let (sigma_position, sigma_angle) = (sigma.position, sigma.angle);
            uncertainties[view] =
                Some(CameraUncertainty { sigma_position, sigma_angle, sigma_delay, sigma_drift, sigma_radial });
        }
    }
    let focal = problem.layout.focal.zip(border).map(|(place, border)| {
        let rows: Vec<usize> = moving.iter().map(|&(_, first, _)| first + place).collect();
        let log_factor =
            |&(view, _, _): &(usize, usize, Rigid)| state.cameras[view].as_ref().map_or(0.0, |c| c.log_focal);
        FocalEstimate {
            views: moving.iter().map(|&(view, _, _)| view).collect(),
            log_factors: moving.iter().map(log_factor).collect(),
            covariance: border
                .select_rows(&rows)
                .select_columns(&rows)
                .row_iter()
                .map(|r| r.iter().copied().collect())
                .collect(),
        }
    });
    Uncertainties { cameras: uncertainties, focal }
}

/// Standard deviation of the difference between two cameras' unknowns at `place`; `reference`, `first`: columns of their first ones.
fn sigma_of_difference(border: &DMatrix<f64>, place: Option<usize>, reference: usize, first: usize) -> Option<f64> {
    let (a, b) = (first + place?, reference + place?);
    Some((border[(a, a)] + border[(b, b)] - 2.0 * border[(a, b)]).max(0.0).sqrt())
}

/// Covariance of the border in the solver's own gauge. [border, border]
///
/// `None` where the border is undetermined, with all blocks or without one of them.
fn border_covariance(problem: &Problem, state: &State, block_frames: usize) -> Option<DMatrix<f64>> {
    let basis = problem.gauge.basis(&problem.layout, state);
    let blocks = person_time_blocks(problem, block_frames);
    if basis.0.ncols() == 0 || blocks.len() < 2 {
        return None;
    }
    let hessian_per_weight = curvature_per_weight(problem, state);
    let of_block = |members: &Vec<usize>| {
        let linearize = |k: usize, block: &mut Block| problem.linearize(members[k], state, block);
        let reduced = arrow::reduce(members.len(), problem.layout.n_border, 0.0, linearize);
        (basis.project(&reduced.hessian) * hessian_per_weight, basis.0.tr_mul(&reduced.gradient))
    };
    let of_blocks: Vec<(DMatrix<f64>, DVector<f64>)> = blocks.par_iter().map(of_block).collect();
    let mut whole = basis.project(&problem.prior_information());
    of_blocks.iter().for_each(|(hessian, _)| whole += hessian);
    hold_idle(&mut whole);
    let inverse = whole.clone().cholesky()?.inverse();
    let mut jackknife = DMatrix::zeros(whole.nrows(), whole.ncols());
    for (hessian, gradient) in of_blocks {
        let shift = shift_without(&whole, hessian, gradient)?;
        jackknife.ger(1.0, &shift, &shift, 1.0);
    }
    let (n_blocks, n_unknowns) = (blocks.len() as f64, whole.nrows() as f64);
    jackknife *= (n_blocks - 1.0) / n_blocks;
    let inflation = whole.component_mul(&jackknife).sum() / n_unknowns;
    let jackknife_weight = n_blocks / (n_blocks + n_unknowns);
    let covariance = jackknife * jackknife_weight + inverse * (inflation * (1.0 - jackknife_weight));
    Some(&basis.0 * covariance * basis.0.transpose())
}

/// Movement of the border when a block is left out, in one Newton step; `None` where the rest does not determine it.
///
/// Unknowns that depend almost only on the block (the bones of a person seen in no other) do not move: without the block
/// they are undetermined, and nothing else depends on them.
fn shift_without(whole: &DMatrix<f64>, block: DMatrix<f64>, mut gradient: DVector<f64>) -> Option<DVector<f64>> {
    let mut rest = whole - block;
    for k in 0..rest.nrows() {
        if rest[(k, k)] < MIN_REST * whole[(k, k)] {
            rest.row_mut(k).fill(0.0);
            rest.column_mut(k).fill(0.0);
            rest[(k, k)] = 1.0;
            gradient[k] = 0.0;
        }
        rest[(k, k)] *= 1.0 + RIDGE;
    }
    Some(rest.cholesky()?.solve(&gradient))
}

/// Keyframes by person and block of consecutive frames; shorter blocks where there would be too few.
fn person_time_blocks(problem: &Problem, block_frames: usize) -> Vec<Vec<usize>> {
    let keyframes: Vec<(usize, usize)> = problem.variables.iter().map(|own| (own.person, own.frame)).collect();
    blocks_of(&keyframes, block_frames)
}

/// Indices of keyframes of a person and frame each, by blocks of half, a quarter, ... of `block_frames` where there would be less than
/// [`MIN_BLOCKS`].
fn blocks_of(keyframes: &[(usize, usize)], block_frames: usize) -> Vec<Vec<usize>> {
    let mut frames = block_frames.max(1);
    loop {
        let mut blocks: BTreeMap<(usize, usize), Vec<usize>> = BTreeMap::new();
        for (i, (person, frame)) in keyframes.iter().enumerate() {
            blocks.entry((*person, frame / frames)).or_default().push(i);
        }
        if blocks.len() >= MIN_BLOCKS.min(keyframes.len()) || frames == 1 {
            return blocks.into_values().collect();
        }
        frames = frames.div_ceil(2);
    }
}

/// Mean curvature of the reprojection cost over its mean weight.
fn curvature_per_weight(problem: &Problem, state: &State) -> f64 {
    let misfits = problem.misfits(state).filter(|m| m.sigmas.is_finite());
    let robust = misfits.map(|m| geman_mcclure(m.sigmas * m.sigmas, problem.robust_scale));
    robust.fold(Curvature::default(), |sum, robust| sum.with(&robust, 1.0)).per_weight()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Blocks were as long as an eighth of the keyframes, which lie far apart: errors of 2 s were counted as if they lasted a second.
    #[test]
    fn blocks_are_as_long_as_asked_whatever_lies_between_keyframes() {
        let sparse: Vec<(usize, usize)> = (0..250).map(|k| (k % 2, 24 * (k / 2))).collect();
        let blocks = blocks_of(&sparse, 60);
        assert_eq!(blocks.len(), 2 * (24 * 124 / 60 + 1));
        assert!(blocks.iter().flatten().all(|&k| k < 250) && blocks.iter().map(Vec::len).sum::<usize>() == 250);
        let short: Vec<(usize, usize)> = (0..40).map(|t| (0, t)).collect();
        assert_eq!(blocks_of(&short, 60).len(), 10, "blocks of 4 frames");
        assert_eq!(blocks_of(&short[..3], 60).len(), 3);
    }
}
