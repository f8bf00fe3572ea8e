//! Tests of the capsules against the skin, and of their derivatives.

use crate::posing::{random_pose, standard_poses};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::time::Instant;
use wandless::body::capsules::{BodyCapsules, N_CAPSULES, NearestBall};
use wandless::body::joint_ranges::natural_pose;
use wandless::body::kinematics::{Pose, posed};
use wandless::body::skeleton::N_JOINTS;
use wandless::body::skinning::skinned;
use wandless::body::{Betas, BodyModel, default_body};
use wandless::geometry::capsule::TaperedCapsule;

/// Distances of every vertex to the union of the capsules, mm.
fn distances_mm(model: &BodyModel, capsules: &BodyCapsules, betas: &Betas, pose: &Pose) -> Vec<f64> {
    let balls = capsules.posed(betas, &posed(&model.shaped(betas), pose));
    let nearest = |v: &Vector3<f64>| balls.iter().map(|c| c.distance_to(v).distance).fold(f64::INFINITY, f64::min);
    skinned(model, betas, pose).iter().map(|v| nearest(v).abs() * 1e3).collect()
}

/// Root mean square and 95th percentile.
fn summary(mut sizes: Vec<f64>) -> [f64; 2] {
    sizes.sort_by(f64::total_cmp);
    let rms = (sizes.iter().map(|s| s * s).sum::<f64>() / sizes.len() as f64).sqrt();
    [rms, sizes[sizes.len() * 95 / 100]]
}

fn residual_mm(model: &BodyModel, capsules: &BodyCapsules, betas: &Betas, pose: &Pose) -> [f64; 2] {
    summary(distances_mm(model, capsules, betas, pose))
}

fn assert_near(name: &str, [rms, p95]: [f64; 2]) {
    println!("{name}: root mean square {rms:.2} mm, 95 % below {p95:.2} mm");
    assert!(rms <= 8.0 && p95 <= 16.0, "{name}: {rms}, {p95}");
}

/// To write the file again: `WANDLESS_WRITE_ASSETS=1 cargo test --release --test body`, after the body itself.
#[test]
fn the_embedded_capsules_are_those_that_are_fitted() {
    let model = default_body();
    let fitted = BodyCapsules::fitted(&model).to_bytes();
    if std::env::var_os("WANDLESS_WRITE_ASSETS").is_some() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/default-adult-v1-capsules.f64");
        std::fs::write(path, &fitted).unwrap();
    }
    let numbers =
        |bytes: Vec<u8>| -> Vec<f64> { bytes.as_chunks().0.iter().map(|number| f64::from_le_bytes(*number)).collect() };
    let (embedded, fitted) = (numbers(BodyCapsules::of(&model).to_bytes()), numbers(fitted));
    assert_eq!(embedded.len(), fitted.len());
    let largest = embedded.iter().zip(&fitted).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(largest < 1e-9, "{largest} m: write the file again, see the test's comment");
}

/// A body with joints elsewhere is not the default body, though its skin is.
#[test]
fn a_body_with_moved_joints_has_capsules_of_its_own() {
    let mut shifts = [Vector3::zeros(); N_JOINTS];
    shifts[18] = Vector3::new(0.03, 0.0, 0.0);
    let moved = default_body().with_joints_moved(&shifts);
    assert!(BodyCapsules::of(&moved) == BodyCapsules::fitted(&moved));
    assert!(BodyCapsules::of(&moved) != BodyCapsules::of(&default_body()));
}

#[test]
fn the_capsules_follow_the_skin_of_every_shape() {
    let model = default_body();
    let began = Instant::now();
    let capsules = BodyCapsules::fitted(&model);
    println!("fitted in {:.0} ms", began.elapsed().as_secs_f64() * 1e3);
    let rest = Pose::rest();
    assert_near("mean", residual_mm(&model, &capsules, &Betas::zeros(), &rest));
    for (k, size) in (0..10).flat_map(|k| [(k, 2.0), (k, -2.0)]) {
        let betas = Betas::ith(k, size);
        assert_near(&format!("beta {k} {size:+}"), residual_mm(&model, &capsules, &betas, &rest));
    }
}

#[test]
fn the_capsules_follow_the_skin_in_natural_poses() {
    let model = default_body();
    let capsules = BodyCapsules::fitted(&model);
    let mut rng = ChaCha8Rng::seed_from_u64(14);
    let mut drawn = |spread: f64| -> Vec<Vec<f64>> {
        let mut pose = || natural_pose(&mut rng, spread);
        (0..20).map(|_| distances_mm(&model, &capsules, &Betas::zeros(), &pose())).collect()
    };
    let describe = |name: &str, poses: &[Vec<f64>]| {
        let each: Vec<[f64; 2]> = poses.iter().map(|sizes| summary(sizes.clone())).collect();
        let worst = [0, 1].map(|i| each.iter().map(|r| r[i]).fold(0.0, f64::max));
        let n_beyond = each.iter().filter(|[rms, p95]| *rms > 8.0 || *p95 > 16.0).count();
        let [rms, p95] = summary(poses.concat());
        println!(
            "{name}: all together {rms:.2}, {p95:.2} mm; {n_beyond} of 20 beyond the bounds, worst {worst:.1?} mm"
        );
    };
    // A quarter of the joints' spreads about standing with the arms hanging: all vertices of all poses together.
    let near = drawn(0.25);
    describe("near standing", &near);
    assert_near("20 poses", summary(near.concat()));
    describe("twice as far", &drawn(0.5));
    // Extreme bends are printed, not tested: see the module's known limits.
    for (name, pose) in standard_poses() {
        let [rms, p95] = residual_mm(&model, &capsules, &Betas::zeros(), &pose);
        println!("{name}: {rms:.2} mm, {p95:.2} mm");
    }
}

