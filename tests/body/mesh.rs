//! Tests of the mesh: weights, joints, symmetry, and that the generator reproduces the embedded file.

use crate::generated;
use nalgebra::Vector3;
use std::collections::{BTreeMap, BTreeSet};
use wandless::body::Betas;
use wandless::body::default_body;
use wandless::body::loader::{LandmarkTable, body_from_bytes, body_npz};
use wandless::body::skeleton::{JOINT_NAMES, N_JOINTS};

/// To generate the file again: `WANDLESS_WRITE_ASSETS=1 cargo test --release --test body`.
#[test]
fn the_generator_reproduces_the_embedded_body() {
    let body = generated();
    let bytes = body_npz(&body.surface, false).unwrap();
    if std::env::var_os("WANDLESS_WRITE_ASSETS").is_some() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/default-adult-v1.npz");
        std::fs::write(path, &bytes).unwrap();
    }
    let made = body_from_bytes(default_body().name, &bytes, &LandmarkTable::default()).unwrap();
    assert!(made == default_body(), "generate the file again: see the test's comment");
    assert!(bytes.len() < 1_500_000, "{} bytes", bytes.len());
}

#[test]
fn the_surface_is_closed_and_turned_outward() {
    let surface = &default_body().surface;
    assert!(surface.is_watertight());
    let n_edges = surface.faces.len() * 3 / 2;
    assert_eq!(surface.vertices.len() + surface.faces.len(), n_edges + 2, "Euler's number of a sphere is 2");
    assert!((6_500..=7_500).contains(&surface.vertices.len()), "{}", surface.vertices.len());
    let mut near: BTreeMap<usize, BTreeSet<usize>> = BTreeMap::new();
    for [a, b, c] in &surface.faces {
        near.entry(*a).or_default().extend([*b, *c]);
        near.entry(*b).or_default().extend([*c, *a]);
        near.entry(*c).or_default().extend([*a, *b]);
    }
    let (mut seen, mut open) = (BTreeSet::from([0]), vec![0]);
    while let Some(v) = open.pop() {
        open.extend(near[&v].iter().filter(|n| seen.insert(**n)));
    }
    assert_eq!(seen.len(), surface.vertices.len(), "one component that uses every vertex");
    assert!(surface.volume(&surface.vertices) > 0.0);
}

#[test]
fn weights_are_sparse_positive_and_one_sided() {
    let surface = &default_body().surface;
    let mut owned = [0; N_JOINTS];
    for (row, vertex) in surface.skin.iter().zip(&surface.vertices) {
        assert!((1..=4).contains(&row.len()) && row.iter().all(|s| s.weight > 0.0));
        assert!((row.iter().map(|s| s.weight).sum::<f64>() - 1.0).abs() < 1e-12);
        owned[row.iter().max_by(|a, b| a.weight.total_cmp(&b.weight)).unwrap().joint] += 1;
        for share in row {
            let name = JOINT_NAMES[share.joint];
            assert!(!(name.starts_with("left_") && vertex.x < -0.020), "{name} at {vertex:?}");
            assert!(!(name.starts_with("right_") && vertex.x > 0.020), "{name} at {vertex:?}");
        }
    }
    assert!(owned.iter().all(|n| *n >= 10), "{owned:?}");
}

/// Regressed joints against the positions that the figure was generated from.
#[test]
fn regressed_joints_follow_the_measures() {
    let (model, made) = (default_body(), generated());
    let mut worst = [0.0_f64; 3];
    for j in 0..N_JOINTS {
        let row = &model.surface.regressor[j];
        assert!(row.iter().all(|v| v.weight >= 0.0));
        assert!((row.iter().map(|v| v.weight).sum::<f64>() - 1.0).abs() < 1e-6);
        let offset = model.rest_joints[j] - made.joints[j];
        let directions = model.shape_directions[j] - made.joint_directions[j];
        worst[0] = worst[0].max(offset.norm());
        for (k, size) in (0..10).flat_map(|k| [(k, 1.0), (k, -1.0), (k, 2.0), (k, -2.0)]) {
            let error = (offset + directions.column(k) * size).norm();
            let slot = size.abs() as usize;
            worst[slot] = worst[slot].max(error);
        }
    }
    println!("joints off by {:?} mm at beta 0, 1, 2", worst.map(|v| v * 1e3));
    assert!(worst[0] < 0.5e-3 && worst[1] <= 2e-3 && worst[2] <= 4e-3);
}

#[test]
fn left_is_the_mirror_image_of_right() {
    let surface = &default_body().surface;
    let key = |v: &Vector3<f64>| [v.x, v.y, v.z].map(|c| (c * 1e7).round() as i64);
    let index: BTreeMap<[i64; 3], usize> = surface.vertices.iter().enumerate().map(|(i, v)| (key(v), i)).collect();
    let image =
        |i: usize| index[&key(&Vector3::new(-surface.vertices[i].x, surface.vertices[i].y, surface.vertices[i].z))];
    let other = |j: usize| {
        let name = JOINT_NAMES[j];
        let twin =
            if name.starts_with("left_") { name.replace("left_", "right_") } else { name.replace("right_", "left_") };
        JOINT_NAMES.iter().position(|n| *n == twin).unwrap()
    };
    for i in 0..surface.vertices.len() {
        let (a, b) = (&surface.shape_directions[i], &surface.shape_directions[image(i)]);
        for k in 0..10 {
            assert!((a[(0, k)] + b[(0, k)]).abs() < 1e-6 && (a[(1, k)] - b[(1, k)]).abs() < 1e-6);
            assert!((a[(2, k)] - b[(2, k)]).abs() < 1e-6);
        }
        let weight = |i: usize, j: usize| surface.skin[i].iter().find(|s| s.joint == j).map_or(0.0, |s| s.weight);
        assert!((0..N_JOINTS).all(|j| (weight(i, j) - weight(image(i), other(j))).abs() < 1e-6));
    }
    let joints = default_body().shaped(&Betas::from_fn(|k, _| 0.4 * k as f64 - 1.5)).rest_joints;
    for j in 0..N_JOINTS {
        let twin = joints[other(j)];
        assert!((joints[j] - Vector3::new(-twin.x, twin.y, twin.z)).norm() < 1e-6);
    }
}

#[test]
fn triangles_are_well_shaped() {
    let surface = &default_body().surface;
    let (mut smallest_angle, mut edges) = (f64::INFINITY, [f64::INFINITY, 0.0_f64]);
    for face in &surface.faces {
        let corners = face.map(|v| surface.vertices[v]);
        for k in 0..3 {
            let (u, v) = (corners[(k + 1) % 3] - corners[k], corners[(k + 2) % 3] - corners[k]);
            smallest_angle = smallest_angle.min(u.angle(&v));
            edges = [edges[0].min(u.norm()), edges[1].max(u.norm())];
        }
    }
    println!("smallest angle {:.1} deg, edges {:?} m", smallest_angle.to_degrees(), edges);
    assert!(smallest_angle.to_degrees() >= 15.0);
    assert!(edges[0] >= 0.005 && edges[1] <= 0.035);
}
