//! Seeded scenes with exact truth and named noise: tests, demo, benchmarks.
//!
//! In reading order:
//!
//! - [`config`], [`presets`]: what is simulated: people, cameras, noise
//! - [`skeleton`]: the simulated body, deliberately not the one that is fitted
//! - `individual`: default bodies with joints of their own, and a detector with habits
//! - [`choreography`], [`gait`]: people who walk, stop, turn, crouch, sit, reach and gesture
//! - `dance`: two people within arms' reach
//! - [`placement`]: people from motion capture (AMASS layout) or drawn from the motion prior, put on the floor
//! - [`landmarks`]: the points a detector looks for, from a posed skeleton
//! - [`rig`]: cameras around the scene
//! - [`occlusion`], [`detector`]: what each camera's detector and tracker report
//! - [`truth`]: what really was, and its files
//!
//! World: y up, metres, floor at y = 0. Every random number comes from a ChaCha8 stream keyed by the seed and by the
//! item it belongs to (camera, person), so that one more camera changes nothing of the others.

mod action_generator;
pub mod choreography;
pub mod config;
mod dance;
pub mod detector;
mod drawn;
mod error;
pub mod gait;
mod individual;
pub mod landmarks;
mod observer;
pub mod occlusion;
pub mod placement;
pub mod presets;
mod random;
pub mod rig;
pub mod scene;
mod simulate;
pub mod skeleton;
mod tracker;
pub mod truth;

pub use config::{Arrangement, Bodies, Lens, MotionSource, NoiseConfig, RigConfig, SimulationConfig, Tracks};
pub use error::SimulationError;
pub use presets::{Preset, random_rig_config};
pub use simulate::simulate;
pub use truth::{Simulated, Statistics, Truth, write_truth};

#[cfg(test)]
mod tests;
