//! The shared check of derivatives against central differences.

use nalgebra::DMatrix;

/// Compares an analytic Jacobian with central differences of `residual` about zero increments.
///
/// `residual` maps increments of all unknowns to the residual. The step of 1e-6 leaves an error of some 1e-10 relative
/// to the third derivative and to rounding; 1e-6 of the Jacobian's size is allowed.
pub(crate) fn assert_derivative(jacobian: &DMatrix<f64>, residual: impl Fn(&[f64]) -> Vec<f64>) {
    const STEP: f64 = 1e-6;
    let tolerance = 1e-6 * jacobian.amax().max(1.0);
    for unknown in 0..jacobian.ncols() {
        let at = |h: f64| {
            let mut increments = vec![0.0; jacobian.ncols()];
            increments[unknown] = h;
            residual(&increments)
        };
        let (ahead, behind) = (at(STEP), at(-STEP));
        assert_eq!(ahead.len(), jacobian.nrows(), "rows of the Jacobian");
        for row in 0..jacobian.nrows() {
            let numeric = (ahead[row] - behind[row]) / (2.0 * STEP);
            let analytic = jacobian[(row, unknown)];
            assert!(
                (numeric - analytic).abs() < tolerance,
                "row {row}, unknown {unknown}: {analytic} against {numeric}"
            );
        }
    }
}

/// [`assert_derivative`] for the gradient of a scalar `cost`.
pub(crate) fn assert_gradient(gradient: &[f64], cost: impl Fn(&[f64]) -> f64) {
    assert_derivative(&DMatrix::from_row_slice(1, gradient.len(), gradient), |d| vec![cost(d)]);
}
