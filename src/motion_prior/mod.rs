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
//! - [`gaps`], [`objective`], [`training`]: its training
//! - [`weights`], [`prior`]: its file; the operations of a trained prior, at any frame rate (`grid`)
//! - [`evaluation`]: errors of hidden joints

pub mod basis;
pub mod bridge;
pub mod chart;
pub mod dataset;
pub mod denoiser;
pub mod denoiser_input;
pub mod drawing;
pub mod evaluation;
pub mod gaps;
mod grid;
pub mod interpolation;
pub mod joints;
pub mod motion_file;
pub mod motion_writer;
pub mod objective;
pub mod observed;
pub mod pose_gaussian;
pub mod prior;
pub mod training;
pub mod weights;

pub use prior::MotionPrior;
