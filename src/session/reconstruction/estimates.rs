//! Estimated quantities with their uncertainty, and summary statistics of errors.

use serde::{Deserialize, Serialize};

/// A factor on both focal lengths of a camera.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FocalFactor {
    /// Refined focal length divided by the given one.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

/// Time offset of a camera: frame number `n` was taken at `n / fps + secs`; with a drift that holds in the middle of the recording.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TimeOffset {
    /// Offset, s; the reference camera keeps its given offset, usually 0.
    pub secs: f64,
    /// Standard deviation relative to the reference camera, s; `None` where the offset was given or could not be estimated.
    pub sigma_secs: Option<f64>,
    /// `None` where the clock has the rate of the reference camera's.
    pub drift: Option<ClockDrift>,
}

/// Drift of a camera's clock: its offset grows by `rate` seconds a second, and is [`TimeOffset::secs`] in the middle of the recording.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ClockDrift {
    /// s/s; against the reference camera.
    pub rate: f64,
    /// Its standard deviation, s/s; `None` where the people do not show it.
    pub sigma: Option<f64>,
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
    /// 95th percentile.
    pub p95: f64,
}
