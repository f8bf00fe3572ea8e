//! Accelerations of keypoints as white noise.

/// Spectral density of acceleration of hands and feet, m^2/s^3: 12 m/s^2 (a brisk gesture) held for a thirtieth of a second.
const LIMB_ACCELERATION: f64 = 5.0;
/// The same of head and trunk: 5 m/s^2.
const TRUNK_ACCELERATION: f64 = 0.8;

/// Spectral density of the acceleration of a keypoint, m^2/s^3.
pub fn acceleration_density(keypoint: &str) -> f64 {
    let limb = ["wrist", "elbow", "ankle", "knee", "toe", "heel", "hand", "foot", "index", "pinky", "thumb"];
    if limb.iter().any(|part| keypoint.ends_with(part)) { LIMB_ACCELERATION } else { TRUNK_ACCELERATION }
}

/// Variance per axis of a second difference of positions `dt` seconds apart, under a spectral density of the acceleration:
/// $\tfrac23 q\,dt^3$, m^2.
pub fn second_difference_variance(density: f64, dt: f64) -> f64 {
    density * dt.powi(3) * 2.0 / 3.0
}
