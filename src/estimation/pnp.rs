//! A camera's pose from known points with many outliers.

use super::consensus::{ConsensusProblem, find_consensus};
use crate::geometry::p3p::{PointCorrespondence, p3p};
use crate::geometry::projection::by_left_increment;
use crate::geometry::{Distortion, Intrinsics, Rigid};
use crate::optim::dense_levenberg_marquardt::{QuadraticModel, descend};
use crate::optim::robust::{geman_mcclure_rho, geman_mcclure_weight};
use nalgebra::{SVector, Vector2};

/// An estimated camera pose, with its inliers.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseEstimate {
    /// The pose, in the points' unit of length.
    pub camera_from_world: Rigid,
    /// `sum max(0, 1 - d^2 / threshold^2)`, d the reprojection error.
    pub support: f64,
    /// Which points are in front of the camera and within the threshold of their reprojection.
    pub inliers: Vec<bool>,
    /// Share of inliers.
    pub inlier_ratio: f64,
}

/// Linearisations of the re-fit of a new best model, and of the final one.
const REFIT_ITERATIONS: usize = 4;
const FINAL_ITERATIONS: usize = 15;

/// The camera whose pixels are normalised coordinates.
const NORMALIZED_CAMERA: Intrinsics =
    Intrinsics { width: 0, height: 0, fx: 1.0, fy: 1.0, cx: 0.0, cy: 0.0, skew: 0.0, dist: Distortion::None };

/// Finds the camera pose that most points agree with: three-point samples, soft score, re-fits.
///
/// `points`: world position and ideal normalised coordinates. `threshold`: reprojection error at which a point's
/// gain reaches zero, normalised (px / focal). `iterations`: most samples drawn.
///
/// `None` with fewer than four points (three leave up to four poses) or fewer than four inliers. Known limit: distant
/// coplanar points have two nearly equal solutions.
pub fn estimate_pose(
    points: &[PointCorrespondence],
    threshold: f64,
    iterations: usize,
    seed: u64,
) -> Option<PoseEstimate> {
    let problem = ConsensusProblem { n_data: points.len(), weights: None, threshold, iterations, seed };
    let found = find_consensus(
        &problem,
        |sample| p3p(&sample.map(|i| points[i])),
        |pose, i| squared_reprojection(pose, &points[i]),
        |pose| refine_pose(pose, points, threshold, REFIT_ITERATIONS),
    )?;
    let refined = refine_pose(&found.model, points, threshold, FINAL_ITERATIONS);
    // The descent minimises a smooth robust cost, not the score; of two nearly equal poses the score decides.
    let (before, after) = (score_pose(&found.model, points, threshold), score_pose(&refined, points, threshold));
    let best = if after.support >= before.support { after } else { before };
    (best.inliers.iter().filter(|&&inlier| inlier).count() >= 4).then_some(best)
}

/// Scores a pose on points.
pub fn score_pose(camera_from_world: &Rigid, points: &[PointCorrespondence], threshold: f64) -> PoseEstimate {
    let gain =
        |point: &PointCorrespondence| 1.0 - squared_reprojection(camera_from_world, point) / (threshold * threshold);
    let gains: Vec<f64> = points.iter().map(gain).collect();
    let inliers: Vec<bool> = gains.iter().map(|g| *g > 0.0).collect();
    let n_inliers = inliers.iter().filter(|&&inlier| inlier).count();
    PoseEstimate {
        camera_from_world: *camera_from_world,
        support: gains.iter().map(|g| g.max(0.0)).sum(),
        inlier_ratio: n_inliers as f64 / points.len().max(1) as f64,
        inliers,
    }
}

/// Refines a pose on points: the Geman-McClure loss of reprojection errors, with `threshold` as its scale.
///
/// Points behind the camera have the cost of an outlier and no gradient. The cost never rises; the start is returned
/// where no step improves it.
pub fn refine_pose(start: &Rigid, points: &[PointCorrespondence], threshold: f64, iterations: usize) -> Rigid {
    let retract = |pose: &Rigid, step: &SVector<f64, 6>| {
        pose.perturbed_left(&step.fixed_rows::<3>(0).into_owned(), &step.fixed_rows::<3>(3).into_owned())
    };
    descend(*start, iterations, |pose| Some(linearize(pose, points, threshold * threshold)), retract)
}

fn squared_reprojection(camera_from_world: &Rigid, (point, seen): &PointCorrespondence) -> f64 {
    let projected = NORMALIZED_CAMERA.pixel_from_camera(&camera_from_world.transform(point));
    projected.map_or(f64::INFINITY, |p: Vector2<f64>| (p - seen).norm_squared())
}

