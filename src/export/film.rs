//! The camera as film-making programs have it: y up, looking along -z, a lens of some focal length before a sensor.

use super::take::TakeCamera;
use crate::geometry::{Intrinsics, Rigid};
use nalgebra::{Matrix3, Vector3};

/// Width of the sensor that focal lengths are written for, m: full frame. Only ratios of it show in an image.
pub(super) const SENSOR_WIDTH: f64 = 0.036;

/// A lens before a sensor of [`SENSOR_WIDTH`], m. Distortion and skew have no place here.
pub(super) struct FilmLens {
    pub(super) focal_length: f64,
    pub(super) sensor_width: f64,
    /// Other than the image's shape has it where pixels are not square.
    pub(super) sensor_height: f64,
    /// The middle of the sensor from the lens's axis, to the right.
    pub(super) offset_right: f64,
    /// The middle of the sensor from the lens's axis, upwards.
    pub(super) offset_up: f64,
}

/// A pixel is `sensor_width / width` wide, and as high as makes the focal length the same both ways.
pub(super) fn film_lens(lens: &Intrinsics) -> FilmLens {
    let (width, height) = (f64::from(lens.width), f64::from(lens.height));
    let pixel_width = SENSOR_WIDTH / width;
    let focal_length = lens.fx * pixel_width;
    let pixel_height = focal_length / lens.fy;
    FilmLens {
        focal_length,
        sensor_width: SENSOR_WIDTH,
        sensor_height: height * pixel_height,
        // The middle of the image lies at ((w - 1) / 2, (h - 1) / 2): pixel (0, 0) is the centre of the first.
        offset_right: ((width - 1.0) / 2.0 - lens.cx) * pixel_width,
        offset_up: (lens.cy - (height - 1.0) / 2.0) * pixel_height,
    }
}

/// Vertical angle of view, rad, of an image with its principal point in the middle.
pub(super) fn vertical_view(lens: &Intrinsics) -> f64 {
    2.0 * (f64::from(lens.height) / (2.0 * lens.fy)).atan()
}

/// `world_from_camera` with the camera's y up and z backwards.
pub(super) fn world_from_film(camera: &TakeCamera) -> Rigid {
    let world_from_camera = camera.camera_from_world.inverse();
    let camera_from_film = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
    Rigid { rotation: world_from_camera.rotation * camera_from_film, translation: world_from_camera.translation }
}
