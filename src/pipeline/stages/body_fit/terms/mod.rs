//! The terms of the objective in the order in which they are summed.
//!
//! | file | extent | cost |
//! |---|---|---|
//! | [`data`] | frame | triangulated points or detected pixels of landmarks |
//! | [`whitened_pixels`] | path | detected pixels whose errors are correlated in time |
//! | [`joint_limits`] | frame | ends of the joints' ranges, and the rest pose |
//! | [`pose_prior`] | frame | a Gaussian over recorded poses |
//! | [`completion`] | frame | Gaussians of the motion prior about joints that no camera shows |
//! | [`collision`] | frame | overlap with other persons' bodies |
//! | [`smoothness`] | three frames | accelerations of the pelvis and of the joint rotations |
//! | [`foot_contact`] | three frames | accelerations of the ankles in the world |
//! | [`border_priors`] | border | priors of betas, the person's bone offsets, the detector's keypoint offsets |
//!
//! A new term implements one of the traits of [`term`] and joins the list in `objective.rs`; `tests.rs` checks the
//! gradients of all. [`unknowns`] defines the unknowns and their places: three per group in every frame, and a border shared by
//! all frames.

pub(crate) mod border_priors;
pub(crate) mod camera_unknowns;
pub(crate) mod collision;
pub(crate) mod completion;
pub(crate) mod data;
pub(crate) mod foot_contact;
pub(crate) mod frame;
pub(crate) mod joint_limits;
pub(crate) mod landmark_jacobian;
pub(crate) mod noise_process;
pub(crate) mod path_system;
pub(crate) mod pose_prior;
pub(crate) mod smoothness;
pub(crate) mod speed_scaling;
pub(crate) mod term;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod tests_paths;
pub(crate) mod unknowns;
pub(crate) mod whitened_pixels;
pub(crate) mod window;
