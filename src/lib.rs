//! **wandless** reconstructs moving people and the cameras that filmed them from 2D poses, without a calibration wand.
//!
//! ```no_run
//! use wandless::prelude::*;
//!
//! fn main() -> Result<(), Box<dyn std::error::Error>> {
//!     let loaded = read_path("session".as_ref(), &UploadLimits::default())?;
//!     let result = reconstruct(&loaded.session, &Options::default(), &Progress::silent())?;
//!     for (view, camera) in loaded.session.views.iter().zip(&result.cameras) {
//!         if let Some(camera_from_world) = camera.camera_from_world {
//!             println!("camera {} at {} m", view.id, camera_from_world.center());
//!         }
//!     }
//!     for motion in &result.motions {
//!         println!("person {}: {} frames, shape {:?}", motion.person.0, motion.frames.len(), motion.betas);
//!     }
//!     Ok(())
//! }
//! ```
//!
//! [`session::SessionBuilder`] builds sessions from data in memory. `examples/` holds complete programs: from a folder, from
//! data in memory, and from detector output to glTF.
//!
//! # Modules, in reading order
//!
//! Imports point downwards only: data types at the bottom, algorithms above them, callers on top.
//!
//! - [`prelude`]: the names that most programs need
//! - [`geometry`]: rotations, rigid transforms, cameras, rays
//! - [`formats`]: NumPy's `.npy` and `.npz` files
//! - [`progress`]: progress reports and cancellation
//! - [`optim`]: least-squares solvers and robust kernels
//! - [`body`]: the body model: skeleton, keypoint conventions, shape, kinematics, skinning
//! - [`motion_prior`]: the network that completes unseen joints, its training and its embedded weights
//! - [`session`]: sessions, views, detections and reconstructions; readers of all input formats
//! - [`residuals`]: residuals of the objective with their derivatives
//! - [`estimation`]: robust estimators: essential matrix, camera pose, triangulation
//! - [`matching`]: association of detections to people, across views and time
//! - [`simulation`]: simulated sessions with exact ground truth
//! - [`evaluation`]: errors of cameras, poses and identities against ground truth
//! - [`export`]: the result folder and its file formats
//! - [`pipeline`]: the stages of a reconstruction, in order
//! - `service` (feature `service`): sessions and jobs over HTTP; each job runs in a supervised child process
//! - `cli` (feature `cli`): the commands of the `wandless` binary
//!
//! # Conventions
//!
//! Transforms are named `target_from_source`, points `x_in_frame`. Units are metres, radians, seconds and pixels, `f64`.
//! Cameras look along +z with x right and y down; pixel (0, 0) is the centre of the first pixel.

pub mod body;
#[cfg(feature = "cli")]
pub mod cli;
pub mod estimation;
pub mod evaluation;
pub mod export;
pub mod formats;
pub mod geometry;
pub mod matching;
pub mod motion_prior;
pub mod optim;
pub mod pipeline;
pub mod prelude;
pub mod progress;
pub mod residuals;
#[cfg(feature = "service")]
pub mod service;
pub mod session;
pub mod simulation;
