//! Errors of cameras, poses and identities relative to ground truth.

pub mod alignment;
pub mod camera_error;
pub mod documents;
pub mod error;
pub mod identity_error;
pub mod jitter;
pub mod joint_error;
pub mod marker_error;
pub mod markers;
pub mod person_matching;
pub mod report;
pub mod shelf14;
mod table;
pub mod world_error;

pub use camera_error::{CameraPair, camera_errors, relative_camera_error};
pub use error::EvaluationError;
pub use report::{Evaluation, EvaluationOptions, evaluate};

#[cfg(test)]
mod reference_tests;
