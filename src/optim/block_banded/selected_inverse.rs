//! The diagonal blocks of the inverse, without the rest of it.
//!
//! From `H = L L^T` and `Z = H^-1` follows `Z L = L^-T`, whose blocks below the diagonal are zero and on it known: with
//! `G = L[t+1][t] L[t][t]^-1` and `F = L[t+2][t] L[t][t]^-1`
//!
//! `Z[s][t] = -(Z[s][t+1] G + Z[s][t+2] F)` for `s = t+1, t+2`, and
//! `Z[t][t] = L[t][t]^-T L[t][t]^-1 - Z[t+1][t]^T G - Z[t+2][t]^T F`,
//!
//! backwards in time and within the band alone (Takahashi, Fagan and Chin 1973; Erisman and Tinney 1975). Diagonal blocks are
//! made symmetric: an antisymmetric rounding error would meet `Z[t+1][t+2] = Z[t+2][t+1]^T` with the wrong sign and grow by a factor
//! of two a frame.

use super::Eliminated;
use super::responses::Following;
use nalgebra::DMatrix;

impl Eliminated {
    /// Calls `visit` with each frame, `(H[frames][frames]^-1)[t][t]` and the frame's [response](Self::responses) to each unknown of the
    /// border, from the last frame to the first.
    pub fn for_each_inverse_block(&self, mut visit: impl FnMut(usize, &DMatrix<f64>, &DMatrix<f64>)) {
        // Z[t+1][t+1], Z[t+2][t+2] and Z[t+2][t+1] of the frames behind.
        let (mut one, mut two, mut across): (DMatrix<f64>, DMatrix<f64>, DMatrix<f64>) = Default::default();
        let n_frames = self.n_frames();
        let mut following = Following::default();
        for t in (0..n_frames).rev() {
            let factor = self.frame_factor(t);
            let mut own = factor.inverse.transpose() * &factor.inverse;
            let mut next = DMatrix::zeros(factor.to_next.nrows(), own.ncols());
            if t + 1 < n_frames {
                let to_next = &factor.to_next * &factor.inverse;
                next.gemm(-1.0, &one, &to_next, 0.0);
                if t + 2 < n_frames {
                    let to_after_next = &factor.to_after_next * &factor.inverse;
                    next.gemm(-1.0, &across.transpose(), &to_after_next, 1.0);
                    let mut after_next = -(&two * &to_after_next);
                    after_next.gemm(-1.0, &across, &to_next, 1.0);
                    own.gemm(-1.0, &after_next.transpose(), &to_after_next, 1.0);
                }
                own.gemm(-1.0, &next.transpose(), &to_next, 1.0);
            }
            make_symmetric(&mut own);
            visit(t, &own, following.response(&factor));
            (two, across, one) = (one, next, own);
        }
    }
}

fn make_symmetric(a: &mut DMatrix<f64>) {
    for i in 0..a.nrows() {
        for j in 0..i {
            let mean = 0.5 * (a[(i, j)] + a[(j, i)]);
            (a[(i, j)], a[(j, i)]) = (mean, mean);
        }
    }
}
