//! Tests of pelvis and hips: no skirt at rest, no fold when they bend.

use crate::anthropometry::girth;
use crate::intersections::n_intersections;
use nalgebra::Vector3;
use std::collections::BTreeMap;
use wandless::body::kinematics::Pose;
use wandless::body::skinning::skinned;
use wandless::body::surface::Surface;
use wandless::body::{Betas, BodyModel, default_body};
use wandless::geometry::rotation::exp;

/// Edges about the hips of the mean body, as the middle of the edge at rest and its angle in a pose, degrees: 0 is flat, above it
/// the surface bends inward, below outward. The midline between the thighs is left out.
fn bends_deg(surface: &Surface, posed: &[Vector3<f64>]) -> Vec<f64> {
    let middle = |v: &[Vector3<f64>], face: &[usize; 3]| face.iter().map(|i| v[*i]).sum::<Vector3<f64>>() / 3.0;
    let normal = |[a, b, c]: &[usize; 3]| (posed[*b] - posed[*a]).cross(&(posed[*c] - posed[*a])).normalize();
    let mut faces_of_edge: BTreeMap<[usize; 2], Vec<&[usize; 3]>> = BTreeMap::new();
    for face in &surface.faces {
        for k in 0..3 {
            let (a, b) = (face[k], face[(k + 1) % 3]);
            faces_of_edge.entry([a.min(b), a.max(b)]).or_default().push(face);
        }
    }
    let is_at_hip = |[a, b]: &[usize; 2]| {
        let place = (surface.vertices[*a] + surface.vertices[*b]) / 2.0;
        (0.03..0.25).contains(&place.x.abs()) && (0.68..1.02).contains(&place.y)
    };
    let bend = |faces: &Vec<&[usize; 3]>| {
        let [own, other] = [0, 1].map(|k| normal(faces[k]));
        let across = middle(posed, faces[1]) - middle(posed, faces[0]);
        own.angle(&other).to_degrees() * across.dot(&own).signum()
    };
    faces_of_edge.iter().filter(|(edge, _)| is_at_hip(edge)).map(|(_, faces)| bend(faces)).collect()
}

/// Both hips bent by an angle, arms down.
fn seated(deg: f64) -> Pose {
    let mut pose = Pose::rest();
    for (joint, turn) in [
        (1, Vector3::x() * -deg.to_radians()),
        (2, Vector3::x() * -deg.to_radians()),
        (16, Vector3::z() * -1.2),
        (17, Vector3::z() * 1.2),
    ] {
        pose.rotations[joint] = exp(&turn);
    }
    pose
}

fn n_sharp(bends_deg: &[f64]) -> usize {
    bends_deg.iter().filter(|bend| bend.abs() > 30.0).count()
}

/// The trunk ended in a rim of 1.12 m about thighs of 0.96 m, where adults have 1.02 m, with 42 edges beyond 30 degrees.
#[test]
fn the_trunk_runs_into_the_thighs_without_a_rim() {
    let surface = &default_body().surface;
    let outline: Vec<f64> = (0..11).map(|k| girth(surface, 0.83 + 0.012 * f64::from(k), f64::MIN)).collect();
    println!("girths from 0.83 to 0.95 m: {outline:.3?} m");
    assert!(outline.iter().all(|girth| (0.94..=1.05).contains(girth)));
    let bends = bends_deg(surface, &surface.vertices);
    let n_sharp = n_sharp(&bends);
    println!("{n_sharp} of {} edges beyond 30 degrees", bends.len());
    assert!(n_sharp <= 10);
}

/// Bent by 60 degrees the groin is a crease and not a fold: no edge closes to a right angle, few are sharp (the rim had 86 beyond
/// 30 degrees), no faces intersect, and little volume is lost.
#[test]
fn hips_bend_by_60_degrees_without_a_fold() {
    let model: BodyModel = default_body();
    let surface = &model.surface;
    for (name, betas) in [
        ("mean", Betas::zeros()),
        ("slim", Betas::ith(1, -2.0)),
        ("heavy", Betas::ith(1, 2.0)),
        ("small", Betas::ith(0, -2.0)),
        ("tall", Betas::ith(0, 2.0)),
    ] {
        let [straight, bent] = [0.0, 60.0].map(|deg| skinned(&model, &betas, &seated(deg)));
        let bends = bends_deg(surface, &bent);
        let deepest = bends.iter().copied().fold(f64::MIN, f64::max);
        let n_sharp = n_sharp(&bends);
        let lost = 1.0 - surface.volume(&bent) / surface.volume(&straight);
        let new_pairs =
            n_intersections(&bent, &surface.faces).saturating_sub(n_intersections(&straight, &surface.faces));
        println!("{name}: deepest {deepest:.0} deg, {n_sharp} beyond 30, {lost:.3} of the volume, {new_pairs} pairs");
        assert!(deepest < 90.0 && n_sharp <= 45 && lost <= 0.03 && new_pairs == 0, "{name}");
    }
}
