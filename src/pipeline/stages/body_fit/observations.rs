//! One person's observations by frame: triangulated points and detected pixels of the body's landmarks.

use super::gaps::{MIN_GAP, gaps};
use crate::geometry::PixelCovariance;
use crate::pipeline::calibration::PosedCamera;
use nalgebra::{Matrix2, Vector2, Vector3};
use std::borrow::Cow;
use std::collections::BTreeSet;
use std::ops::Range;

/// A triangulated point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PointObservation {
    /// Landmark of the body model.
    pub landmark: usize,
    /// World, m.
    pub position: Vector3<f64>,
}

/// A detected pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PixelObservation {
    /// Landmark of the body model.
    pub landmark: usize,
    /// Index of the camera in [`Observations::cameras`].
    pub camera: usize,
    /// As detected, px.
    pub pixel: Vector2<f64>,
    /// Apparent size of the whole person times the detector's noise factor at this confidence, px; the detector's error is
    /// proportional to it.
    pub scale_px: f64,
    pub error: ErrorShape,
}

/// The shape of a pixel's error: as the detector states it, until that is weighed against the residuals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum ErrorShape {
    /// Equal in all directions.
    Round,
    Stated(StatedError),
    /// Whitened by this matrix as far as the stated covariance counts (determinant 1).
    Whitened(Matrix2<f64>),
}

impl ErrorShape {
    pub(super) fn stated(&self) -> Option<&StatedError> {
        if let Self::Stated(stated) = self { Some(stated) } else { None }
    }

    pub(super) fn whitening(&self) -> Option<Matrix2<f64>> {
        if let Self::Whitened(whitening) = self { Some(*whitening) } else { None }
    }
}

/// A covariance as the detector states it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct StatedError {
    pub covariance: PixelCovariance,
    /// Apparent size of the person, px.
    pub size_px: f64,
}

/// All observations of one person.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Observations {
    pub cameras: Vec<PosedCamera>,
    /// `points[frame]`.
    pub points: Vec<Vec<PointObservation>>,
    /// `pixels[frame]`, landmark by landmark.
    pub pixels: Vec<Vec<PixelObservation>>,
}

impl Observations {
    /// Whether a view saw the person at a frame. Points alone do not show it, since smooth paths continue through gaps.
    pub(super) fn is_seen(&self, frame: usize) -> bool {
        !self.pixels[frame].is_empty()
    }

    /// Mean number of equations of a frame that any view saw: two per pixel.
    pub(super) fn equations_per_frame(&self) -> f64 {
        let seen = self.pixels.iter().filter(|frame| !frame.is_empty()).count();
        2.0 * self.pixels.iter().map(Vec::len).sum::<usize>() as f64 / seen.max(1) as f64
    }

    /// The run of `n_frames` (or of the whole window) with most pixels in a window of frames.
    pub(super) fn most_seen(&self, window: Range<usize>, n_frames: usize) -> Range<usize> {
        let length = window.len().min(n_frames.max(1));
        let seen = |first: usize| self.pixels[first..first + length].iter().map(Vec::len).sum::<usize>();
        let runs = window.start..=window.end - length;
        let first = runs.max_by_key(|&first| (seen(first), std::cmp::Reverse(first))).unwrap_or(window.start);
        first..first + length
    }

    /// The same without the points of a landmark that no view shows for [`MIN_GAP`] or longer while views show others: the smooth
    /// path of a single point knows nothing of the body, and limbs that follow it turn about themselves.
    pub(super) fn without_unseen_points(mut self, frame_interval: f64) -> Self {
        let landmarks: BTreeSet<usize> = self.points.iter().flatten().map(|point| point.landmark).collect();
        for landmark in landmarks {
            let is_shown = |frame: &Vec<PixelObservation>| frame.iter().any(|pixel| pixel.landmark == landmark);
            let shown: Vec<bool> = self.pixels.iter().map(is_shown).collect();
            for gap in gaps(&shown).into_iter().filter(|gap| gap.len() as f64 * frame_interval >= MIN_GAP) {
                for frame in gap.filter(|&frame| !self.pixels[frame].is_empty()) {
                    self.points[frame].retain(|point| point.landmark != landmark);
                }
            }
        }
        self
    }

    /// The observations of every `stride`-th frame of a run.
    pub(super) fn thinned(&self, run: Range<usize>, stride: usize) -> Self {
        let every = || run.clone().step_by(stride);
        Self {
            cameras: self.cameras.clone(),
            points: every().map(|t| self.points[t].clone()).collect(),
            pixels: every().map(|t| self.pixels[t].clone()).collect(),
        }
    }

    /// The observations of a run of frames.
    pub(super) fn slice(&self, frames: Range<usize>) -> Cow<'_, Self> {
        if frames == (0..self.pixels.len()) {
            return Cow::Borrowed(self);
        }
        Cow::Owned(Self {
            cameras: self.cameras.clone(),
            points: self.points[frames.clone()].to_vec(),
            pixels: self.pixels[frames].to_vec(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Limbs that followed the paths of unseen points turned about themselves.
    #[test]
    fn points_that_no_view_shows_are_left_out_of_long_gaps() {
        let pixel = |landmark| PixelObservation {
            landmark,
            camera: 0,
            pixel: Vector2::zeros(),
            scale_px: 1.0,
            error: ErrorShape::Round,
        };
        let point = |landmark| PointObservation { landmark, position: Vector3::zeros() };
        // Landmark 1 is hidden for 3 frames and for 6; in the last two of these nothing is seen.
        let pixels = |t: usize| match t {
            18..20 => vec![],
            4..7 | 14..18 => vec![pixel(0)],
            _ => vec![pixel(0), pixel(1)],
        };
        let observations = Observations {
            cameras: vec![],
            points: vec![vec![point(0), point(1)]; 30],
            pixels: (0..30).map(pixels).collect(),
        };
        let kept = observations.without_unseen_points(1.0 / 30.0).points;
        let short: Vec<usize> = (0..30).filter(|&t| kept[t].len() < 2).collect();
        assert_eq!(short, [14, 15, 16, 17]);
        assert!(kept[14..18].iter().all(|points| points[0].landmark == 0));
    }
}
