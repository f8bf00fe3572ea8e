//! Affinities of detections with each other (geometry) and with a predicted person (physics).
//!
//! The two costs of Huang et al. 2021, Sec. 3.2, as affinities: the distance of two rays, and of a ray to the person's joint.
//! The published form of the first vanishes for nearly parallel rays; here it is the distance of the lines. Both are divided
//! by their standard deviations under the detector's noise: `A = 1 - mean e^2 / (e^2 + s^2)`.

use super::normalized::NormalizedDetection;
use crate::body::detector_noise::DetectorNoise;
use crate::body::detector_profile::DETECTOR;
use crate::geometry::Rigid;
use crate::geometry::epipolar::{PluckerRay, ray_ray_distance};
use crate::geometry::projection::NormalizedProjection;
use crate::optim::robust::OUTLIER_SIGMAS;

/// Fewest shared keypoints for an affinity, and the number below which missing keypoints count as disagreement: two
/// joints that fit are weak evidence, four are enough.
const MIN_SHARED: usize = 2;
const ENOUGH_SHARED: usize = 4;

/// Weights of geometry and physics in the affinity of two detections (Huang et al. 2021).
pub const GEOMETRY_WEIGHT: f64 = 0.7;
/// See [`GEOMETRY_WEIGHT`].
pub const PHYSICS_WEIGHT: f64 = 0.3;

/// For each keypoint of the body the keypoint of a detection that shows it.
pub type Order = [usize];

/// A detection with its camera's pose and the noise of its keypoints.
#[derive(Debug, Clone)]
pub struct PosedDetection<'a> {
    /// `camera_from_world`, m.
    pub camera: &'a Rigid,
    /// The detection.
    pub detection: &'a NormalizedDetection,
    /// Noise of each keypoint over that of a keypoint of full confidence ($f(c)$); `None` for keypoints of too low
    /// confidence.
    factors: Vec<Option<f64>>,
}

impl<'a> PosedDetection<'a> {
    /// `noise`: standard deviations of the detector.
    pub fn new(camera: &'a Rigid, detection: &'a NormalizedDetection, noise: &DetectorNoise) -> Self {
        let factor = |c: &f64| (*c >= DETECTOR.comparable).then(|| noise.factor(*c));
        Self { camera, detection, factors: detection.confidence.iter().map(factor).collect() }
    }
}

/// Agreement of a detection with an expectation.
#[derive(Debug, Clone, Copy, Default)]
pub struct Agreement {
    /// Affinity, 0 to 1.
    pub affinity: f64,
    /// Number of compared keypoints.
    pub n_shared: usize,
}

/// Squared distance of keypoint `from` from the expected position of the body's `keypoint`, in variances; `None` where it
/// is missing or of too low confidence.
pub fn squared_misfit(
    seen: &PosedDetection,
    from: usize,
    expected: &NormalizedProjection,
    noise: &DetectorNoise,
    keypoint: usize,
) -> Option<f64> {
    let sigma_m = noise.sigmas_m()[keypoint] * seen.factors[from]?;
    let offset = (expected.normalized - seen.detection.normalized[from]) * (expected.depth / sigma_m);
    Some(offset.norm_squared())
}

/// Agreement of a detection with a person's expected points; `None` with too few shared keypoints.
pub fn physics_affinity(
    seen: &PosedDetection,
    expected: &[Option<NormalizedProjection>],
    noise: &DetectorNoise,
    order: &Order,
) -> Option<Agreement> {
    let misfits = order.iter().zip(expected).enumerate();
    agreement(misfits.filter_map(|(k, (&from, point))| squared_misfit(seen, from, point.as_ref()?, noise, k)))
}

/// Agreement of two detections of different views: gaps between the rays of equal keypoints, 0 to 1.
pub fn geometry_affinity(one: &PosedDetection, other: &PosedDetection, noise: &DetectorNoise) -> Option<f64> {
    let gap = |(k, sigma_m): (usize, &f64)| {
        let [factor_a, factor_b] = [one.factors[k]?, other.factors[k]?];
        let [a, b] = [one, other].map(|s| PluckerRay::through(s.camera, &s.detection.normalized[k]));
        // Both rays are uncertain in the one direction perpendicular to both.
        let gap = ray_ray_distance(&a, &b) / (sigma_m * factor_a.hypot(factor_b));
        Some(gap * gap)
    };
    agreement(noise.sigmas_m().iter().enumerate().filter_map(gap)).map(|agreement| agreement.affinity)
}

fn agreement(squared_misfits: impl Iterator<Item = f64>) -> Option<Agreement> {
    const SOFT: f64 = OUTLIER_SIGMAS * OUTLIER_SIGMAS;
    let (n_shared, sum) = squared_misfits.fold((0, 0.0), |(n, sum), e2| (n + 1, sum + SOFT / (e2 + SOFT)));
    (n_shared >= MIN_SHARED).then(|| Agreement { affinity: sum / n_shared.max(ENOUGH_SHARED) as f64, n_shared })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::skeleton::KeypointConvention;
    use crate::geometry::projection::project_normalized;
    use crate::geometry::rotation;
    use nalgebra::{Vector2, Vector3};

    fn camera(angle: f64) -> Rigid {
        let rotation = rotation::exp(&(Vector3::y() * angle));
        Rigid { rotation, translation: Vector3::new(0.0, 0.0, 4.0) }
    }

    fn seen_by(camera: &Rigid, points: &[Vector3<f64>]) -> NormalizedDetection {
        let normalized = |p: &Vector3<f64>| {
            let x = camera.transform(p);
            Vector2::new(x.x / x.z, x.y / x.z)
        };
        NormalizedDetection::of_points(points.iter().map(normalized).collect(), 0.4)
    }

    #[test]
    fn only_detections_of_the_same_person_agree() {
        let person: Vec<_> =
            (0..17).map(|k| Vector3::new(0.1 * (k % 3) as f64, 0.15 * k as f64, 0.05 * k as f64)).collect();
        let neighbour: Vec<_> = person.iter().map(|p| p + Vector3::new(0.6, 0.3, 0.2)).collect();
        let (first, second) = (camera(0.0), camera(1.2));
        let noise = DetectorNoise::published(KeypointConvention::Coco17);
        let [a, b, c] = [seen_by(&first, &person), seen_by(&second, &person), seen_by(&second, &neighbour)];
        let [a, b, c] = [(&first, &a), (&second, &b), (&second, &c)]
            .map(|(camera, detection)| PosedDetection::new(camera, detection, &noise));
        let geometry = |one, other| geometry_affinity(one, other, &noise).unwrap();
        assert!(geometry(&a, &b) > 0.99 && geometry(&a, &c) < 0.3);
        let expected: Vec<_> = person.iter().map(|point| project_normalized(&second, point)).collect();
        let order: Vec<usize> = (0..17).collect();
        let physics = |seen, n: usize| physics_affinity(seen, &expected[..n], &noise, &order);
        let whole = physics(&b, 17).unwrap();
        assert!(whole.affinity > 0.99 && whole.n_shared == 17);
        assert!(physics(&c, 17).unwrap().affinity < 0.1);
        assert!((physics(&b, 3).unwrap().affinity - 0.75).abs() < 0.01);
        assert!(physics(&b, 1).is_none());
    }
}
