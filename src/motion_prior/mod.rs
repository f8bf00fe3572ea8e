//! The motion prior: how people move where cameras do not see them.
//!
//! In reading order:
//!
//! - [`motion_file`], [`motion_writer`], [`dataset`]: motion capture in the AMASS layout
//! - [`interpolation`]: rotations between samples
//! - [`chart`], [`joints`], [`basis`]: rotations as 57 numbers a frame; joint positions; the linear code of single poses
//! - [`pose_gaussian`]: the linear code as a Gaussian over poses
//! - [`drawing`]: motions drawn from it
//! - [`observed`], [`bridge`]: motions with gaps; paths through the gaps that need no network
//! - [`denoiser_input`], [`denoiser`]: the network that corrects them and states its uncertainty
//! - [`weights`], [`prior`]: its file; the operations of a trained prior, at any frame rate ([`grid`])
//! - [`gru`], [`vae`]: the paper's latent motion prior, an autoencoder
//! - [`latent_prior`]: its operations once it is trained, in windows (`time_windows`)
//! - [`gaps`], [`objective`], [`vae_objective`], [`training`]: training of both (`denoiser_training`, `vae_training`) on
//!   `stretches` of takes, by gradient `descent`
//! - [`evaluation`], [`reconstruction`]: errors of hidden joints; of motions after encoding and decoding

pub mod basis;
pub mod bridge;
pub mod chart;
pub mod dataset;
pub mod denoiser;
pub mod denoiser_input;
mod denoiser_training;
mod descent;
pub mod drawing;
pub mod evaluation;
pub mod gaps;
pub mod grid;
pub mod gru;
pub mod interpolation;
pub mod joints;
pub mod latent_prior;
pub mod motion_file;
pub mod motion_writer;
pub mod objective;
pub mod observed;
pub mod pose_gaussian;
pub mod prior;
pub mod reconstruction;
mod stretches;
mod time_windows;
pub mod training;
pub mod vae;
pub mod vae_objective;
mod vae_training;
pub mod weights;

pub use latent_prior::LatentPrior;
pub use prior::MotionPrior;
