//! Least squares and dynamic programming, independent of cameras and bodies.
//!
//! - [`robust`]: bounded costs for residuals with outliers, medians and quantiles
//! - [`levenberg_marquardt`]: the damping loop of large problems, which assemble and solve their systems themselves
//! - [`dense_levenberg_marquardt`]: the same for a handful of unknowns, from a linearised cost
//! - [`point_chain`]: banded Cholesky of a trajectory of points, 3x3 blocks coupled by multiples of the identity
//! - [`block_banded`]: banded Cholesky with one dense block per frame, coupled over two frames, and a border
//! - [`arrow`]: many small systems coupled only through a few shared unknowns
//! - [`vectors`]: vector instructions of the processor at hand
//! - [`large_array`]: arrays of many megabytes in large pages
//! - [`determinant`]: determinants of factored matrices
//! - [`viterbi`]: the cheapest path through a few states per step

pub mod arrow;
pub mod block_banded;
pub mod dense_levenberg_marquardt;
pub mod determinant;
pub mod large_array;
pub mod levenberg_marquardt;
pub mod point_chain;
pub mod robust;
pub mod vectors;
pub mod viterbi;
