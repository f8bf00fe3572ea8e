//! Banded systems over a sequence of points, each coupled to its two predecessors: 3x3 blocks, solved in linear time.

use nalgebra::{Matrix3, Vector3};

/// A symmetric positive definite matrix over a sequence of points. Blocks `(t, t)` are arbitrary; blocks `(t, t - 1)` and
/// `(t, t - 2)` are multiples of the identity.
#[derive(Debug, Clone)]
pub struct PointChain {
    /// Blocks `(t, t)`.
    pub diagonal: Vec<Matrix3<f64>>,
    /// Factors of the blocks `(t, t - 1)` and `(t, t - 2)`; 0 for blocks outside the matrix.
    pub couplings: Vec<[f64; 2]>,
    /// Blocks `(t, t - 1)` of the factor, where [`solve`](Self::solve) has made it.
    near: Vec<Matrix3<f64>>,
}

impl PointChain {
    /// The zero matrix over `n` points.
    pub fn zeros(n: usize) -> Self {
        let zeros = || vec![Matrix3::zeros(); n];
        Self { diagonal: zeros(), couplings: vec![[0.0; 2]; n], near: zeros() }
    }

    /// Makes it the quadratic form `sum weight(t) |x_(t+1) - 2 x_t + x_(t-1)|^2`.
    pub fn set_second_differences(&mut self, weight: impl Fn(usize) -> f64) {
        self.diagonal.fill(Matrix3::zeros());
        self.couplings.fill([0.0; 2]);
        for last in 2..self.diagonal.len() {
            let weight = weight(last - 1);
            for (t, w) in [(last - 2, 1.0), (last - 1, 4.0), (last, 1.0)] {
                self.diagonal[t] += Matrix3::from_diagonal_element(weight * w);
            }
            self.couplings[last - 1][0] -= 2.0 * weight;
            self.couplings[last][0] -= 2.0 * weight;
            self.couplings[last][1] += weight;
        }
    }

    /// Makes `product` `A x`.
    pub fn times(&self, x: &[Vector3<f64>], product: &mut Vec<Vector3<f64>>) {
        product.clear();
        product.extend(self.diagonal.iter().zip(x).map(|(block, x)| block * x));
        for (t, couplings) in self.couplings.iter().enumerate() {
            for (back, coupling) in (1..).zip(couplings).filter(|(back, _)| *back <= t) {
                product[t] += x[t - back] * *coupling;
                product[t - back] += x[t] * *coupling;
            }
        }
    }

    /// Makes `b` the solution of `A x = b`; `None` where `A` is not positive definite. The matrix is used up.
    ///
    /// $A = L D L^T$ block by block: with couplings $a_t$ and $b_t$,
    /// $L_{t,t-2} = b_t D_{t-2}^{-1}$, $L_{t,t-1} = (a_t I - b_t L_{t-1,t-2}^T) D_{t-1}^{-1}$.
    pub fn solve(&mut self, b: &mut [Vector3<f64>]) -> Option<()> {
        // The diagonal becomes its inverse, block by block.
        let Self { diagonal, couplings, near } = self;
        for t in 0..b.len() {
            let [one, two] = couplings[t];
            let mut reduced = Matrix3::from_diagonal_element(one);
            if t >= 1 {
                reduced -= near[t - 1].transpose() * two;
                near[t] = reduced * diagonal[t - 1];
                diagonal[t] -= near[t] * reduced.transpose();
                b[t] -= near[t] * b[t - 1];
            } else {
                near[t] = Matrix3::zeros();
            }
            if t >= 2 {
                let far = diagonal[t - 2] * two;
                diagonal[t] -= far * two;
                b[t] -= far * b[t - 2];
            }
            diagonal[t] = inverse_of_positive(&diagonal[t])?;
        }
        for t in 0..b.len() {
            b[t] = diagonal[t] * b[t];
        }
        for t in (0..b.len()).rev() {
            let x = b[t];
            if t >= 1 {
                b[t - 1] -= near[t].tr_mul(&x);
            }
            if t >= 2 {
                b[t - 2] -= (diagonal[t - 2] * couplings[t][1]).tr_mul(&x);
            }
        }
        Some(())
    }
}

/// The inverse of a symmetric matrix by its cofactors; `None` where it is not positive definite (Sylvester's criterion).
fn inverse_of_positive(a: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let minor = |i: [usize; 2], j: [usize; 2]| a[(i[0], j[0])] * a[(i[1], j[1])] - a[(i[0], j[1])] * a[(i[1], j[0])];
    let (c11, c12, c13) = (minor([1, 2], [1, 2]), -minor([1, 2], [0, 2]), minor([1, 2], [0, 1]));
    let (c22, c23, c33) = (minor([0, 2], [0, 2]), -minor([0, 2], [0, 1]), minor([0, 1], [0, 1]));
    let determinant = a.m11 * c11 + a.m12 * c12 + a.m13 * c13;
    let is_positive = a.m11 > 0.0 && c33 > 0.0 && determinant > 0.0;
    is_positive.then(|| Matrix3::new(c11, c12, c13, c12, c22, c23, c13, c23, c33) / determinant)
}

/// Frequencies of the integral of [`smoothing_gain`].
const N_FREQUENCIES: usize = 64;

