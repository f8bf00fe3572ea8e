//! Why a body file is refused.

use std::io;

/// The first fault found in a body file.
#[derive(Debug, thiserror::Error)]
pub enum BodyFileError {
    /// The file cannot be read.
    #[error("the file cannot be read: {0}")]
    Io(#[from] io::Error),
    /// Something is larger than any body model.
    #[error("{what} is larger than the {limit} that a body model may have")]
    TooLarge {
        /// What.
        what: &'static str,
        /// Bytes, elements or steps.
        limit: u64,
    },
    /// The pickle ends early or is no pickle.
    #[error("byte {offset}: {expected} expected; is this an .npz or .pkl body file?")]
    Malformed {
        /// Where reading stopped.
        offset: usize,
        /// What was expected there.
        expected: &'static str,
    },
    /// The pickle asks for something that no body model needs.
    #[error(
        "the pickle asks for {}.{}, which no body model needs; convert the file to .npz",
        module.escape_debug(),
        name.escape_debug()
    )]
    ForbiddenGlobal {
        /// Python module.
        module: String,
        /// Name in it.
        name: String,
    },
    /// A field is missing.
    #[error("the field {field} is missing; a SMPL model file has it")]
    Missing {
        /// Which.
        field: &'static str,
    },
    /// A field is not an array of numbers in a known form.
    #[error("{field}: {expected} expected; convert the file to .npz with plain arrays")]
    NotAnArray {
        /// Which.
        field: String,
        /// What was expected.
        expected: &'static str,
    },
    /// A field has another shape.
    #[error("{field}: shape {expected} expected, found {found:?}")]
    Shape {
        /// Which.
        field: &'static str,
        /// In letters: V vertices, F faces.
        expected: &'static str,
        /// What the file has.
        found: Vec<usize>,
    },
    /// Another model of the family.
    #[error("this is {model} ({joints} joints), which is not supported; use the SMPL file of 24 joints")]
    OtherModel {
        /// Its name.
        model: &'static str,
        /// Its joints.
        joints: usize,
    },
    /// A number breaks a rule.
    #[error("{field}, row {row}: {rule}")]
    Value {
        /// Which field.
        field: &'static str,
        /// Which row.
        row: usize,
        /// What must hold.
        rule: &'static str,
    },
    /// The landmark table does not fit the mesh.
    #[error("landmark {name}: vertex {vertex} is not one of the {n_vertices} of this body")]
    LandmarkVertex {
        /// Which landmark.
        name: String,
        /// Its vertex.
        vertex: usize,
        /// Vertices of the mesh.
        n_vertices: usize,
    },
}
