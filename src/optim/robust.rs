//! Robust statistics: bounded costs for residuals with outliers, their schedule of scales, medians and quantiles.

/// A robust cost and the weight with which its residual enters the normal equations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Robust {
    /// Half of rho: for small residuals half the squared residual.
    pub cost: f64,
    /// `rho'(e) / (2 e)`: 1 for small residuals, near 0 for outliers.
    pub weight: f64,
    /// `rho''(e) / 2`, the second derivative along the residual; negative for outliers. Perpendicular to it, it is `weight`.
    pub curvature: f64,
}

/// Sums over residuals in the plane of the second derivatives of a robust cost, and of the weights that normal equations have in
/// their place.
#[derive(Debug, Clone, Copy, Default)]
pub struct Curvature {
    curvature: f64,
    weight: f64,
}

/// Smallest ratio of curvature to weight, reached where half of the residuals are as large as the robust scale.
const MIN_CURVATURE: f64 = 0.1;

impl Curvature {
    /// With a residual whose square counts `factor` times: half of its second derivatives are along it, half across.
    #[must_use]
    pub fn with(self, robust: &Robust, factor: f64) -> Self {
        let curvature = 0.5 * factor * (robust.curvature + robust.weight);
        self.and(Self { curvature, weight: factor * robust.weight })
    }

    /// With those of other residuals.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Self { curvature: self.curvature + other.curvature, weight: self.weight + other.weight }
    }

    /// The Hessian over the normal equations. At a minimum the sum is positive; the floor bounds the certainty of a bad fit.
    pub fn per_weight(self) -> f64 {
        if self.weight > 0.0 { (self.curvature / self.weight).max(MIN_CURVATURE) } else { 1.0 }
    }
}

/// The Geman-McClure cost of a residual of squared norm `squared`.
///
/// `rho(e) = s^2 e^2 / (s^2 + e^2)`, `w = (s^2 / (s^2 + e^2))^2`, `rho'' / 2 = w (1 - 4 e^2 / (s^2 + e^2))`: Geman and
/// McClure 1985, scaled so that rho is `e^2` near zero. `squared` is the squared norm of a residual vector.
///
/// `scale`: positive, in the unit of the residual. Solvers use the weight instead of the curvature, which is negative
/// beyond `s / sqrt(3)`: the normal matrix stays positive semi-definite. A covariance needs both.
pub fn geman_mcclure(squared: f64, scale: f64) -> Robust {
    let s2 = scale * scale;
    let ratio = s2 / (s2 + squared);
    let weight = ratio * ratio;
    Robust { cost: 0.5 * squared * ratio, weight, curvature: weight * (4.0 * ratio - 3.0) }
}

/// The cost [`geman_mcclure`] of an infinite residual: `s^2 / 2`.
///
/// It applies to data without a residual, as a point behind the camera that saw it. At no cost the solver would move
/// bad points there.
pub fn geman_mcclure_ceiling(scale: f64) -> f64 {
    0.5 * scale * scale
}

/// The Geman-McClure loss `rho(e) = s^2 e^2 / (e^2 + s^2)` itself, from squares: twice the cost of [`geman_mcclure`], rounded
/// differently. For the small solvers, whose scale is fixed.
pub fn geman_mcclure_rho(squared: f64, squared_scale: f64) -> f64 {
    squared_scale * squared / (squared + squared_scale)
}

/// The weight `(s^2 / (s^2 + e^2))^2` of a residual under [`geman_mcclure_rho`]; equal to that of [`geman_mcclure`].
pub fn geman_mcclure_weight(squared: f64, squared_scale: f64) -> f64 {
    let ratio = squared_scale / (squared_scale + squared);
    ratio * ratio
}

/// Scale of a robust cost, in standard deviations: a datum further off is more likely wrong than noisy. A normal error of
/// two dimensions stays within it with 98.9 %. Adjustments that were tuned on simulated captures name their own (4).
pub const OUTLIER_SIGMAS: f64 = 3.0;

