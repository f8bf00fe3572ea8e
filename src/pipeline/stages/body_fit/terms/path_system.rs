//! Blocks of the paths' term in the Gauss-Newton system: from positions of landmarks to the unknowns that move them.

use super::super::observations::PosedCamera;
use super::landmark_jacobian::LandmarkJacobian;
use super::unknowns::Unknowns;
use super::whitened_pixels::{PathBlock, Positions, WhitenedPixels};
use super::window::TrackedLandmark;
use crate::optim::block_banded::BlockBanded;
use nalgebra::{DMatrix, DVector, Matrix3, Matrix3xX};
use rayon::prelude::*;

/// Adds the term at the landmarks `paths`, `[frame][observed landmark]`.
///
/// With `J` the derivatives of a position by its frame, `B` by the border, and `M_k` the second derivatives by the positions of
/// a frame and of the one `k` frames earlier: blocks `J_t^T M_k J_{t-k}` between frames, `J_t^T N_t` and `B_t^T N_t` to the border,
/// where `N_t = sum_k M_k B_{t-k} + M_k^T B_{t+k}`.
pub(crate) fn add_paths(
    (term, cameras): (&WhitenedPixels, &[PosedCamera]),
    unknowns: &Unknowns,
    paths: &[Vec<TrackedLandmark>],
    system: &mut BlockBanded,
) {
    let border = &unknowns.border;
    let positions: Positions =
        paths.iter().map(|frame| frame.iter().map(|landmark| landmark.position).collect()).collect();
    let blocks = term.blocks(cameras, &positions, border.cameras);
    let (n_point, cameras, n_camera) =
        (border.keypoint_bias().end, border.camera_columns(), border.cameras.unknowns.len());
    let by_border: Vec<Vec<Matrix3xX<f64>>> = paths
        .par_iter()
        .map(|frame| frame.iter().map(|landmark| landmark.jacobian.by_border.dense(n_point)).collect())
        .collect();

    let n = 3 * unknowns.n_groups();
    let frame_part = |t: usize| {
        let mut part = FramePart::zeros(n, border.len(), t);
        for (l, landmark) in paths[t].iter().enumerate() {
            let of_frame = |t: usize| blocks.landmarks[l].frames.get(t);
            let Some(block) = of_frame(t) else { continue };
            if block.hessian[0] == Matrix3::zeros() {
                continue;
            }
            let mut by_border_of_position = Matrix3xX::zeros(border.len());
            let mut point_columns = block.hessian[0] * &by_border[t][l];
            for lag in 1..=2 {
                if let Some(earlier) = t.checked_sub(lag) {
                    point_columns += block.hessian[lag] * &by_border[earlier][l];
                    part.add_coupling(lag, &landmark.jacobian, &block.hessian[lag], &paths[earlier][l].jacobian);
                }
                if let Some(later) = of_frame(t + lag) {
                    point_columns += later.hessian[lag].transpose() * &by_border[t + lag][l];
                }
            }
            by_border_of_position.columns_mut(0, n_point).copy_from(&point_columns);
            for (camera, columns) in blocks.landmarks[l].by_cameras(t).iter().enumerate() {
                let mut own = by_border_of_position.columns_mut(cameras.start + n_camera * camera, n_camera);
                own.copy_from(&columns.columns(0, n_camera));
            }
            part.add_own(block, &landmark.jacobian, &by_border_of_position);
            part.corner.rows_mut(0, n_point).gemm(1.0, &by_border[t][l].transpose(), &by_border_of_position, 1.0);
            part.corner_gradient.rows_mut(0, n_point).gemv_tr(1.0, &by_border[t][l], &block.gradient, 1.0);
        }
        part
    };
    let parts: Vec<FramePart> = (0..paths.len()).into_par_iter().map(frame_part).collect();
    let mut corner = DMatrix::zeros(border.len(), border.len());
    for (t, part) in parts.into_iter().enumerate() {
        system.diagonal[t] += part.diagonal;
        system.border[t] += part.border;
        system.gradient[t] += part.gradient;
        for (lag, coupling) in part.couplings.into_iter().enumerate() {
            if let Some(coupling) = coupling {
                system.add_coupling(t, lag + 1, coupling);
            }
        }
        corner += part.corner;
        system.corner.gradient += part.corner_gradient;
    }
    // Rows of the cameras against what moves points: the transpose of the columns.
    let crossed = corner.view((0, cameras.start), (n_point, cameras.len())).transpose();
    corner.view_mut((cameras.start, 0), (cameras.len(), n_point)).copy_from(&crossed);
    system.corner.hessian += corner;
    blocks.add_cameras_to(cameras.start, &mut system.corner);
}

/// What the paths add to one frame.
struct FramePart {
    diagonal: DMatrix<f64>,
    /// With the frames one and two before.
    couplings: [Option<DMatrix<f64>>; 2],
    border: DMatrix<f64>,
    gradient: DVector<f64>,
    corner: DMatrix<f64>,
    corner_gradient: DVector<f64>,
}

impl FramePart {
    fn zeros(n: usize, n_border: usize, t: usize) -> Self {
        let coupling = |lag: usize| (t >= lag).then(|| DMatrix::zeros(n, n));
        Self {
            diagonal: DMatrix::zeros(n, n),
            couplings: [coupling(1), coupling(2)],
            border: DMatrix::zeros(n, n_border),
            gradient: DVector::zeros(n),
            corner: DMatrix::zeros(n_border, n_border),
            corner_gradient: DVector::zeros(n_border),
        }
    }

    fn add_own(&mut self, block: &PathBlock, jacobian: &LandmarkJacobian, by_border: &Matrix3xX<f64>) {
        for (i, (row, a)) in jacobian.by_frame.iter().enumerate() {
            let mut gradient = self.gradient.fixed_rows_mut::<3>(3 * row);
            gradient += a.tr_mul(&block.gradient);
            let mut border = self.border.fixed_rows_mut::<3>(3 * row);
            border += a.tr_mul(by_border);
            let left = a.tr_mul(&block.hessian[0]);
            for (column, b) in &jacobian.by_frame[..=i] {
                let mut target = self.diagonal.fixed_view_mut::<3, 3>(3 * row, 3 * column);
                target += left * b;
            }
        }
    }

    fn add_coupling(
        &mut self,
        lag: usize,
        later: &LandmarkJacobian,
        hessian: &Matrix3<f64>,
        earlier: &LandmarkJacobian,
    ) {
        let Some(coupling) = &mut self.couplings[lag - 1] else { return };
        for (row, a) in &later.by_frame {
            let left = a.tr_mul(hessian);
            for (column, b) in &earlier.by_frame {
                let mut target = coupling.fixed_view_mut::<3, 3>(3 * row, 3 * column);
                target += left * b;
            }
        }
    }
}
