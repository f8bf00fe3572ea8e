//! Pickles, protocols 0 to 4, as an inert tree: nothing is imported, nothing is called.
//!
//! Nodes are stored in one vector and refer to each other by index, so that a file that refers to itself does not make
//! an infinite value; code that walks the tree bounds the depth. Every count is checked before memory is reserved.

mod escapes;
mod machine;
mod node;

pub(super) use node::{Global, Node, NodeId};

use super::error::BodyFileError;
use machine::{Machine, Step};

/// Most opcodes of a file; released models have some hundreds.
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
