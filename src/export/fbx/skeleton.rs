//! The models of a person: a root, and a limb node per joint with its rest rotation.

use super::node::{Node, Property as P};
use super::objects::{ObjectId, Objects, integer, properties, property, text, vector};
use super::person::{CM, Person};
use crate::geometry::euler::zyx_angles;
use crate::session::formats::entries;
use nalgebra::Matrix3;

/// Numbers of a person's models.
pub(super) struct Models {
    /// Parent of the skeleton and the mesh.
    pub(super) root: ObjectId,
    pub(super) joints: Vec<ObjectId>,
}

/// Adds the models below `parent`. Rotations of zero are the rest pose: `local = T R_pre R`, where the pre-rotation gives
/// the axes along the bones.
pub(super) fn add_models(objects: &mut Objects, person: &Person<'_>, parent: ObjectId) -> Models {
    let root_attribute = objects.add("NodeAttribute", person.name, "NodeAttribute", "Null", vec![flags("Null")]);
    let root = objects.add("Model", person.name, "Model", "Null", model(vec![]));
    objects.connect(root_attribute, root);
    objects.connect(root, parent);
    let mut joints = vec![root; person.rig.n_joints()];
    for joint in 0..person.rig.n_joints() {
        let name = &person.joint_names[joint];
        let attribute = objects.add("NodeAttribute", name, "NodeAttribute", "LimbNode", vec![flags("Skeleton")]);
        let at = entries(&(person.rig.offset(joint) * CM));
        let placement = vec![
            vector("PreRotation", "Vector3D", "", angles_deg(&person.rig.rest(joint))),
            vector("Lcl Translation", "Lcl Translation", "A", at),
            vector("Lcl Rotation", "Lcl Rotation", "A", [0.0; 3]),
        ];
        joints[joint] = objects.add("Model", name, "Model", "LimbNode", model(placement));
        objects.connect(attribute, joints[joint]);
        objects.connect(joints[joint], person.rig.parents[joint].map_or(root, |parent| joints[parent]));
    }
    Models { root, joints }
}

/// The content of a model: the properties that all have, and those given.
pub(super) fn model(placement: Vec<Node>) -> Vec<Node> {
    let mut all = vec![
        property("RotationActive", "bool", "", "", [P::I32(1)]), // without it the pre-rotation is ignored
        property("InheritType", "enum", "", "", [P::I32(1)]),    // parent, then own: RSrs
        property("DefaultAttributeIndex", "int", "Integer", "", [P::I32(0)]),
        property("Visibility", "Visibility", "", "A", [P::F64(1.0)]),
    ];
    all.extend(placement);
    vec![
        integer("Version", 232),
        properties(all),
        Node::leaf("Shading", [P::Bool(true)]),
        Node::leaf("Culling", [text("CullingOff")]),
    ]
}

fn flags(kind: &str) -> Node {
    Node::leaf("TypeFlags", [text(kind)])
}

/// FBX's default order: `R = R_z R_y R_x`, given as x, y, z in degrees.
fn angles_deg(rotation: &Matrix3<f64>) -> [f64; 3] {
    let angles = zyx_angles(rotation);
    [angles.inner, angles.middle, angles.outer].map(f64::to_degrees)
}
