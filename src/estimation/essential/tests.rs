use super::*;
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

/// Pixel noise over a focal length of 1000 px.
const NOISE: f64 = 2.0 / 1000.0;

struct Scene {
    pose: Rigid,
    pairs: Vec<PointPair>,
}

/// Two views 4 m apart and rotated by some 60 degrees that see a volume of 3 m; a share of the pairs is arbitrary.
fn scene(seed: u64, n: usize, outliers: f64) -> Scene {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let noise = Normal::new(0.0, NOISE).unwrap();
    let yaw = rng.random_range(-1.2..-0.6);
    let rotation = rotation::exp(&Vector3::new(rng.random_range(-0.1..0.1), yaw, rng.random_range(-0.1..0.1)));
    // The second camera looks at the same middle, 5 m away.
    let middle = Vector3::new(0.0, 0.0, 5.0);
    let pose = Rigid { rotation, translation: middle - rotation * middle };
    let mut pairs = Vec::new();
    for _ in 0..n {
        let point = middle + Vector3::from_fn(|_, _| rng.random_range(-1.5..1.5));
        let moved = pose.transform(&point);
        let mut jitter = |v: Vector3<f64>| (v.xy() / v.z).map(|c| c + noise.sample(&mut rng));
        let (a, mut b) = (jitter(point), jitter(moved));
        if rng.random_bool(outliers) {
            b = nalgebra::Vector2::from_fn(|_, _| rng.random_range(-0.5..0.5));
        }
        pairs.push((a, b));
    }
    Scene { pose, pairs }
}

fn rotation_error_deg(pose: &Rigid, truth: &Rigid) -> f64 {
    rotation::log(&(pose.rotation * truth.rotation.transpose())).norm().to_degrees()
}

fn direction_error_deg(pose: &Rigid, truth: &Rigid) -> f64 {
    pose.translation.normalize().dot(&truth.translation.normalize()).clamp(-1.0, 1.0).acos().to_degrees()
}

#[test]
fn half_wrong_pairs_leave_the_pose_within_its_noise() {
    for seed in 0..20 {
        let scene = scene(seed, 150, 0.5);
        let found = estimate_essential(&scene.pairs, None, 6e-3, 300, seed).unwrap();
        // The best solution of these pairs: the descent from the truth, without sampling.
        let from_truth = refine_essential(&scene.pose, &scene.pairs, None, 6e-3, 20);
        let best = score_essential(&epipolar::essential_from_pose(&from_truth), &scene.pairs, None, 6e-3);
        assert!(found.support > 0.99 * best.support, "{seed}: {} {}", found.support, best.support);
        // 75 pairs at 2 px on a stage of 3 m: a median of 0.5 degrees, so 2.5 is far above the noise.
        let pose = &found.second_from_first;
        assert!(rotation_error_deg(pose, &scene.pose) < 2.5, "{seed}: {}", rotation_error_deg(pose, &scene.pose));
        assert!(direction_error_deg(pose, &scene.pose) < 2.5, "{seed}: {}", direction_error_deg(pose, &scene.pose));
        assert!((0.4..0.65).contains(&found.inlier_ratio), "{}", found.inlier_ratio);
        assert!(found.cheirality_ratio > 0.9, "{}", found.cheirality_ratio);
        assert!(found.support > 0.25 * 150.0 && found.support < found.inlier_ratio * 150.0);
    }
}

#[test]
fn the_same_seed_gives_the_same_bits() {
    let scene = scene(7, 100, 0.4);
    let run = || estimate_essential(&scene.pairs, None, 6e-3, 100, 5);
    assert_eq!(run(), run());
}

#[test]
fn pairs_of_weight_zero_are_ignored() {
    let mut scene = scene(8, 120, 0.0);
    let weights: Vec<f64> = (0..120).map(|i| if i < 60 { 1.0 } else { 0.0 }).collect();
    scene.pairs[60..].iter_mut().for_each(|(_, b)| b.x = f64::NAN);
    let found = estimate_essential(&scene.pairs, Some(&weights), 6e-3, 100, 0).unwrap();
    assert!(rotation_error_deg(&found.second_from_first, &scene.pose) < 1.0);
    assert!(found.inlier_ratio > 0.95);
}