/// The weight `1 / (1 + e^2 / k^2)` of a residual under Cauchy's cost `k^2 / 2 log(1 + e^2 / k^2)`, which grows without bound, but hardly.
pub fn cauchy_weight(squared: f64, scale: f64) -> f64 {
    (1.0 + squared / (scale * scale)).recip()
}

/// The Charbonnier cost of a residual of squared norm `squared`: quadratic near zero, linear far beyond the knee k.
///
/// `rho / 2 = factor k^2 (r - 1)` with `r = sqrt(1 + e^2 / k^2)`; weight `factor / r`, curvature `factor / r^3`: Charbonnier et al.
/// 1994. `knee_squared`: k^2, positive, in the squared unit of the residual.
pub fn charbonnier(factor: f64, squared: f64, knee_squared: f64) -> Robust {
    let root = (1.0 + squared / knee_squared).sqrt();
    let weight = factor / root;
    Robust { cost: factor * knee_squared * (root - 1.0), weight, curvature: weight / (root * root) }
}

/// Graduated non-convexity: the scale falls geometrically, so that the residuals of a rough start are not outliers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GraduatedScale {
    /// First scale, in units of the residual's standard deviation.
    pub start: f64,
    /// Last scale, same unit.
    pub end: f64,
    /// Number of scales including both ends, at least 1; 1 means `end` alone.
    pub steps: usize,
}

impl GraduatedScale {
    /// The scales from `start` to `end`, in order; the last is exactly `end`.
    pub fn scales(&self) -> Vec<f64> {
        let last = self.steps.max(1) - 1;
        (0..last).map(|k| self.start * (self.end / self.start).powf(k as f64 / last as f64)).chain([self.end]).collect()
    }

    /// The same schedule with a first scale of at most `widest`: for good starts, which outliers would disturb.
    pub fn starting_within(&self, widest: f64) -> Self {
        Self { start: self.start.min(widest.max(self.end)), ..*self }
    }
}

/// Standard deviation of a normal distribution over its median absolute deviation.
pub const NORMAL_SIGMA_OF_MAD: f64 = 1.4826;

/// Half the width of a 95 % interval of a normal distribution, in standard deviations.
pub const INTERVAL_95: f64 = 1.96;

/// Median length of a normal error in two dimensions over its standard deviation per axis: `sqrt(2 ln 2)`.
pub const MEDIAN_LENGTH_IN_PLANE: f64 = 1.177;

/// Least share of the equations that counts as left over to show the errors.
const MIN_FREEDOM: f64 = 0.25;

/// Variance of errors over that of the residuals that `n` equations leave of them after determining `p` unknowns:
/// `n / (n - p)`; one where nothing was seen.
pub fn variance_per_residual(n: f64, p: f64) -> f64 {
    if n > 0.0 { n / (n - p).max(MIN_FREEDOM * n) } else { 1.0 }
}

/// Median and median absolute deviation; zeros for an empty set. Reorders `values`.
pub fn median_and_spread(values: &mut [f64]) -> (f64, f64) {
    let Some(center) = median(values) else { return (0.0, 0.0) };
    let mut deviations: Vec<f64> = values.iter().map(|v| (v - center).abs()).collect();
    (center, median(&mut deviations).unwrap_or(0.0))
}

/// The upper median; `None` for an empty set. Reorders `values`.
pub fn median(values: &mut [f64]) -> Option<f64> {
    quantile(values, 0.5)
}

