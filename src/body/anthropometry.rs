//! How adults differ: fourteen measures of the ANSUR II survey, and ten independent ways to vary them.
//!
//! Source: Gordon et al., 2012 Anthropometric Survey of U.S. Army Personnel, NATICK/TR-15/007 (public release,
//! distribution unlimited): 4,082 men and 1,986 women, here pooled half and half. Soldiers are heavier-muscled than
//! civilians; children are outside.

use nalgebra::SVector;

/// Number of shape coefficients (betas).
pub const N_BETAS: usize = 10;

/// A change of something per standard deviation of each beta.
pub type BetaRow = SVector<f64, N_BETAS>;

/// Number of measures in the table.
pub const N_MEASURES: usize = 14;

/// A body measure, in the table's order. The first ten drive one beta each.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Measure {
    /// Standing height.
    Stature,
    /// Body mass (kg, where all others are mm).
    Weight,
    /// Top of the greater trochanter above the floor; the femoral head's centre lies level with it.
    TrochanterHeight,
    /// Acromion to radiale.
    UpperArm,
    /// Between the acromia.
    BiacromialBreadth,
    /// Between the iliac crests.
    BicristalBreadth,
    /// Radiale to stylion.
    Forearm,
    /// Lateral femoral epicondyle above the floor.
    KneeHeight,
    /// Acromion above the floor.
    AcromialHeight,
    /// Heel to longest toe.
    FootLength,
    /// Seventh neck vertebra above the floor.
    CervicaleHeight,
    /// Lateral malleolus above the floor.
    MalleolusHeight,
    /// Wrist to middle finger tip.
    HandLength,
    /// Tragion (ear) below the top of the head.
    TragionToTop,
}

/// Pooled mean and standard deviation (mm; kg for the weight), in the order of [`Measure`].
const MOMENTS: [(f64, f64); N_MEASURES] = [
    (1692.344, 92.140),
    (76.641, 15.503),
    (873.141, 54.582),
    (323.221, 21.088),
    (390.512, 31.372),
    (274.366, 20.057),
    (254.606, 20.280),
    (478.797, 29.782),
    (1387.916, 80.494),
    (258.736, 17.832),
    (1456.483, 86.442),
    (67.826, 7.409),
    (187.180, 11.714),
    (128.811, 6.773),
];

/// Pooled correlations below the diagonal, row by row.
#[rustfmt::skip]
const CORRELATIONS: [&[f64]; N_MEASURES] = [
    &[],
    &[0.6889],
    &[0.8824, 0.5718],
    &[0.8653, 0.6338, 0.8482],
    &[0.7918, 0.7187, 0.6473, 0.6886],
    &[0.3506, 0.5679, 0.2737, 0.3367, 0.2609],
    &[0.8359, 0.6099, 0.8345, 0.8100, 0.7376, 0.2009],
    &[0.8382, 0.5564, 0.9075, 0.8226, 0.5937, 0.3015, 0.7889],
    &[0.9820, 0.7077, 0.8927, 0.8776, 0.7548, 0.3824, 0.8324, 0.8550],
    &[0.8554, 0.6953, 0.7840, 0.7698, 0.7821, 0.2787, 0.8243, 0.7569, 0.8415],
    &[0.9918, 0.7036, 0.8926, 0.8743, 0.8003, 0.3494, 0.8495, 0.8476, 0.9850, 0.8604],
    &[0.7134, 0.5853, 0.5807, 0.5798, 0.6589, 0.2447, 0.5950, 0.5525, 0.6993, 0.6462, 0.7144],
    &[0.7667, 0.6109, 0.7589, 0.7360, 0.6751, 0.2514, 0.7800, 0.7520, 0.7637, 0.8481, 0.7751, 0.5296],
    &[0.3798, 0.3468, 0.2812, 0.3034, 0.3574, 0.2061, 0.2910, 0.2758, 0.3389, 0.3524, 0.3553, 0.3092, 0.2849],
];

