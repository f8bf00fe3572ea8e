//! The way up, from how cameras stand and how people hold themselves.
//!
//! Most cameras stand level, and most people upright. But some rigs are tilted, and some people lie, turn cartwheels or work on a mat:
//! by bodies alone a mat was a wall, and with one of two people lying the floor leant by 40 degrees. Every direction is weighed by both
//! with probabilities for what is unusual. The result is the direction with most of the probability around it, not the one with
//! the highest peak: any two cameras are level against some direction.
//!
//! On 72 captures (realistic, `paper` and `hard`; 3 to 12 cameras, twelve kinds of rigs) it is 0.8 degrees off where cameras roll by
//! 1 degree, 2.2 where they roll by 3; the mean direction of bodies is 4 degrees off, and that of people on a mat 90.

use crate::body::skeleton::KeypointConvention;
use crate::geometry::Rigid;
use crate::geometry::rotation::tangents;
use crate::session::JointTrajectory;
use nalgebra::{Matrix2, Matrix3, Vector3};
use std::f64::consts::{PI, TAU};

/// Roll of cameras that are set level by eye, rad; the five of Shelf roll by 0.4 to 3.9 degrees.
const LEVEL_SIGMA: f64 = 0.087; // 5 degrees

/// Probability that a camera is mounted unlike the others: at any roll.
const ODD_CAMERA: f64 = 0.2;

/// Probabilities that the cameras of a rig are mounted upright, turned by a quarter, inverted, and turned by three quarters.
const MOUNTINGS: [f64; 4] = [0.9, 0.03, 0.04, 0.03];

/// How far cameras at the height of people look down, rad.
const PITCH: f64 = 0.26; // 15 degrees
const PITCH_SIGMA: f64 = 0.35; // 20 degrees

/// Probability that the cameras of a rig are at such heights, and that one of them looks elsewhere.
const USUAL_HEIGHTS: f64 = 0.7;
const ODD_PITCH: f64 = 0.2;

/// Angle between the way up and the axis of an upright body, per axis, rad: people lean, bend and sit.
const LEAN_SIGMA: f64 = 0.35; // 20 degrees

/// Share of the time in which people are not upright.
const NOT_UPRIGHT: f64 = 0.15;

/// Number of independent postures that all people of a session count for: people lie for long, and together.
const N_INDEPENDENT: f64 = 2.0;

/// Directions that are compared first: 4.5 degrees apart.
const N_DIRECTIONS: usize = 2000;

/// Radius about a mode within which probability counts as its own, degrees; another mode is twice as far away.
const MODE_RADIUS_DEG: i32 = 20;

/// Modes that are looked at.
const N_MODES: usize = 4;

/// Bodies of one person that are looked at, spread over the take.
const SAMPLES_PER_PERSON: usize = 25;

/// Tilt of cameras' mean upright against the way up, rad, where no body shows it.
const CAMERA_TILT: f64 = 0.26; // 15 degrees

/// The way up in the solution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UpDirection {
    /// Unit length.
    pub direction: Vector3<f64>,
    /// Of its tilts along its [`tangents`], rad^2.
    pub covariance: Matrix2<f64>,
    /// The likeliest one that is far from it.
    pub rival: Option<UpRival>,
}

/// Another way up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UpRival {
    /// How many times less likely it is.
    pub ratio: f64,
    /// Between the two, degrees.
    pub angle_deg: f64,
}

/// By cameras and bodies; without bodies the cameras' mean upright.
pub fn up_direction(
    convention: KeypointConvention,
    cameras: &[Option<Rigid>],
    people: &[JointTrajectory],
) -> UpDirection {
    let bodies: Vec<Vec<Vector3<f64>>> =
        people.iter().map(|person| body_axes(convention, person)).filter(|axes| !axes.is_empty()).collect();
    if bodies.is_empty() {
        let direction = camera_axis(cameras).unwrap_or(-Vector3::y());
        return UpDirection { direction, covariance: Matrix2::identity() * CAMERA_TILT * CAMERA_TILT, rival: None };
    }
    UpEvidence { cameras: cameras.iter().flatten().map(|camera| camera.rotation).collect(), bodies }.likeliest()
}

/// Directions from hips, knees and ankles to the shoulder above, of frames spread over the take.
fn body_axes(convention: KeypointConvention, person: &JointTrajectory) -> Vec<Vector3<f64>> {
    let Some(shoulders) = convention.sides_of("shoulder") else { return Vec::new() };
    let lower = ["hip", "knee", "ankle"].into_iter().filter_map(|part| convention.sides_of(part));
    let pairs: Vec<(usize, usize)> = lower.flat_map(|sides| sides.into_iter().zip(shoulders)).collect();
    let axis = |points: &Vec<Option<Vector3<f64>>>| {
        let directions = pairs.iter().filter_map(|&(low, high)| (points[high]? - points[low]?).try_normalize(1e-9));
        directions.sum::<Vector3<f64>>().try_normalize(1e-6)
    };
    let axes: Vec<Vector3<f64>> = person.points.iter().filter_map(axis).collect();
    let n = axes.len().min(SAMPLES_PER_PERSON);
    (0..n).map(|k| axes[k * axes.len() / n]).collect()
}

