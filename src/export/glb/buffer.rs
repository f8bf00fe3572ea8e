//! The binary part of a glb: one buffer, with a view and an accessor per array.

use serde_json::{Value, json};
use std::io;

const GLTF_MAGIC: u32 = 0x4654_6c67;
const GLTF_VERSION: u32 = 2;
const JSON_CHUNK: u32 = 0x4e4f_534a;
const BINARY_CHUNK: u32 = 0x004e_4942;
const FLOAT: u32 = 5126;
const UNSIGNED_BYTE: u32 = 5121;
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// Element type of an accessor.
#[derive(Clone, Copy)]
pub(super) enum Element {
    Scalar,
    Vec3,
    Vec4,
    Mat4,
}

impl Element {
    /// glTF's name, and the number of values.
    fn layout(self) -> (&'static str, usize) {
        match self {
            Self::Scalar => ("SCALAR", 1),
            Self::Vec3 => ("VEC3", 3),
            Self::Vec4 => ("VEC4", 4),
            Self::Mat4 => ("MAT4", 16),
        }
    }
}

/// The buffer under construction.
#[derive(Default)]
pub(super) struct Buffer {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Buffer {
    /// Adds floats with their bounds, which glTF requires for times and positions; returns the index of the accessor.
    pub(super) fn floats(&mut self, values: &[f32], element: Element) -> usize {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes());
        let accessor = self.add(bytes, None, FLOAT, values.len(), element);
        let (_, width) = element.layout();
        if width <= 3 {
            let of_column = |c: usize| values.iter().skip(c).step_by(width).copied();
            let bound = |pick: fn(f32, f32) -> f32| -> Vec<Option<f32>> {
                (0..width).map(|c| of_column(c).reduce(pick)).collect()
            };
            let (min, max) = (bound(f32::min), bound(f32::max));
            self.accessors[accessor]["min"] = json!(min);
            self.accessors[accessor]["max"] = json!(max);
        }
        accessor
    }

    /// Adds floats of vertices.
    pub(super) fn vertex_floats(&mut self, values: &[f32], element: Element) -> usize {
        let accessor = self.floats(values, element);
        self.views[accessor]["target"] = json!(ARRAY_BUFFER);
        accessor
    }

    /// Adds four bytes per vertex.
    pub(super) fn vertex_bytes(&mut self, values: &[[u8; 4]]) -> usize {
        let bytes = values.iter().flatten().copied();
        self.add(bytes, Some(ARRAY_BUFFER), UNSIGNED_BYTE, values.len() * 4, Element::Vec4)
    }

    /// Adds indices of triangles.
    pub(super) fn indices(&mut self, values: &[u32]) -> usize {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes());
        self.add(bytes, Some(ELEMENT_ARRAY_BUFFER), UNSIGNED_INT, values.len(), Element::Scalar)
    }

    fn add(
        &mut self,
        bytes: impl Iterator<Item = u8>,
        target: Option<u32>,
        component_type: u32,
        n_values: usize,
        element: Element,
    ) -> usize {
        let offset = self.bytes.len();
        self.bytes.extend(bytes);
        let mut view = json!({ "buffer": 0, "byteOffset": offset, "byteLength": self.bytes.len() - offset });
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        fill(&mut self.bytes, 0);
        let (index, (name, width)) = (self.views.len(), element.layout());
        self.views.push(view);
        self.accessors.push(json!({
            "componentType": component_type, "bufferView": index, "count": n_values / width, "type": name,
        }));
        index
    }

    /// The whole file: `root` completed with the buffer's views and accessors.
    ///
    /// # Errors
    /// Beyond 4 GiB, the limit of the format's 32-bit sizes.
    pub(super) fn into_glb(self, mut root: Value) -> io::Result<Vec<u8>> {
        if !self.bytes.is_empty() {
            root["buffers"] = json!([{ "byteLength": self.bytes.len() }]);
            root["bufferViews"] = Value::from(self.views);
            root["accessors"] = Value::from(self.accessors);
        }
        let mut text = serde_json::to_vec(&root)?;
        fill(&mut text, b' ');
        let mut chunks = vec![(JSON_CHUNK, text)];
        if !self.bytes.is_empty() {
            chunks.push((BINARY_CHUNK, self.bytes));
        }
        let n_bytes = 12 + chunks.iter().map(|(_, bytes)| 8 + bytes.len()).sum::<usize>();
        let counted =
            |n: usize| u32::try_from(n).map_err(|_| io::Error::other("the scene exceeds 4 GiB, the limit of a glb"));
        let mut glb = Vec::with_capacity(n_bytes);
        for word in [GLTF_MAGIC, GLTF_VERSION, counted(n_bytes)?] {
            glb.extend(word.to_le_bytes());
        }
        for (kind, bytes) in chunks {
            glb.extend(counted(bytes.len())?.to_le_bytes());
            glb.extend(kind.to_le_bytes());
            glb.extend(bytes);
        }
        Ok(glb)
    }
}

/// Pads to a multiple of four bytes, where chunks and arrays start.
fn fill(bytes: &mut Vec<u8>, with: u8) {
    bytes.resize(bytes.len().next_multiple_of(4), with);
}
