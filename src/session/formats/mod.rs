//! Readers and writers of the dialects in which sessions are given.

pub(crate) mod calibration;
pub(crate) mod foreign;
pub(crate) mod joints;
pub mod native;
pub(crate) mod poses;
pub(crate) mod time;

use crate::geometry::{Distortion, Intrinsics};
use nalgebra::{Matrix3, Vector3};
use serde::Serialize;

/// `value` rounded to `decimals` decimal places for a file; never a negative zero.
///
/// Values beyond 2^53 units of the last place are returned unchanged up to rounding errors.
pub(crate) fn rounded(value: f64, decimals: i32) -> f64 {
    let unit = 10f64.powi(decimals);
    (value * unit).round() / unit + 0.0
}

/// A matrix row by row, as the JSON files of sessions and results hold it.
pub(crate) fn rows(matrix: &Matrix3<f64>) -> [[f64; 3]; 3] {
    std::array::from_fn(|r| std::array::from_fn(|c| matrix[(r, c)]))
}

/// The distortion model's name in JSON files, where the coefficients alone do not determine it.
pub(crate) fn distortion_model(dist: &Distortion) -> Option<&'static str> {
    match dist {
        Distortion::None | Distortion::OpenCv5(_) => None,
        Distortion::Rational8(_) | Distortion::Fisheye4(_) => Some(dist.name()),
    }
}

/// Image size, K and distortion of a camera, as `session.json` and `cameras.json` hold them.
#[derive(Serialize)]
#[cfg_attr(feature = "service", derive(utoipa::ToSchema))]
pub(crate) struct LensFields {
    /// Width of the images, px.
    width: u32,
    /// Height of the images, px.
    height: u32,
    /// Camera matrix, px.
    #[serde(rename = "K", skip_serializing_if = "Option::is_none")]
    matrix: Option<[[f64; 3]; 3]>,
    /// Distortion coefficients in OpenCV's order.
    dist: Vec<f64>,
    /// `rational` or `fisheye`; absent for the polynomial model.
    #[serde(skip_serializing_if = "Option::is_none")]
    distortion_model: Option<&'static str>,
}

impl LensFields {
    /// Those of a lens of which nothing but the image size is known.
    pub(crate) fn unknown(lens: &Intrinsics) -> Self {
        Self { matrix: None, ..Self::of(lens) }
    }

    /// The fields of a lens.
    pub(crate) fn of(lens: &Intrinsics) -> Self {
        Self {
            width: lens.width,
            height: lens.height,
            matrix: Some(rows(&lens.matrix())),
            dist: lens.dist.coefficients().to_vec(),
            distortion_model: distortion_model(&lens.dist),
        }
    }
}

/// A vector's entries.
pub(crate) fn entries(vector: &Vector3<f64>) -> [f64; 3] {
    [vector.x, vector.y, vector.z]
}