/// The value with `share` (0 to 1) of all values below it; `None` for an empty set. Reorders `values`.
pub fn quantile(values: &mut [f64], share: f64) -> Option<f64> {
    let last = values.len().checked_sub(1)?;
    let place = (values.len() as f64 * share) as usize;
    Some(*values.select_nth_unstable_by(place.min(last), f64::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn the_weight_is_the_derivative_of_the_cost() {
        for e2 in [0.0, 0.3, 4.0, 900.0] {
            let h = 1e-5 * (1.0 + e2);
            let slope = (geman_mcclure(e2 + h, 3.0).cost - geman_mcclure(e2 - h, 3.0).cost) / h;
            assert!((slope - geman_mcclure(e2, 3.0).weight).abs() < 1e-8);
        }
    }

    #[test]
    fn the_curvature_is_the_second_derivative_of_the_cost() {
        for e in [0.0, 0.3, 1.7, 30.0_f64] {
            let slope_at = |e: f64| e * geman_mcclure(e * e, 3.0).weight;
            let slope = (slope_at(e + 1e-5) - slope_at(e - 1e-5)) / 2e-5;
            assert!((slope - geman_mcclure(e * e, 3.0).curvature).abs() < 1e-8);
        }
    }

    /// Half of the weight along the residual is `4 e^2 / (s^2 + e^2)` too much.
    #[test]
    fn the_hessian_is_less_than_the_weights() {
        let sum = |squared| Curvature::default().with(&geman_mcclure(squared, 4.0), 3.0);
        assert_eq!(sum(0.0).per_weight(), 1.0);
        assert!((sum(2.0).per_weight() - (1.0 - 4.0 / 18.0)).abs() < 1e-12);
        assert_eq!(sum(900.0).per_weight(), MIN_CURVATURE, "outliers alone");
        assert_eq!(Curvature::default().per_weight(), 1.0, "nothing was seen");
    }

    /// Estimates by a robust cost were stated as if its Hessian were the normal equations, too sure by a fifth.
    #[test]
    fn robust_estimates_scatter_as_the_hessian_says() {
        const N: usize = 40;
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut estimate = || {
            let points: [Vector2<f64>; N] =
                std::array::from_fn(|_| Vector2::from_fn(|_, _| StandardNormal.sample(&mut rng)));
            let mut at = Vector2::zeros();
            for _ in 0..20 {
                let weights = points.map(|p| geman_mcclure((p - at).norm_squared(), 4.0).weight);
                at = points.iter().zip(weights).map(|(p, w)| p * w).sum::<Vector2<f64>>() / weights.iter().sum::<f64>();
            }
            let robust = points.map(|p| geman_mcclure((p - at).norm_squared(), 4.0));
            let of_scores: f64 =
                points.iter().zip(&robust).map(|(p, r)| (p - at).norm_squared() * r.weight.powi(2)).sum();
            let weights: f64 = robust.iter().map(|r| r.weight).sum();
            let hessian = robust.iter().fold(Curvature::default(), |sum, r| sum.with(r, 1.0)).per_weight() * weights;
            (at.norm_squared(), of_scores / hessian.powi(2))
        };
        let (mut found, mut stated) = (0.0, 0.0);
        for _ in 0..4000 {
            let (of_one, of_sandwich) = estimate();
            (found, stated) = (found + of_one, stated + of_sandwich);
        }
        // A mean of 8,000 squares is sure to 1.6 %; by 40 points a sandwich is a twentieth short.
        assert!((0.9..1.05).contains(&(stated / found)), "{}", stated / found);
    }

    #[test]
    fn the_cost_is_bounded_by_its_ceiling() {
        let far = geman_mcclure(1e12, 3.0);
        assert!((far.cost - geman_mcclure_ceiling(3.0)).abs() < 1e-6 && far.weight < 1e-12);
    }

    #[test]
    fn scales_fall_geometrically_and_end_exactly() {
        let schedule = GraduatedScale { start: 32.0, end: 4.0, steps: 4 };
        let scales = schedule.scales();
        assert!(scales.iter().zip([32.0, 16.0, 8.0, 4.0]).all(|(a, b)| (a - b).abs() < 1e-12));
        assert_eq!(schedule.starting_within(1.0).scales(), vec![4.0; 4]);
        assert_eq!(GraduatedScale { steps: 0, ..schedule }.scales(), vec![4.0]);
    }
}
