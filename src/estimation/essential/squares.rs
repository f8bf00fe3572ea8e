//! Normal equations of the Sampson distances of many pairs, in vectors of pairs.

use crate::geometry::Rigid;
use crate::geometry::epipolar::PointPair;
use crate::optim::dense_levenberg_marquardt::QuadraticModel;
use crate::optim::vectors::vectorised;
use nalgebra::{Matrix3x2, SMatrix, SVector};
use pulp::{Simd, WithSimd};

/// Pairs that are computed side by side: two vectors of four, or one of eight.
const LANES: usize = 8;

/// Degrees of freedom of an essential matrix: rotation, and direction of the baseline.
const N: usize = 5;

/// Sums over pairs: the cost, the gradient, the lower triangle of the Hessian.
const N_SUMS: usize = 1 + N + N * (N + 1) / 2;

/// Pairs side by side: coordinates of the first and the second point, and weights.
struct Lanes {
    coordinates: [[f64; LANES]; 4],
    weights: [f64; LANES],
}

/// Pairs in groups of [`LANES`]; the last group is filled up with pairs of weight zero.
pub(super) struct PairLanes(Vec<Lanes>);

impl PairLanes {
    /// Pairs of positive weight; `weight`: by index. A pair that is not finite is left out: it would stop the descent for all others.
    pub(super) fn new(pairs: &[PointPair], weight: impl Fn(usize) -> f64) -> Self {
        let is_finite = |(a, b): &PointPair| a.iter().chain(b).all(|coordinate| coordinate.is_finite());
        let usable = pairs.iter().enumerate().map(|(i, pair)| (pair, weight(i)));
        let mut groups: Vec<Lanes> = Vec::with_capacity(pairs.len().div_ceil(LANES));
        for (i, ((a, b), weight)) in usable.filter(|(pair, weight)| *weight > 0.0 && is_finite(pair)).enumerate() {
            let lane = i % LANES;
            if lane == 0 {
                groups.push(Lanes { coordinates: [[0.0; LANES]; 4], weights: [0.0; LANES] });
            }
            if let Some(group) = groups.last_mut() {
                group.coordinates.iter_mut().zip([a.x, a.y, b.x, b.y]).for_each(|(all, own)| all[lane] = own);
                group.weights[lane] = weight;
            }
        }
        Self(groups)
    }

    /// The Geman-McClure loss of Sampson distances about `pose`, by a left rotation and along the `tangents` of the baseline.
    pub(super) fn linearized(&self, pose: &Rigid, tangents: &Matrix3x2<f64>, threshold: f64) -> QuadraticModel<N> {
        let sums = vectorised(Squares { pairs: &self.0, pose, tangents, scale2: threshold * threshold });
        let [cost, gradient @ ..] = sums;
        let (gradient, triangle) = gradient.split_at(N);
        let lower = |i: usize, j: usize| triangle[i * (i + 1) / 2 + j];
        let hessian = SMatrix::from_fn(|i, j| lower(i.max(j), i.min(j)));
        QuadraticModel { cost, gradient: SVector::from_column_slice(gradient), hessian }
    }
}

/// The sums over all pairs.
struct Squares<'a> {
    pairs: &'a [Lanes],
    pose: &'a Rigid,
    tangents: &'a Matrix3x2<f64>,
    scale2: f64,
}

