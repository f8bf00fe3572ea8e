//! What a body is: skeleton, keypoint conventions, kinematics.

pub mod bones;
pub mod detector_noise;
pub mod skeleton;
