//! `cameras.json`: intrinsics as given or refined, and the solved poses.

use crate::session::formats::{LensFields, entries, rows};
use crate::session::reconstruction::{ErrorSummary, SolvedCamera};
use crate::session::recording::UpAxis;
use crate::session::{Reconstruction, Session, View};
use serde::Serialize;

/// The file.
#[derive(Serialize)]
pub(super) struct Cameras<'a> {
    units: &'static str,
    up_axis: UpAxis,
    handedness: &'static str,
    cameras: Vec<Camera<'a>>,
}

#[derive(Serialize)]
struct Camera<'a> {
    id: &'a str,
    #[serde(flatten)]
    lens: LensFields,
    #[serde(rename = "R")]
    rotation: Option<[[f64; 3]; 3]>,
    #[serde(rename = "t")]
    translation: Option<[f64; 3]>,
    position: Option<[f64; 3]>,
    reprojection_px: Option<ErrorSummary>,
    n_observations: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    sigma_position_mm: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    sigma_angle_deg: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    focal_factor: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    sigma_focal_factor: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    time_offset_s: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    sigma_time_offset_s: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    clock_drift_ppm: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    sigma_clock_drift_ppm: Option<f64>,
    status: &'static str,
}

/// The content of `cameras.json`.
pub(super) fn cameras<'a>(session: &'a Session, reconstruction: &Reconstruction) -> Cameras<'a> {
    let pairs = session.views.iter().zip(&reconstruction.cameras);
    Cameras {
        units: "m",
        up_axis: reconstruction.up_axis,
        handedness: "right",
        cameras: pairs.map(|(view, solved)| camera(view, solved)).collect(),
    }
}

fn camera<'a>(view: &'a View, solved: &SolvedCamera) -> Camera<'a> {
    let camera_from_world = solved.camera_from_world;
    let drift = solved.time_offset.and_then(|offset| offset.drift);
    Camera {
        id: &view.id,
        lens: LensFields::of(&solved.lens(&view.intrinsics)),
        rotation: camera_from_world.map(|pose| rows(&pose.rotation)),
        translation: camera_from_world.map(|pose| entries(&pose.translation)),
        position: camera_from_world.map(|pose| entries(&pose.center())),
        reprojection_px: solved.reprojection_px,
        n_observations: solved.n_observations,
        sigma_position_mm: solved.sigma_position_mm,
        sigma_angle_deg: solved.sigma_angle_deg,
        focal_factor: solved.focal_factor.map(|factor| factor.value),
        sigma_focal_factor: solved.focal_factor.map(|factor| factor.sigma),
        time_offset_s: solved.time_offset.map(|offset| offset.secs),
        sigma_time_offset_s: solved.time_offset.and_then(|offset| offset.sigma_secs),
        clock_drift_ppm: drift.map(|drift| 1e6 * drift.rate),
        sigma_clock_drift_ppm: drift.and_then(|drift| drift.sigma).map(|sigma| 1e6 * sigma),
        status: if camera_from_world.is_some() { "solved" } else { "unsolved" },
    }
}
