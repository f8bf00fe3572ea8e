//! Body measures of adults: 35 measures of the ANSUR II survey, and ten independent directions of variation.
//!
//! Source: Gordon et al., 2012 Anthropometric Survey of U.S. Army Personnel, NATICK/TR-15/007 (public release,
//! distribution unlimited): 4,082 men and 1,986 women, here pooled half and half. Soldiers have more muscle than
//! civilians; children are not covered.

use nalgebra::SVector;

/// Number of shape coefficients (betas).
pub const N_BETAS: usize = 10;

/// Change of a quantity per unit of each beta.
pub type BetaRow = SVector<f64, N_BETAS>;

/// Number of measures in the table.
pub const N_MEASURES: usize = 35;

/// A body measure, in the table's order. Each of the first ten defines one beta.
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
    /// Fullest height of the chest above the floor.
    ChestHeight,
    /// Navel above the floor.
    WaistHeight,
    /// Rearmost point of the buttocks above the floor.
    ButtockHeight,
    /// Crotch above the floor.
    CrotchHeight,
    /// Across the knuckles.
    HandBreadth,
    /// Circumference of the chest at its height.
    ChestGirth,
    /// Circumference of the waist at the navel.
    WaistGirth,
    /// Circumference of the buttocks at their height.
    ButtockGirth,
    /// Circumference of the thigh just below the gluteal furrow.
    ThighGirth,
    /// Circumference of the thigh just above the knee.
    LowerThighGirth,
    /// Circumference of the calf at its fullest.
    CalfGirth,
    /// Circumference of the ankle at its slimmest.
    AnkleGirth,
    /// Circumference of the flexed upper arm.
    BicepsGirth,
    /// Circumference of the flexed forearm.
    ForearmGirth,
    /// Circumference of the wrist.
    WristGirth,
    /// Circumference of the neck at the larynx.
    NeckGirth,
    /// Across the head above the ears.
    HeadBreadth,
    /// Brow to the back of the head.
    HeadLength,
    /// Across the ball of the foot.
    FootBreadth,
    /// Across the heel.
    HeelBreadth,
    /// Between the deltoids, arms hanging.
    BideltoidBreadth,
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
    (1231.378, 82.044),
    (1018.317, 63.781),
    (860.804, 54.990),
    (814.124, 55.578),
    (83.208, 6.523),
    (1002.782, 101.831),
    (900.741, 113.222),
    (1020.383, 76.294),
    (620.645, 57.323),
    (404.998, 33.832),
    (382.759, 30.629),
    (222.542, 16.262),
    (331.857, 41.985),
    (287.070, 30.688),
    (165.355, 13.501),
    (363.722, 40.841),
    (151.050, 6.288),
    (194.662, 8.710),
    (97.286, 6.785),
    (69.834, 5.958),
    (480.375, 42.928),
];

