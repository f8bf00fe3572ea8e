//! Hands and faces of simulated people, for conventions that have their points.
//!
//! - `motion`: smooth random angles of fingers and wrists
//! - `details`: the true points of face and hands
//! - `noise`: the numbers of a detector of hands and faces
//! - `detector`: their detections, with errors relative to the size of the hand or the face, misses and swaps
//!
//! Sessions of other conventions do not change by a byte: all random numbers come from streams of their own.

mod details;
mod detector;
mod motion;
mod noise;
#[cfg(test)]
mod tests;

pub(super) use details::Details;
pub use details::{N_DETAILS, has_details};
pub(super) use detector::DetailDetector;
pub(super) use motion::{FingerMotion, turn_wrists};
pub(super) use noise::SeenHands;
pub use noise::{HandNoise, HandSource};
