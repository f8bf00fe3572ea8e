//! Distances of detected pixels from the projected landmarks of a motion.

use super::context::FitContext;
use super::observations::Observations;
use super::terms::data::DataSource;
use super::terms::unknowns::MotionState;
use super::terms::whitened_pixels::WhitenedPixels;
use crate::body::BodyModel;
use crate::body::kinematics::{landmark_position, posed};
use crate::optim::robust::{MEDIAN_LENGTH_IN_PLANE, median, variance_per_residual};

/// The detector's standard deviation per axis as a share of apparent size, from the median residual.
///
/// The median length of a normal error in the plane is a known multiple of sigma. The estimate is enlarged by
/// sqrt(n / (n - p)), since n equations that determine p unknowns leave residuals smaller than their errors.
pub(super) fn pixel_share(context: &FitContext, observations: &Observations, state: &MotionState) -> f64 {
    let mut shares: Vec<f64> =
        residuals(context.model, observations, state).into_iter().map(|residual| residual.share).collect();
    let [low, high] = context.config.pixel_share_bounds;
    let freedom = variance_per_residual(observations.equations_per_frame(), context.config.unknowns_per_frame).sqrt();
    median(&mut shares).map_or(high, |m| (freedom * m / MEDIAN_LENGTH_IN_PLANE).clamp(low, high))
}

/// The detected pixels of one person as data.
pub(super) enum DetectedPixels {
    /// With independent errors; standard deviation as a share of apparent size.
    Independent { share: f64 },
    /// With errors that are correlated in time.
    Correlated(WhitenedPixels),
}

impl DetectedPixels {
    /// Correlated in time once the errors have been measured; before, independent of the size that the residuals of `state`
    /// show.
    pub(super) fn new(context: &FitContext, observations: &Observations, state: &MotionState) -> Self {
        match context.noise {
            Some(noise) => Self::Correlated(WhitenedPixels::new(observations, noise, context.config.robust_scale)),
            None => Self::independent(context, observations, state),
        }
    }

    /// Independent, of the size that the residuals of `state` show.
    pub(super) fn independent(context: &FitContext, observations: &Observations, state: &MotionState) -> Self {
        Self::Independent { share: pixel_share(context, observations, state) }
    }

    pub(super) fn source(&self) -> DataSource<'_> {
        match self {
            Self::Independent { share } => DataSource::Pixels { share: *share },
            Self::Correlated(pixels) => DataSource::Paths(pixels),
        }
    }
}

/// Face; legs; trunk and arms.
const N_REGIONS: f64 = 3.0;

/// Variance of a sum of the errors of `n_landmarks` over that of as many independent ones, of which residuals show the part that is
/// each landmark's own: `(1 + s (m - 1)) / (1 - s)`, the design effect (Kish 1965) of the m landmarks of one region, whose errors
/// correlate by `s`, `shared`.
pub(super) fn shared_error_variance(n_landmarks: usize, shared: f64) -> f64 {
    let of_region = (n_landmarks as f64 / N_REGIONS).max(1.0);
    (1.0 + shared * (of_region - 1.0)) / (1.0 - shared)
}

/// Median distance of the detected pixels from the projected landmarks, px.
pub(super) fn median_distance_px(model: &BodyModel, observations: &Observations, state: &MotionState) -> Option<f64> {
    let residuals = residuals(model, observations, state).into_iter();
    median(&mut residuals.map(|residual| residual.distance_px).collect::<Vec<_>>())
}

/// Distance of one detected pixel from its landmark's projection.
struct PixelResidual {
    distance_px: f64,
    /// In units of [`super::observations::PixelObservation::scale_px`].
    share: f64,
}

fn residuals(model: &BodyModel, observations: &Observations, state: &MotionState) -> Vec<PixelResidual> {
    let body = model.shaped(&state.betas);
    let mut residuals = Vec::new();
    for (pixels, pose) in observations.pixels.iter().zip(&state.poses) {
        let skeleton = posed(&body, pose);
        for pixel in pixels {
            let camera = &observations.cameras[pixel.camera];
            let position = landmark_position(model, &body, &skeleton, pixel.landmark);
            if let Some(projected) = camera.pixel_of(&position) {
                let distance_px = (projected - pixel.pixel).norm();
                residuals.push(PixelResidual { distance_px, share: distance_px / pixel.scale_px });
            }
        }
    }
    residuals
}
