//! Cameras around the scene.

use super::config::{Arrangement, RigConfig};
use super::random::{Purpose, normal, stream};
use crate::geometry::{Intrinsics, Rigid, rotation};
use nalgebra::{Matrix3, Vector2, Vector3};

/// One camera of the rig.
#[derive(Debug, Clone, PartialEq)]
pub struct RigCamera {
    /// Name of the camera.
    pub id: String,
    /// Exact intrinsics.
    pub intrinsics: Intrinsics,
    /// Exact pose.
    pub camera_from_world: Rigid,
}

/// The middle of a standing person, which every camera is aimed at, m.
const AIM_HEIGHT: f64 = 0.95;
/// Smallest height of a camera, m.
const MIN_HEIGHT: f64 = 0.6;

/// The cameras of a configuration; every camera has a separate random stream.
pub fn cameras(config: &RigConfig, views: usize, seed: u64) -> Vec<RigCamera> {
    (0..views).map(|view| camera(config, view, views, seed)).collect()
}

fn camera(config: &RigConfig, view: usize, views: usize, seed: u64) -> RigCamera {
    let mut rng = stream(seed, Purpose::Camera, view, 0);
    let azimuth = azimuth(config.arrangement, view, views) + normal(&mut rng, 0.06);
    let radius = config.radius * (1.0 + normal(&mut rng, 0.05));
    let height = (config.height + normal(&mut rng, 0.25)).max(MIN_HEIGHT);
    let center = Vector3::new(radius * azimuth.sin(), height, radius * azimuth.cos());
    let aim = Vector3::new(0.0, AIM_HEIGHT, 0.0) + Vector3::from_fn(|_, _| normal(&mut rng, config.aim_jitter));
    let roll = normal(&mut rng, config.roll_jitter_deg).to_radians();
    let fov = (config.fov_deg * (1.0 + normal(&mut rng, 0.03))).clamp(1.0, 160.0).to_radians();
    let (width, height) = (f64::from(config.image_width), f64::from(config.image_height));
    let dist = config.lens.distortion();
    // The edge of the image is at half the field of view.
    let focal = ten_thousandths(0.5 * width / dist.distorted(&Vector2::new((0.5 * fov).tan(), 0.0)).x);
    let intrinsics = Intrinsics {
        width: config.image_width,
        height: config.image_height,
        fx: focal,
        fy: focal,
        cx: ten_thousandths(0.5 * width + normal(&mut rng, 3.0)),
        cy: ten_thousandths(0.5 * height + normal(&mut rng, 3.0)),
        skew: 0.0,
        dist,
    };
    let rotation = rotation::exp(&Vector3::new(0.0, 0.0, roll)) * camera_rotation_towards(&(aim - center));
    RigCamera {
        id: format!("cam{view:02}"),
        intrinsics,
        camera_from_world: Rigid { rotation, translation: -(rotation * center) },
    }
}

/// Position of a camera on the circle, rad from +z towards +x.
fn azimuth(arrangement: Arrangement, view: usize, views: usize) -> f64 {
    match arrangement {
        Arrangement::Ring => std::f64::consts::TAU * view as f64 / views as f64,
        Arrangement::Arc { span_deg } => span_deg.to_radians() * (view as f64 / (views.max(2) - 1) as f64 - 0.5),
    }
}

/// `camera_from_world` rotation of an upright camera (+y of the world is up) that looks along `direction`.
fn camera_rotation_towards(direction: &Vector3<f64>) -> Matrix3<f64> {
    let forward = direction.try_normalize(1e-9).unwrap_or_else(Vector3::z);
    let right = forward.cross(&Vector3::y()).try_normalize(1e-9).unwrap_or_else(Vector3::x);
    let down = forward.cross(&right);
    Matrix3::from_rows(&[right.transpose(), down.transpose(), forward.transpose()])
}

/// Rounds to four decimals, the precision of calibration files.
fn ten_thousandths(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}