#[test]
fn refinement_converges_from_ten_degrees_away() {
    let scene = scene(9, 60, 0.0);
    let exact: Vec<PointPair> = scene
        .pairs
        .iter()
        .map(|(a, _)| {
            let point = a.push(1.0) * 5.0;
            let moved = scene.pose.transform(&point);
            (*a, moved.xy() / moved.z)
        })
        .collect();
    let turned = Rigid {
        rotation: rotation::exp(&Vector3::new(0.1, -0.1, 0.1)) * scene.pose.rotation,
        translation: scene.pose.translation.normalize() + Vector3::new(0.1, 0.1, -0.1),
    };
    let refined = refine_essential(&turned, &exact, None, 0.05, 30);
    assert!(rotation_error_deg(&refined, &scene.pose) < 1e-6);
    assert!((refined.translation - scene.pose.translation.normalize()).norm() < 1e-8);
}

#[test]
fn non_finite_pairs_are_ignored() {
    let scene = scene(11, 80, 0.0);
    let mut pairs = scene.pairs.clone();
    pairs.push((nalgebra::Vector2::repeat(f64::NAN), nalgebra::Vector2::zeros()));
    let refined = refine_essential(&scene.pose, &pairs, None, 6e-3, 10);
    assert_eq!(refined, refine_essential(&scene.pose, &scene.pairs, None, 6e-3, 10));
    assert!(refined.rotation != scene.pose.rotation);
}

#[test]
fn degenerate_input_gives_none() {
    let scene = scene(10, 4, 0.0);
    assert_eq!(estimate_essential(&scene.pairs, None, 6e-3, 100, 0), None);
    assert_eq!(estimate_essential(&[], None, 6e-3, 100, 0), None);
    let nan = nalgebra::Vector2::repeat(f64::NAN);
    assert_eq!(estimate_essential(&[(nan, nan); 20], None, 6e-3, 20, 0), None);
    estimate_essential(&[(nalgebra::Vector2::zeros(), nalgebra::Vector2::zeros()); 20], None, 6e-3, 20, 0);
}

/// Of 13 pairs, which fill one group of lanes and part of another, with weights and wrong pairs.
#[test]
fn sums_over_lanes_are_the_derivatives_of_the_cost() {
    let scene = scene(12, 13, 0.3);
    let (threshold, step) = (0.05, 1e-6);
    let lanes = PairLanes::new(&scene.pairs, |i| 1.0 + 0.1 * i as f64);
    let pose = Rigid { translation: scene.pose.translation.normalize(), ..scene.pose };
    let tangents = rotation::tangents(&pose.translation);
    let model = lanes.linearized(&pose, &tangents, threshold);
    let squared =
        scene.pairs.iter().map(|(a, b)| epipolar::sampson_squared(&epipolar::essential_from_pose(&pose), a, b));
    let rho = squared
        .enumerate()
        .map(|(i, d2)| (1.0 + 0.1 * i as f64) * crate::optim::robust::geman_mcclure_rho(d2, threshold * threshold));
    assert!((model.cost - rho.sum::<f64>()).abs() < 1e-12 * model.cost);
    for k in 0..5 {
        let moved = |sign: f64| {
            let mut along = SVector::<f64, 5>::zeros();
            along[k] = sign * step;
            lanes.linearized(&retract(&pose, &along), &tangents, threshold).cost
        };
        let found = (moved(1.0) - moved(-1.0)) / (4.0 * step);
        assert!((found - model.gradient[k]).abs() < 1e-7 * model.gradient.amax().max(1.0), "{k}: {found}");
        assert!(model.hessian[(k, k)] > 0.0 && model.hessian == model.hessian.transpose());
    }
}