/// The population as a linear model: `measure_i = mean_i + loadings_i . beta`, `beta ~ N(0, I)`.
#[derive(Debug, Clone, PartialEq)]
pub struct Population {
    /// Mean of each measure, m (kg for the weight).
    pub means: [f64; N_MEASURES],
    /// What one unit of each beta adds, m (kg for the weight).
    pub loadings: [BetaRow; N_MEASURES],
    /// Standard deviation that the ten betas leave unexplained, m (kg).
    pub unexplained: [f64; N_MEASURES],
}

impl Population {
    /// The ANSUR II adults, men and women half and half.
    ///
    /// The loadings are the first ten columns of the Cholesky factor L of the covariance, `C = L L^T`, the measures
    /// taken in the order of [`Measure`]: beta 0 is stature with all that goes with it on average (the regressions on
    /// stature), beta 1 is weight at a given stature, beta 2 leg length given both, then arm, shoulders, pelvis,
    /// forearm, knee height, shoulder height, foot: each is what the earlier ones leave open. So no beta but the
    /// first changes the stature, and the ten are independent with variance one by construction. Known limit: the
    /// last four measures keep an unexplained rest of 5 to 9 mm.
    pub fn ansur2() -> Self {
        let mut factor = [[0.0; N_MEASURES]; N_MEASURES];
        for i in 0..N_MEASURES {
            for j in 0..=i {
                let correlation = if i == j { 1.0 } else { CORRELATIONS[i][j] };
                let rest = correlation - (0..j).map(|k| factor[i][k] * factor[j][k]).sum::<f64>();
                factor[i][j] = if i == j { rest.sqrt() } else { rest / factor[j][j] };
            }
        }
        let unit = |i: usize| if i == Measure::Weight as usize { 1.0 } else { 1e-3 };
        let sd = |i: usize| MOMENTS[i].1 * unit(i);
        let unexplained = |i: usize| (N_BETAS..N_MEASURES).map(|k| factor[i][k] * factor[i][k]).sum::<f64>().sqrt();
        Self {
            means: std::array::from_fn(|i| MOMENTS[i].0 * unit(i)),
            loadings: std::array::from_fn(|i| BetaRow::from_fn(|k, _| factor[i][k] * sd(i))),
            unexplained: std::array::from_fn(|i| unexplained(i) * sd(i)),
        }
    }
}

/// `constant + sum of factor * measure`, m: how a place on the body follows from the measures.
#[derive(Debug, Clone, PartialEq)]
pub struct Length {
    /// Part that does not vary, m.
    pub constant: f64,
    /// Measures and their factors.
    pub terms: Vec<(f64, Measure)>,
}

/// Mean of a length over the population and its change per beta, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VariedLength {
    /// At beta 0.
    pub mean: f64,
    /// Per unit of each beta.
    pub per_beta: BetaRow,
}

impl Length {
    /// The length in a population.
    pub fn in_population(&self, population: &Population) -> VariedLength {
        let mut length = VariedLength { mean: self.constant, per_beta: BetaRow::zeros() };
        for &(factor, measure) in &self.terms {
            length.mean += factor * population.means[measure as usize];
            length.per_beta += population.loadings[measure as usize] * factor;
        }
        length
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_loadings_give_back_the_surveys_covariance() {
        let p = Population::ansur2();
        for i in 0..N_MEASURES {
            let unit = if i == 1 { 1.0 } else { 1e-3 };
            let variance = p.loadings[i].norm_squared() + p.unexplained[i].powi(2);
            assert!((variance.sqrt() - MOMENTS[i].1 * unit).abs() < 1e-9 * unit.max(1e-3));
            for j in 0..i.min(N_BETAS) {
                let covariance = p.loadings[i].dot(&p.loadings[j]);
                let sds = (p.loadings[i].norm_squared() + p.unexplained[i].powi(2)).sqrt() * p.loadings[j].norm();
                assert!((covariance / sds - CORRELATIONS[i][j]).abs() < 1e-9, "measures {i} and {j}");
            }
        }
    }

    #[test]
    fn only_the_first_beta_changes_the_stature() {
        let stature = Population::ansur2().loadings[Measure::Stature as usize];
        assert!((stature[0] - 0.09214).abs() < 1e-9);
        assert!(stature.iter().skip(1).all(|v| v.abs() < 1e-12));
    }
}