/// Mean up direction of the cameras, most of which stand upright.
fn camera_axis(cameras: &[Option<Rigid>]) -> Option<Vector3<f64>> {
    cameras.iter().flatten().map(|c| -c.rotation.row(1).transpose()).sum::<Vector3<f64>>().try_normalize(1e-6)
}

/// What shows the way up.
struct UpEvidence {
    /// `camera_from_solution`.
    cameras: Vec<Matrix3<f64>>,
    /// Unit vectors from legs to shoulders, by person.
    bodies: Vec<Vec<Vector3<f64>>>,
}

/// Probability around a direction.
struct Mode {
    log_probability: f64,
    up: UpDirection,
}

impl UpEvidence {
    /// The likeliest direction, with the mean and spread of the probability around it.
    fn likeliest(&self) -> UpDirection {
        let mut left: Vec<(f64, Vector3<f64>)> = sphere(N_DIRECTIONS).map(|up| (self.log_density(&up), up)).collect();
        let mut modes = Vec::new();
        while modes.len() < N_MODES && !left.is_empty() {
            let (_, peak) = left.iter().copied().fold(left[0], |best, next| if next.0 > best.0 { next } else { best });
            let radius = f64::from(2 * MODE_RADIUS_DEG).to_radians();
            left.retain(|(_, up)| up.angle(&peak) > radius);
            modes.push(self.mode_around(&peak));
        }
        modes.sort_by(|a, b| b.log_probability.total_cmp(&a.log_probability));
        let rival = |first: &Mode, other: &Mode| UpRival {
            ratio: (first.log_probability - other.log_probability).exp(),
            angle_deg: first.up.direction.angle(&other.up.direction).to_degrees(),
        };
        UpDirection { rival: modes.get(1).map(|other| rival(&modes[0], other)), ..modes[0].up }
    }

    /// Up to a constant, relative to all directions being alike.
    fn log_density(&self, up: &Vector3<f64>) -> f64 {
        self.of_cameras(up) + self.of_bodies(up)
    }

    /// Rolls against the mounting of the rig, by von Mises' distribution, whose concentration falls as a camera looks along `up`; and pitches.
    fn of_cameras(&self, up: &Vector3<f64>) -> f64 {
        let (mut rolls, mut pitches) = (MOUNTINGS.map(f64::ln), 0.0);
        for camera in &self.cameras {
            let seen = camera * up; // x right, y down, z forward
            let length = seen.xy().norm();
            let concentration = (length / LEVEL_SIGMA).powi(2);
            let normaliser = (TAU * concentration + 1.0).sqrt();
            for (sum, along) in rolls.iter_mut().zip([-seen.y, seen.x, seen.y, -seen.x]) {
                let density = normaliser * (length * (along - length) / LEVEL_SIGMA.powi(2)).exp();
                *sum += odd_or(ODD_CAMERA, density);
            }
            let off = ((-seen.z).clamp(-1.0, 1.0).asin() - PITCH) / PITCH_SIGMA;
            let density = (-0.5 * off * off).exp() / (PITCH_SIGMA * TAU.sqrt()) / (0.5 * length.max(0.05));
            pitches += odd_or(ODD_PITCH, density);
        }
        log_sum(&rolls) + log_sum(&[USUAL_HEIGHTS.ln() + pitches, (1.0 - USUAL_HEIGHTS).ln()])
    }

    fn of_bodies(&self, up: &Vector3<f64>) -> f64 {
        let inverse_variance = LEAN_SIGMA.powi(-2);
        let of_axis = |axis: &Vector3<f64>| {
            odd_or(NOT_UPRIGHT, 2.0 * inverse_variance * ((axis.dot(up) - 1.0) * inverse_variance).exp())
        };
        let of_person = |axes: &Vec<Vector3<f64>>| axes.iter().map(of_axis).sum::<f64>() / axes.len() as f64;
        let of_people: f64 = self.bodies.iter().map(of_person).sum();
        N_INDEPENDENT * of_people / self.bodies.len().max(1) as f64
    }

    fn mode_around(&self, peak: &Vector3<f64>) -> Mode {
        let around = cap(peak);
        let logs: Vec<f64> = around.iter().map(|up| self.log_density(up)).collect();
        let log_probability = log_sum(&logs);
        let weights: Vec<f64> = logs.iter().map(|log| (log - log_probability).exp()).collect();
        let mean: Vector3<f64> = around.iter().zip(&weights).map(|(up, weight)| up * *weight).sum();
        let direction = mean.normalize();
        let tilts = tangents(&direction).transpose();
        let spread = |(up, weight): (&Vector3<f64>, &f64)| {
            let tilt = tilts * up;
            tilt * tilt.transpose() * *weight
        };
        let covariance = around.iter().zip(&weights).map(spread).sum();
        Mode { log_probability, up: UpDirection { direction, covariance, rival: None } }
    }
}

