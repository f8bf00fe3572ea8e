//! Time offsets between cameras: whole frames estimated from the motion, and the recording shifted by given offsets.

pub mod retiming;
pub mod whole_frames;
