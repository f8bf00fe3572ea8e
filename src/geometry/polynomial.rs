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
/// Roots are isolated by the signs of Bernstein coefficients (Lane and Riesenfeld, "Bounds on a polynomial", BIT 21, 1981):
/// a piece of the interval without a change of sign has no root, one with a single change has one; others are divided.
/// Roots beyond 1 are reciprocals of roots of the reversed polynomial; all arithmetic stays on [-1, 1], where powers do not
/// overflow. Coefficients beyond [`MAX_DEGREE`] are not read.
///
/// Two roots that rounding cannot separate, 1e-8 apart, are returned as one root or as two within that distance.
pub fn real_roots(coefficients: &[f64]) -> RealRoots {
    let used = coefficients.len().min(MAX_DEGREE + 1);
    // A leading zero would be a root of the reversed polynomial at zero.
    let Some(degree) = coefficients[..used].iter().rposition(|c| *c != 0.0) else { return RealRoots::default() };
    let mut polynomial = Polynomial { coefficients: [0.0; MAX_DEGREE + 1], degree };
    polynomial.coefficients[..=degree].copy_from_slice(&coefficients[..=degree]);

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

/// A piece with two changes of sign has a double root where it is below this share of the sum of all absolute coefficients.
const DOUBLE_ROOT_TOLERANCE: f64 = 1e-13;

/// Share of a piece at which it is divided: round numbers, where double roots of exact input lie, should lie within pieces.
const SPLIT: f64 = 0.48;

/// Most divisions of the interval; it is then 1e-9 wide, and two roots in it are equal to rounding.
const MAX_DIVISIONS: usize = 32;

/// Bernstein coefficients of powers: `x^i = sum_j BERNSTEIN[n][i][j] B_j^n((x + 1) / 2)`, the mean product of i of n numbers of which
/// j are 1 and the others -1.
const BERNSTEIN: [[[f64; MAX_DEGREE + 1]; MAX_DEGREE + 1]; MAX_DEGREE + 1] = bernstein_of_powers();

const fn bernstein_of_powers() -> [[[f64; MAX_DEGREE + 1]; MAX_DEGREE + 1]; MAX_DEGREE + 1] {
    let mut table = [[[0.0; MAX_DEGREE + 1]; MAX_DEGREE + 1]; MAX_DEGREE + 1];
    let mut n = 0;
    while n <= MAX_DEGREE {
        let mut j = 0;
        while j <= n {
            // (1 + s)^j (1 - s)^(n - j): its i-th coefficient is the sum of the products, of which there are n over i.
            let mut sums = [0.0; MAX_DEGREE + 1];
            sums[0] = 1.0;
            let mut factor = 0;
            while factor < n {
                let sign = if factor < j { 1.0 } else { -1.0 };
                let mut i = factor + 1;
                while i > 0 {
                    sums[i] += sign * sums[i - 1];
                    i -= 1;
                }
                factor += 1;
            }
            let (mut i, mut binomial) = (0, 1.0);
            while i <= n {
                table[n][i][j] = sums[i] / binomial;
                binomial *= (n - i) as f64 / (i + 1) as f64;
                i += 1;
            }
            j += 1;
        }
        n += 1;
    }
    table
}

struct Polynomial {
    coefficients: [f64; MAX_DEGREE + 1],
    degree: usize,
}

/// A polynomial on a piece of the interval.
#[derive(Clone, Copy, Default)]
struct Piece {
    bernstein: [f64; MAX_DEGREE + 1],
    low: f64,
    high: f64,
    divisions: usize,
}

impl Polynomial {
    fn value_and_slope(&self, x: f64) -> (f64, f64) {
        self.coefficients[..=self.degree].iter().rev().fold((0.0, 0.0), |(f, d), c| (f * x + c, d * x + f))
    }

    fn roots_near_unit_interval(&self) -> RealRoots {
        let mut roots = RealRoots::default();
        let zero = DOUBLE_ROOT_TOLERANCE * self.coefficients[..=self.degree].iter().map(|c| c.abs()).sum::<f64>();
        let mut pieces = [Piece::default(); MAX_DIVISIONS + 2];
        pieces[0] = self.whole();
        let mut waiting = 1;
        while waiting > 0 {
            waiting -= 1;
            let piece = pieces[waiting];
            let bernstein = &piece.bernstein[..=self.degree];
            // A root where two pieces meet; parts of the right one begin with it again.
            if bernstein[0] == 0.0 && piece.divisions > 0 && roots.as_slice().last() != Some(&piece.low) {
                roots.push(piece.low);
            }
            match sign_changes(bernstein) {
                0 => {}
                1 => roots.push(self.root_within(&piece)),
                _ if piece.divisions == MAX_DIVISIONS || bernstein.iter().all(|b| b.abs() < zero) => {
                    roots.push(self.extremum_within(&piece));
                }
                _ => {
                    let [left, right] = piece.parts(self.degree);
                    pieces[waiting] = right;
                    pieces[waiting + 1] = left;
                    waiting += 2;
                }
            }
        }
        roots
    }

    fn whole(&self) -> Piece {
        let mut whole = Piece { low: -END, high: END, ..Piece::default() };
        let mut power = 1.0;
        for (c, of_power) in self.coefficients[..=self.degree].iter().zip(&BERNSTEIN[self.degree]) {
            for (sum, b) in whole.bernstein.iter_mut().zip(of_power) {
                *sum += c * power * b;
            }
            power *= END;
        }
        whole
    }

    /// Newton's method, kept inside a bracket by bisection.
    fn root_within(&self, piece: &Piece) -> f64 {
        let (mut low, mut high) = (piece.low, piece.high);
        let rising = piece.bernstein.iter().find(|b| **b != 0.0).is_some_and(|b| *b < 0.0);
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

    /// The extremum in a piece that is too small to tell two roots apart. The slope is linear there.
    fn extremum_within(&self, piece: &Piece) -> f64 {
        let [low, high] = [piece.low, piece.high].map(|x| self.value_and_slope(x).1);
        let share = if low == high { 0.5 } else { (low / (low - high)).clamp(0.0, 1.0) };
        piece.low + share * (piece.high - piece.low)
    }
}

impl Piece {
    /// De Casteljau's subdivision.
    fn parts(&self, degree: usize) -> [Piece; 2] {
        let middle = self.low + SPLIT * (self.high - self.low);
        let divisions = self.divisions + 1;
        let mut left = Piece { low: self.low, high: middle, divisions, ..Piece::default() };
        let mut right = Piece { low: middle, high: self.high, divisions, ..*self };
        for level in 0..=degree {
            left.bernstein[level] = right.bernstein[0];
            for i in 0..degree - level {
                right.bernstein[i] += SPLIT * (right.bernstein[i + 1] - right.bernstein[i]);
            }
        }
        [left, right]
    }
}

/// Changes of sign in a sequence, zeros left out.
fn sign_changes(values: &[f64]) -> usize {
    let (mut changes, mut last) = (0, 0.0);
    for &value in values.iter().filter(|value| **value != 0.0) {
        changes += usize::from(value * last < 0.0);
        last = value.signum();
    }
    changes
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
        assert_roots(&[-3.0, 2.0, 0.0, 0.0], &[1.5]); // leading zeros
        for double in [0.5, 0.3, -0.7, 0.0, 4.0] {
            let found = sorted(real_roots(&[double * double, -2.0 * double, 1.0]));
            assert!((1..=2).contains(&found.len()), "{double}: {found:?}");
            assert!(found.iter().all(|root| (root - double).abs() < 2e-8 * (1.0 + double.abs())), "{found:?}");
        }
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