/// A wider, taller and deeper body: the fit does not depend on the default body's size.
#[test]
fn fits_another_body() {
    let mut model = default_body();
    let mut surface = (*model.surface).clone();
    surface.vertices.iter_mut().for_each(|v| *v = v.component_mul(&Vector3::new(1.1, 1.15, 1.2)));
    model = BodyModel::new("own".to_owned(), surface);
    let capsules = BodyCapsules::fitted(&model);
    let [rms, p95] = residual_mm(&model, &capsules, &Betas::zeros(), &Pose::rest());
    println!("stretched: {rms:.2} mm, {p95:.2} mm");
    assert!(rms <= 8.0 * 1.2 && p95 <= 16.0 * 1.2);
}

/// Distances of two bodies' capsules by pose and translation, against central differences.
#[test]
fn derivatives_agree_with_central_differences() {
    let model = default_body();
    let capsules = BodyCapsules::fitted(&model);
    let mut rng = ChaCha8Rng::seed_from_u64(15);
    for _ in 0..10 {
        let (pose, mut other) = (random_pose(&mut rng, 0.4), random_pose(&mut rng, 0.4));
        other.translation = pose.translation + Vector3::new(0.5, 0.1, 0.2);
        let betas = Betas::from_fn(|_, _| rng.random_range(-2.0..2.0));
        let theirs = capsules.posed(&Betas::zeros(), &posed(&model.shaped(&Betas::zeros()), &other));
        let skeleton = posed(&model.shaped(&betas), &pose);
        let ours = capsules.posed(&betas, &skeleton);
        let of = |pose: &Pose, betas: &Betas, i: usize, j: usize| {
            let ours: [TaperedCapsule; N_CAPSULES] = capsules.posed(betas, &posed(&model.shaped(betas), pose));
            ours[i].distance_to_capsule(&theirs[j]).distance
        };
        for (i, j) in [(0, 0), (3, 14), (7, 16), (20, 8), (17, 17)] {
            let found = ours[i].distance_to_capsule(&theirs[j]);
            let ball = NearestBall { capsule: i, share: found.shares[0], normal: found.normal };
            let check = |expected: f64, at: &dyn Fn(f64) -> f64| {
                let difference = (at(1e-6) - at(-1e-6)) / 2e-6;
                assert!((difference - expected).abs() < 1e-6, "capsules {i}, {j}: {difference} {expected}");
            };
            for axis in 0..3 {
                check(-ball.normal[axis], &|h| {
                    let mut moved = pose;
                    moved.translation[axis] += h;
                    of(&moved, &betas, i, j)
                });
                for joint in 0..N_JOINTS {
                    let expected = capsules.distance_by_rotation(&skeleton, &ours, &ball, joint)[axis];
                    check(expected, &|h| {
                        let mut turned = pose;
                        turned.rotations[joint] *= wandless::geometry::rotation::exp(&Vector3::ith(axis, h));
                        of(&turned, &betas, i, j)
                    });
                }
            }
        }
    }
}

/// Two bodies face to face, apart, then one inside the other.
#[test]
fn distances_between_bodies_match_the_mesh() {
    let model = default_body();
    let capsules = BodyCapsules::fitted(&model);
    let at = |z: f64| {
        let pose = Pose { translation: Vector3::z() * z, ..Pose::rest() };
        capsules.posed(&Betas::zeros(), &posed(&model.shaped(&Betas::zeros()), &pose))
    };
    let least = |a: &[TaperedCapsule; N_CAPSULES], b: &[TaperedCapsule; N_CAPSULES]| {
        let pairs = a.iter().flat_map(|a| b.iter().map(move |b| a.distance_to_capsule(b).distance));
        pairs.fold(f64::INFINITY, f64::min)
    };
    // The mesh's own gap, from vertex to vertex: edges of 20 mm make it 2 mm too wide at most.
    let skin = &model.surface.vertices;
    let gap = |z: f64| {
        let nearest = |a: &Vector3<f64>| {
            skin.iter().map(|b| (b + Vector3::z() * z - a).norm_squared()).fold(f64::INFINITY, f64::min)
        };
        skin.iter().map(nearest).fold(f64::INFINITY, f64::min).sqrt()
    };
    for z in [0.4, 0.5] {
        let (found, exact) = (least(&at(0.0), &at(z)), gap(z));
        println!("{z} m behind each other: {found:.3} m apart by capsules, {exact:.3} m by the mesh");
        assert!((found - exact).abs() < 0.025);
    }
    assert!(least(&at(0.0), &at(0.05)) < -0.1);
    let (a, b) = (at(0.0), at(0.2));
    let began = Instant::now();
    let sum: f64 = (0..200).map(|_| least(std::hint::black_box(&a), &b)).sum();
    println!("441 pairs in {:.1} us ({sum:.1})", began.elapsed().as_secs_f64() * 1e6 / 200.0);
}
