//! Clocks of the cameras against the common time line.

/// Largest offset between cameras that is looked for, s: of cameras that were started by hand.
pub const MAX_OFFSET_SECS: f64 = 10.0;

/// A camera's clock: its frame `n` is taken at `n + offset + drift * t` frames of the common time line, `t` from -1 at the first
/// frame of the take to 1 at the last ([`take_time`]).
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct CameraClock {
    /// In the middle of the take, frames.
    pub offset: f64,
    /// What is added at the end of the take, and taken away at its start, frames.
    pub drift: f64,
}

/// Place of a frame in a take of `n_frames`, from -1 at its start to 1 at its end.
pub fn take_time(frame: usize, n_frames: usize) -> f64 {
    2.0 * frame as f64 / n_frames.saturating_sub(1).max(1) as f64 - 1.0
}

/// By how much a camera's frames last longer than those of the common time line, as a share, if its clock drifts by `drift` frames to
/// either end of the take.
pub fn rate_of_drift(drift: f64, n_frames: usize) -> f64 {
    2.0 * drift / (n_frames as f64 - 1.0)
}

/// The inverse of [`rate_of_drift`].
pub fn drift_of_rate(rate: f64, n_frames: usize) -> f64 {
    0.5 * rate * (n_frames as f64 - 1.0)
}

impl CameraClock {
    /// A clock at the right rate.
    pub fn shifted(offset: f64) -> Self {
        Self { offset, drift: 0.0 }
    }

    /// How many frames later than its number a frame is taken.
    pub fn offset_at(&self, frame: usize, n_frames: usize) -> f64 {
        self.offset + self.drift * take_time(frame, n_frames)
    }

    /// Frame of the common time line nearest to a frame of the camera; `None` beyond its ends, and where the next frame is as near:
    /// a fast clock has more frames than the time line.
    pub fn common_frame(&self, frame: usize, n_frames: usize) -> Option<usize> {
        let nearest = |frame: usize| frame as f64 + self.offset_at(frame, n_frames).round();
        let target = nearest(frame);
        let is_inside = (0.0..n_frames as f64).contains(&target);
        (is_inside && nearest(frame + 1) != target).then_some(target as usize)
    }

    /// The camera's frame at a frame of the common time line, see [`Self::common_frame`].
    pub fn recorded_frame(&self, common: usize, n_frames: usize) -> Option<usize> {
        let near = common as f64 - self.offset_at(common, n_frames).round();
        // Offsets within the take differ by twice the drift at most.
        let reach = (2.0 * self.drift.abs()).ceil() + 1.0;
        let frames = (near - reach).max(0.0) as usize..(near + reach + 1.0).clamp(0.0, n_frames as f64) as usize;
        frames.into_iter().find(|&frame| self.common_frame(frame, n_frames) == Some(common))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A fast clock has frames to spare, a slow one leaves gaps; no two frames share a place.
    #[test]
    fn frames_of_a_drifting_clock_go_to_the_nearest_places() {
        for (offset, drift) in [(0.0, 0.0), (3.0, 0.0), (-2.6, 0.0), (0.4, 2.2), (-1.0, -2.2), (90.0, 1.0)] {
            let clock = CameraClock { offset, drift };
            let places: Vec<Option<usize>> = (0..100).map(|frame| clock.common_frame(frame, 100)).collect();
            let mut taken: Vec<usize> = places.iter().flatten().copied().collect();
            assert!(taken.is_sorted(), "{clock:?}");
            taken.dedup();
            assert_eq!(taken.len(), places.iter().flatten().count());
            for (frame, place) in places.iter().enumerate() {
                let Some(place) = *place else { continue };
                assert!((frame as f64 + clock.offset_at(frame, 100) - place as f64).abs() <= 0.5);
                assert_eq!(clock.recorded_frame(place, 100), Some(frame), "{clock:?}");
            }
        }
        let drifting = CameraClock { offset: 0.0, drift: 2.0 };
        assert_eq!([0, 99].map(|frame| drifting.offset_at(frame, 100)), [-2.0, 2.0]);
        assert_eq!((drifting.common_frame(99, 100), drifting.common_frame(0, 100)), (None, None));
        assert_eq!(CameraClock::shifted(1.0).common_frame(0, 1), None);
    }
}
