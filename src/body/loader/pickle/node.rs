//! The values of a pickle.

use std::borrow::Cow;

/// Index of a node in the vector of all nodes.
pub(crate) type NodeId = usize;

/// A value of the pickle.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Node<'a> {
    /// `None`, and sets, which no field uses.
    None,
    /// A truth value or an integer; larger ones than 64 bits become `None`.
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
    /// A Python object from the list of allowed ones.
    Global(Global),
    /// The result of calling `callable`, which is not called, and the state set on it.
    Object {
        /// A global, or another object.
        callable: NodeId,
        /// Its arguments.
        arguments: NodeId,
        /// State, if one was set.
        state: Option<NodeId>,
    },
}

/// The Python objects that a body model's pickle may refer to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Global {
    /// Creates an empty array, filled by its state.
    ArrayReconstruct,
    /// A numpy scalar.
    Scalar,
    /// The array class.
    NdArray,
    /// The element type.
    DType,
    /// Bytes written as text.
    Encode,
    /// Creates an empty object, filled by its state.
    Reconstructor,
    /// Python's base class or empty set.
    Plain,
    /// A sparse matrix stored by columns.
    Csc,
    /// A sparse matrix stored by rows.
    Csr,
    /// A chumpy leaf, whose value is `x`.
    Ch,
    /// A chumpy choice of elements.
    Select,
}

impl Global {
    /// The object of a name in a module; `None` if it is not allowed.
    pub(super) fn named(module: &str, name: &str) -> Option<Self> {
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