/// Pooled correlations with the first ten measures, row by row, below the diagonal.
#[rustfmt::skip]
#[allow(clippy::approx_constant)] // one of them equals pi / 6 in its digits
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
    &[0.7134, 0.5853, 0.5807, 0.5798, 0.6589, 0.2447, 0.5950, 0.5525, 0.6993, 0.6462],
    &[0.7667, 0.6109, 0.7589, 0.7360, 0.6751, 0.2514, 0.7800, 0.7520, 0.7637, 0.8481],
    &[0.3798, 0.3468, 0.2812, 0.3034, 0.3574, 0.2061, 0.2910, 0.2758, 0.3389, 0.3524],
    &[0.9653, 0.6609, 0.8824, 0.8518, 0.7828, 0.2752, 0.8454, 0.8402, 0.9598, 0.8482],
    &[0.9395, 0.5661, 0.9160, 0.8582, 0.7139, 0.2386, 0.8411, 0.8850, 0.9376, 0.8177],
    &[0.8635, 0.5741, 0.9677, 0.8323, 0.6344, 0.2883, 0.8314, 0.8980, 0.8773, 0.7709],
    &[0.9013, 0.5593, 0.9452, 0.8635, 0.6791, 0.2375, 0.8616, 0.9200, 0.9058, 0.8112],
    &[0.7507, 0.7124, 0.6104, 0.6508, 0.7914, 0.2496, 0.6985, 0.5656, 0.7315, 0.7879],
    &[0.5331, 0.9105, 0.4113, 0.5038, 0.6448, 0.5474, 0.4766, 0.3892, 0.5589, 0.5589],
    &[0.3907, 0.8649, 0.3038, 0.3880, 0.4632, 0.6476, 0.3400, 0.2968, 0.4283, 0.4096],
    &[0.2504, 0.7450, 0.2168, 0.2706, 0.2370, 0.6519, 0.1952, 0.2540, 0.2929, 0.2654],
    &[0.2586, 0.7751, 0.2340, 0.2701, 0.2911, 0.5515, 0.2433, 0.2568, 0.2959, 0.3061],
    &[0.3101, 0.7561, 0.2628, 0.3028, 0.3164, 0.5064, 0.2630, 0.3121, 0.3344, 0.3694],
    &[0.4221, 0.8099, 0.3286, 0.3826, 0.4688, 0.4812, 0.3536, 0.3545, 0.4316, 0.4833],
    &[0.5310, 0.7368, 0.3969, 0.4381, 0.5439, 0.4287, 0.4225, 0.4018, 0.5236, 0.5905],
    &[0.5559, 0.8878, 0.4415, 0.4986, 0.6770, 0.3995, 0.5354, 0.4146, 0.5619, 0.6138],
    &[0.6746, 0.8687, 0.5391, 0.5945, 0.7790, 0.3347, 0.6396, 0.5040, 0.6696, 0.7254],
    &[0.7729, 0.8143, 0.6139, 0.6674, 0.8185, 0.3309, 0.7005, 0.5708, 0.7559, 0.7981],
    &[0.6700, 0.8325, 0.5109, 0.5858, 0.8077, 0.3115, 0.6250, 0.4600, 0.6649, 0.7024],
    &[0.4312, 0.5029, 0.3124, 0.3585, 0.5257, 0.2079, 0.3888, 0.2827, 0.4162, 0.4631],
    &[0.6027, 0.5680, 0.5124, 0.5182, 0.6035, 0.1749, 0.5653, 0.4809, 0.5779, 0.6185],
    &[0.6975, 0.7175, 0.5760, 0.6015, 0.7295, 0.2958, 0.6561, 0.5547, 0.6828, 0.7735],
    &[0.4734, 0.6227, 0.4383, 0.4612, 0.5398, 0.1747, 0.5422, 0.4371, 0.4700, 0.6316],
    &[0.6570, 0.9110, 0.5185, 0.5972, 0.8325, 0.4520, 0.6051, 0.4827, 0.6601, 0.6808],
];

/// The population as a linear model: `measure_i = mean_i + loadings_i . beta`, `beta ~ N(0, I)`.
#[derive(Debug, Clone, PartialEq)]
pub struct Population {
    /// Mean of each measure, m (kg for the weight).
    pub means: [f64; N_MEASURES],
    /// Change of each measure per unit of each beta, m (kg for the weight).
    pub loadings: [BetaRow; N_MEASURES],
    /// Standard deviation of each measure that the ten betas do not explain, m (kg for the weight).
    pub unexplained: [f64; N_MEASURES],
}

impl Population {
    /// The ANSUR II adults, men and women half and half.
    ///
    /// The loadings are the first ten columns of the Cholesky factor L of the covariance, `C = L L^T`, the measures
    /// taken in the order of [`Measure`]: beta 0 is stature with the regressions of all measures on it, beta 1 is
    /// weight at a given stature, beta 2 leg length given both, then arm, shoulders, pelvis, forearm, knee height,
    /// shoulder height, foot: each is the part that the earlier ones do not explain. Only the first beta therefore
    /// changes the stature, and the ten are independent with variance one by construction. Known limit: the later
    /// measures keep an unexplained standard deviation (5 to 9 mm for lengths, up to 45 mm for girths).
    pub fn ansur2() -> Self {
        let mut factor = [BetaRow::zeros(); N_MEASURES];
        let mut unexplained = [0.0; N_MEASURES];
        for i in 0..N_MEASURES {
            for j in 0..N_BETAS.min(i) {
                let rest = CORRELATIONS[i][j] - (0..j).map(|k| factor[i][k] * factor[j][k]).sum::<f64>();
                factor[i][j] = rest / factor[j][j];
            }
            let rest = (1.0 - factor[i].norm_squared()).sqrt();
            *(if i < N_BETAS { &mut factor[i][i] } else { &mut unexplained[i] }) = rest;
        }
        let unit = |i: usize| if i == Measure::Weight as usize { 1.0 } else { 1e-3 };
        let sd = |i: usize| MOMENTS[i].1 * unit(i);
        Self {
            means: std::array::from_fn(|i| MOMENTS[i].0 * unit(i)),
            loadings: std::array::from_fn(|i| factor[i] * sd(i)),
            unexplained: std::array::from_fn(|i| unexplained[i] * sd(i)),
        }
    }
}

/// `constant + sum of factor * measure`, m: a coordinate on the body as a function of the measures.
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
    /// Value at beta 0, m.
    pub mean: f64,
    /// Change per unit of each beta, m.
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
    fn the_loadings_reproduce_the_surveys_covariance() {
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
