//! The objects of a scene and their connections, under construction.

use super::node::{Node, Property as P};

/// Number of an object; 0 is the scene itself.
pub(super) type ObjectId = i64;

/// The scene, as the parent of objects.
pub(super) const SCENE: ObjectId = 0;

/// Objects and connections, in the order of the file.
#[derive(Default)]
pub(super) struct Objects {
    pub(super) nodes: Vec<Node>,
    pub(super) connections: Vec<Node>,
}

impl Objects {
    /// Adds an object: its record, its name with its class, its kind within the class, and its content.
    pub(super) fn add(
        &mut self,
        record: &'static str,
        name: &str,
        class: &str,
        kind: &str,
        content: Vec<Node>,
    ) -> ObjectId {
        let id = 1_000_000 + self.nodes.len() as ObjectId; // beyond the small numbers that programs reserve
        let full_name = format!("{name}\u{0}\u{1}{class}");
        self.nodes.push(Node::new(record, [P::I64(id), P::Text(full_name), text(kind)], content));
        id
    }

    /// Puts an object below another.
    pub(super) fn connect(&mut self, child: ObjectId, parent: ObjectId) {
        self.connections.push(Node::leaf("C", [text("OO"), P::I64(child), P::I64(parent)]));
    }

    /// Lets an object drive a property of another.
    pub(super) fn connect_property(&mut self, source: ObjectId, target: ObjectId, property: &str) {
        self.connections.push(Node::leaf("C", [text("OP"), P::I64(source), P::I64(target), text(property)]));
    }
}

pub(super) fn text(text: &str) -> P {
    P::Text(text.to_owned())
}

pub(super) fn integer(name: &'static str, value: i32) -> Node {
    Node::leaf(name, [P::I32(value)])
}

/// The record `Properties70` with typed properties.
pub(super) fn properties(properties: Vec<Node>) -> Node {
    Node::new("Properties70", [], properties)
}

/// A property: name, type, second name of the type, flags (`A` animatable), values.
pub(super) fn property(name: &str, kind: &str, label: &str, flags: &str, values: impl IntoIterator<Item = P>) -> Node {
    let head = [text(name), text(kind), text(label), text(flags)];
    Node::leaf("P", head.into_iter().chain(values).collect::<Vec<_>>())
}

pub(super) fn vector(name: &str, kind: &str, flags: &str, values: [f64; 3]) -> Node {
    property(name, kind, if kind == "Vector3D" { "Vector" } else { "" }, flags, values.map(P::F64))
}
