//! What a body is: skeleton, keypoint conventions, kinematics.

pub mod anthropometry;
pub mod bone_offsets;
pub mod bones;
pub mod capsules;
pub mod default_body;
pub mod dense_landmarks;
pub mod detector_noise;
pub mod detector_offsets;
pub mod detector_profile;
pub mod gait;
pub mod generator;
pub mod hand;
pub mod human_speeds;
pub mod joint_angles;
pub mod joint_ranges;
pub mod keypoint_accelerations;
pub mod kinematics;
pub mod landmarks;
pub mod loader;
pub mod measures;
pub mod mocap_skeleton;
pub mod model;
pub mod scale;
pub mod segments;
pub mod shape;
pub mod skeleton;
pub mod skinning;
pub mod surface;

pub use default_body::default_body;
pub use model::{Betas, BodyModel};
