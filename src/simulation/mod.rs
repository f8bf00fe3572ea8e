//! Seeded sessions with exact truth and documented noise, for tests, demo and benchmarks.
//!
//! In reading order:
//!
//! - [`config`], [`presets`]: people, cameras and noise of a session
//! - [`skeleton`]: the simulated body, deliberately not the body model of the fit
//! - `individual`: default bodies with moved joints, and a detector with a keypoint bias
//! - [`choreography`], `action_generator`, [`gait`]: people who walk, stop, turn, crouch, sit, reach and gesture
//! - `dance`: two people within arms' reach; `running`: people who run through
//! - [`placement`], `drawn`: people from motion capture (AMASS layout) or from the motion prior, put on the floor
//! - [`landmarks`]: the true keypoints of a posed skeleton
//! - [`rig`]: cameras around the scene
//! - [`scene`]: joints and true keypoints over time; recordings
//! - [`occlusion`], `projection`: the true keypoints in the image
//! - `observer`, [`detector`]: the detections of each camera
//! - `preset_errors`: independent errors of keypoints, the noise of the presets
//! - [`real_noise`], `real_errors`, `ghosts`, `merged_limbs`: the noise of a real detector; `processes`: what lasts
//! - [`hands`]: fingers, hands and faces, where the convention has their points
//! - [`truth`]: the exact truth, and its files
//! - [`mistakes`]: mistakes that users make with the files of a recording
//!
//! World: y up, metres, floor at y = 0. Every random number comes from a ChaCha8 stream keyed by the seed and by its
//! item (camera, person), so that an additional camera does not change the others.

mod action_generator;
pub mod choreography;
pub mod config;
mod dance;
pub mod detector;
mod drawn;
mod error;
pub mod gait;
mod ghosts;
pub mod hands;
mod individual;
mod keypoint_errors;
pub mod landmarks;
mod merged_limbs;
pub mod mistakes;
mod observer;
pub mod occlusion;
pub mod placement;
mod preset_errors;
pub mod presets;
mod processes;
mod projection;
mod random;
mod real_errors;
pub mod real_noise;
pub mod rig;
mod running;
pub mod scene;
mod simulate;
pub mod skeleton;
mod stretched_errors;
mod tracker;
pub mod truth;

pub use config::{Arrangement, Bodies, Lens, MotionSource, NoiseConfig, RigConfig, SimulationConfig, Tracks};
pub use error::SimulationError;
pub use hands::HandNoise;
pub use presets::{Preset, random_rig_config};
pub use real_noise::RealNoise;
pub use simulate::simulate;
pub use truth::{Simulated, Statistics, Truth, write_truth};

#[cfg(test)]
mod real_noise_tests;
#[cfg(test)]
mod tests;
