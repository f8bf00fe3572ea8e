//! Errors of cameras, poses and identities relative to ground truth.
//!
//! - [`alignment`]: the transform between the result's world and the truth's
//! - [`camera_error`]: position, orientation and reprojection of cameras; relative errors, which need no alignment
//! - [`shelf14`]: conversion of every skeleton to the 14 joints of the pose errors
//! - [`person_matching`], [`joint_error`]: PCP and MPJPE
//! - [`markers`], [`marker_error`]: virtual markers on the true and the fitted skin
//! - [`jitter`]: mean acceleration
//! - [`identity_error`]: accuracy of the assignment of detections to people
//! - [`documents`]: readers of the files that an evaluation needs
//! - [`report`]: evaluation of one result, as a table and as JSON

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

pub use camera_error::{CameraPair, camera_errors, relative_camera_error};
pub use error::EvaluationError;
pub use report::{Evaluation, EvaluationOptions, evaluate};

#[cfg(test)]
mod reference_tests;
