//! Residuals and costs with their derivatives. Each formula has its only implementation here.
//!
//! A residual is a free function: values with units in, a residual divided by its standard deviation out, with its
//! derivatives. The caller applies robust weights unless the function returns a cost. One shared check compares every
//! derivative with central differences.

pub mod acceleration;
pub mod bone_length;
#[cfg(test)]
pub(crate) mod derivative_check;
pub mod interpenetration;
pub mod joint_angles;
pub mod pose_likelihood;
pub mod position_cost;
pub mod reprojection;
pub mod rotation_likelihood;
