//! Pickles, protocols 0 to 4, as an inert tree: nothing is imported, nothing is called.
//!
//! Nodes live in one vector and refer to each other by index, so a file that refers to itself makes no endless value;
//! whoever walks the tree bounds the depth. Every count is bounded before memory is taken.

mod escapes;
mod machine;

use super::error::BodyFileError;
use machine::{Machine, Step};
use std::borrow::Cow;

/// Index of a node.
pub(super) type NodeId = usize;

/// A value of the pickle.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Node<'a> {
    /// `None`, and sets, which no field needs.
    None,
    /// A truth value or an integer; one beyond 64 bits is not kept.
    Int(i64),
    /// A float.
    Float(f64),
    /// Python's bytes, and Python 2's strings.
    Bytes(Cow<'a, [u8]>),
    /// Text.
    Text(Cow<'a, str>),
    /// A tuple or list.
    Sequence(Vec<NodeId>),
    /// A dictionary.
    Dict(Vec<(NodeId, NodeId)>),
    /// A name in a module, from the list of those allowed.
    Global(Global),
    /// What calling `callable` would have given, and the state set upon it.
    Object {
        /// A global, or another object.
        callable: NodeId,
        /// Its arguments.
        arguments: NodeId,
        /// State, where one was set.
        state: Option<NodeId>,
    },
}

/// What a body model's pickle may name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Global {
    /// Makes an empty array, filled by its state.
    ArrayReconstruct,
    /// A numpy scalar.
    Scalar,
    /// The array class.
    NdArray,
    /// The element type.
    DType,
    /// Bytes spelt as text.
    Encode,
    /// Makes an empty object, filled by its state.
    Reconstructor,
    /// Python's base class or empty set.
    Plain,
    /// A matrix by columns.
    Csc,
    /// A matrix by rows.
    Csr,
    /// A chumpy leaf: its `x`.
    Ch,
    /// A chumpy choice of elements.
    Select,
}

impl Global {
    fn named(module: &str, name: &str) -> Option<Self> {
        Some(match (module, name) {
            ("numpy.core.multiarray" | "numpy._core.multiarray", "_reconstruct") => Self::ArrayReconstruct,
            ("numpy.core.multiarray" | "numpy._core.multiarray", "scalar") => Self::Scalar,
            ("numpy", "ndarray") => Self::NdArray,
            ("numpy", "dtype") => Self::DType,
            ("_codecs", "encode") => Self::Encode,
            ("copy_reg" | "copyreg", "_reconstructor") => Self::Reconstructor,
            ("__builtin__" | "builtins", "object" | "set") => Self::Plain,
            ("scipy.sparse.csc" | "scipy.sparse._csc", "csc_matrix" | "csc_array") => Self::Csc,
            ("scipy.sparse.csr" | "scipy.sparse._csr", "csr_matrix" | "csr_array") => Self::Csr,
            ("chumpy.ch", "Ch") => Self::Ch,
            ("chumpy.reordering", "Select") => Self::Select,
            _ => return None,
        })
    }
}

/// Opcodes in a file; released models have some hundreds.
const MAX_STEPS: usize = 400_000;

/// A parsed pickle.
#[derive(Debug)]
pub(super) struct Pickle<'a> {
    /// All nodes.
    pub nodes: Vec<Node<'a>>,
    /// The value of the whole.
    pub root: NodeId,
}

/// Parses a pickle.
pub(super) fn parse(bytes: &[u8]) -> Result<Pickle<'_>, BodyFileError> {
    let mut machine = Machine::new(bytes);
    for _ in 0..MAX_STEPS {
        if machine.step()? == Step::Done {
            let root = machine.pop()?;
            return Ok(Pickle { nodes: machine.nodes, root });
        }
    }
    Err(BodyFileError::TooLarge { what: "the number of pickle opcodes", limit: MAX_STEPS as u64 })
}
