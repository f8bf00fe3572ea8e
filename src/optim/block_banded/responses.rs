//! How the frames follow the border: many back substitutions at once.

use super::Eliminated;
use nalgebra::DMatrix;

impl Eliminated {
    /// Movement of each frame per unit of each column of `border`, with the frames at their minimum given the border:
    /// `-H[frames][frames]^-1 H[frames][border] border`. [frame: (unknowns, columns)]
    pub fn responses(&self, border: &DMatrix<f64>) -> Vec<DMatrix<f64>> {
        let n_frames = self.n_frames();
        let mut frames = vec![DMatrix::zeros(self.factor.layout.n, border.ncols()); n_frames];
        for t in (0..n_frames).rev() {
            let factor = self.frame_factor(t);
            // Products of transposed copies are several times faster than those of columns with columns.
            let mut y = factor.to_border.transpose() * border;
            for (later, to_later) in [(t + 1, &factor.to_next), (t + 2, &factor.to_after_next)] {
                if later < n_frames {
                    y.gemm(1.0, &to_later.transpose(), &frames[later], 1.0);
                }
            }
            frames[t].gemm(-1.0, &factor.inverse.transpose(), &y, 0.0);
        }
        frames
    }
}
