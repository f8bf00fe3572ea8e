//! Passes over the stages: each runs one or more stages, in rounds where the result of one improves another.

pub mod adjustment;
pub mod cameras;
pub mod correction;
pub mod denoising;
pub mod focal_lengths;
pub mod held_out_check;
pub mod recording_check;
pub mod synchronisation;
pub mod unknown_lenses;
