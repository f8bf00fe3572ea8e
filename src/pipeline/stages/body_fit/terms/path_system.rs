//! Blocks of the paths' term in the Gauss-Newton system: from positions of landmarks to the unknowns that move them.

use super::super::observations::PosedCamera;
use super::camera_unknowns::{FOCAL, POSE};
use super::landmark_jacobian::BorderJacobian;
use super::term::RUN;
use super::unknowns::{CameraColumns, Unknowns};
use super::whitened_pixels::{PathBlocks, Positions, WhitenedPixels};
use super::window::TrackedLandmark;
use crate::optim::block_banded::{BlockBanded, Corner, FramePanel};
use nalgebra::Matrix3;
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
    let (n_border, cameras) = (border.len(), border.camera_columns());
    let linear = LinearPaths {
        blocks: &blocks,
        paths,
        cameras: border.cameras,
        first_camera: cameras.start,
        has_border: n_border > 0,
    };
    let add_run = |(run, frames): (usize, &mut [FramePanel])| {
        let mut corner = Corner::zeros(n_border);
        frames.iter_mut().enumerate().for_each(|(i, frame)| linear.add_frame(RUN * run + i, frame, &mut corner));
        corner
    };
    let corners: Vec<Corner> = system.frames().par_chunks_mut(RUN).enumerate().map(add_run).collect();
    let mut corner = Corner::zeros(n_border);
    for part in corners {
        corner.hessian += part.hessian;
        corner.gradient += part.gradient;
    }
    // Rows of the cameras against what moves points: the transpose of the columns.
    let crossed = corner.hessian.view((0, cameras.start), (cameras.start, cameras.len())).transpose();
    corner.hessian.view_mut((cameras.start, 0), (cameras.len(), cameras.start)).copy_from(&crossed);
    system.corner.hessian += corner.hessian;
    system.corner.gradient += corner.gradient;
    blocks.add_cameras_to(cameras.start, &mut system.corner);
}

/// The term to second order by positions, and the derivatives of these.
struct LinearPaths<'a> {
    blocks: &'a PathBlocks,
    paths: &'a [Vec<TrackedLandmark>],
    cameras: CameraColumns,
    /// Column of the first camera.
    first_camera: usize,
    has_border: bool,
}

impl LinearPaths<'_> {
    /// First column of a camera in the border.
    fn column(&self, camera: usize) -> usize {
        self.first_camera + self.cameras.unknowns.len() * camera
    }

    /// Adds what concerns frame `t`: its own blocks, those of later frames with it, and its rows of the border.
    fn add_frame(&self, t: usize, system: &mut FramePanel, corner: &mut Corner) {
        for (l, landmark) in self.paths[t].iter().enumerate() {
            let of_landmark = &self.blocks.landmarks[l];
            let Some(block) = of_landmark.frames.get(t).filter(|block| block.hessian[0] != Matrix3::zeros()) else {
                continue;
            };
            landmark.jacobian.add_to_frame(&block.gradient, &block.hessian[0], system);
            for lag in 1..=2 {
                let Some(hessian) = of_landmark.frames.get(t + lag).map(|later| &later.hessian[lag]) else { continue };
                if *hessian == Matrix3::zeros() {
                    continue;
                }
                for (row, a) in &self.paths[t + lag][l].jacobian.by_frame {
                    let left = a.tr_mul(hessian);
                    for (column, b) in &landmark.jacobian.by_frame {
                        system.add_coupling(lag, 3 * row, 3 * column, &(left * b));
                    }
                }
            }
            if self.has_border {
                self.add_border(t, l, system, corner);
            }
        }
    }

    /// Adds the rows of the border of one landmark in frame `t`.
    fn add_border(&self, t: usize, l: usize, system: &mut FramePanel, corner: &mut Corner) {
        let (landmark, of_landmark) = (&self.paths[t][l], &self.blocks.landmarks[l]);
        let by_border = |t: usize| &self.paths[t][l].jacobian.by_border;
        let block = &of_landmark.frames[t];
        let mut parts = vec![(block.hessian[0], by_border(t))];
        for lag in 1..=2 {
            parts.extend(t.checked_sub(lag).map(|earlier| (block.hessian[lag], by_border(earlier))));
            parts.extend(of_landmark.frames.get(t + lag).map(|b| (b.hessian[lag].transpose(), by_border(t + lag))));
        }
        let across = BorderJacobian::sum(&parts);
        let own = &landmark.jacobian.by_border;
        own.add_gradient(&block.gradient, corner);
        own.add_product(&across, corner);
        for (camera, by_camera) in of_landmark.by_cameras(t).iter().enumerate() {
            let first = self.column(camera);
            own.add_columns(first, &by_camera.fixed_columns::<POSE>(0).into_owned(), corner);
            if self.cameras.unknowns.focal {
                own.add_columns(first + FOCAL, &by_camera.fixed_columns::<1>(FOCAL).into_owned(), corner);
            }
        }
        for (group, a) in &landmark.jacobian.by_frame {
            across.add_to_border(3 * group, &a.transpose(), system);
            for (camera, by_camera) in of_landmark.by_cameras(t).iter().enumerate() {
                let (first, rows) = (self.column(camera), by_camera.tr_mul(a));
                system.add_border(first, 3 * group, &rows.fixed_rows::<POSE>(0).into_owned());
                if self.cameras.unknowns.focal {
                    system.add_border(first + FOCAL, 3 * group, &rows.fixed_rows::<1>(FOCAL).into_owned());
                }
            }
        }
    }
}
