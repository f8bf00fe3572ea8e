//! The motion prior: a variational autoencoder over whole takes, its training, and the embedded weights.
//!
//! In reading order:
//!
//! - [`chart`]: rotations as 57 numbers a frame; joints outside the latent
//! - [`joints`]: joint positions from features, with the backward pass
//! - [`basis`]: the frozen linear code
//! - [`pose_gaussian`]: a Gaussian over poses
//! - [`paths`]: candidate paths by smoothing
//! - [`checkpoint`]: the file of a trained prior
//! - [`interpolation`]: rotations between samples
//! - [`motion_file`], [`motion_writer`], [`dataset`]: motion capture in the AMASS layout
//! - [`windows`], [`prior`]: long takes; the operations of a trained prior
//! - [`corruption`], [`training`]: training of the network
//! - [`evaluation`]: errors of a prior on test takes

pub mod basis;
pub mod chart;
pub mod checkpoint;
mod clips;
pub mod corruption;
pub mod dataset;
mod encoder_input;
pub mod evaluation;
mod fusion;
mod gru;
pub mod interpolation;
pub mod joints;
mod layers;
pub mod motion_file;
pub mod motion_writer;
mod objective;
pub mod optimizer;
mod panels;
pub mod paths;
mod pentadiagonal;
pub mod pose_gaussian;
pub mod prior;
mod self_contact;
mod shape;
mod six_d;
pub mod training;
mod trunk;
mod vae;
pub mod windows;

pub use prior::MotionPrior;
pub use shape::{VaeForm, VaeShape};
