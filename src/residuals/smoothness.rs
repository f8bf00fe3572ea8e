//! Points do not accelerate much.

use nalgebra::Vector3;

/// An acceleration residual and its derivatives, each a multiple of the identity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Acceleration {
    /// Acceleration over its standard deviation.
    pub residual: Vector3<f64>,
    /// By the earliest, middle and latest position, per m.
    pub by_position: [f64; 3],
}

/// The acceleration through three positions, over `sigma` (m/s^2): the second divided difference
/// `2 ((x2 - x1) / after - (x1 - x0) / before) / (before + after)`, exact for a parabola.
///
/// `before`, `after`: the times between them, s, positive; unequal across a gap.
pub fn linearize(positions: [&Vector3<f64>; 3], before: f64, after: f64, sigma: f64) -> Acceleration {
    let scale = 2.0 / ((before + after) * sigma);
    let (first, last) = (scale / before, scale / after);
    let by_position = [first, -(first + last), last];
    let [x0, x1, x2] = positions;
    Acceleration { residual: (x2 - x1) * last - (x1 - x0) * first, by_position }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residuals::derivative_check::assert_derivative;
    use nalgebra::DMatrix;

    #[test]
    fn the_derivatives_match_central_differences() {
        let x = [Vector3::new(0.1, 0.2, 0.3), Vector3::new(0.15, 0.1, 0.35), Vector3::new(0.3, 0.1, 0.2)];
        let at = |d: &[f64]| {
            let moved = std::array::from_fn::<_, 3, _>(|k| x[k] + Vector3::new(d[3 * k], d[3 * k + 1], d[3 * k + 2]));
            linearize([&moved[0], &moved[1], &moved[2]], 0.04, 0.08, 8.0)
        };
        let found = at(&[0.0; 9]);
        let jacobian =
            DMatrix::from_fn(3, 9, |row, column| if column % 3 == row { found.by_position[column / 3] } else { 0.0 });
        assert_derivative(&jacobian, |d| at(d).residual.as_slice().to_vec());
    }

    #[test]
    fn free_fall_accelerates_with_gravity_across_a_gap_too() {
        let at = |t: f64| Vector3::new(2.0 * t, 1.0 - 0.5 * 9.81 * t * t, 0.0);
        let found = linearize([&at(0.0), &at(0.04), &at(0.2)], 0.04, 0.16, 1.0);
        assert!((found.residual - Vector3::new(0.0, -9.81, 0.0)).norm() < 1e-9);
    }
}
