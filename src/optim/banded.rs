//! Cholesky factorisation of a symmetric positive definite band matrix: linear in its size.

/// A symmetric matrix of which only the diagonal and `width` sub-diagonals are not zero; lower part, row by row.
#[derive(Debug, Clone)]
pub struct BandMatrix {
    n: usize,
    width: usize,
    /// Row `i` holds columns `i - width ..= i`.
    rows: Vec<f64>,
}

impl BandMatrix {
    /// The zero matrix of `n` rows with `width` sub-diagonals.
    pub fn zeros(n: usize, width: usize) -> Self {
        Self { n, width, rows: vec![0.0; n * (width + 1)] }
    }

    fn at(&self, i: usize, j: usize) -> usize {
        i * (self.width + 1) + self.width + j - i
    }

    /// Adds to an entry; `i >= j`, `i - j <= width`.
    pub fn add(&mut self, i: usize, j: usize, value: f64) {
        let at = self.at(i, j);
        self.rows[at] += value;
    }

    /// Solves `A x = b` in place by Cholesky's factorisation; `None` where `A` is not positive definite. Destroys `self`.
    pub fn solve(mut self, mut b: Vec<f64>) -> Option<Vec<f64>> {
        let w = self.width;
        for i in 0..self.n {
            let low = i.saturating_sub(w);
            for j in low..=i {
                let start = low.max(j.saturating_sub(w));
                let (ri, rj) = (self.at(i, start), self.at(j, start));
                let dot: f64 = (0..j - start).map(|k| self.rows[ri + k] * self.rows[rj + k]).sum();
                let at = self.at(i, j);
                let value = self.rows[at] - dot;
                if i == j {
                    if value <= 0.0 || !value.is_finite() {
                        return None;
                    }
                    self.rows[at] = value.sqrt();
                } else {
                    self.rows[at] = value / self.rows[self.at(j, j)];
                }
            }
            let row = self.at(i, low);
            let dot: f64 = (low..i).map(|k| self.rows[row + k - low] * b[k]).sum();
            b[i] = (b[i] - dot) / self.rows[self.at(i, i)];
        }
        for i in (0..self.n).rev() {
            b[i] /= self.rows[self.at(i, i)];
            let low = i.saturating_sub(w);
            let row = self.at(i, low);
            for k in low..i {
                b[k] -= self.rows[row + k - low] * b[i];
            }
        }
        Some(b)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};

    #[test]
    fn solves_what_a_dense_solver_solves() {
        let (n, w) = (40, 5);
        let mut band = BandMatrix::zeros(n, w);
        let mut dense = DMatrix::zeros(n, n);
        for i in 0..n {
            for j in i.saturating_sub(w)..=i {
                let value = if i == j { 10.0 + i as f64 * 0.1 } else { ((i * 7 + j * 3) % 11) as f64 * 0.1 - 0.5 };
                band.add(i, j, value);
                dense[(i, j)] = value;
                dense[(j, i)] = value;
            }
        }
        let b: Vec<f64> = (0..n).map(|i| (i as f64).sin()).collect();
        let expected = dense.cholesky().unwrap().solve(&DVector::from_vec(b.clone()));
        let found = band.solve(b).unwrap();
        assert!(found.iter().zip(expected.iter()).all(|(a, b)| (a - b).abs() < 1e-12));
    }

    #[test]
    fn an_indefinite_matrix_is_refused() {
        let mut band = BandMatrix::zeros(2, 1);
        band.add(0, 0, 1.0);
        band.add(1, 0, 2.0);
        band.add(1, 1, 1.0);
        assert!(band.solve(vec![1.0, 1.0]).is_none());
    }
}
