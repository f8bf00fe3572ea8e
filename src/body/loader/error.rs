//! Why a body file is rejected.

use crate::formats::npy::NpyError;
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
        /// What is too large.
        what: &'static str,
        /// Largest allowed size, bytes, elements or steps.
        limit: u64,
    },
    /// The pickle ends early or is damaged.
    #[error("byte {offset}: {expected} expected; is this an .npz or .pkl body file?")]
    Malformed {
        /// Byte at which reading stopped.
        offset: usize,
        /// What was expected there.
        expected: &'static str,
    },
    /// The pickle refers to a Python object that no body model needs.
    #[error(
        "the pickle refers to {}.{}, which no body model needs; convert the file to .npz",
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
    #[error("the field {field} is missing; every SMPL model file has it")]
    Missing {
        /// Name of the field.
        field: &'static str,
    },
    /// A field is not an array of numbers in a known form.
    #[error("{field}: {expected} expected; convert the file to .npz with plain arrays")]
    NotAnArray {
        /// Name of the field.
        field: String,
        /// What was expected.
        expected: &'static str,
    },
    /// A field does not have the expected shape.
    #[error("{field}: shape {expected} expected, found {found:?}")]
    Shape {
        /// Name of the field.
        field: &'static str,
        /// Expected shape in letters: V vertices, F faces.
        expected: &'static str,
        /// Shape in the file.
        found: Vec<usize>,
    },
    /// The pickle holds a larger model of the SMPL family.
    #[error("this pickle holds {model} ({joints} joints), which is read as .npz only; use the model's .npz file")]
    OtherModel {
        /// Name of the model.
        model: &'static str,
        /// Number of its joints.
        joints: usize,
    },
    /// A number violates a rule.
    #[error("{field}, row {row}: {rule}")]
    Value {
        /// Name of the field.
        field: &'static str,
        /// Row of the array.
        row: usize,
        /// The rule.
        rule: &'static str,
    },
    /// The landmark table does not fit the mesh.
    #[error("landmark {name}: vertex {vertex} is not one of the {n_vertices} of this body")]
    LandmarkVertex {
        /// Name of the landmark.
        name: String,
        /// Vertex in the table.
        vertex: usize,
        /// Number of vertices of the mesh.
        n_vertices: usize,
    },
}

impl BodyFileError {
    /// The error of an array in a body file.
    pub(super) fn of_array(field: &str, error: NpyError) -> Self {
        let not_an_array = |expected| Self::NotAnArray { field: field.to_owned(), expected };
        match error {
            NpyError::Io(error) => Self::Io(error),
            NpyError::Archive(_) => Self::Malformed { offset: 0, expected: "a readable zip archive" },
            NpyError::Header(_) => not_an_array("a numpy array"),
            NpyError::NotNumbers { .. } => not_an_array("an array of numbers"),
            NpyError::TooLarge { limit, .. } => Self::TooLarge { what: "an array", limit: limit as u64 },
            NpyError::Length { .. } => not_an_array("as many bytes as the shape says"),
        }
    }
}
