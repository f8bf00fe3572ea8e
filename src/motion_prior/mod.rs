//! What is known of human motion: a variational autoencoder over whole takes, trained here and shipped inside.
//!
//! In reading order:
//!
//! - [`chart`]: rotations as 57 numbers a frame; joints outside the latent
//! - [`joints`]: joint positions from them, and the way back
//! - [`basis`]: the frozen linear code
//! - [`pose_gaussian`]: which poses are likely
//! - [`paths`]: what smoothing alone makes of a take
//! - [`checkpoint`]: the file of a trained prior
//! - [`interpolation`]: rotations between samples, with derivatives
//! - [`motion_file`], [`motion_writer`], [`dataset`]: motion capture in the AMASS layout
//! - [`windows`], [`prior`]: long takes, and all that can be asked of a trained prior
//! - [`corruption`], [`training`]: how the network learns
//! - [`evaluation`]: how good it is

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
