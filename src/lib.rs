//! **wandless** recovers moving people and the cameras that filmed them, together, without a calibration wand.
//!
//! # The map, in reading order
//!
//! Nouns lie at the bottom, verbs above, callers on top; nothing looks up. `tests/layering.rs` holds the table of who
//! may import whom.
//!
//! - [`geometry`]: pure maths on rotations, rigid motions, cameras and rays
//! - [`formats`]: NumPy's `.npy` and `.npz` files
//! - [`progress`]: progress and cancellation, all that the core knows of its caller
//! - [`optim`]: least squares that knows no cameras and no bodies
//! - [`body`]: what a body is: skeleton, keypoint conventions, kinematics
//! - [`motion_prior`]: what is known of human motion: a network over whole takes, trained here, shipped inside
//! - [`session`]: every noun that travels, from the recording to the reconstruction
//! - [`residuals`]: each formula and its derivative, once
//! - [`estimation`]: how one geometric thing is found robustly
//! - [`matching`]: who is who, across views and time
//! - [`simulation`]: seeded scenes with exact truth and named noise
//! - [`evaluation`]: errors of cameras, poses and identities against truth
//! - [`export`]: the result folder, one file a format
//! - [`pipeline`]: the stages, in order
//! - `service` (feature `service`): sessions and jobs over HTTP, each job in a supervised child process
//! - `cli` (feature `cli`): the commands
//!
//! # Conventions
//!
//! Transforms are named `target_from_source`, points `x_in_frame`. Metres, radians, seconds, pixels, `f64`. Cameras
//! look along +z, x right, y down; pixel (0, 0) is the centre of the first pixel.

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
pub mod progress;
pub mod residuals;
#[cfg(feature = "service")]
pub mod service;
pub mod session;
pub mod simulation;
