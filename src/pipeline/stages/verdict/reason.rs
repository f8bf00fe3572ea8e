//! Reasons of the verdict and the bounds of statistics.

use crate::session::reconstruction::Verdict;

/// One problem of a result.
pub(super) struct Reason {
    pub(super) verdict: Verdict,
    pub(super) text: String,
}

impl Reason {
    pub(super) fn warn(text: String) -> Self {
        Self { verdict: Verdict::Warn, text }
    }

    pub(super) fn reject(text: String) -> Self {
        Self { verdict: Verdict::Reject, text }
    }
}

/// Bounds of a statistic: beyond `warn` the result needs a check, beyond `reject` it is not usable.
pub(super) struct Bounds {
    pub(super) warn: f64,
    pub(super) reject: f64,
}

impl Bounds {
    /// The verdict on a statistic that should be small; `None` where it is.
    pub(super) fn on_high(&self, value: f64) -> Option<Verdict> {
        if value > self.reject {
            Some(Verdict::Reject)
        } else if value > self.warn {
            Some(Verdict::Warn)
        } else {
            None
        }
    }

    /// The verdict on a statistic that should be large; `None` where it is.
    pub(super) fn on_low(&self, value: f64) -> Option<Verdict> {
        Self { warn: -self.warn, reject: -self.reject }.on_high(-value)
    }
}
