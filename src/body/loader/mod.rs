//! Reading a body file: SMPL's `.npz` and official `.pkl`, SMPL-H's and SMPL-X's `.npz`, and our own layout.
//!
//! The user's model keeps the user's licence; its numbers stay in memory. Nothing in a file is ever executed: pickles
//! become an inert tree, of which only numeric arrays are read.
//!
//! Fields (V vertices, F faces, 24 joints): `v_template` (V, 3), `shapedirs` (V, 3, n >= 1, of which ten are used),
//! `weights` (V, 24), `J_regressor` (24, V) dense or sparse, `kintree_table` (2, 24), `f` (F, 3), optional `posedirs`
//! (V, 3, 207); ours adds landmarks as sparse rows. All other fields are ignored. SMPL-H (52 joints) and SMPL-X (55) are
//! folded to 24 joints (`larger_models`).

mod assemble;
mod cache;
mod error;
mod fields;
mod landmark_table;
mod larger_models;
mod npz;
mod pickle;
mod read;
mod tree;
mod write;

pub use cache::{CachedBody, load_body_cached, write_private};
pub use error::BodyFileError;
pub use landmark_table::{LandmarkTable, LandmarkTableError};
pub use read::{body_from_bytes, load_body};
pub(crate) use tree::arrays_of_pickle;
pub use write::{body_glb, body_npz, body_obj};
