//! The data term: landmarks against triangulated points or detected pixels.

use super::super::observations::{Observations, PixelObservation, PointObservation};
use super::frame::{LinearisedFrame, PosedFrame};
use super::landmark_jacobian::LinearLandmarks;
use super::term::FrameTerm;
use super::whitened_pixels::WhitenedPixels;
use crate::optim::block_banded::{Corner, FramePanel};
use crate::residuals::position_cost::{PositionCost, point_cost};
use crate::residuals::reprojection::pixel_cost;
use std::ops::Add;

/// Which observations are fitted, and how precise they are taken to be.
#[derive(Debug, Clone, Copy)]
pub(crate) enum DataSource<'a> {
    /// Triangulated points; standard deviation per axis, m.
    Points { sigma: f64 },
    /// Pixels; standard deviation per axis as a share of [`PixelObservation::scale_px`].
    Pixels { share: f64 },
    /// Pixels whose errors are correlated in time.
    Paths(&'a WhitenedPixels),
}

/// Landmarks that are observed in a frame: of COCO's 17 keypoints or more.
const USUAL_LANDMARKS: usize = 17;

/// Robust distances between landmarks and their observations.
pub(crate) struct DataTerm<'a> {
    pub observations: &'a Observations,
    pub source: DataSource<'a>,
    /// Scale of Geman-McClure's cost, in standard deviations.
    pub robust_scale: f64,
}

impl DataTerm<'_> {
    /// Calls `visit` with every observed landmark and the cost of all its observations over its position: the sum comes
    /// first, since the derivatives of the position are the larger part of the work.
    fn for_each_landmark(&self, frame: &PosedFrame, mut visit: impl FnMut(usize, PositionCost)) {
        match self.source {
            DataSource::Points { sigma } => {
                for PointObservation { landmark, position } in &self.observations.points[frame.index] {
                    visit(
                        *landmark,
                        point_cost(&frame.observed_position(*landmark), position, sigma, self.robust_scale),
                    );
                }
            }
            DataSource::Pixels { share } => {
                for pixels in self.observations.pixels[frame.index].chunk_by(|a, b| a.landmark == b.landmark) {
                    let landmark = pixels[0].landmark;
                    let position = frame.observed_position(landmark);
                    let cost = |pixel: &PixelObservation| {
                        let camera = &self.observations.cameras[pixel.camera];
                        let (sigma_px, scale) = (share * pixel.scale_px, self.robust_scale);
                        let camera_from_world = &camera.camera_from_world;
                        pixel_cost(&camera.intrinsics, camera_from_world, &position, &pixel.pixel, sigma_px, scale)
                    };
                    if let Some(cost) = pixels.iter().map(cost).reduce(Add::add) {
                        visit(landmark, cost);
                    }
                }
            }
            // Paths are a term of their own.
            DataSource::Paths(_) => {}
        }
    }
}

impl FrameTerm for DataTerm<'_> {
    fn cost(&self, frame: &PosedFrame) -> f64 {
        let mut sum = 0.0;
        self.for_each_landmark(frame, |_, at| sum += at.cost);
        sum
    }

    fn add_to(&self, frame: &LinearisedFrame, system: &mut FramePanel, corner: &mut Corner) {
        let (mut landmarks, mut costs) =
            (LinearLandmarks::with_room(USUAL_LANDMARKS), Vec::with_capacity(USUAL_LANDMARKS));
        self.for_each_landmark(&frame.posed, |landmark, at| {
            frame.add_observed(landmark, &mut landmarks);
            costs.push(at);
        });
        let costs = costs.iter().enumerate();
        costs.for_each(|(index, at)| landmarks.jacobian(index).add_cost(at, system, corner));
    }
}