fn linearize(camera_from_world: &Rigid, points: &[PointCorrespondence], scale2: f64) -> QuadraticModel<6> {
    let mut model = QuadraticModel::zeros();
    for (point, seen) in points {
        let in_camera = camera_from_world.transform(point);
        let Some((projected, by_point)) = NORMALIZED_CAMERA.project_with_jacobian(&in_camera) else {
            model.cost += scale2;
            continue;
        };
        let residual = projected - seen;
        let squared = residual.norm_squared();
        if !squared.is_finite() {
            continue; // a point that is not finite would stop the descent for all others
        }
        let by_pose = by_left_increment(&by_point, &in_camera);
        let weight = geman_mcclure_weight(squared, scale2);
        model.cost += geman_mcclure_rho(squared, scale2);
        for axis in 0..2 {
            model.add(residual[axis], &by_pose.row(axis).transpose(), weight, 0.0);
        }
    }
    model
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::rotation;
    use nalgebra::Vector3;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, Normal};

    fn scene(seed: u64, n: usize, noise: f64, outliers: f64) -> (Rigid, Vec<PointCorrespondence>) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let normal = Normal::new(0.0, noise).unwrap();
        let mut random = || Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0));
        let pose = Rigid { rotation: rotation::exp(&(random() * 2.0)), translation: random() + Vector3::z() * 5.0 };
        let points = (0..n)
            .map(|_| {
                let point = Vector3::from_fn(|_, _| rng.random_range(-1.5..1.5));
                let seen = pose.transform(&point);
                let exact = (seen.xy() / seen.z).map(|c| c + normal.sample(&mut rng));
                let wrong = Vector2::from_fn(|_, _| rng.random_range(-0.5..0.5));
                (point, if rng.random_bool(outliers) { wrong } else { exact })
            })
            .collect();
        (pose, points)
    }

    fn center_error(found: &Rigid, truth: &Rigid) -> f64 {
        (found.center() - truth.center()).norm()
    }

    #[test]
    fn finds_the_pose_among_four_of_ten_outliers() {
        for seed in 0..30 {
            let (truth, points) = scene(seed, 100, 0.002, 0.4);
            let found = estimate_pose(&points, 0.01, 100, seed).unwrap();
            // 60 points, 2 mrad at 5 m: some 10 mm / 0.05 degrees expected; five times that is far above the noise.
            assert!(center_error(&found.camera_from_world, &truth) < 0.05, "{seed}");
            let angle = rotation::angle_between(&found.camera_from_world.rotation, &truth.rotation);
            assert!(angle.to_degrees() < 0.4, "{seed}: {}", angle.to_degrees());
            assert!((0.45..0.75).contains(&found.inlier_ratio), "{seed}: {}", found.inlier_ratio);
        }
    }

    #[test]
    fn exact_points_give_the_exact_pose() {
        let (truth, points) = scene(50, 30, 0.0, 0.0);
        let found = estimate_pose(&points, 0.01, 20, 0).unwrap();
        assert!(center_error(&found.camera_from_world, &truth) < 1e-9);
        assert!(found.inliers.iter().all(|&inlier| inlier) && found.support > 30.0 - 1e-9);
    }

    #[test]
    fn refinement_converges_from_a_distant_start() {
        let (truth, points) = scene(51, 40, 0.0, 0.0);
        let start = truth.perturbed_left(&Vector3::new(0.2, -0.2, 0.3), &Vector3::new(0.1, -0.1, 0.1));
        let refined = refine_pose(&start, &points, 0.2, 40);
        assert!(center_error(&refined, &truth) < 1e-8, "{}", center_error(&refined, &truth));
    }

    #[test]
    fn the_gradient_agrees_with_central_differences() {
        let (truth, points) = scene(52, 20, 0.01, 0.2);
        let scale2 = 0.02 * 0.02;
        let model = linearize(&truth, &points, scale2);
        let step = 1e-6;
        for k in 0..6 {
            let moved = |sign: f64| {
                let mut d = SVector::<f64, 6>::zeros();
                d[k] = sign * step;
                let (rho, phi) = (d.fixed_rows::<3>(0).into_owned(), d.fixed_rows::<3>(3).into_owned());
                linearize(&truth.perturbed_left(&rho, &phi), &points, scale2).cost
            };
            let half_slope = (moved(1.0) - moved(-1.0)) / (4.0 * step);
            assert!((half_slope - model.gradient[k]).abs() < 1e-7 * (1.0 + model.gradient.norm()), "{k}");
        }
    }

    #[test]
    fn degenerate_input_gives_none() {
        let (_, points) = scene(53, 3, 0.0, 0.0);
        assert_eq!(estimate_pose(&points, 0.01, 20, 0), None);
        assert_eq!(estimate_pose(&[], 0.01, 20, 0), None);
        assert_eq!(estimate_pose(&[points[0]; 20], 0.01, 20, 0), None);
        assert_eq!(estimate_pose(&[(Vector3::repeat(f64::NAN), Vector2::zeros()); 20], 0.01, 20, 0), None);
    }
}
