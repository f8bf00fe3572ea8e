//! Estimated quantities with their uncertainty, and summary statistics of errors.

use serde::{Deserialize, Serialize};

/// A factor on both focal lengths of a camera.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FocalFactor {
    /// Refined over given.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

/// When a camera's frames were taken: frame number `n` at `n / fps + secs`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TimeOffset {
    /// s; that of the reference camera is as the session gives it, mostly 0.
    pub secs: f64,
    /// Its standard deviation against the reference camera, s; `None` where it was given or could not be found.
    pub sigma_secs: Option<f64>,
}

/// Mean and median of a set of errors.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ErrorSummary {
    /// Arithmetic mean.
    pub mean: f64,
    /// Median.
    pub median: f64,
}

/// Median and 95th percentile of a set of standard deviations.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SigmaSummary {
    /// Median.
    pub median: f64,
    /// The value that 95 % lie below.
    pub p95: f64,
}
