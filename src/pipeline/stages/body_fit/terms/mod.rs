//! The terms of the objective, one file each, in the order in which they are summed.
//!
//! | file | extent | cost |
//! |---|---|---|
//! | [`data`] | frame | triangulated points or detected pixels of landmarks |
//! | [`joint_limits`] | frame | ends of the joints' ranges, and the rest pose |
//! | [`pose_prior`] | frame | a Gaussian over recorded poses |
//! | [`collision`] | frame | overlap with other persons' bodies |
//! | [`smoothness`] | three frames | accelerations of the pelvis and of the joint rotations |
//! | [`foot_contact`] | three frames | accelerations of the ankles in the world |
//! | [`shape`] | border, person | prior of the betas |
//! | [`bone_lengths`] | border, person | prior of the person's bone offsets |
//! | [`keypoint_bias`] | border, session | prior of the detector's keypoint offsets |
//!
//! A new term implements one of the traits of [`term`] and joins the list in `objective.rs`; `tests.rs` checks the
//! gradients of all. [`unknowns`] defines the unknowns and their places: three per group in every frame, and a border shared by
//! all frames.

pub(crate) mod bone_lengths;
pub(crate) mod collision;
pub(crate) mod data;
pub(crate) mod foot_contact;
pub(crate) mod frame;
pub(crate) mod frame_system;
pub(crate) mod joint_limits;
pub(crate) mod keypoint_bias;
pub(crate) mod landmark_jacobian;
pub(crate) mod pose_prior;
pub(crate) mod shape;
pub(crate) mod smoothness;
pub(crate) mod speed_scaling;
pub(crate) mod term;
#[cfg(test)]
mod tests;
pub(crate) mod unknowns;
pub(crate) mod window;
