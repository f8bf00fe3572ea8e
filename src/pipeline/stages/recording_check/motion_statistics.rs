//! How people move: means and covariance of the logarithms of root mean square changes of position, from recorded motion.
//!
//! 1,290 recordings of 1 to 4 people and 3 to 20 s, cut from motion capture of 27 groups of takes (walking, running, climbing, dancing,
//! playing, gymnastics, directing traffic, everyday chores), with noise of 3 to 12 mm as of a detector; every group counts the same. The
//! covariance is that of the eight largest principal components, and [`OTHER`] beside them.
//!
//! By these statistics alone, groups that were left out of them are judged right in 98 % of their recordings at the right rate; the
//! others show gymnasts, and people who run and jump all the time; these are known by their steps and flights. A rate 2.5 times too high
//! is recognised in 77 %, 4 times in 91 %, one 2.5 times too low in 10 %: people may be slow.

/// Parts whose change is measured: hips in the room, ankles and wrists from the hips.
pub(super) const PARTS: usize = 3;
/// Statistics of a part: differences over [`DIFFERENCE_SECS`], then second differences over [`SECOND_DIFFERENCE_SECS`].
pub(super) const PER_PART: usize = DIFFERENCE_SECS.len() + SECOND_DIFFERENCE_SECS.len();
/// Number of statistics.
pub(super) const N: usize = PARTS * PER_PART;

/// Lags of `x(t + lag) - x(t)`, s.
pub(super) const DIFFERENCE_SECS: [f64; 4] = [0.1, 0.2, 0.4, 0.8];
/// Lags of `x(t + lag) - 2 x(t) + x(t - lag)`, s.
pub(super) const SECOND_DIFFERENCE_SECS: [f64; 2] = [0.2, 0.4];

/// Standard deviation beside the components. With 0.1, groups that were left out of the statistics are judged wrong at their right rate
/// twice as often.
pub(super) const OTHER: f64 = 0.2;
/// Degrees of freedom of Student's distribution of the logarithms: people who are unlike most are rarer than a normal distribution has them.
pub(super) const FREEDOM: f64 = 8.0;
/// Squares of distances from the mean that 95 % of recordings do not reach: chi squared with [`N`] degrees of freedom.
pub(super) const USUAL_DISTANCE: f64 = 28.9;

/// Means of the logarithms, metres; a line per part.
#[rustfmt::skip]
pub(super) const MEAN: [f64; N] = [
    -2.63, -2.00, -1.39, -0.81, -2.70, -2.00,
    -2.37, -1.81, -1.37, -1.29, -1.59, -0.88,
    -2.52, -1.92, -1.45, -1.31, -1.77, -0.99,
];

/// Principal components of the logarithms, each times its standard deviation; a line per part.
#[rustfmt::skip]
pub(super) const COMPONENTS: [[f64; N]; 8] = [
    [
        -0.65, -0.76, -0.86, -0.97, -0.36, -0.42,
        -0.67, -0.74, -0.75, -0.63, -0.75, -0.82,
        -0.10, -0.10, -0.08, 0.04, -0.16, -0.17,
    ],
    [
        -0.08, -0.10, -0.14, -0.21, 0.24, 0.27,
        0.03, -0.01, -0.06, -0.06, 0.05, -0.06,
        0.60, 0.60, 0.58, 0.59, 0.65, 0.60,
    ],
    [
        -0.13, -0.14, -0.13, -0.11, -0.27, -0.35,
        0.16, 0.15, 0.16, 0.16, 0.12, 0.14,
        0.04, 0.04, 0.05, 0.04, 0.01, 0.03,
    ],
    [
        -0.13, -0.13, -0.13, -0.16, 0.14, 0.28,
        0.07, 0.07, 0.08, 0.18, 0.05, 0.03,
        -0.05, -0.06, -0.04, 0.09, -0.10, -0.11,
    ],
    [
        -0.02, 0.01, 0.06, 0.11, -0.08, 0.00,
        -0.09, -0.03, 0.04, 0.13, -0.15, -0.03,
        -0.02, 0.02, 0.08, 0.17, -0.12, 0.00,
    ],
    [
        -0.05, -0.02, 0.00, 0.03, -0.04, 0.05,
        -0.04, -0.01, 0.02, 0.05, -0.04, 0.02,
        0.01, 0.00, -0.02, -0.08, 0.06, 0.04,
    ],
    [
        -0.03, -0.02, 0.01, 0.04, -0.08, 0.05,
        0.01, 0.00, -0.02, -0.06, 0.04, 0.01,
        -0.01, -0.01, -0.01, 0.03, 0.00, -0.01,
    ],
    [
        -0.02, -0.01, 0.00, 0.00, 0.03, -0.01,
        -0.03, -0.01, 0.01, -0.03, 0.01, 0.06,
        -0.04, -0.02, 0.02, 0.00, -0.03, 0.06,
    ],
];
