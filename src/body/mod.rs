//! What a body is: skeleton, keypoint conventions, kinematics.

pub mod skeleton;
