//! The option `--noise` of the commands that simulate.

use crate::simulation::NoiseConfig;
use clap::ValueEnum;

/// Values of `--noise`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum NoiseName {
    /// As measured on a real detector: slow errors that neighbouring keypoints share, lasting outliers and holes, ghosts,
    /// half detections, merged limbs
    Real,
    /// Errors that are independent from keypoint to keypoint and nearly so from frame to frame
    Presets,
}

impl NoiseName {
    /// This noise with the rates of `preset`.
    pub(super) fn of(self, preset: NoiseConfig) -> NoiseConfig {
        match self {
            Self::Real => preset.with_real_errors(),
            Self::Presets => NoiseConfig { real: None, ..preset },
        }
    }

    /// The value of the option.
    #[cfg(any(test, feature = "service"))]
    pub(super) fn word(self) -> &'static str {
        match self {
            Self::Real => "real",
            Self::Presets => "presets",
        }
    }
}
