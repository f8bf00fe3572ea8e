//! residuals

pub mod joint_acceleration;
pub mod joint_angles;
