//! `intri.yml` and `extri.yml`: OpenCV's file storage with EasyMocap's names.
//!
//! `names`; per camera `K_` 3x3 px, `dist_` 1x5 (`k1 k2 p1 p2 k3`) or, for a rational lens, 1x8 (followed by `k4 k5 k6`),
//! `H_`, `W_` px; `R_` Rodrigues vector rad, `Rot_` 3x3, `T_` m: `x_camera = Rot x_world + T`. The world is that of the
//! result.
//!
//! Known limits: four coefficients are read as `k1 k2 p1 p2`, so those of a fisheye are left out and reported. Keys contain
//! letters, digits, `_` and `-` only; `names` contains the names as in the keys.

use super::files::ResultFiles;
use super::names::file_names;
use super::take::Take;
use crate::geometry::{Distortion, rotation};
use nalgebra::Matrix3;
use std::io;

const HEAD: &str = "%YAML:1.0\n---\n";
const MEDIA_TYPE: &str = "application/yaml";

/// Writes both files into a folder of the result: `prefix` is empty or ends with a slash.
pub(super) fn write(files: &mut ResultFiles, take: &Take, prefix: &str) -> io::Result<()> {
    files.bytes(&format!("{prefix}intri.yml"), MEDIA_TYPE, intrinsics(take).as_bytes())?;
    files.bytes(&format!("{prefix}extri.yml"), MEDIA_TYPE, extrinsics(take).as_bytes())
}

fn intrinsics(take: &Take) -> String {
    let names = names(take);
    let mut text = head(&names);
    for (name, camera) in names.iter().zip(&take.cameras) {
        let lens = &camera.intrinsics;
        text += &matrix(&format!("K_{name}"), 3, 3, &row_major(&lens.matrix()));
        // Readers interpret the coefficients as a polynomial: a fisheye's are left out, which is reported.
        let dist = match lens.dist {
            Distortion::Fisheye4(_) => Distortion::None,
            supported => supported,
        };
        let coefficients = dist.coefficients();
        text += &matrix(&format!("dist_{name}"), 1, coefficients.len(), coefficients);
        text += &format!("H_{name}: {}\nW_{name}: {}\n", lens.height, lens.width);
    }
    text
}

fn extrinsics(take: &Take) -> String {
    let names = names(take);
    let mut text = head(&names);
    for (name, camera) in names.iter().zip(&take.cameras) {
        let pose = &camera.camera_from_world;
        text += &matrix(&format!("R_{name}"), 3, 1, rotation::log(&pose.rotation).as_slice());
        text += &matrix(&format!("Rot_{name}"), 3, 3, &row_major(&pose.rotation));
        text += &matrix(&format!("T_{name}"), 3, 1, pose.translation.as_slice());
    }
    text
}

fn names(take: &Take) -> Vec<String> {
    file_names(take.cameras.iter().map(|camera| camera.id.as_str()))
}

fn head(names: &[String]) -> String {
    if names.is_empty() {
        return format!("{HEAD}names: []\n"); // OpenCV does not read an empty value as a list
    }
    let items: String = names.iter().map(|name| format!("   - \"{name}\"\n")).collect();
    format!("{HEAD}names:\n{items}")
}

fn matrix(key: &str, n_rows: usize, n_columns: usize, values: &[f64]) -> String {
    let data: Vec<String> = values.iter().map(|value| format!("{value:?}")).collect();
    let data = data.join(", ");
    format!("{key}: !!opencv-matrix\n   rows: {n_rows}\n   cols: {n_columns}\n   dt: d\n   data: [ {data} ]\n")
}

fn row_major(m: &Matrix3<f64>) -> Vec<f64> {
    m.transpose().as_slice().to_vec()
}
