//! Determinants of symmetric matrices.

use nalgebra::{Cholesky, Dyn};

/// `log |A| / 2` of a matrix `A = L L^T`.
pub fn half_log_det(cholesky: &Cholesky<f64, Dyn>) -> f64 {
    cholesky.l_dirty().diagonal().iter().map(|d| d.ln()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;

    #[test]
    fn half_log_det_of_a_known_matrix() {
        let matrix = DMatrix::from_row_slice(2, 2, &[4.0, 2.0, 2.0, 10.0]);
        assert!((half_log_det(&matrix.cholesky().unwrap()) - 6.0f64.ln()).abs() < 1e-12);
    }
}
