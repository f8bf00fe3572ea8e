//! How the frames follow the border, and how they spread: many back substitutions at once.

use super::Eliminated;
use super::frame_factor::FrameFactor;
use nalgebra::DMatrix;
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

/// The movements of the two frames behind the next one of a back substitution.
#[derive(Default)]
pub(super) struct Following {
    next: DMatrix<f64>,
    after_next: DMatrix<f64>,
}

impl Following {
    /// The movement of a frame with this factor per unit of each unknown of the border; frames come from the last to the first.
    pub(super) fn response(&mut self, factor: &FrameFactor) -> &DMatrix<f64> {
        self.substituted(factor, factor.to_border.transpose())
    }

    /// `-(L^-T y)` of a frame.
    fn substituted(&mut self, factor: &FrameFactor, mut y: DMatrix<f64>) -> &DMatrix<f64> {
        // Products of transposed copies are several times faster than those of columns with columns.
        for (to_later, later) in [(&factor.to_next, &self.next), (&factor.to_after_next, &self.after_next)] {
            if !to_later.is_empty() {
                y.gemm(1.0, &to_later.transpose(), later, 1.0);
            }
        }
        let own = -(factor.inverse.transpose() * y);
        self.after_next = std::mem::replace(&mut self.next, own);
        &self.next
    }
}

impl Eliminated {
    /// Movement of each frame per unit of each column of `border`, with the frames at their minimum given the border:
    /// `-H[frames][frames]^-1 H[frames][border] border`. [frame: (unknowns, columns)]
    pub fn responses(&self, border: &DMatrix<f64>) -> Vec<DMatrix<f64>> {
        self.substituted_backwards(|factor| factor.to_border.transpose() * border)
    }

    /// [`Self::responses`], and as further columns draws from the normal distribution of covariance `H[frames][frames]^-1`, which is
    /// that of the frames' errors given the border.
    pub fn responses_and_samples(
        &self,
        border: &DMatrix<f64>,
        n_samples: usize,
        rng: &mut impl Rng,
    ) -> Vec<DMatrix<f64>> {
        self.substituted_backwards(|factor| {
            let mut right = factor.to_border.transpose() * border;
            right = right.resize_horizontally(border.ncols() + n_samples, 0.0);
            right.columns_mut(border.ncols(), n_samples).apply(|white| *white = StandardNormal.sample(rng));
            right
        })
    }

    /// `-(L^-T y)` with the rows `right` of `y` that belong to each frame, asked for from the last frame to the first.
    fn substituted_backwards(&self, mut right: impl FnMut(&FrameFactor) -> DMatrix<f64>) -> Vec<DMatrix<f64>> {
        let mut following = Following::default();
        let mut of_frame = |t: usize| {
            let factor = self.frame_factor(t);
            following.substituted(&factor, right(&factor)).clone()
        };
        let mut frames: Vec<_> = (0..self.n_frames()).rev().map(&mut of_frame).collect();
        frames.reverse();
        frames
    }
}
