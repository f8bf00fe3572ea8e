//! 38 virtual markers on the skin, distributed over the body segments like a full-body motion capture set.
//!
//! A marker is a vertex of the mesh: the vertex nearest to a ray that leaves the body at a defined place in the rest pose of
//! the mean shape. Bodies of one model share their vertices, so that a marker is the same spot of the skin on every shape.

use crate::body::skeleton::JOINT_NAMES;
use crate::body::{Betas, BodyModel};
use nalgebra::Vector3;

/// Position of a marker: where a ray leaves the skin.
struct Rule {
    name: &'static str,
    /// The ray starts at this joint in the rest pose (of a pair the left one), shifted by this offset, m.
    joint: &'static str,
    offset: [f64; 3],
    /// Direction of the ray. In the T-pose x is left, y up, z forward.
    direction: [f64; 3],
}

const fn rule(name: &'static str, joint: &'static str, offset: [f64; 3], direction: [f64; 3]) -> Rule {
    Rule { name, joint, offset, direction }
}

/// Markers of the midline.
const MIDDLE: [Rule; 4] = [
    rule("c7", "neck", [0.0, 0.0, 0.0], [0.0, 0.0, -1.0]),
    rule("t10", "spine2", [0.0, 0.0, 0.0], [0.0, 0.0, -1.0]),
    rule("clavicle", "neck", [0.0, -0.05, 0.0], [0.0, 0.0, 1.0]),
    rule("sternum", "spine3", [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]),
];

/// Markers of the left side; the right side is mirrored.
const LEFT: [Rule; 17] = [
    rule("forehead", "head", [0.0, 0.10, 0.0], [0.6, 0.0, 0.8]),
    rule("back_head", "head", [0.0, 0.10, 0.0], [0.6, 0.0, -0.8]),
    rule("shoulder", "left_shoulder", [0.0, 0.0, 0.0], [0.0, 1.0, 0.0]),
    rule("upper_arm", "left_shoulder", [0.14, 0.0, 0.0], [0.0, 0.6, -0.8]),
    rule("elbow", "left_elbow", [0.0, 0.0, 0.0], [0.0, 0.6, -0.8]),
    rule("forearm", "left_elbow", [0.13, 0.0, 0.0], [0.0, 0.6, -0.8]),
    rule("thumb_wrist", "left_wrist", [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]),
    rule("little_finger_wrist", "left_wrist", [0.0, 0.0, 0.0], [0.0, 0.0, -1.0]),
    rule("hand", "left_hand", [0.0, 0.0, 0.0], [0.0, 1.0, 0.0]),
    rule("front_hip", "left_hip", [0.03, 0.08, 0.0], [0.0, 0.0, 1.0]),
    rule("back_hip", "left_hip", [-0.04, 0.10, 0.0], [0.0, 0.0, -1.0]),
    rule("thigh", "left_hip", [0.0, -0.22, 0.0], [1.0, 0.0, 0.0]),
    rule("knee", "left_knee", [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]),
    rule("shank", "left_knee", [0.0, -0.20, 0.0], [1.0, 0.0, 0.0]),
    rule("ankle", "left_ankle", [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]),
    rule("heel", "left_ankle", [0.0, -0.03, 0.0], [0.0, 0.0, -1.0]),
    rule("toe", "left_foot", [0.0, 0.0, 0.0], [0.0, 1.0, 0.3]),
];

/// A marker on a mesh.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Marker {
    /// Its name.
    pub name: String,
    /// Its vertex.
    pub vertex: usize,
}

/// The markers of a body model: those of the midline, then left and right alternating.
pub fn markers(model: &BodyModel) -> Vec<Marker> {
    let mesh = model.surface.shaped(&Betas::zeros());
    let place = |rule: &Rule, side: &str, mirror: f64| {
        let mirrored = |[x, y, z]: [f64; 3]| Vector3::new(x * mirror, y, z);
        let own = rule.joint.replace("left_", side);
        let joint = JOINT_NAMES.iter().position(|name| *name == own).expect("a test checks that all rules name joints");
        let start = model.rest_joints[joint] + mirrored(rule.offset);
        let vertex = nearest_to_ray(&mesh, &start, &mirrored(rule.direction).normalize());
        Marker { name: format!("{side}{}", rule.name), vertex }
    };
    let middle = MIDDLE.iter().map(|rule| place(rule, "", 1.0));
    let sides = LEFT.iter().flat_map(|rule| [place(rule, "left_", 1.0), place(rule, "right_", -1.0)]);
    middle.chain(sides).collect()
}

/// Index of the point ahead of `start` that is nearest to the ray along the unit vector `direction`.
fn nearest_to_ray(points: &[Vector3<f64>], start: &Vector3<f64>, direction: &Vector3<f64>) -> usize {
    let distance = |point: &Vector3<f64>| {
        let (from, along) = (point - start, (point - start).dot(direction));
        if along > 0.0 { (from - direction * along).norm() } else { f64::INFINITY }
    };
    let nearest = |best: (usize, f64), (i, d): (usize, f64)| if d < best.1 { (i, d) } else { best };
    points.iter().map(distance).enumerate().fold((0, f64::INFINITY), nearest).0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::default_body;
    use std::collections::BTreeSet;

    #[test]
    fn markers_are_distinct_mirrored_and_near_their_joints() {
        let model = default_body();
        let markers = markers(&model);
        assert_eq!(markers.len(), 38);
        assert_eq!(markers.iter().map(|m| m.vertex).collect::<BTreeSet<_>>().len(), 38);
        let place = |marker: &Marker| model.surface.vertices[marker.vertex];
        for pair in markers[MIDDLE.len()..].chunks(2) {
            let (left, right) = (place(&pair[0]), place(&pair[1]));
            let image = Vector3::new(-right.x, right.y, right.z);
            // Vertices are about 15 mm apart.
            assert!(left.x > 0.0 && (left - image).norm() < 0.015, "{}: {left} {right}", pair[0].name);
        }
        let on_the_left = markers[MIDDLE.len()..].iter().step_by(2);
        for (rule, marker) in MIDDLE.iter().zip(&markers).chain(LEFT.iter().zip(on_the_left)) {
            let joint = JOINT_NAMES.iter().position(|name| *name == rule.joint).unwrap();
            let ray = place(marker) - model.rest_joints[joint] - Vector3::from(rule.offset);
            let beside =
                ray - Vector3::from(rule.direction).normalize() * ray.dot(&Vector3::from(rule.direction).normalize());
            // The longest ray crosses half of the pelvis.
            assert!(ray.norm() < 0.2 && beside.norm() < 0.012, "{}: {ray} {beside}", marker.name);
        }
    }
}
