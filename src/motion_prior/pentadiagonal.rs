//! Symmetric positive definite systems of half bandwidth 2, as in second-order smoothers.

/// The matrix: entry t holds `A_tt, A_t(t-1), A_t(t-2)`.
pub(crate) struct Pentadiagonal {
    rows: Vec<[f64; 3]>,
}

/// Its factors `A = L D L^T`: entry t holds `D_t, L_t(t-1), L_t(t-2)`.
pub(crate) struct Factored {
    rows: Vec<[f64; 3]>,
}

impl Pentadiagonal {
    /// A diagonal matrix.
    pub(crate) fn diagonal(entries: impl Iterator<Item = f64>) -> Self {
        Self { rows: entries.map(|entry| [entry, 0.0, 0.0]).collect() }
    }

    /// Adds `stiffness e_t^2` with `e_t = sum_k c_k x_(t-k)`.
    pub(crate) fn add_innovation(&mut self, t: usize, coefficients: &[f64], stiffness: f64) {
        for (a, ca) in coefficients.iter().enumerate() {
            for (b, cb) in coefficients.iter().enumerate().skip(a) {
                self.rows[t - a][b - a] += stiffness * ca * cb;
            }
        }
    }

    /// Factors the matrix in place.
    pub(crate) fn factored(self) -> Factored {
        let mut rows = self.rows;
        for t in 0..rows.len() {
            let [mut pivot, mut first, mut second] = rows[t];
            if t >= 2 {
                let above = rows[t - 2][0];
                second /= above;
                first -= second * above * rows[t - 1][1];
                pivot -= second * second * above;
            }
            if t >= 1 {
                first /= rows[t - 1][0];
                pivot -= first * first * rows[t - 1][0];
            }
            rows[t] = [pivot, first, second];
        }
        Factored { rows }
    }
}

impl Factored {
    /// Solves in place.
    pub(crate) fn solve(&self, x: &mut [f64]) {
        let rows = &self.rows;
        for t in 1..x.len() {
            x[t] -= rows[t][1] * x[t - 1];
            if t >= 2 {
                x[t] -= rows[t][2] * x[t - 2];
            }
        }
        for t in (0..x.len()).rev() {
            x[t] /= rows[t][0];
            if t + 1 < x.len() {
                x[t] -= rows[t + 1][1] * x[t + 1];
            }
            if t + 2 < x.len() {
                x[t] -= rows[t + 2][2] * x[t + 2];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_solution_satisfies_the_system() {
        let n = 12;
        let mut matrix = Pentadiagonal::diagonal((0..n).map(|t| 0.1 + t as f64));
        (2..n).for_each(|t| matrix.add_innovation(t, &[1.0, -1.7, 0.8], 5.0));
        (1..n).for_each(|t| matrix.add_innovation(t, &[1.0, -1.0], 0.3));
        let rows = matrix.rows.clone();
        let entry = |a: usize, b: usize| rows[a.max(b)].get(a.abs_diff(b)).copied().unwrap_or(0.0);
        let right: Vec<f64> = (0..n).map(|t| (t as f64).cos()).collect();
        let mut x = right.clone();
        matrix.factored().solve(&mut x);
        for t in 0..n {
            let product: f64 = (0..n).map(|s| entry(t, s) * x[s]).sum();
            assert!((product - right[t]).abs() < 1e-12);
        }
    }
}
