//! `Calib.toml` (Pose2Sim) and `calibration.toml` (anipose): cameras as TOML tables.
//!
//! `name`; `size` px; `matrix` K; `distortions` `k1 k2 p1 p2` and, for anipose, `k3` and a rational lens's `k4 k5 k6`;
//! `rotation` Rodrigues vector rad, `translation` m: `x_camera = exp(rotation) x_world + translation`; `fisheye`, and where
//! it is true, `distortions` is `k1 k2 k3 k4`. The world is that of the result: Pose2Sim assumes z up.
//!
//! Known limits: Pose2Sim's layout has four distortion coefficients; a `k3` or a rational lens is left out and reported. Its
//! own reader ignores `fisheye`. Versions of anipose that project without OpenCV require exactly five coefficients.

use super::files::ResultFiles;
use super::names::{file_names, quoted};
use super::take::{Take, TakeCamera};
use crate::geometry::{Distortion, rotation};
use std::io;

const MEDIA_TYPE: &str = "application/toml";

/// Writes `Calib.toml`.
pub(super) fn write_pose2sim(files: &mut ResultFiles, take: &Take) -> io::Result<()> {
    let names = file_names(take.cameras.iter().map(|camera| camera.id.as_str()));
    let tables = take.cameras.iter().zip(names).map(|(camera, name)| table(&name, camera, 4));
    let text = tables.collect::<String>() + "[metadata]\nadjusted = false\nerror = 0.0\n";
    files.bytes("Calib.toml", MEDIA_TYPE, text.as_bytes())
}

/// Writes `calibration.toml`; its readers sort the tables by key, so the keys are numbers of equal width.
pub(super) fn write_anipose(files: &mut ResultFiles, take: &Take) -> io::Result<()> {
    let width = take.cameras.len().saturating_sub(1).to_string().len();
    let tables = take.cameras.iter().enumerate().map(|(i, camera)| table(&format!("cam_{i:0width$}"), camera, 5));
    let text = tables.collect::<String>() + "[metadata]\nadjusted = false\nerror = 0.0\n";
    files.bytes("calibration.toml", MEDIA_TYPE, text.as_bytes())
}

fn table(key: &str, camera: &TakeCamera, n_distortions: usize) -> String {
    let lens = &camera.intrinsics;
    let k = lens.matrix();
    let row = |r: usize| array(&[k[(r, 0)], k[(r, 1)], k[(r, 2)]]);
    let pose = &camera.camera_from_world;
    let is_fisheye = matches!(lens.dist, Distortion::Fisheye4(_));
    let coefficients = match lens.dist {
        Distortion::None | Distortion::OpenCv5(_) => lens.dist.coefficients()[..n_distortions].to_vec(),
        // The first coefficients of a rational lens alone are invalid: where the format lacks the others, no distortion is
        // written, and the loss is reported.
        Distortion::Rational8(_) if n_distortions < 5 => vec![0.0; n_distortions],
        Distortion::Rational8(_) | Distortion::Fisheye4(_) => lens.dist.coefficients().to_vec(),
    };
    format!(
        "[{key}]\nname = {}\nsize = {}\nmatrix = [{}, {}, {}]\ndistortions = {}\nrotation = {}\ntranslation = {}\n\
         fisheye = {is_fisheye}\n\n",
        quoted(&camera.id),
        array(&[f64::from(lens.width), f64::from(lens.height)]),
        row(0),
        row(1),
        row(2),
        array(&coefficients),
        array(rotation::log(&pose.rotation).as_slice()),
        array(pose.translation.as_slice()),
    )
}

fn array(values: &[f64]) -> String {
    let values: Vec<String> = values.iter().map(|value| format!("{value:?}")).collect();
    format!("[{}]", values.join(", "))
}