impl WithSimd for Squares<'_> {
    type Output = [f64; N_SUMS];

    /// With `q = R a`, `p = b x t`, `l = t x q = E a`, `m = R^T p = E^T b`, `g = l_1^2 + l_2^2 + m_1^2 + m_2^2`, the signed Sampson
    /// distance is `r = (b . l) / sqrt(g)`, and `dr = u . dl + v . dm`, `u = b / sqrt(g) - k (l_1, l_2, 0)`, `v = -k (m_1, m_2, 0)`,
    /// `k = (b . l) / g^(3/2)`; then `dr/dphi = q x (u x t) + (R v) x p` and `dr/dt = q x u + (R v) x b`. All are zero where both
    /// points are epipoles.
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let splat = |value: f64| simd.splat_f64s(value);
        let mul = |a, b| simd.mul_f64s(a, b);
        let add_product = |a, b, sum| simd.mul_add_e_f64s(a, b, sum);
        let minus = |a| simd.neg_f64s(a);
        let dot = |a: [S::f64s; 3], b: [S::f64s; 3]| add_product(a[0], b[0], add_product(a[1], b[1], mul(a[2], b[2])));
        let area = |a, b, c, d| add_product(a, d, minus(mul(b, c)));
        let cross = |a: [S::f64s; 3], b: [S::f64s; 3]| {
            [area(a[1], a[2], b[1], b[2]), area(a[2], a[0], b[2], b[0]), area(a[0], a[1], b[0], b[1])]
        };
        let sum = |a: [S::f64s; 3], b: [S::f64s; 3]| [0, 1, 2].map(|i| simd.add_f64s(a[i], b[i]));
        let rows = [0, 1, 2].map(|i| [0, 1, 2].map(|j| splat(self.pose.rotation[(i, j)])));
        let columns = [0, 1].map(|j| rows.map(|row| row[j]));
        let t = [0, 1, 2].map(|i| splat(self.pose.translation[i]));
        let tangents = [0, 1].map(|k| [0, 1, 2].map(|i| splat(self.tangents[(i, k)])));
        let (zero, one, scale2) = (splat(0.0), splat(1.0), splat(self.scale2));

        let mut sums = [zero; N_SUMS];
        for Lanes { coordinates, weights } in self.pairs {
            let [ax, ay, bx, by] = coordinates.each_ref().map(|values| S::as_simd_f64s(values).0);
            for (i, own_weight) in S::as_simd_f64s(weights).0.iter().enumerate() {
                let (a, b) = ([ax[i], ay[i], one], [bx[i], by[i], one]);
                let (q, p) = (rows.map(|row| dot(row, a)), cross(b, t));
                let (l, m) = (cross(t, q), columns.map(|column| dot(column, p)));
                let g = [l[0], l[1], m[0], m[1]].into_iter().fold(zero, |g, x| add_product(x, x, g));
                let g = simd.select_f64s(simd.greater_than_f64s(g, zero), g, one);
                let inverse = simd.div_f64s(one, simd.sqrt_f64s(g));
                let residual = mul(dot(b, l), inverse);
                let k = minus(simd.div_f64s(residual, g));
                let u = [add_product(k, l[0], mul(b[0], inverse)), add_product(k, l[1], mul(b[1], inverse)), inverse];
                let v = [mul(k, m[0]), mul(k, m[1]), zero];
                let s = rows.map(|row| dot(row, v));
                let turn = sum(cross(q, cross(u, t)), cross(s, p));
                let slide = sum(cross(q, u), cross(s, b));
                let jacobian = [turn[0], turn[1], turn[2], dot(tangents[0], slide), dot(tangents[1], slide)];

                // Geman and McClure's: `(s^2 / (s^2 + r^2))^2` and `s^2 r^2 / (s^2 + r^2)`.
                let squared = mul(residual, residual);
                let ratio = simd.div_f64s(scale2, simd.add_f64s(scale2, squared));
                let weighted_ratio = mul(*own_weight, ratio);
                sums[0] = add_product(weighted_ratio, squared, sums[0]);
                let weight = mul(weighted_ratio, ratio);
                for i in 0..N {
                    let weighted = mul(weight, jacobian[i]);
                    sums[1 + i] = add_product(weighted, residual, sums[1 + i]);
                    for j in 0..=i {
                        let place = 1 + N + i * (i + 1) / 2 + j;
                        sums[place] = add_product(weighted, jacobian[j], sums[place]);
                    }
                }
            }
        }
        sums.map(|lanes| simd.reduce_sum_f64s(lanes))
    }
}
