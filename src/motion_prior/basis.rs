//! The frozen linear code: 32 principal components of the features in the metric of joint positions.
//!
//! With the mean joint metric `A = E[J^T J] / 23` (J: derivative of the joints to the features' right increments, so
//! that `d^T A d` is the expected square of the mean joint displacement) and its Cholesky factor `A = L L^T`, the code
//! is `z = S^-1 V^T L^T (u - m)` and its decoder `u = m + L^-T V S z`, where V and S hold the leading eigenvectors and
//! standard deviations of `L^T (u - m)`. Among linear codes of this width none has a smaller expected joint error to
//! first order, and over the training set each number of z has mean 0 and variance 1.

use super::chart::{Chart, Features, LATENT_JOINTS, LocalRotations, N_FEATURES, on_shortest_branch};
use super::joints::{Bones, frame, rows};
use super::observed::joints_below;
use crate::body::skeleton::N_JOINTS;
use crate::geometry::rotation;
use crate::geometry::svd::nearest_rotation;
use nalgebra::{Cholesky, DMatrix, Matrix3, SymmetricEigen};

/// Dimensions of the latent code of one frame.
pub const LATENT_DIM: usize = 32;

/// Added to the metric's diagonal, m^2/rad^2 (a lever of 26 mm at one of 23 joints), so that wrist and toe rotations, which
/// move joints very little, are coded too. The linear code alone has an error of 2.1 mm on the held out subjects with a
/// third of this value, 1.96 mm with this value and with three times it.
const METRIC_FLOOR: f64 = 3e-5;

/// Stride of the frames over which the metric is averaged: it varies slowly with the pose.
const METRIC_STRIDE: usize = 10;

/// The frozen part of the prior, measured once on the training set.
#[derive(Debug, Clone, PartialEq)]
pub struct Basis {
    /// Mean rotations.
    pub chart: Chart,
    /// `m`, mean features, rad.
    pub mean: [f32; N_FEATURES],
    /// Standard deviation of each feature, rad.
    pub spread: [f32; N_FEATURES],
    /// `(L^-T V S)^T`, `[32, 57]`: features less the mean from a code.
    pub features_from_code: Vec<f32>,
}

/// A basis with its encoder, which only training needs.
pub struct FittedBasis {
    /// The basis.
    pub basis: Basis,
    /// `S^-1 V^T L^T`, `[32, 57]`: a code from features less the mean.
    pub code_from_features: Vec<f32>,
}

/// Mean rotations over a training set.
pub fn mean_rotations(takes: &[Vec<LocalRotations>]) -> Chart {
    let mut sums = [Matrix3::zeros(); LATENT_JOINTS.len()];
    for rotations in takes.iter().flatten() {
        for (sum, joint) in sums.iter_mut().zip(LATENT_JOINTS) {
            *sum += rotations[joint];
        }
    }
    Chart { means: sums.map(|sum| nearest_rotation(&sum)) }
}

/// Measures the basis on the features of a training set. `None` if there are fewer frames than features.
pub fn fit_basis(chart: Chart, takes: &[Vec<Features>]) -> Option<FittedBasis> {
    let n_frames: usize = takes.iter().map(Vec::len).sum();
    if n_frames <= N_FEATURES {
        return None;
    }
    let known: Vec<Features> = takes
        .iter()
        .flat_map(|take| on_shortest_branch(rows(take)).chunks_exact(N_FEATURES).map(frame).collect::<Vec<_>>())
        .collect();
    let frames = || known.iter();
    let mean: Features = std::array::from_fn(|i| frames().map(|f| f[i]).sum::<f64>() / n_frames as f64);
    let mut covariance = DMatrix::<f64>::zeros(N_FEATURES, N_FEATURES);
    for features in frames() {
        let off = DMatrix::from_fn(N_FEATURES, 1, |i, _| features[i] - mean[i]);
        covariance.ger(1.0 / n_frames as f64, &off.column(0), &off.column(0), 1.0);
    }
    let spread: Features = std::array::from_fn(|i| covariance[(i, i)].sqrt().max(1e-3));
    let factor = Cholesky::new(joint_metric(&chart, frames().step_by(METRIC_STRIDE)))?.unpack(); // L
    let eigen = SymmetricEigen::new(factor.transpose() * covariance * &factor);
    let mut order: Vec<usize> = (0..N_FEATURES).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let leading = DMatrix::from_fn(N_FEATURES, LATENT_DIM, |i, k| eigen.eigenvectors[(i, order[k])]);
    let sd = |k: usize| eigen.eigenvalues[order[k]].max(1e-12).sqrt();
    let decode = factor.transpose().solve_upper_triangular(&leading)?;
    let row_major = |n: usize, m: usize| (0..n).flat_map(move |i| (0..m).map(move |j| (i, j)));
    let encode = (factor * leading).transpose(); // V^T L^T
    let basis = Basis {
        chart,
        mean: mean.map(|v| v as f32),
        spread: spread.map(|v| v as f32),
        features_from_code: row_major(LATENT_DIM, N_FEATURES).map(|(k, i)| (decode[(i, k)] * sd(k)) as f32).collect(),
    };
    let code_from_features = row_major(LATENT_DIM, N_FEATURES).map(|(k, i)| (encode[(k, i)] / sd(k)) as f32).collect();
    Some(FittedBasis { basis, code_from_features })
}

impl Basis {
    /// Features of codes `[N, 32]`, `[N, 57]`.
    pub fn features(&self, codes: &[f32]) -> Vec<f32> {
        let row = |code: &[f32]| {
            let feature = |i: usize| {
                let moved = code.iter().enumerate().map(|(k, z)| z * self.features_from_code[k * N_FEATURES + i]);
                self.mean[i] + moved.sum::<f32>()
            };
            (0..N_FEATURES).map(feature).collect::<Vec<f32>>()
        };
        codes.chunks_exact(LATENT_DIM).flat_map(row).collect()
    }
}

/// `E[J^T J] / 23` over frames, plus the floor.
fn joint_metric<'a>(chart: &Chart, frames: impl Iterator<Item = &'a Features>) -> DMatrix<f64> {
    let bones = Bones::of_default_body();
    let mut metric = DMatrix::<f64>::zeros(N_FEATURES, N_FEATURES);
    let mut jacobian = DMatrix::<f64>::zeros(3 * N_JOINTS, N_FEATURES);
    let mut n = 0_usize;
    for features in frames {
        let posed = bones.posed(&chart.rotations(features));
        for (i, joint) in LATENT_JOINTS.iter().enumerate() {
            for below in joints_below(*joint) {
                let lever = posed.joints[below] - posed.joints[*joint];
                let block = -rotation::skew(&lever) * posed.rotations[*joint];
                jacobian.fixed_view_mut::<3, 3>(3 * below, 3 * i).copy_from(&block);
            }
        }
        metric.gemm_tr(1.0, &jacobian, &jacobian, 1.0);
        n += 1;
    }
    metric / (n.max(1) * (N_JOINTS - 1)) as f64 + DMatrix::identity(N_FEATURES, N_FEATURES) * METRIC_FLOOR
}
