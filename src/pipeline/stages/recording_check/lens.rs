//! A camera's focal length by resection: people's points fit best under one focal length, with its own pose.
//!
//! The points are those of all cameras, so the result is a start for an adjustment of all, not a measurement. An adjustment alone
//! reaches a focal length that is 20 % off after hundreds of steps, since focal length and distance trade against each other.

use crate::body::detector_profile::DETECTOR;
use crate::estimation::pnp::refine_pose;
use crate::geometry::Rigid;
use crate::geometry::p3p::PointCorrespondence;
use crate::geometry::projection::project_normalized;
use crate::optim::robust::geman_mcclure_rho;
use crate::pipeline::calibration::TrackedPeople;
use nalgebra::{Vector2, Vector3};

/// Logarithms of the focal factors that are tried: `-N_STEPS..=N_STEPS` times `STEP`.
const STEP: f64 = 0.1;
const N_STEPS: i32 = 7;
/// Points of a resection, evenly over all.
const MAX_POINTS: usize = 500;
const MIN_POINTS: usize = 60;
/// Reprojection error from which a point hardly counts, rad under the given focal length: 10 px at 1,060 px.
const TOLERANCE: f64 = 0.01;
const ITERATIONS: usize = 12;
/// The cost must fall to this share of that of the given focal length: else the given one is the better start.
const BETTER: f64 = 0.95;

/// A focal length and the pose that goes with it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lens {
    /// Factor on the given focal length.
    pub factor: f64,
    /// Pose of the camera.
    pub camera_from_world: Rigid,
}

/// The focal length under which the camera shows the people best; `None` where the given one is as good.
pub fn resected(people: &TrackedPeople, view: usize) -> Option<Lens> {
    let camera = people.cameras[view].as_ref()?;
    let points = points(people, view);
    if points.len() < MIN_POINTS {
        return None;
    }
    let given = fit(people, view, camera, &points, 0);
    let mut best = (0, given);
    for direction in [-1, 1] {
        let mut pose = given.0;
        for step in 1..=N_STEPS {
            let found = fit(people, view, &pose, &points, direction * step);
            pose = found.0;
            if found.1 < best.1.1 {
                best = (direction * step, found);
            }
        }
    }
    let (step, (camera_from_world, cost)) = best;
    (cost < BETTER * given.1).then(|| Lens { factor: factor(step), camera_from_world })
}

fn factor(step: i32) -> f64 {
    (f64::from(step) * STEP).exp()
}

/// Points in space with their pixels.
fn points(people: &TrackedPeople, view: usize) -> Vec<(Vector3<f64>, Vector2<f64>)> {
    let mut found = Vec::new();
    for (_, points, detection) in people.seen_by(view) {
        let seen = points.iter().zip(&detection.keypoints);
        let confident = seen.filter(|(_, k)| k.confidence > DETECTOR.confident);
        found.extend(confident.filter_map(|(point, k)| Some(((*point)?, k.pixel))));
    }
    let stride = found.len().div_ceil(MAX_POINTS).max(1);
    found.into_iter().step_by(stride).collect()
}

/// The pose under a focal length, and the robust cost in squared angles under the given one.
fn fit(
    people: &TrackedPeople,
    view: usize,
    start: &Rigid,
    points: &[(Vector3<f64>, Vector2<f64>)],
    step: i32,
) -> (Rigid, f64) {
    let factor = factor(step);
    let lens = people.session.views[view].intrinsics.with_focal_factor(factor);
    let seen: Vec<PointCorrespondence> =
        points.iter().map(|(x, pixel)| (*x, lens.normalized_from_pixel(pixel))).collect();
    let threshold = TOLERANCE / factor;
    let pose = refine_pose(start, &seen, threshold, ITERATIONS);
    let squared = |(x, at): &PointCorrespondence| {
        project_normalized(&pose, x).map_or(f64::INFINITY, |p| (p.normalized - at).norm_squared())
    };
    let scale2 = threshold * threshold;
    let rho = |squared: f64| if squared.is_finite() { geman_mcclure_rho(squared, scale2) } else { scale2 };
    (pose, factor * factor * seen.iter().map(|point| rho(squared(point))).sum::<f64>())
}
