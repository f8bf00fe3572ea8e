//! A camera's focal length by resection: people's points fit best under one focal length, with its own pose.
//!
//! The points rest on the other cameras as they are, so the result is a start for an adjustment of all, not a measurement. An adjustment alone
//! reaches a focal length that is 20 % off after hundreds of steps, since focal length and distance trade against each other.

use crate::body::detector_profile::DETECTOR;
use crate::estimation::pnp::refine_pose;
use crate::estimation::triangulation::triangulate_reweighted;
use crate::geometry::p3p::PointCorrespondence;
use crate::geometry::projection::project_normalized;
use crate::geometry::triangulation::PointObservation;
use crate::geometry::{Intrinsics, Rigid};
use crate::optim::robust::geman_mcclure_rho;
use crate::pipeline::calibration::TrackedPeople;
use crate::session::View;
use nalgebra::{Vector2, Vector3};

/// Logarithms of the focal factors that are tried: `-N_STEPS..=N_STEPS` times `STEP`.
const STEP: f64 = 0.1;
const N_STEPS: i32 = 7;
/// Difference of logarithms between the factors on `fy / fx` that are tried, and their largest number: formats with pixels that are not
/// square are 7, 9 and 33 % wide.
const ASPECT_STEP: f64 = 0.05;
const MAX_ASPECT_STEPS: f64 = 7.0;
/// Points of a resection, evenly over all.
const MAX_POINTS: usize = 500;
const MIN_POINTS: usize = 60;
/// Reprojection error from which a point hardly counts, rad under the given focal length: 10 px at 1,060 px.
const TOLERANCE: f64 = 0.01;
const ITERATIONS: usize = 12;
/// Residual of a ray, m, from which it hardly counts in a point: three times a detector's noise.
const ROBUST_SCALE_M: f64 = 0.1;
/// The cost must fall to this share of that of the given focal length: else the given one is the better start.
const BETTER: f64 = 0.95;

/// A focal length and the pose that goes with it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lens {
    /// Factor on the given focal length.
    pub factor: f64,
    /// Pose of the camera.
    pub camera_from_world: Rigid,
    /// Robust cost, squared angles under the given focal length.
    pub cost: f64,
}

/// A camera beside the people's points in space, as the other cameras locate them.
pub struct SeenPeople {
    lens: Intrinsics,
    camera_from_world: Rigid,
    points: Vec<(Vector3<f64>, Vector2<f64>)>,
}

impl SeenPeople {
    /// `None` for a camera that has no place or sees too few points.
    pub fn of(people: &TrackedPeople, view: usize) -> Option<Self> {
        let camera_from_world = people.cameras[view]?;
        let points = points(people, view);
        let lens = people.session.views[view].intrinsics;
        (points.len() >= MIN_POINTS).then_some(Self { lens, camera_from_world, points })
    }

    /// The focal length under which the camera shows the people best; `None` where the given one is as good.
    pub fn resected(&self) -> Option<Lens> {
        let given = fit(&self.lens, 1.0, &self.camera_from_world, &self.points);
        let mut best = (0, given);
        for direction in [-1, 1] {
            let mut pose = given.0;
            for step in 1..=N_STEPS {
                let factor = factor(direction * step);
                let found = fit(&self.lens.with_focal_factor(factor), factor, &pose, &self.points);
                pose = found.0;
                if found.1 < best.1.1 {
                    best = (direction * step, found);
                }
            }
        }
        let (step, (camera_from_world, cost)) = best;
        (cost < BETTER * given.1).then(|| Lens { factor: factor(step), camera_from_world, cost })
    }

    /// The factor on `fy / fx` under which the camera shows the people best: downhill from the given one step by step, then the lowest
    /// point of the parabola through the last three costs.
    pub fn likeliest_aspect(&self) -> f64 {
        let cost = |step: f64| self.under_lens(&self.lens.with_aspect_factor((step * ASPECT_STEP).exp())).1;
        let (mut at, mut sides) = (0.0, [cost(-1.0), cost(1.0)]);
        let mut own = cost(0.0);
        let direction = if sides[0] < sides[1] { -1.0 } else { 1.0 };
        while sides[0].min(sides[1]) < own && f64::abs(at) < MAX_ASPECT_STEPS {
            at += direction;
            let next = cost(at + direction);
            let lowest = sides[0].min(sides[1]);
            sides = if direction < 0.0 { [next, own] } else { [own, next] };
            own = lowest;
        }
        let curvature = sides[0] - 2.0 * own + sides[1];
        let off = if curvature > 0.0 { (0.5 * (sides[0] - sides[1]) / curvature).clamp(-1.0, 1.0) } else { 0.0 };
        ((at + off) * ASPECT_STEP).exp()
    }

    /// The pose of the camera under another lens, and its robust cost, squared angles under the given focal length.
    pub fn under_lens(&self, lens: &Intrinsics) -> (Rigid, f64) {
        fit(lens, lens.focal() / self.lens.focal(), &self.camera_from_world, &self.points)
    }
}

fn factor(step: i32) -> f64 {
    (f64::from(step) * STEP).exp()
}

/// Points in space, as the other cameras locate them, with their pixels: points that the camera itself takes part in would follow
/// its lens.
fn points(people: &TrackedPeople, view: usize) -> Vec<(Vector3<f64>, Vector2<f64>)> {
    let (mut seen, n_named) = (Vec::new(), people.session.convention.names().len());
    for (track, tracked) in people.tracks.iter().enumerate() {
        for (t, assigned) in tracked.detections.iter().enumerate() {
            let detection = assigned[view].and_then(|d| people.session.views[view].frames[tracked.first.0 + t].get(d));
            let keypoints = detection.iter().flat_map(|detection| detection.keypoints[..n_named].iter().enumerate());
            let confident = keypoints.filter(|(_, k)| k.confidence > DETECTOR.confident);
            seen.extend(confident.map(|(k, keypoint)| (track, t, k, keypoint.pixel)));
        }
    }
    let stride = seen.len().div_ceil(MAX_POINTS).max(1);
    let located = seen.into_iter().step_by(stride);
    located.filter_map(|(track, t, k, pixel)| Some((by_others(people, view, track, t, k)?, pixel))).collect()
}

/// A person's keypoint from the cameras other than `view`; `None` with fewer than two.
fn by_others(people: &TrackedPeople, view: usize, track: usize, t: usize, keypoint: usize) -> Option<Vector3<f64>> {
    let tracked = &people.tracks[track];
    let ray = |(other, assigned): (usize, &Option<usize>)| {
        let camera_from_world = people.cameras[other].as_ref().filter(|_| other != view)?;
        let View { frames, intrinsics, .. } = &people.session.views[other];
        let seen = frames[tracked.first.0 + t].get((*assigned)?)?.keypoints[keypoint];
        let normalized = intrinsics.normalized_from_pixel(&seen.pixel);
        (seen.confidence > DETECTOR.judged).then_some(PointObservation { camera_from_world, normalized, weight: 1.0 })
    };
    let rays: Vec<PointObservation> = tracked.detections[t].iter().enumerate().filter_map(ray).collect();
    triangulate_reweighted(&rays, ROBUST_SCALE_M)
}

/// The pose under a lens whose focal length is `factor` times the given one, and the robust cost in squared angles under that.
fn fit(lens: &Intrinsics, factor: f64, start: &Rigid, points: &[(Vector3<f64>, Vector2<f64>)]) -> (Rigid, f64) {
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