/// Variance of a point of a long smooth path over that of its own measurement, if errors are independent from point to point.
///
/// $\frac1{2\pi} \int 1 / (1 + c (2 - 2 \cos\omega)^2) d\omega$, with `c` the variance of a measurement over that of a second
/// difference: the diagonal of the inverse of the Hessian, far from both ends.
pub fn smoothing_gain(c: f64) -> f64 {
    let kept = |k: usize| {
        let second_difference = 2.0 - 2.0 * (std::f64::consts::PI * (k as f64 + 0.5) / N_FREQUENCIES as f64).cos();
        1.0 / (1.0 + c * second_difference.powi(2))
    };
    (0..N_FREQUENCIES).map(kept).sum::<f64>() / N_FREQUENCIES as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};

    fn dense(chain: &PointChain) -> DMatrix<f64> {
        let n = chain.diagonal.len();
        let mut dense = DMatrix::zeros(3 * n, 3 * n);
        for t in 0..n {
            dense.fixed_view_mut::<3, 3>(3 * t, 3 * t).copy_from(&chain.diagonal[t]);
            for (back, coupling) in (1..).zip(chain.couplings[t]).filter(|(back, _)| *back <= t) {
                for a in 0..3 {
                    dense[(3 * t + a, 3 * (t - back) + a)] = coupling;
                    dense[(3 * (t - back) + a, 3 * t + a)] = coupling;
                }
            }
        }
        dense
    }

    fn chain(n: usize) -> PointChain {
        let mut chain = PointChain::zeros(n);
        chain.set_second_differences(|t| 0.7 + 0.1 * t as f64);
        for (t, block) in chain.diagonal.iter_mut().enumerate() {
            let direction = Vector3::new((t as f64).sin(), 0.5, (2.0 * t as f64).cos());
            *block += direction * direction.transpose() + Matrix3::identity() * 0.01;
        }
        chain
    }

    #[test]
    fn agrees_with_a_dense_solver() {
        for n in [1, 2, 3, 40] {
            let chain = chain(n);
            let b: Vec<Vector3<f64>> = (0..n).map(|t| Vector3::new(t as f64, (t as f64).sin(), 1.0)).collect();
            let flat = DVector::from_iterator(3 * n, b.iter().flat_map(|v| v.iter().copied()));
            let expected = dense(&chain).cholesky().unwrap().solve(&flat);
            let mut found = b.clone();
            chain.clone().solve(&mut found).unwrap();
            let difference = found.iter().flat_map(|v| v.iter()).zip(expected.iter()).map(|(a, b)| (a - b).abs());
            assert!(difference.fold(0.0, f64::max) < 1e-10);
            let mut back = Vec::new();
            chain.times(&found, &mut back);
            assert!(back.iter().zip(&b).all(|(a, b)| (a - b).norm() < 1e-10));
        }
    }

    #[test]
    fn indefinite_pivots_are_none() {
        let a = Matrix3::new(4.0, 1.0, 0.5, 1.0, 3.0, -1.0, 0.5, -1.0, 2.0);
        assert!((inverse_of_positive(&a).unwrap() * a - Matrix3::identity()).norm() < 1e-14);
        for wrong in [Vector3::new(-1.0, 2.0, -3.0), Vector3::new(1.0, -2.0, -3.0), Vector3::new(1.0, f64::NAN, 1.0)] {
            assert_eq!(inverse_of_positive(&Matrix3::from_diagonal(&wrong)), None);
        }
        assert_eq!(inverse_of_positive(&Matrix3::zeros()), None);
    }

    #[test]
    fn second_differences_cost_nothing_on_a_straight_line() {
        let mut chain = PointChain::zeros(6);
        chain.set_second_differences(|_| 2.0);
        let cost = |x: &[Vector3<f64>]| -> f64 {
            let mut product = Vec::new();
            chain.times(x, &mut product);
            product.iter().zip(x).map(|(a, b)| a.dot(b)).sum()
        };
        let line: Vec<Vector3<f64>> = (0..6).map(|t| Vector3::new(1.0, 2.0, 3.0) * t as f64).collect();
        assert!(cost(&line).abs() < 1e-10);
        let bend: Vec<Vector3<f64>> = (0..6).map(|t| Vector3::x() * (t * t) as f64).collect();
        assert!((cost(&bend) - 2.0 * 4.0 * 4.0).abs() < 1e-9);
    }

    #[test]
    fn rejects_indefinite_matrices() {
        let (diagonal, couplings) = (vec![Matrix3::identity(); 2], vec![[0.0; 2], [2.0, 0.0]]);
        let mut chain = PointChain { diagonal, couplings, ..PointChain::zeros(2) };
        assert!(chain.solve(&mut [Vector3::x(); 2]).is_none());
    }

    /// The diagonal of the inverse in the middle of a long path.
    #[test]
    fn smoothing_gain_is_that_of_a_long_path() {
        const N: usize = 401;
        for c in [1e-4, 0.3, 3.0, 300.0] {
            let mut system = PointChain::zeros(N);
            system.set_second_differences(|_| c);
            system.diagonal.iter_mut().for_each(|block| *block += Matrix3::identity());
            let mut unit = vec![Vector3::zeros(); N];
            unit[N / 2] = Vector3::x();
            system.solve(&mut unit).unwrap();
            let left = unit[N / 2].x;
            assert!((smoothing_gain(c) / left - 1.0).abs() < 1e-3, "{c}: {} and {left}", smoothing_gain(c));
        }
        assert!(smoothing_gain(1e-4) > 0.99, "motion, not noise");
    }
}
