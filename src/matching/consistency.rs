//! How well detections agree with each other (geometry) and with where a person should be (physics), in noise units.
//!
//! The paper's two costs, Huang et al. 2021 Sec. 3.2: distance of two rays, and of a ray to the person's joint, as
//! affinities. Printed, the first is blind for nearly parallel rays: here it is the true gap. Both are divided by what
//! the detector's noise makes them, not by metres of one scene: `A = 1 - mean e^2 / (e^2 + s^2)`.

use super::sightings::Sighting;
use crate::body::detector_noise::DetectorNoise;
use crate::geometry::Rigid;
use crate::geometry::epipolar::{Ray, ray_ray_distance};
use nalgebra::Vector3;

/// Standard deviations beyond which a keypoint is more likely wrong than noisy.
const SOFT_SIGMAS: f64 = 3.0;

/// Keypoints that must be shared before an affinity says anything, and the number below which what is missing counts as
/// disagreement: two joints that fit are some evidence, four are enough.
const MIN_SHARED: usize = 2;
const ENOUGH_SHARED: usize = 4;

/// Keypoints below this confidence have no say.
const MIN_CONFIDENCE: f64 = 0.2;

/// Weights of geometry and physics in the affinity of two detections (Huang et al. 2021).
pub const GEOMETRY_WEIGHT: f64 = 0.7;
/// See [`GEOMETRY_WEIGHT`].
pub const PHYSICS_WEIGHT: f64 = 0.3;

/// Which of a detection's keypoints stands for each keypoint of the body.
pub type Order = [usize];

/// A detection by a placed camera.
#[derive(Debug, Clone, Copy)]
pub struct Seen<'a> {
    /// `camera_from_world`, m.
    pub camera: &'a Rigid,
    /// What was seen.
    pub sighting: &'a Sighting,
}

/// Distance of keypoint `from` to the projection of `point`, where the body has `keypoint`, in standard deviations; `None`
/// where it is not seen, too doubtful, or the point lies behind the camera.
pub fn misfit(seen: Seen, from: usize, point: &Vector3<f64>, noise: &DetectorNoise, keypoint: usize) -> Option<f64> {
    let confidence = seen.sighting.confidence[from];
    if confidence < MIN_CONFIDENCE {
        return None;
    }
    let x = seen.camera.transform(point);
    let depth = (x.z > 0.1).then_some(x.z)?;
    let offset = (x.xy() / depth - seen.sighting.bearings[from]).norm();
    Some(offset * depth / noise.sigma_m(keypoint, confidence))
}

/// Agreement of a detection with a person's expected points, 0 to 1; `None` where too little is shared.
pub fn physics_affinity(
    seen: Seen,
    points: &[Option<Vector3<f64>>],
    noise: &DetectorNoise,
    order: &Order,
) -> Option<f64> {
    let misfits = order.iter().zip(points).enumerate();
    affinity(misfits.filter_map(|(k, (&from, point))| misfit(seen, from, point.as_ref()?, noise, k)))
}

/// Agreement of two detections of different views: gaps between the rays of equal keypoints, 0 to 1.
pub fn geometry_affinity(one: Seen, other: Seen, noise: &DetectorNoise) -> Option<f64> {
    let gap = |k: usize| {
        let confidences = [one, other].map(|s| s.sighting.confidence[k]);
        if confidences.iter().any(|c| *c < MIN_CONFIDENCE) {
            return None;
        }
        let [a, b] = [one, other].map(|s| Ray::through(s.camera, &s.sighting.bearings[k]));
        // Both rays are uncertain, in the one direction across both of them.
        let [sigma_a, sigma_b] = confidences.map(|c| noise.sigma_m(k, c));
        Some(ray_ray_distance(&a, &b) / sigma_a.hypot(sigma_b))
    };
    affinity((0..noise.sigmas_m().len()).filter_map(gap))
}

fn affinity(misfits: impl Iterator<Item = f64>) -> Option<f64> {
    let (mut n, mut sum) = (0, 0.0);
    for e in misfits {
        n += 1;
        sum += SOFT_SIGMAS * SOFT_SIGMAS / (e * e + SOFT_SIGMAS * SOFT_SIGMAS);
    }
    (n >= MIN_SHARED).then(|| sum / n.max(ENOUGH_SHARED) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::skeleton::KeypointConvention;
    use crate::geometry::rotation;
    use nalgebra::Vector2;

    fn camera(angle: f64) -> Rigid {
        let rotation = rotation::exp(&(Vector3::y() * angle));
        Rigid { rotation, translation: Vector3::new(0.0, 0.0, 4.0) }
    }

    fn seen_by(camera: &Rigid, points: &[Vector3<f64>]) -> Sighting {
        let bearing = |p: &Vector3<f64>| {
            let x = camera.transform(p);
            Vector2::new(x.x / x.z, x.y / x.z)
        };
        let bearings = points.iter().map(bearing).collect();
        Sighting { bearings, confidence: vec![1.0; points.len()], size: 0.4, track_id: None }
    }

    #[test]
    fn the_same_person_agrees_and_a_neighbour_does_not() {
        let person: Vec<_> =
            (0..17).map(|k| Vector3::new(0.1 * (k % 3) as f64, 0.15 * k as f64, 0.05 * k as f64)).collect();
        let neighbour: Vec<_> = person.iter().map(|p| p + Vector3::new(0.6, 0.3, 0.2)).collect();
        let (first, second) = (camera(0.0), camera(1.2));
        let sigmas = DetectorNoise::published(KeypointConvention::Coco17);
        let [a, b, c] = [seen_by(&first, &person), seen_by(&second, &person), seen_by(&second, &neighbour)];
        let [a, b, c] =
            [(&first, &a), (&second, &b), (&second, &c)].map(|(camera, sighting)| Seen { camera, sighting });
        assert!(geometry_affinity(a, b, &sigmas).unwrap() > 0.99 && geometry_affinity(a, c, &sigmas).unwrap() < 0.3);
        let expected: Vec<_> = person.iter().copied().map(Some).collect();
        let order: Vec<usize> = (0..17).collect();
        assert!(physics_affinity(b, &expected, &sigmas, &order).unwrap() > 0.99);
        assert!(physics_affinity(c, &expected, &sigmas, &order).unwrap() < 0.1);
        assert!((physics_affinity(b, &expected[..3], &sigmas, &order).unwrap() - 0.75).abs() < 0.01);
        assert!(physics_affinity(b, &expected[..1], &sigmas, &order).is_none());
    }
}
