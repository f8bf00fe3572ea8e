//! How well the cameras are known.
//!
//! Detector errors are correlated in time, so the inverse Hessian promises too much. The sandwich
//! `A^-1 M A^-1` does not: `A` is the reduced Hessian of the border, `M` the sum over blocks of one person's
//! consecutive frames of `g g^T`, `g` the block's share of the reduced gradient (Huber 1967; blocks after Liang and
//! Zeger 1986). The result is moved into the free-network gauge, in which cameras are compared after a similarity.
//!
//! Known limits: errors that never change (a biased detector, wrong intrinsics) are invisible here. Few blocks make
//! `M` poor, so it is shrunk towards `kappa A`, the inverse Hessian's own claim inflated by the mean ratio of the
//! two, with `n / (n + blocks)` of the weight, n the number of border unknowns. At AR(0.9) a block of 50 frames sees
//! 80 % of the long-run variance.

use super::CameraUncertainty;
use super::problem::{Problem, State};
use crate::geometry::Rigid;
use crate::geometry::rotation::skew;
use crate::optim::arrow::{self, Block};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Matrix3, Vector3};
use std::collections::BTreeMap;

/// Orientations count this little in the alignment, in units of the rig's radius: centres decide, as in evaluation,
/// and only a rig whose centres lie on a line is turned by its orientations.
const ORIENTATION_WEIGHT: f64 = 1e-2;

/// Uncertainty per view; `None` for views that did not move, and for all where the data leave one undetermined.
pub(super) fn camera_uncertainties(
    problem: &Problem,
    state: &State,
    block_frames: usize,
) -> Vec<Option<CameraUncertainty>> {
    let moving: Vec<(usize, usize, Rigid)> = (state.cameras.iter().zip(&problem.layout.camera_columns).enumerate())
        .filter_map(|(view, (camera, first))| Some((view, (*first)?, camera.as_ref()?.camera_from_world)))
        .collect();
    let mut uncertainties = vec![None; state.cameras.len()];
    let poses: Vec<Rigid> = moving.iter().map(|&(_, _, pose)| pose).collect();
    let projection = free_network_projection(&poses);
    if let (Some(border), Some(projection)) = (border_covariance(problem, state, block_frames), projection) {
        let rows: Vec<usize> = moving.iter().flat_map(|&(_, first, _)| first..first + 6).collect();
        let of_cameras = border.select_rows(&rows).select_columns(&rows);
        let free = &projection * of_cameras * projection.transpose();
        for (k, &(view, _, _)) in moving.iter().enumerate() {
            let covariance = free.fixed_view::<6, 6>(6 * k, 6 * k).into_owned();
            let sigma = |first: usize| covariance.fixed_view::<3, 3>(first, first).trace().max(0.0).sqrt();
            uncertainties[view] =
                Some(CameraUncertainty { covariance, sigma_position: sigma(0), sigma_angle: sigma(3) });
        }
    }
    uncertainties
}

/// Sandwich covariance of the border in the solver's own gauge. [border, border]
fn border_covariance(problem: &Problem, state: &State, block_frames: usize) -> Option<DMatrix<f64>> {
    let (n_instants, n_border) = (problem.variables.len(), problem.layout.n_border);
    let linearize = |i: usize, block: &mut Block| problem.linearize(i, state, block);
    let mut reduced = arrow::reduce(n_instants, n_border, 0.0, linearize);
    problem.add_focal_prior(state, &mut reduced.hessian, &mut reduced.gradient);
    let basis = problem.gauge.basis(&problem.layout, state);
    if basis.0.ncols() == 0 {
        return None;
    }
    let bread = basis.restrict(&reduced.hessian);
    let factor = bread.clone().cholesky()?;
    let gradients = arrow::reduced_gradients(n_instants, n_border, linearize);
    let blocks = block_gradients(problem, &gradients, block_frames);
    let meat = shrunk_meat(blocks.iter().map(|g| basis.0.tr_mul(g)), &bread, &factor)?;
    let covariance = factor.solve(&factor.solve(&meat).transpose());
    Some(&basis.0 * covariance * basis.0.transpose())
}

/// Sums of gradients over blocks of `block_frames` consecutive frames of one person.
fn block_gradients(problem: &Problem, gradients: &[DVector<f64>], block_frames: usize) -> Vec<DVector<f64>> {
    let mut blocks: BTreeMap<(usize, usize), DVector<f64>> = BTreeMap::new();
    for (variables, gradient) in problem.variables.iter().zip(gradients) {
        let key = (variables.person, variables.frame / block_frames.max(1));
        *blocks.entry(key).or_insert_with(|| DVector::zeros(gradient.len())) += gradient;
    }
    blocks.into_values().collect()
}

/// `M` with the small-sample factor, shrunk towards `kappa A`; `None` for fewer than two blocks.
fn shrunk_meat(
    blocks: impl ExactSizeIterator<Item = DVector<f64>>,
    bread: &DMatrix<f64>,
    factor: &Cholesky<f64, Dyn>,
) -> Option<DMatrix<f64>> {
    let (n_blocks, n_unknowns) = (blocks.len() as f64, bread.nrows() as f64);
    if n_blocks < 2.0 {
        return None;
    }
    let mut meat = DMatrix::zeros(bread.nrows(), bread.nrows());
    blocks.for_each(|g| meat.ger(n_blocks / (n_blocks - 1.0), &g, &g, 1.0));
    let inflation = factor.solve(&meat).trace() / n_unknowns;
    let trust = n_blocks / (n_blocks + n_unknowns);
    Some(meat * trust + bread * (inflation * (1.0 - trust)))
}

/// Takes the best similarity off a joint increment of all cameras: `I - N (N^T D N)^-1 N^T D`. [6 cameras, 6 cameras]
///
/// `N`: the seven directions of a similarity, `D`: the weights of centres (1) and orientations in the alignment.
/// `None` for fewer than two cameras or coinciding centres.
fn free_network_projection(poses: &[Rigid]) -> Option<DMatrix<f64>> {
    let n = 6 * poses.len();
    let centroid = poses.iter().map(Rigid::center).sum::<Vector3<f64>>() / poses.len().max(1) as f64;
    let squared_radius =
        poses.iter().map(|p| (p.center() - centroid).norm_squared()).sum::<f64>() / poses.len().max(1) as f64;
    let mut directions = DMatrix::zeros(n, 7);
    for (k, pose) in poses.iter().enumerate() {
        let (arm, rotation) = (pose.center() - centroid, pose.rotation);
        // The centre moves by t + omega x arm + s arm, and rho = -R dC, phi = -R omega.
        directions.fixed_view_mut::<3, 3>(6 * k, 0).copy_from(&-rotation);
        directions.fixed_view_mut::<3, 3>(6 * k, 3).copy_from(&(rotation * skew(&arm)));
        directions.fixed_view_mut::<3, 1>(6 * k, 6).copy_from(&(-(rotation * arm)));
        directions.fixed_view_mut::<3, 3>(6 * k + 3, 3).copy_from(&Matrix3::from(-rotation));
    }
    let orientation = ORIENTATION_WEIGHT * ORIENTATION_WEIGHT * squared_radius;
    let mut weighted = directions.clone();
    for k in 0..poses.len() {
        weighted.rows_mut(6 * k + 3, 3).scale_mut(orientation);
    }
    let normal = weighted.tr_mul(&directions).cholesky()?;
    Some(DMatrix::identity(n, n) - &directions * normal.solve(&weighted.transpose()))
}
