//! The camera model of film-making programs: y up, looking along -z, focal length and sensor size.

use super::take::TakeCamera;
use crate::geometry::{Intrinsics, Rigid};
use nalgebra::{Matrix3, Vector3};

/// Width of the sensor that focal lengths refer to, m: full frame. Only its ratios affect an image.
pub(super) const SENSOR_WIDTH: f64 = 0.036;

/// A lens with a sensor of [`SENSOR_WIDTH`], m. Distortion and skew cannot be represented.
pub(super) struct FilmLens {
    pub(super) focal_length: f64,
    pub(super) sensor_width: f64,
    /// Differs from the image's aspect where pixels are not square.
    pub(super) sensor_height: f64,
    /// Offset of the sensor's centre from the optical axis, to the right.
    pub(super) offset_right: f64,
    /// Offset of the sensor's centre from the optical axis, upwards.
    pub(super) offset_up: f64,
}

/// Converts intrinsics: a pixel is `sensor_width / width` wide, and its height gives the same focal length in both
/// directions.
pub(super) fn film_lens(lens: &Intrinsics) -> FilmLens {
    let (width, height) = (f64::from(lens.width), f64::from(lens.height));
    let pixel_width = SENSOR_WIDTH / width;
    let focal_length = lens.fx * pixel_width;
    let pixel_height = focal_length / lens.fy;
    FilmLens {
        focal_length,
        sensor_width: SENSOR_WIDTH,
        sensor_height: height * pixel_height,
        // The centre of the image is ((w - 1) / 2, (h - 1) / 2), since pixel (0, 0) is the centre of the first pixel.
        offset_right: ((width - 1.0) / 2.0 - lens.cx) * pixel_width,
        offset_up: (lens.cy - (height - 1.0) / 2.0) * pixel_height,
    }
}

/// Vertical field of view, rad, of an image with a central principal point.
pub(super) fn vertical_view(lens: &Intrinsics) -> f64 {
    2.0 * (f64::from(lens.height) / (2.0 * lens.fy)).atan()
}

/// The pose `world_from_camera` with the camera's y up and z backwards.
pub(super) fn world_from_film(camera: &TakeCamera) -> Rigid {
    let world_from_camera = camera.camera_from_world.inverse();
    let camera_from_film = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
    Rigid { rotation: world_from_camera.rotation * camera_from_film, translation: world_from_camera.translation }
}
