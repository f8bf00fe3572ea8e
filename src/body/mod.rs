//! What a body is: skeleton, keypoint conventions, kinematics.

pub mod anthropometry;
pub mod bones;
pub mod default_body;
pub mod detector_noise;
pub mod joint_ranges;
pub mod kinematics;
pub mod model;
pub mod scale;
pub mod skeleton;

pub use default_body::default_body;
pub use model::{Betas, BodyModel};
