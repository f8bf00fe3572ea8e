use super::*;
use crate::geometry::rotation;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

const SIGMA_PX: f64 = 3.0;

struct Rig {
    cameras: Vec<Rigid>,
    intrinsics: Intrinsics,
}

/// Cameras on a circle of 5 m that look at its middle, with a little distortion.
fn rig(n: usize) -> Rig {
    let turn = |i: usize| rotation::exp(&(Vector3::y() * (i as f64 * std::f64::consts::TAU / n as f64)));
    let intrinsics = Intrinsics {
        width: 1920,
        height: 1080,
        fx: 1100.0,
        fy: 1090.0,
        cx: 950.0,
        cy: 545.0,
        skew: 0.0,
        dist: [-0.1, 0.03, 0.001, -0.0005, 0.0].into(),
    };
    let cameras = (0..n).map(|i| Rigid { rotation: turn(i), translation: Vector3::z() * 5.0 }).collect();
    Rig { cameras, intrinsics }
}

impl Rig {
    fn observe(&self, point: &Vector3<f64>, mut jitter_px: impl FnMut() -> f64) -> Vec<RayObservation<'_>> {
        let mut see = |camera: &'_ Rigid| {
            let pixel = self.intrinsics.pixel_from_camera(&camera.transform(point)).unwrap();
            pixel + Vector2::new(jitter_px(), jitter_px())
        };
        let pixels: Vec<_> = self.cameras.iter().map(&mut see).collect();
        let observation = |(camera_from_world, pixel)| RayObservation {
            camera_from_world,
            intrinsics: &self.intrinsics,
            pixel,
            sigma_px: SIGMA_PX,
        };
        self.cameras.iter().zip(pixels).map(observation).collect()
    }
}

fn random_point(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0))
}

#[test]
fn exact_observations_give_the_exact_point() {
    let rig = rig(5);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for _ in 0..50 {
        let point = random_point(&mut rng);
        let found = triangulate_robust(&rig.observe(&point, || 0.0)).unwrap();
        assert!((found.point - point).norm() < 1e-9);
        assert!(found.cost < 1e-12 && found.inliers == vec![true; 5]);
    }
}

#[test]
fn gross_errors_in_two_of_five_views_are_found_and_left_out() {
    let rig = rig(5);
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let normal = Normal::new(0.0, SIGMA_PX).unwrap();
    let mut right = 0;
    for trial in 0..300 {
        let point = random_point(&mut rng);
        let mut seen = rig.observe(&point, || normal.sample(&mut rng));
        let (one, other) = (trial % 5, (trial + 2) % 5);
        for view in [one, other] {
            seen[view].pixel += Vector2::new(rng.random_range(60.0..300.0), rng.random_range(60.0..300.0));
        }
        let Some(found) = triangulate_robust(&seen) else { continue };
        // Three views at 3 px and 5 m: 10 mm or so; 60 px would be 270 mm.
        right += ((found.point - point).norm() < 0.06 && !found.inliers[one] && !found.inliers[other]) as usize;
    }
    // Now and then two wrong rays meet a right one by chance.
    assert!(right >= 285, "{right} of 300");
}

#[test]
fn the_covariance_predicts_the_scatter() {
    let rig = rig(4);
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let normal = Normal::new(0.0, SIGMA_PX).unwrap();
    let (mut sum, mut n) = (0.0, 0);
    for _ in 0..2000 {
        let point = random_point(&mut rng);
        let found = triangulate_robust(&rig.observe(&point, || normal.sample(&mut rng))).unwrap();
        if found.inliers.iter().all(|&inlier| inlier) {
            let error = found.point - point;
            sum += error.dot(&(found.covariance.try_inverse().unwrap() * error));
            n += 1;
        }
    }
    // Chi-square of three degrees of freedom, mean 3, its mean known to 0.055; cutting at 3 sigma and down-weighting
    // by the robust loss move it by some percent each.
    let mean = sum / n as f64;
    assert!((2.6..3.6).contains(&mean), "{mean} over {n}");
}

#[test]
fn the_gradient_agrees_with_central_differences() {
    let rig = rig(5);
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let seen = rig.observe(&random_point(&mut rng), || 5.0);
    let (point, step) = (Vector3::new(0.1, 0.05, -0.2), 1e-6);
    let model = linearize(&point, &seen);
    assert!((model.cost - robust_cost(&point, &seen)).abs() < 1e-12);
    for axis in 0..3 {
        let mut d = Vector3::zeros();
        d[axis] = step;
        let half_slope = (robust_cost(&(point + d), &seen) - robust_cost(&(point - d), &seen)) / (4.0 * step);
        assert!((half_slope - model.gradient[axis]).abs() < 1e-6 * (1.0 + model.gradient.norm()));
    }
}

#[test]
fn unusable_observations_are_ignored_and_too_few_give_none() {
    let rig = rig(5);
    let point = Vector3::new(0.3, 0.2, -0.1);
    let mut seen = rig.observe(&point, || 0.0);
    seen[1].pixel.x = f64::NAN;
    seen[3].sigma_px = 0.0;
    let found = triangulate_robust(&seen).unwrap();
    assert_eq!(found.inliers, [true, false, true, false, true]);
    assert!((found.point - point).norm() < 1e-9);
    assert_eq!(triangulate_robust(&seen[..2]), None);
    assert_eq!(triangulate_robust(&[]), None);
    assert_eq!(triangulate_robust(&[seen[0], seen[0]]), None, "parallel rays");
    let many = vec![seen[0]; 200];
    assert_eq!(triangulate_robust(&many), None);
}
