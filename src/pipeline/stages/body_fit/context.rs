//! What all fits of a session share.

use super::config::BodyFitConfig;
use super::terms::noise_process::PathNoise;
use crate::body::BodyModel;
use crate::optim::block_banded::SystemPool;
use crate::progress::Progress;
use nalgebra::Vector3;
use std::ops::Range;

/// Model, settings and progress of the fits of a session.
#[derive(Clone, Copy)]
pub(super) struct FitContext<'a> {
    pub model: &'a BodyModel,
    pub config: &'a BodyFitConfig,
    /// Settings of fits from a rough start, see [`BodyFitConfig::without_refinement`].
    pub first_config: &'a BodyFitConfig,
    /// s.
    pub frame_interval: f64,
    /// The upward direction in the world, unit length.
    pub up: Vector3<f64>,
    pub progress: &'a Progress,
    /// The detector's errors over time, once they have been measured.
    pub noise: Option<&'a PathNoise>,
    /// The same of frames that are averaged, see [`super::averaging`].
    pub averaged_noise: Option<&'a PathNoise>,
    pub systems: &'a SystemPool,
}

impl FitContext<'_> {
    /// Frames beyond its own that a window includes on each side.
    pub(super) fn halo_frames(&self) -> usize {
        (self.config.halo_secs / self.frame_interval).round() as usize
    }

    /// Largest number of frames of a window: above 30 Hz up to twice as many, so that a window's shape comes from as many seconds. With
    /// half of them joints came 3 to 5 % worse at 60 Hz.
    pub(super) fn window_frames(&self) -> usize {
        let rate = (1.0 / (30.0 * self.frame_interval)).clamp(1.0, 2.0);
        ((self.config.window_frames as f64 * rate).round() as usize).max(3)
    }

    /// A window of `n_frames` frames and its halo.
    pub(super) fn with_halo(&self, window: &Range<usize>, n_frames: usize) -> Range<usize> {
        let halo = self.halo_frames();
        window.start.saturating_sub(halo)..(window.end + halo).min(n_frames)
    }

    /// That of a fit to every `stride`-th frame.
    pub(super) fn thinned(&self, stride: usize) -> Self {
        Self { frame_interval: stride as f64 * self.frame_interval, ..*self }
    }

    /// Whether the motion prior refines a first fit.
    pub(super) fn has_refinement(&self) -> bool {
        self.config.motion_prior && !self.first_config.motion_prior
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_fixtures::Surroundings;
    use super::*;

    #[test]
    fn windows_last_as_long_up_to_60_hertz() {
        let surroundings = Surroundings::new();
        let frames = |rate: f64| FitContext { frame_interval: 1.0 / rate, ..surroundings.context() }.window_frames();
        assert_eq!([15.0, 25.0, 30.0, 50.0, 60.0, 240.0].map(frames), [480, 480, 480, 800, 960, 960]);
    }
}
