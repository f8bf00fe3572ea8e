//! Reading of other tools' files: every pose dialect, every calibration format, and the errors and warnings for wrong ones.

#![allow(clippy::unwrap_used)] // a test may

mod calibrations;
mod damage;
mod dialects;
mod speed;
#[path = "../fixtures/stick_figure.rs"]
mod stick_figure;
mod suspicions;
mod take;
mod tool_quirks;
