//! Least squares that knows no cameras and no bodies.
//!
//! - [`robust`]: a bounded cost for residuals of which some are grossly wrong
//! - [`levenberg_marquardt`]: the damping loop, written once
//! - [`point_chain`]: points in a row, each held to its neighbours
//! - [`block_banded`]: one dense block per frame, coupled over two frames, with a border
//! - [`arrow`]: many small local systems coupled only through a few shared unknowns
//! - [`viterbi`]: the cheapest path through a few states per step

pub mod arrow;
pub mod block_banded;
pub mod dense_levenberg_marquardt;
pub mod levenberg_marquardt;
pub mod point_chain;
pub mod robust;
pub mod viterbi;
