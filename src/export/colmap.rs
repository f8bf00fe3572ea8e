//! `colmap/cameras.txt`, `images.txt` and an empty `points3D.txt`: COLMAP's text model, one image per camera.
//!
//! Model `PINHOLE` without distortion, `OPENCV` (`k1 k2 p1 p2`) or, with a `k3`, `FULL_OPENCV`. COLMAP's first pixel has
//! its centre at (0.5, 0.5): half a pixel is added to the principal point. Poses are `camera_from_world`, quaternions
//! `w x y z`, metres, in the result's own world. Images are named after their camera, `<camera>.png`.

use super::files::ResultFiles;
use super::names::file_names;
use super::rotation_forms::quaternion_xyzw;
use super::take::Take;
use crate::geometry::Intrinsics;
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
        cameras += &format!("{id} {} {} {} {}\n", model(lens), lens.width, lens.height, parameters(lens));
        let [x, y, z, w] = quaternion_xyzw(&camera.camera_from_world.rotation);
        let t = camera.camera_from_world.translation;
        images += &format!("{id} {w:?} {x:?} {y:?} {z:?} {:?} {:?} {:?} {id} {name}.png\n\n", t.x, t.y, t.z);
    }
    files.bytes("colmap/cameras.txt", "text/plain", cameras.as_bytes())?;
    files.bytes("colmap/images.txt", "text/plain", images.as_bytes())?;
    files.bytes("colmap/points3D.txt", "text/plain", b"# POINT3D_ID X Y Z R G B ERROR TRACK[]\n")
}

fn model(lens: &Intrinsics) -> &'static str {
    match lens.dist {
        [0.0, 0.0, 0.0, 0.0, 0.0] => "PINHOLE",
        [_, _, _, _, 0.0] => "OPENCV",
        _ => "FULL_OPENCV",
    }
}

fn parameters(lens: &Intrinsics) -> String {
    let [k1, k2, p1, p2, k3] = lens.dist;
    let mut values = vec![lens.fx, lens.fy, lens.cx + HALF_PIXEL, lens.cy + HALF_PIXEL];
    match model(lens) {
        "PINHOLE" => {}
        "OPENCV" => values.extend([k1, k2, p1, p2]),
        _ => values.extend([k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]),
    }
    let values: Vec<String> = values.iter().map(|value| format!("{value:?}")).collect();
    values.join(" ")
}
