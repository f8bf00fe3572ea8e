//! Errors of cameras, poses and identities against truth.
//!
//! - [`alignment`]: the transform between the result's world and the truth's
//! - [`camera_error`]: position, orientation and reprojection of cameras; relative errors, which need no alignment
//! - [`shelf14`]: every skeleton as the 14 joints that pose errors are defined on
//! - [`joint_error`]: PCP and MPJPE
//! - [`jitter`]: mean acceleration
//! - [`identity_error`]: who was taken for whom
//! - [`documents`]: the files that all of it is read from
//! - [`report`]: one result against one truth, as a table and as JSON

pub mod alignment;
pub mod camera_error;
pub mod documents;
pub mod identity_error;
pub mod jitter;
pub mod joint_error;
pub mod report;
pub mod shelf14;

pub use camera_error::{CameraPair, camera_errors, relative_camera_error};
pub use report::{Evaluation, EvaluationError, EvaluationOptions, evaluate};

#[cfg(test)]
mod reference_tests;
