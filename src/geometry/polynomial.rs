//! Real roots of small polynomials, without heap allocation, for the minimal solvers.

/// Highest degree that is solved: that of the five-point problem.
pub const MAX_DEGREE: usize = 10;

/// The real roots of one polynomial.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RealRoots {
    values: [f64; MAX_DEGREE],
    count: usize,
}

impl RealRoots {
    /// The roots as a slice.
    pub fn as_slice(&self) -> &[f64] {
        &self.values[..self.count]
    }

    fn push(&mut self, root: f64) {
        if self.count < MAX_DEGREE {
            self.values[self.count] = root;
            self.count += 1;
        }
    }
}

/// All real roots of `sum_i coefficients[i] x^i`: those within [-1, 1] ascending, then the others ascending in `1 / x`.
///
/// Between two neighbouring critical points a polynomial is monotone, so the roots of every derivative bracket those
/// of the one before. Roots beyond 1 are reciprocals of roots of the reversed polynomial; all arithmetic stays
/// on [-1, 1], where powers do not overflow. Coefficients beyond [`MAX_DEGREE`] are not read.
///
/// Two roots that rounding cannot separate are returned as one root or as two equal ones.
pub fn real_roots(coefficients: &[f64]) -> RealRoots {
    let degree = coefficients.len().saturating_sub(1).min(MAX_DEGREE);
    let mut polynomial = Polynomial { coefficients: [0.0; MAX_DEGREE + 1], degree };
    let used = coefficients.len().min(MAX_DEGREE + 1);
    polynomial.coefficients[..used].copy_from_slice(&coefficients[..used]);

    let mut roots = RealRoots::default();
    for &x in polynomial.roots_near_unit_interval().as_slice() {
        if x.abs() <= 1.0 {
            roots.push(x);
        }
    }
    polynomial.coefficients[..=degree].reverse();
    for &x in polynomial.roots_near_unit_interval().as_slice() {
        if x.abs() < 1.0 && x != 0.0 {
            roots.push(1.0 / x);
        }
    }
    roots
}

/// End of the searched interval, a little beyond 1: a root at exactly 1 still changes the sign.
const END: f64 = 1.0 + 1e-9;

/// An extremum is a double root where its value is below this share of the sum of all absolute coefficients.
const DOUBLE_ROOT_TOLERANCE: f64 = 1e-13;

struct Polynomial {
    coefficients: [f64; MAX_DEGREE + 1],
    degree: usize,
}

impl Polynomial {
    fn value(&self, x: f64) -> f64 {
        self.coefficients[..=self.degree].iter().rev().fold(0.0, |sum, c| sum * x + c)
    }

    fn value_and_slope(&self, x: f64) -> (f64, f64) {
        self.coefficients[..=self.degree].iter().rev().fold((0.0, 0.0), |(f, d), c| (f * x + c, d * x + f))
    }

    /// The `order`-th derivative divided by `order!`, which keeps the coefficients small.
    fn scaled_derivative(&self, order: usize) -> Polynomial {
        let mut derivative = Polynomial { coefficients: [0.0; MAX_DEGREE + 1], degree: self.degree - order };
        let mut binomial = 1.0; // (i + order) over order
        for i in 0..=derivative.degree {
            derivative.coefficients[i] = binomial * self.coefficients[i + order];
            binomial *= (i + order + 1) as f64 / (i + 1) as f64;
        }
        derivative
    }

    fn roots_near_unit_interval(&self) -> RealRoots {
        let mut roots = RealRoots::default();
        for order in (0..self.degree).rev() {
            roots = self.scaled_derivative(order).roots_between(&roots, order == 0);
        }
        roots
    }

    /// One root per sign change between neighbouring critical points.
    fn roots_between(&self, critical: &RealRoots, keep_double: bool) -> RealRoots {
        let mut roots = RealRoots::default();
        let scale: f64 = self.coefficients[..=self.degree].iter().map(|c| c.abs()).sum();
        let (mut low, mut low_value) = (-END, self.value(-END));
        for &high in critical.as_slice().iter().chain(&[END]) {
            let high_value = self.value(high);
            if (low_value < 0.0) != (high_value < 0.0) {
                roots.push(self.root_within(low, high, low_value < 0.0));
            } else if keep_double && high < END && high_value.abs() < DOUBLE_ROOT_TOLERANCE * scale {
                roots.push(high);
            }
            (low, low_value) = (high, high_value);
        }
        roots
    }

    /// Newton's method, kept inside a bracket by bisection.
    fn root_within(&self, mut low: f64, mut high: f64, rising: bool) -> f64 {
        let mut x = 0.5 * (low + high);
        for _ in 0..100 {
            let (value, slope) = self.value_and_slope(x);
            if (value < 0.0) == rising {
                low = x;
            } else {
                high = x;
            }
            let newton = x - value / slope;
            let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
            let settled = (next - x).abs() <= f64::EPSILON;
            x = next;
            if settled {
                break;
            }
        }
        x
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    fn with_roots(roots: &[f64]) -> Vec<f64> {
        let mut coefficients = vec![1.0];
        for r in roots {
            let mut next = vec![0.0; coefficients.len() + 1];
            for (i, c) in coefficients.iter().enumerate() {
                next[i + 1] += c;
                next[i] -= r * c;
            }
            coefficients = next;
        }
        coefficients
    }

    fn sorted(roots: RealRoots) -> Vec<f64> {
        let mut values = roots.as_slice().to_vec();
        values.sort_by(f64::total_cmp);
        values
    }

    #[test]
    fn known_roots_are_found() {
        let assert_roots = |coefficients: &[f64], truth: &[f64]| {
            let found = sorted(real_roots(coefficients));
            assert_eq!(found.len(), truth.len(), "{coefficients:?}");
            assert!(found.iter().zip(truth).all(|(f, t)| (f - t).abs() < 1e-14), "{found:?}");
        };
        assert_roots(&[-6.0, 1.0, 1.0], &[-3.0, 2.0]);
        assert_roots(&[1.0, 0.0, 1.0], &[]);
        assert_roots(&[-1.0, 0.0, 1.0], &[-1.0, 1.0]);
        assert_roots(&[0.25, -1.0, 1.0], &[0.5]); // double
        assert_roots(&[-3.0, 2.0, 0.0, 0.0], &[1.5]); // leading zeros
        assert_eq!(real_roots(&[]).as_slice().len() + real_roots(&[1.0]).as_slice().len(), 0);
    }

    #[test]
    fn products_of_known_factors_give_their_real_roots() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(2);
        for _ in 0..300 {
            let mut truth: Vec<f64> = (0..6).map(|i| i as f64 - 2.5 + rng.random_range(-0.3..0.3)).collect();
            truth.iter_mut().for_each(|r| *r *= 0.7);
            let mut coefficients = with_roots(&truth);
            for _ in 0..2 {
                // Times x^2 + b, which has no real root.
                let b = rng.random_range(0.2..2.0);
                let mut product = vec![0.0; coefficients.len() + 2];
                for (i, c) in coefficients.iter().enumerate() {
                    product[i] += b * c;
                    product[i + 2] += c;
                }
                coefficients = product;
            }
            let found = sorted(real_roots(&coefficients));
            assert_eq!(found.len(), truth.len());
            for (f, t) in found.iter().zip(&truth) {
                assert!((f - t).abs() < 1e-10, "{f} for {t}");
            }
        }
    }

    #[test]
    fn non_finite_coefficients_do_not_panic() {
        real_roots(&[f64::NAN; 11]);
        real_roots(&[f64::INFINITY, 1.0, f64::NEG_INFINITY]);
    }
}
