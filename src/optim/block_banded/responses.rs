//! How the frames follow the border: many back substitutions at once.

use super::Eliminated;
use nalgebra::DMatrix;

impl Eliminated {
    /// Movement of each frame per unit of each column of `border`, with the frames at their minimum given the border:
    /// `-H[frames][frames]^-1 H[frames][border] border`. [frame: (unknowns, columns)]
    pub fn responses(&self, border: &DMatrix<f64>) -> Vec<DMatrix<f64>> {
        let n_frames = self.n_frames();
        let mut frames: Vec<DMatrix<f64>> = vec![DMatrix::zeros(0, 0); n_frames];
        for t in (0..n_frames).rev() {
            let factor = self.frame_factor(t);
            let mut y = -factor.to_border.tr_mul(border);
            if t + 1 < n_frames {
                y -= factor.to_next.tr_mul(&frames[t + 1]);
            }
            if t + 2 < n_frames {
                y -= factor.to_after_next.tr_mul(&frames[t + 2]);
            }
            frames[t] = factor.inverse.tr_mul(&y);
        }
        frames
    }
}
