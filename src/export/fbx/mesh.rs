//! The mesh of a person, its skin, and the bind pose.

use super::node::{Node, Property as P};
use super::objects::{ObjectId, Objects, integer, text};
use super::person::{CM, Person};
use super::skeleton::{Models, model};
use crate::export::skin::{SkinMesh, vertices_by_joint};
use nalgebra::{Isometry3, Matrix4, Rotation3, UnitQuaternion, Vector3};

/// Adds the mesh below the person's root, skinned to the joints. Returns its model.
pub(super) fn add_mesh(objects: &mut Objects, person: &Person<'_>, models: &Models, mesh: &SkinMesh) -> ObjectId {
    let name = format!("{}_body", person.name);
    let geometry = objects.add("Geometry", &name, "Geometry", "Mesh", geometry(mesh));
    let mesh_model = objects.add("Model", &name, "Model", "Mesh", model(vec![]));
    objects.connect(geometry, mesh_model);
    objects.connect(mesh_model, models.root);
    add_skin(objects, person, models, mesh, geometry);
    add_bind_pose(objects, person, models, mesh_model);
    mesh_model
}

fn geometry(mesh: &SkinMesh) -> Vec<Node> {
    let coordinates = |points: &[Vector3<f64>], scale: f64| -> Vec<f64> {
        points.iter().flat_map(|p| [p.x * scale, p.y * scale, p.z * scale]).collect()
    };
    // The last corner of a face is stored as its complement.
    let corners = mesh.faces.iter().flat_map(|[a, b, c]| [*a as i32, *b as i32, !(*c as i32)]).collect();
    let normals = Node::new(
        "LayerElementNormal",
        [P::I32(0)],
        vec![
            integer("Version", 101),
            Node::leaf("Name", [text("")]),
            Node::leaf("MappingInformationType", [text("ByVertice")]), // the format's own spelling
            Node::leaf("ReferenceInformationType", [text("Direct")]),
            Node::leaf("Normals", [P::F64s(coordinates(&mesh.normals, 1.0))]),
        ],
    );
    let element = vec![Node::leaf("Type", [text("LayerElementNormal")]), integer("TypedIndex", 0)];
    let layer = vec![integer("Version", 100), Node::new("LayerElement", [], element)];
    vec![
        integer("GeometryVersion", 124),
        Node::leaf("Vertices", [P::F64s(coordinates(&mesh.vertices, CM))]),
        Node::leaf("PolygonVertexIndex", [P::I32s(corners)]),
        normals,
        Node::new("Layer", [P::I32(0)], layer),
    ]
}

fn add_skin(objects: &mut Objects, person: &Person<'_>, models: &Models, mesh: &SkinMesh, geometry: ObjectId) {
    let content = vec![integer("Version", 101), Node::leaf("Link_DeformAcuracy", [P::F64(50.0)])];
    let skin = objects.add("Deformer", person.name, "Deformer", "Skin", content);
    objects.connect(skin, geometry);
    for (joint, vertices) in vertices_by_joint(mesh).into_iter().enumerate() {
        let body_from_bone = rest_pose(person, joint);
        let content = vec![
            integer("Version", 100),
            Node::leaf("UserData", [text(""), text("")]),
            Node::leaf("Indexes", [P::I32s(vertices.iter().map(|(vertex, _)| *vertex as i32).collect())]),
            Node::leaf("Weights", [P::F64s(vertices.iter().map(|(_, weight)| *weight).collect())]),
            Node::leaf("Transform", [matrix(&body_from_bone.inverse())]),
            Node::leaf("TransformLink", [matrix(&body_from_bone)]),
        ];
        let cluster = objects.add("Deformer", &person.joint_names[joint], "SubDeformer", "Cluster", content);
        objects.connect(cluster, skin);
        objects.connect(models.joints[joint], cluster);
    }
}

fn add_bind_pose(objects: &mut Objects, person: &Person<'_>, models: &Models, mesh_model: ObjectId) {
    let entry = |id: ObjectId, place: &Isometry3<f64>| {
        Node::new("PoseNode", [], vec![Node::leaf("Node", [P::I64(id)]), Node::leaf("Matrix", [matrix(place)])])
    };
    let mut content = vec![
        Node::leaf("Type", [text("BindPose")]),
        integer("Version", 100),
        integer("NbPoseNodes", person.rig.n_joints() as i32 + 2),
        entry(models.root, &Isometry3::identity()),
        entry(mesh_model, &Isometry3::identity()),
    ];
    content.extend((0..person.rig.n_joints()).map(|joint| entry(models.joints[joint], &rest_pose(person, joint))));
    objects.add("Pose", person.name, "Pose", "BindPose", content);
}

/// `body_from_bone` in the rest pose, cm.
fn rest_pose(person: &Person<'_>, joint: usize) -> Isometry3<f64> {
    let axes = Rotation3::from_matrix_unchecked(person.rig.axes[joint]);
    Isometry3::from_parts((person.rig.joints[joint] * CM).into(), UnitQuaternion::from_rotation_matrix(&axes))
}

/// A matrix for row vectors row by row, which is a matrix for columns column by column.
fn matrix(pose: &Isometry3<f64>) -> P {
    let matrix: Matrix4<f64> = pose.to_homogeneous();
    P::F64s(matrix.as_slice().to_vec())
}
