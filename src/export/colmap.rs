//! `colmap/cameras.txt`, `images.txt` and an empty `points3D.txt`: COLMAP's text model, one image per camera.
//!
//! Model `PINHOLE` without distortion, `OPENCV` (`k1 k2 p1 p2`), with a `k3` or a rational lens `FULL_OPENCV`, for a fisheye
//! `OPENCV_FISHEYE`. COLMAP's first pixel has its centre at (0.5, 0.5): half a pixel is added to the principal point. Poses
//! are `camera_from_world`, quaternions `w x y z`, metres, in the result's world. Images are named after their camera,
//! `<camera>.png`.

use super::files::ResultFiles;
use super::names::file_names;
use super::rotation_forms::quaternion_xyzw;
use super::take::Take;
use crate::geometry::{Distortion, Intrinsics};
use std::io;

/// From the centre of the first pixel to its corner, px.
const HALF_PIXEL: f64 = 0.5;

/// Writes the three files.
pub(super) fn write(files: &mut ResultFiles, take: &Take) -> io::Result<()> {
    let names = file_names(take.cameras.iter().map(|camera| camera.id.as_str()));
    let mut cameras = "# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]\n".to_owned();
    let mut images =
        "# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then a line of POINTS2D[], which is empty\n".to_owned();
    for (i, (camera, name)) in take.cameras.iter().zip(names).enumerate() {
        let (id, lens) = (i + 1, &camera.intrinsics);
        let Model { name: model, coefficients } = model(lens);
        let parameters = parameters(lens, &coefficients);
        cameras += &format!("{id} {model} {} {} {parameters}\n", lens.width, lens.height);
        let [x, y, z, w] = quaternion_xyzw(&camera.camera_from_world.rotation);
        let t = camera.camera_from_world.translation;
        images += &format!("{id} {w:?} {x:?} {y:?} {z:?} {:?} {:?} {:?} {id} {name}.png\n\n", t.x, t.y, t.z);
    }
    files.bytes("colmap/cameras.txt", "text/plain", cameras.as_bytes())?;
    files.bytes("colmap/images.txt", "text/plain", images.as_bytes())?;
    files.bytes("colmap/points3D.txt", "text/plain", b"# POINT3D_ID X Y Z R G B ERROR TRACK[]\n")
}

/// COLMAP's name and coefficients of a lens.
struct Model {
    name: &'static str,
    coefficients: Vec<f64>,
}

fn model(lens: &Intrinsics) -> Model {
    let (name, coefficients) = match lens.dist {
        Distortion::None => ("PINHOLE", Vec::new()),
        Distortion::OpenCv5([k1, k2, p1, p2, 0.0]) => ("OPENCV", vec![k1, k2, p1, p2]),
        Distortion::OpenCv5([k1, k2, p1, p2, k3]) => ("FULL_OPENCV", vec![k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]),
        Distortion::Rational8(dist) => ("FULL_OPENCV", dist.to_vec()),
        Distortion::Fisheye4(dist) => ("OPENCV_FISHEYE", dist.to_vec()),
    };
    Model { name, coefficients }
}

fn parameters(lens: &Intrinsics, coefficients: &[f64]) -> String {
    let pinhole = [lens.fx, lens.fy, lens.cx + HALF_PIXEL, lens.cy + HALF_PIXEL];
    let values: Vec<String> = pinhole.iter().chain(coefficients).map(|value| format!("{value:?}")).collect();
    values.join(" ")
}
