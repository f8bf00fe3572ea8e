//! Tests of a solution for mistakes in the recording's files: what the files alone do not show, people in space do.
//!
//! - `agreement`: how much of a camera's detections the people of the others explain
//! - `reading`: a camera registered anew by the people of the others, with its files read in another way (mirrored, exchanged,
//!   late, with another lens)
//! - `lens`: a camera's focal length by resection, the start of the next
//! - `parameters`: delays and focal lengths that an adjustment of all cameras finds
//! - `labels`: left and right exchanged in a camera whose pose is right
//! - `movement`: a camera that turns during the recording
//! - `clock`: a camera whose frames slip against the others; `block_step` finds the step of this and of the last
//! - `handedness`: noses, toes and knees that point backwards
//! - `frame_rate`: steps that are too quick or too slow for their length
//! - `motion_rate`: people who move faster or slower than people do, with the statistics of `motion_statistics`
//! - `gravity`: people who fall faster or slower than g, or move as no floor could push them
//! - `takes`: cameras that show other people than the rest
//!
//! Each test compares with what the recording itself shows as usual, and returns a suspicion where the difference is large and
//! certain; errors of a detector are correlated, so what counts as independent are seconds, not frames.

pub mod agreement;
pub mod block_step;
pub mod clock;
pub mod frame_rate;
pub mod gravity;
pub mod handedness;
pub mod labels;
pub mod lens;
pub mod motion_rate;
mod motion_statistics;
pub mod movement;
pub mod parameters;
pub mod reading;
pub mod takes;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod tests_rate;
