use super::*;
use crate::geometry::rotation;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::PI;

fn random_points(rng: &mut ChaCha8Rng, n: usize) -> Vec<Vector3<f64>> {
    (0..n).map(|_| Vector3::from_fn(|_, _| rng.random_range(-2.0..2.0))).collect()
}

fn distance(a: &Similarity, b: &Similarity) -> f64 {
    (a.scale - b.scale).abs() + (a.rotation - b.rotation).norm() + (a.translation - b.translation).norm()
}

fn squared_error(s: &Similarity, source: &[Vector3<f64>], target: &[Vector3<f64>]) -> f64 {
    source.iter().zip(target).map(|(x, y)| (y - s.transform(x)).norm_squared()).sum()
}

#[test]
fn exact_points_give_the_exact_transform() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for angle in [0.0, 1e-9, 0.3, 2.0, PI - 1e-9, PI] {
        for _ in 0..50 {
            let axis = Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0)).normalize();
            let truth = Similarity {
                scale: rng.random_range(0.1..3.0),
                rotation: rotation::exp(&(axis * angle)),
                translation: Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0)),
            };
            let source = random_points(&mut rng, 10);
            let target: Vec<_> = source.iter().map(|x| truth.transform(x)).collect();
            let found = similarity_from_points(&source, &target, ScaleMode::Free).unwrap();
            assert!(distance(&found, &truth) < 1e-12, "{angle}: {}", distance(&found, &truth));
        }
    }
}

#[test]
fn a_triangle_mirrored_in_its_plane_is_turned_over_in_space() {
    // The triangle of the paper's Sec. IV. In the plane no rotation reaches it; in space half a turn about y does, and
    // the covariance has rank 2: the sign of Eq. (43) decides.
    let source = [Vector3::zeros(), Vector3::x(), Vector3::y() * 2.0];
    let target = [Vector3::zeros(), -Vector3::x(), Vector3::y() * 2.0];
    let found = similarity_from_points(&source, &target, ScaleMode::Free).unwrap();
    assert!((found.rotation - Matrix3::from_diagonal(&Vector3::new(-1.0, 1.0, -1.0))).norm() < 1e-14);
    assert!((found.scale - 1.0).abs() < 1e-14 && found.translation.norm() < 1e-14);
}

#[test]
fn a_mirrored_cloud_gets_its_best_proper_rotation() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let source = random_points(&mut rng, 12);
    let target: Vec<_> = source.iter().map(|x| Vector3::new(x.x, x.y, -x.z)).collect();
    for mode in [ScaleMode::Free, ScaleMode::Unit] {
        let found = similarity_from_points(&source, &target, mode).unwrap();
        assert!((found.rotation.determinant() - 1.0).abs() < 1e-13);
        let least = squared_error(&found, &source, &target);
        assert!(least > 0.1, "a mirror image cannot be reached");
        for _ in 0..200 {
            let turn = rotation::exp(&(Vector3::from_fn(|_, _| rng.random_range(-0.5..0.5))));
            let scale = if mode == ScaleMode::Free { rng.random_range(0.8..1.2) } else { 1.0 };
            let around = Similarity { scale, rotation: turn, translation: Vector3::zeros() };
            assert!(squared_error(&(found * around), &source, &target) >= least);
        }
    }
}

#[test]
fn a_rigid_alignment_keeps_the_length() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let source = random_points(&mut rng, 8);
    let target: Vec<_> = source.iter().map(|x| x * 2.0 + Vector3::x()).collect();
    let found = similarity_from_points(&source, &target, ScaleMode::Unit).unwrap();
    assert_eq!(found.scale, 1.0);
    assert!((found.rotation - Matrix3::identity()).norm() < 1e-14);
}

#[test]
fn degenerate_points_are_rejected_with_the_reason() {
    let line: Vec<_> = (0..5).map(|i| Vector3::new(1.0, 2.0, -1.0) * (i as f64) / 3.0 + Vector3::x() * 100.0).collect();
    let place = vec![Vector3::new(0.1, 0.2, 0.3); 5];
    let cloud = random_points(&mut ChaCha8Rng::seed_from_u64(4), 5);
    let align = |a: &[Vector3<f64>], b: &[Vector3<f64>]| similarity_from_points(a, b, ScaleMode::Free).unwrap_err();
    assert_eq!(align(&line, &line), AlignError::Degenerate);
    assert_eq!(align(&line, &cloud), AlignError::Degenerate);
    assert_eq!(align(&cloud, &line), AlignError::Degenerate);
    assert_eq!(align(&place, &place), AlignError::Degenerate);
    assert_eq!(align(&cloud[..2], &cloud[..2]), AlignError::TooFewPoints { n_points: 2 });
    assert_eq!(align(&cloud[..3], &cloud), AlignError::UnequalCounts { n_source: 3, n_target: 5 });
    let mut holed = cloud.clone();
    holed[3].y = f64::NAN;
    assert_eq!(align(&cloud, &holed), AlignError::NotFinite { index: 3 });
}

#[test]
fn composition_and_cameras_follow_the_points() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut random = || Similarity {
        scale: rng.random_range(0.5..2.0),
        rotation: rotation::exp(&Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0))),
        translation: Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0)),
    };
    let (a, b, x) = (random(), random(), Vector3::new(0.3, 0.4, 5.0));
    assert!(((a * b).transform(&x) - a.transform(&b.transform(&x))).norm() < 1e-14);
    let camera = Rigid { rotation: b.rotation, translation: b.translation };
    let (before, after) = (camera.transform(&x), a.move_camera(&camera).transform(&a.transform(&x)));
    assert!((after - before * a.scale).norm() < 1e-14, "the same direction, the target's unit");
}

/// Two cameras have one baseline: their orientations settle the turn about it.
#[test]
fn aligns_two_cameras_by_their_orientations() {
    let truth = Similarity {
        scale: 1.3,
        rotation: rotation::exp(&Vector3::new(0.4, -1.2, 0.3)),
        translation: Vector3::new(2.0, -1.0, 0.5),
    };
    let camera = |k: usize| {
        let turn = Vector3::new(0.2, 1.1 * k as f64, -0.1);
        Rigid { rotation: rotation::exp(&turn), translation: Vector3::new(0.1 * k as f64, 0.2, 4.0) }
    };
    let source = [camera(0), camera(1)];
    let target = source.map(|camera| truth.move_camera(&camera));
    assert!(distance(&similarity_from_cameras(&source, &target).unwrap(), &truth) < 1e-9);
    assert_eq!(similarity_from_cameras(&source[..1], &target[..1]), Err(AlignError::Degenerate));
}
