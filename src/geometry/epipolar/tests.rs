use super::*;
use crate::geometry::five_point::five_point;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn random_vector(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0))
}

/// A second view with a baseline of 1, turned by up to some 60 degrees.
fn random_pose(rng: &mut ChaCha8Rng) -> Rigid {
    let rotation = rotation::exp(&(random_vector(rng) * 0.7));
    Rigid { rotation, translation: random_vector(rng).normalize() }
}

fn random_pair(rng: &mut ChaCha8Rng, pose: &Rigid) -> PointPair {
    loop {
        let point = random_vector(rng) + Vector3::new(0.0, 0.0, 3.0);
        let moved = pose.transform(&point);
        if moved.z > 0.5 {
            return (point.xy() / point.z, moved.xy() / moved.z);
        }
    }
}

fn essential_distance(a: &Matrix3<f64>, b: &Matrix3<f64>) -> f64 {
    (a - b).norm().min((a + b).norm())
}

#[test]
fn five_pairs_give_the_true_essential_matrix() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut found = 0;
    for _ in 0..1000 {
        let pose = random_pose(&mut rng);
        let pairs = std::array::from_fn(|_| random_pair(&mut rng, &pose));
        let truth = essential_from_pose(&pose);
        let candidates = five_point(&pairs);
        assert!(candidates.len() <= 10);
        for e in &candidates {
            assert!((e * e.transpose() * e * 2.0 - e * e.norm_squared()).norm() < 1e-8);
            assert!(pairs.iter().all(|(a, b)| sampson_squared(e, a, b) < 1e-20));
        }
        found += candidates.iter().any(|e| essential_distance(e, &truth) < 1e-8) as usize;
    }
    assert!(found >= 995, "{found} of 1000");
}

#[test]
fn five_equal_or_non_finite_pairs_do_not_panic() {
    let pair = (Vector2::new(0.1, 0.2), Vector2::new(0.3, -0.1));
    five_point(&[pair; 5]);
    five_point(&[(Vector2::repeat(f64::NAN), Vector2::zeros()); 5]);
    five_point(&[(Vector2::zeros(), Vector2::zeros()); 5]);
}

#[test]
fn only_the_true_of_four_poses_is_in_front() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for _ in 0..200 {
        let pose = random_pose(&mut rng);
        let pairs: Vec<_> = (0..20).map(|_| random_pair(&mut rng, &pose)).collect();
        for sign in [1.0, -1.0] {
            let poses = poses_from_essential(&(essential_from_pose(&pose) * sign));
            let counts = poses.map(|p| pairs.iter().filter(|(a, b)| in_front(&p, a, b)).count());
            let best = (0..4).max_by_key(|&i| counts[i]).unwrap();
            assert_eq!(counts[best], 20);
            assert!((poses[best].rotation - pose.rotation).norm() < 1e-12);
            assert!((poses[best].translation - pose.translation).norm() < 1e-12);
            assert!((0..4).all(|i| i == best || counts[i] < 20));
        }
    }
}

#[test]
fn sampson_distance_is_first_order_epipolar_distance() {
    // Sideways motion: epipolar lines are rows; a row difference d between two views is d / sqrt 2 in each.
    let e = essential_from_pose(&Rigid { rotation: Matrix3::identity(), translation: Vector3::x() });
    let squared = sampson_squared(&e, &Vector2::new(0.3, 0.1), &Vector2::new(-0.2, 0.1 + 0.02));
    assert!((squared - 0.0002).abs() < 1e-15);
    assert_eq!(sampson_squared(&Matrix3::zeros(), &Vector2::zeros(), &Vector2::zeros()), 0.0);
}

#[test]
fn depths_of_an_exact_pair_are_its_z() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let pose = random_pose(&mut rng);
    let point = Vector3::new(0.2, -0.3, 4.0);
    let moved = pose.transform(&point);
    let depths = pair_depths(&pose, &(point.xy() / point.z), &(moved.xy() / moved.z)).unwrap();
    assert!((depths.first - point.z).abs() < 1e-12 && (depths.second - moved.z).abs() < 1e-12);
    let still = Rigid { rotation: Matrix3::identity(), translation: Vector3::x() };
    assert_eq!(pair_depths(&still, &Vector2::zeros(), &Vector2::zeros()), None);
}

#[test]
fn distances_between_rays_and_points_are_exact() {
    let at = |x: f64, y: f64| Rigid { rotation: Matrix3::identity(), translation: -Vector3::new(x, y, 0.0) };
    let forward = PluckerRay::through(&at(1.0, 2.0), &Vector2::zeros());
    assert!((ray_point_distance(&forward, &Vector3::new(1.0, 5.0, 9.0)) - 3.0).abs() < 1e-14);
    // One looks along z at height 2, one slanted in the plane of height 0.5.
    let slanted = PluckerRay::through(&at(-4.0, 0.5), &Vector2::new(0.01, 0.0));
    assert!((ray_ray_distance(&forward, &slanted) - 1.5).abs() < 1e-12, "the true gap, whatever the angle");
    let parallel = PluckerRay::through(&at(4.0, 6.0), &Vector2::zeros());
    assert!((ray_ray_distance(&forward, &parallel) - 5.0).abs() < 1e-14);
}
