//! Each formula and its derivative, once.
//!
//! A residual is a free function: values and units in, a residual divided by its standard deviation out, with its
//! derivatives beside it. Robust weights are the caller's. Every derivative is pinned by one shared check against
//! central differences.

pub mod bone_length;
#[cfg(test)]
pub(crate) mod derivative_check;
pub mod joint_acceleration;
pub mod joint_angles;
pub mod pose_likelihood;
pub mod reprojection;
pub mod smoothness;
