//! Blocks of the paths' term in the Gauss-Newton system: from positions of landmarks to the unknowns that move them.

use super::camera_unknowns::{FOCAL, POSE};
use super::landmark_jacobian::{BorderJacobian, LinearLandmarks};
use super::unknowns::{Border, CameraColumns};
use super::whitened_pixels::{PathBlocks, PointByCamera, Positions, WhitenedPixels};
use crate::optim::block_banded::{Corner, FramePanel, StripRows};
use crate::pipeline::calibration::PosedCamera;
use nalgebra::Matrix3;

/// The term to second order by positions, and the derivatives of these.
///
/// With `J` the derivatives of a position by its frame, `B` by the border, and `M_k` the second derivatives by the positions of
/// a frame and of the one `k` frames earlier: blocks `J_t^T M_k J_{t-k}` between frames, `J_t^T N_t` and `B_t^T N_t` to the border,
/// where `N_t = sum_k M_k B_{t-k} + M_k^T B_{t+k}`.
pub(crate) struct LinearPaths<'a> {
    blocks: PathBlocks,
    /// By frame, the observed landmarks.
    paths: &'a [LinearLandmarks],
    cameras: CameraColumns,
    /// Column of the first camera.
    first_camera: usize,
    has_border: bool,
}

impl<'a> LinearPaths<'a> {
    /// The term at the landmarks `paths`.
    pub(crate) fn new(
        (term, cameras): (&WhitenedPixels, &[PosedCamera]),
        border: &Border,
        paths: &'a [LinearLandmarks],
    ) -> Self {
        let positions: Positions = paths.iter().map(|frame| frame.positions.clone()).collect();
        Self {
            blocks: term.blocks(cameras, &positions, border.cameras),
            paths,
            cameras: border.cameras,
            first_camera: border.camera_columns().start,
            has_border: border.len() > 0,
        }
    }

    /// Adds what concerns the cameras alone, once all frames have been added to `corner`.
    pub(crate) fn add_cameras(&self, corner: &mut Corner) {
        let (first, n) = (self.first_camera, self.cameras.len());
        // Rows of the cameras against what moves points: the transpose of the columns.
        let crossed = corner.hessian.view((0, first), (first, n)).transpose();
        corner.hessian.view_mut((first, 0), (n, first)).copy_from(&crossed);
        self.blocks.add_cameras_to(first, corner);
    }

    /// First column of a camera in the border.
    fn column(&self, camera: usize) -> usize {
        self.first_camera + self.cameras.unknowns.len() * camera
    }

    /// Adds what concerns frame `t`: its own blocks, those of later frames with it, and its rows of the border.
    pub(crate) fn add_frame(&self, t: usize, system: &mut FramePanel, corner: &mut Corner) {
        let mut rows = StripRows::with_room();
        for l in 0..self.paths[t].len() {
            let of_landmark = &self.blocks.landmarks[l];
            let Some(block) = of_landmark.frames.get(t).filter(|block| block.hessian[0] != Matrix3::zeros()) else {
                continue;
            };
            let jacobian = self.paths[t].jacobian(l);
            jacobian.add_to_frame(&block.gradient, &block.hessian[0], system);
            for lag in 1..=2 {
                let Some(hessian) = of_landmark.frames.get(t + lag).map(|later| &later.hessian[lag]) else { continue };
                if *hessian == Matrix3::zeros() {
                    continue;
                }
                system.add_product(lag, self.paths[t + lag].jacobian(l).rows, hessian, jacobian.by_frame);
            }
            if self.has_border {
                rows.clear();
                self.add_border(t, l, &mut rows, system, corner);
            }
        }
    }

    /// Adds the rows of the border of one landmark in frame `t`; `rows`: their place, empty.
    fn add_border(&self, t: usize, l: usize, rows: &mut StripRows, system: &mut FramePanel, corner: &mut Corner) {
        let (jacobian, of_landmark) = (self.paths[t].jacobian(l), &self.blocks.landmarks[l]);
        let by_border = |t: usize| self.paths[t].jacobian(l).by_border;
        let block = &of_landmark.frames[t];
        let earlier = |lag: usize| t.checked_sub(lag).map(|earlier| (block.hessian[lag], by_border(earlier)));
        let later = |lag: usize| {
            of_landmark.frames.get(t + lag).map(|later| (later.hessian[lag].transpose(), by_border(t + lag)))
        };
        let others = [earlier(1), later(1), earlier(2), later(2)].into_iter().flatten();
        let across = BorderJacobian::sum(std::iter::once((block.hessian[0], by_border(t))).chain(others));
        let own = jacobian.by_border;
        own.add_gradient(&block.gradient, corner);
        own.add_product(&across, corner);
        across.add_to_rows(rows);
        let seeing =
            of_landmark.by_cameras(t).iter().enumerate().filter(|(_, block)| **block != PointByCamera::zeros());
        for (camera, by_camera) in seeing {
            let first = self.column(camera);
            let by_pose = by_camera.fixed_columns::<POSE>(0).into_owned();
            own.add_columns(first, &by_pose, corner);
            rows.add(first, &by_pose);
            if self.cameras.unknowns.focal {
                let by_focal = by_camera.fixed_columns::<1>(FOCAL).into_owned();
                own.add_columns(first + FOCAL, &by_focal, corner);
                rows.add(first + FOCAL, &by_focal);
            }
        }
        system.add_border_product(rows, &Matrix3::identity(), jacobian.by_frame);
    }
}
