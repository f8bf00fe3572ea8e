//! Every export is written to disk and read back by a small reader that shares no code with the writer.
//!
//! Joints are compared with `poses3d.json` (at most 0.5 mm), cameras with the projection of `cameras.json` (at most 0.1 px,
//! with the parameters that the format supports), for results with y and with z up.

#![allow(clippy::unwrap_used)] // a test may

mod angles;
mod bvh;
mod calibrations;
mod glb;
mod markers;
mod result;
mod smpl;
mod text_cameras;
mod usd;
