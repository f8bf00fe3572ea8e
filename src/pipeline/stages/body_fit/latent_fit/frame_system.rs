//! The data term in one frame: Geman-McClure costs of the pixels, with derivatives by motion, betas and cameras.

use super::super::observations::PixelObservation;
use super::super::terms::camera_unknowns::POSE;
use super::decoder::{CODE, LatentMotion, MotionDecoder, N_UNKNOWNS};
use crate::body::BodyModel;
use crate::body::anthropometry::N_BETAS;
use crate::body::kinematics::{joints_by_betas, landmark_by_betas, landmark_position, posed};
use crate::body::model::ShapedBody;
use crate::motion_prior::chart::{Features, N_FEATURES};
use crate::optim::block_banded::{Corner, FramePanel};
use crate::optim::robust::{Robust, geman_mcclure};
use crate::pipeline::calibration::PosedCamera;
use crate::residuals::reprojection::{linearize, pixel_cost};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// What is fitted in a frame, and how precise it is taken to be.
#[derive(Clone, Copy)]
pub(super) struct FrameData<'a> {
    pub model: &'a BodyModel,
    pub body: &'a ShapedBody,
    pub cameras: &'a [PosedCamera],
    pub pixels: &'a [PixelObservation],
    /// Standard deviation of a pixel as a share of its scale.
    pub share: f64,
    /// Scale of Geman-McClure's cost, in standard deviations.
    pub robust_scale: f64,
    /// Factor of the cost.
    pub time_weight: f64,
}

/// Columns of the border: betas, then six of each camera; none of a kind that is held.
#[derive(Debug, Clone, Copy)]
pub(super) struct BorderColumns {
    pub n_betas: usize,
    pub n_cameras: usize,
}

impl BorderColumns {
    pub(super) fn len(self) -> usize {
        self.n_betas + POSE * self.n_cameras
    }
}

impl FrameData<'_> {
    /// The cost of all pixels.
    pub(super) fn cost(&self, motion: &LatentMotion, frame: usize) -> f64 {
        let skeleton = posed(self.body, &motion.state.poses[frame]);
        let cost = |pixel: &PixelObservation| {
            let position = landmark_position(self.model, self.body, &skeleton, pixel.landmark);
            let camera = &self.cameras[pixel.camera];
            let sigma_px = self.share * pixel.scale_px;
            let (lens, pose) = (&camera.intrinsics, &camera.camera_from_world);
            pixel_cost(lens, pose, &position, &pixel.pixel, sigma_px, self.robust_scale).cost
        };
        self.time_weight * self.pixels.iter().map(cost).sum::<f64>()
    }

    /// Adds gradient and Gauss-Newton blocks; returns the gradient by the features. The gradient by the code is left out: it
    /// comes through the whole decoder, from all frames.
    pub(super) fn add_to(
        &self,
        decoder: &MotionDecoder,
        (motion, frame): (&LatentMotion, usize),
        columns: BorderColumns,
        panel: &mut FramePanel,
        corner: &mut Corner,
    ) -> Features {
        let skeleton = posed(self.body, &motion.state.poses[frame]);
        let by_betas = (columns.n_betas > 0).then(|| joints_by_betas(self.model, &skeleton));
        let mut own = SMatrix::<f64, N_UNKNOWNS, N_UNKNOWNS>::zeros();
        let mut gradient = SVector::<f64, CODE>::zeros();
        let mut by_features = [0.0; N_FEATURES];
        for pixels in self.pixels.chunk_by(|a, b| a.landmark == b.landmark) {
            let landmark = pixels[0].landmark;
            let position = landmark_position(self.model, self.body, &skeleton, landmark);
            let moving = decoder.landmark(self.body, &skeleton, &motion.features[frame], landmark);
            let shape = by_betas.as_ref().map(|joints| {
                landmark_by_betas(&self.model.landmarks[landmark], &skeleton, joints) // [3, 10]
            });
            let (mut by_position, mut hessian) = (Vector3::zeros(), Matrix3::zeros());
            for pixel in pixels {
                let camera = &self.cameras[pixel.camera];
                let sigma_px = self.share * pixel.scale_px;
                let (lens, pose) = (&camera.intrinsics, &camera.camera_from_world);
                let Some(linear) = linearize(lens, pose, &position, &pixel.pixel, sigma_px) else { continue };
                let Robust { weight, .. } = geman_mcclure(linear.residual.norm_squared(), self.robust_scale);
                let weight = weight * self.time_weight;
                by_position += linear.by_point.tr_mul(&linear.residual) * weight;
                hessian += linear.by_point.tr_mul(&linear.by_point) * weight;
                if columns.n_cameras > 0 {
                    let row = columns.n_betas + POSE * pixel.camera;
                    let across = linear.by_camera.tr_mul(&linear.by_point) * weight; // [6, 3]
                    panel.add_border(row, 0, &(across * moving.by_unknowns));
                    let mut own = corner.hessian.fixed_view_mut::<POSE, POSE>(row, row);
                    own += linear.by_camera.tr_mul(&linear.by_camera) * weight;
                    let mut gradient = corner.gradient.fixed_rows_mut::<POSE>(row);
                    gradient += linear.by_camera.tr_mul(&linear.residual) * weight;
                    if let Some(shape) = &shape {
                        let block: SMatrix<f64, POSE, N_BETAS> = across * shape;
                        let mut lower = corner.hessian.fixed_view_mut::<POSE, N_BETAS>(row, 0);
                        lower += block;
                        let mut upper = corner.hessian.fixed_view_mut::<N_BETAS, POSE>(0, row);
                        upper += block.transpose();
                    }
                }
            }
            own += moving.by_unknowns.tr_mul(&(hessian * moving.by_unknowns));
            gradient += moving.by_unknowns.fixed_columns::<CODE>(0).tr_mul(&by_position);
            for (place, by_u) in &moving.by_features {
                let part = by_u.tr_mul(&by_position);
                (0..3).for_each(|axis| by_features[3 * place + axis] += part[axis]);
            }
            if let Some(shape) = &shape {
                panel.add_border(0, 0, &shape.tr_mul(&(hessian * moving.by_unknowns)));
                let mut block = corner.hessian.fixed_view_mut::<N_BETAS, N_BETAS>(0, 0);
                block += shape.tr_mul(&(hessian * shape));
                let mut gradient = corner.gradient.fixed_rows_mut::<N_BETAS>(0);
                gradient += shape.tr_mul(&by_position);
            }
        }
        panel.add_own(0, 0, &own);
        panel.add_gradient(0, &gradient);
        by_features
    }
}