/// Logarithm of a density relative to all values being alike, which they are with the probability `odd`.
fn odd_or(odd: f64, density: f64) -> f64 {
    ((1.0 - odd) * density + odd).ln()
}

fn log_sum(logs: &[f64]) -> f64 {
    let largest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    largest + logs.iter().map(|log| (log - largest).exp()).sum::<f64>().ln()
}

/// Directions spread evenly over the sphere, on a spiral by the golden angle.
fn sphere(n: usize) -> impl Iterator<Item = Vector3<f64>> {
    (0..n).map(move |k| {
        let height = 1.0 - (2 * k + 1) as f64 / n as f64;
        let (sine, cosine) = (PI * (1.0 + 5.0_f64.sqrt()) * k as f64).sin_cos();
        let radius = (1.0 - height * height).sqrt();
        Vector3::new(radius * cosine, radius * sine, height)
    })
}

/// Directions a degree apart within [`MODE_RADIUS_DEG`] of `middle`.
fn cap(middle: &Vector3<f64>) -> Vec<Vector3<f64>> {
    let tangents = tangents(middle);
    let tilts = |x: i32| (-MODE_RADIUS_DEG..=MODE_RADIUS_DEG).map(move |y| (x, y));
    (-MODE_RADIUS_DEG..=MODE_RADIUS_DEG)
        .flat_map(tilts)
        .filter(|(x, y)| x * x + y * y <= MODE_RADIUS_DEG * MODE_RADIUS_DEG)
        .map(|(x, y)| {
            let [x, y] = [x, y].map(|degrees| f64::from(degrees).to_radians());
            (middle + tangents.column(0) * x + tangents.column(1) * y).normalize()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::rotation;

    /// `camera_from_world` of a camera that looks at the middle of the floor from `azimuth`, rolled; y is up.
    fn camera(azimuth: f64, pitch: f64, roll_deg: f64) -> Matrix3<f64> {
        let turned = rotation::exp(&Vector3::new(pitch, 0.0, 0.0)) * rotation::exp(&Vector3::new(0.0, azimuth, 0.0));
        let level = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0)) * turned;
        rotation::exp(&Vector3::new(0.0, 0.0, roll_deg.to_radians())) * level
    }

    fn evidence(n_cameras: usize, rolls_deg: [f64; 5], axis: Vector3<f64>) -> UpEvidence {
        let azimuth = |k: usize| 0.3 + TAU * k as f64 / n_cameras as f64;
        let cameras = (0..n_cameras).map(|k| camera(azimuth(k), 0.2 + 0.02 * k as f64, rolls_deg[k])).collect();
        UpEvidence { cameras, bodies: vec![vec![axis.normalize(); 20]] }
    }

    const LEVEL: [f64; 5] = [0.5, -1.0, 1.0, 0.0, -0.5];

    fn off_deg(up: &UpDirection) -> f64 {
        up.direction.angle(&Vector3::y()).to_degrees()
    }

    #[test]
    fn cameras_of_the_test_look_down_and_stand_upright() {
        let seen = camera(1.0, 0.2, 0.0) * Vector3::y();
        assert!(seen.y < -0.9 && seen.z < 0.0 && seen.x.abs() < 1e-12, "{seen}");
    }

    /// People on a mat made its floor a wall.
    #[test]
    fn level_cameras_show_the_way_up_beside_people_who_lie() {
        for axis in [Vector3::x(), Vector3::new(0.6, 0.2, 0.8), Vector3::new(-1.0, 1.0, 0.0)] {
            let up = evidence(5, LEVEL, axis).likeliest();
            assert!(off_deg(&up) < 2.5, "{up:?}");
            assert!(up.rival.unwrap().ratio > 20.0, "{up:?}");
        }
    }

    #[test]
    fn upright_people_show_it_however_cameras_are_mounted() {
        for rolls in [[13.0, -37.0, 160.0, 80.0, -120.0], [90.0; 5], [180.0, 179.0, 181.0, 178.0, 182.0]] {
            for n_cameras in [2, 5] {
                let up = evidence(n_cameras, rolls, Vector3::new(0.05, 1.0, -0.05)).likeliest();
                assert!(off_deg(&up) < 15.0, "{n_cameras} cameras: {up:?}");
                assert!(up.rival.unwrap().ratio > 2.0, "{n_cameras} cameras: {up:?}");
            }
        }
    }

    #[test]
    fn two_cameras_leave_it_open_whether_people_lie() {
        let up = evidence(2, LEVEL, Vector3::x()).likeliest();
        assert!(up.rival.unwrap().ratio < 7.0, "{up:?}");
        let up = evidence(2, LEVEL, Vector3::y()).likeliest();
        assert!(off_deg(&up) < 3.0 && up.rival.unwrap().ratio > 20.0, "{up:?}");
    }

    #[test]
    fn its_spread_falls_with_the_number_of_cameras() {
        let spread = |n| evidence(n, LEVEL, Vector3::y()).likeliest().covariance.trace().sqrt().to_degrees();
        assert!(spread(5) < 6.0 && spread(5) < spread(2), "{} {}", spread(2), spread(5));
    }
}
