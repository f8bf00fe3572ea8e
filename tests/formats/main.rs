//! Other tools' files go in as they are: every pose dialect, every calibration file, and what is said of wrong ones.

#![allow(clippy::unwrap_used)] // a test may

mod calibrations;
mod damage;
mod dialects;
mod speed;
mod suspicions;
mod take;
