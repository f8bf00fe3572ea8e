//! How people move: means and covariance of the logarithms of root mean square changes of position, from recorded motion.
//!
//! 186 clips of 10 s of motion capture (342 takes of 25 subjects: walking, climbing, dancing, playing, directing traffic, everyday
//! chores), those in which ankles move by 0.1 m in 0.4 s. The covariance is that of the eight largest principal components; what is
//! left, and how keypoints of a detector differ from joints of motion capture, is [`OTHER`].

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

/// Standard deviation beside the components. With 0.05 the rates of 49 simulated recordings are off by up to 1.9, with 0.1 by up to
/// 1.8 times, and other rates than the true one are rarer among them.
pub(super) const OTHER: f64 = 0.1;

/// Means of the logarithms, metres; a line per part.
#[rustfmt::skip]
pub(super) const MEAN: [f64; N] = [
    -2.87, -2.20, -1.58, -1.01, -2.75, -1.86,
    -2.51, -1.90, -1.43, -1.23, -1.76, -1.00,
    -2.46, -1.84, -1.34, -1.11, -1.75, -0.96,
];

/// Principal components of the logarithms, each times its standard deviation; a line per part.
#[rustfmt::skip]
pub(super) const COMPONENTS: [[f64; N]; 8] = [
    [
        0.19, 0.18, 0.15, 0.12, 0.38, 0.32,
        0.20, 0.18, 0.14, 0.08, 0.25, 0.18,
        0.51, 0.50, 0.47, 0.42, 0.58, 0.52,
    ],
    [
        0.38, 0.39, 0.43, 0.49, 0.11, 0.08,
        0.33, 0.33, 0.31, 0.21, 0.38, 0.37,
        -0.24, -0.24, -0.23, -0.23, -0.23, -0.21,
    ],
    [
        -0.14, -0.14, -0.15, -0.15, -0.13, -0.15,
        0.16, 0.15, 0.13, 0.11, 0.17, 0.15,
        0.02, 0.01, -0.01, -0.05, 0.05, 0.03,
    ],
    [
        -0.02, -0.04, -0.09, -0.15, 0.23, 0.17,
        0.05, 0.03, 0.00, 0.00, 0.07, 0.00,
        -0.05, -0.05, -0.03, 0.12, -0.11, -0.10,
    ],
    [
        -0.03, -0.01, 0.03, 0.06, -0.12, -0.02,
        -0.01, 0.01, 0.05, 0.13, -0.07, 0.02,
        -0.03, 0.00, 0.08, 0.26, -0.13, -0.02,
    ],
    [
        -0.02, -0.02, 0.00, 0.00, 0.00, 0.09,
        -0.02, 0.00, 0.04, 0.13, -0.07, -0.01,
        0.00, 0.00, -0.02, -0.07, 0.03, 0.00,
    ],
    [
        0.05, 0.03, -0.02, -0.04, 0.06, -0.08,
        -0.02, -0.01, 0.02, 0.04, -0.04, 0.02,
        -0.01, -0.01, 0.00, 0.00, 0.00, 0.02,
    ],
    [
        0.01, 0.00, 0.00, 0.01, 0.00, -0.02,
        0.01, 0.00, -0.01, 0.03, 0.01, -0.04,
        0.02, 0.00, -0.03, 0.03, 0.04, -0.04,
    ],
];
