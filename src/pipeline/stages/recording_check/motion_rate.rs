//! The frame rate by how people move: how far hips, ankles and wrists get within fixed times, and how much they turn on the way.
//!
//! Speeds grow with the rate, accelerations with its square, and the times after which limbs swing back fall with it. Under each
//! rate the statistics are compared with those of recorded motion (`motion_statistics`); the likeliest rate of right
//! recordings is within 2 times of the true one for most (standard deviation of its logarithm 0.4). Unlike steps, this needs no
//! walking; where people walk, the likelihood of their steps is added, and where they jump, that of `gravity`. People who do no more
//! than breathe show nothing.

use super::frame_rate::Steps;
use super::gravity::Accelerations;
use super::motion_statistics::{
    COMPONENTS, DIFFERENCE_SECS, FREEDOM, MEAN, N, OTHER, PARTS, SECOND_DIFFERENCE_SECS, USUAL_DISTANCE,
};
use crate::body::skeleton::KeypointConvention;
use crate::session::JointTrajectory;
use nalgebra::{Cholesky, Const, SMatrix, SVector, Vector3};
use rayon::prelude::*;

/// A rate is wrong where the likeliest one is more than this many times as high or low.
const WRONG_FACTOR: f64 = 1.5;
/// Logarithms of the ratio of posteriors from which people move too fast, 250 to 1, and too slowly, 13,000 to 1: right rates are far
/// more common than wrong ones, and slow movements are at anyone's choice. None of 196 recordings goes beyond at its right rate.
const TOO_FAST: f64 = 5.5;
const TOO_SLOW: f64 = 9.5;

/// Frame rates of videos before people are seen: median and standard deviation of the logarithm. Nine of ten are between 15 (webcams)
/// and 80 per second, most of them 24 to 60.
const USUAL_FPS: f64 = 35.0;
const FPS_SIGMA: f64 = 0.5;

/// Logarithms of the factors on the given rate that are compared: from a sixth to 5.5 times, in steps of a tenth.
const RATES: std::ops::RangeInclusive<i32> = -18..=17;
const RATE_STEP: f64 = 0.1;
/// Half the 95 % quantile of chi squared with one degree of freedom: factors within this of the best posterior are possible.
const POSSIBLE: f64 = 1.92;

/// Fewer pairs of frames give no mean square.
const MIN_PAIRS: usize = 20;
/// Frames with a person in all: less than 3 s at 25 Hz say little about how people move.
const MIN_FRAMES: usize = 75;
/// Standard deviation that no movement falls below, m.
const LEAST_M: f64 = 1e-4;

/// A point over time, frame by frame.
type Series = Vec<Option<Vector3<f64>>>;

/// What people's movements and steps show of the frame rate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionRate {
    /// The likeliest factor on the given rate: people move and step like people, at a usual frame rate.
    pub factor: f64,
    /// The smallest and the largest possible factor.
    pub range: [f64; 2],
    /// Logarithm of the posterior of that factor over that of the given rate.
    pub log_ratio: f64,
    /// Whether people move like people under that factor. Never where their movements suit the largest one best: people who stand
    /// still move too little at any rate.
    pub is_human: bool,
}

impl MotionRate {
    /// Whether the given rate is wrong.
    pub fn is_wrong(&self) -> bool {
        let needed = if self.factor < 1.0 { TOO_FAST } else { TOO_SLOW };
        self.is_human && self.factor.ln().abs() > WRONG_FACTOR.ln() && self.log_ratio > needed
    }
}

/// The rate by the movements of all people, by gravity, and by their `steps` where there are any; `None` where the convention lacks
/// hips, ankles or wrists, or there is little to see.
pub fn motion_rate(
    convention: KeypointConvention,
    people: &[JointTrajectory],
    up: &Vector3<f64>,
    fps: f64,
    steps: Option<Steps>,
) -> Option<MotionRate> {
    let parts = parts(convention, people)?;
    let n_seen = parts[0].iter().flatten().flatten().count();
    if n_seen < MIN_FRAMES {
        return None;
    }
    let covariance = covariance();
    let accelerations = Accelerations::of_people(convention, people, up);
    let squared_distance = |factor: f64| {
        let off = statistics(&parts, factor * fps)? - SVector::from(MEAN);
        Some(off.dot(&covariance.solve(&off)))
    };
    let log_likelihood = |factor: f64| {
        let of_movements = -0.5 * (FREEDOM + N as f64) * (squared_distance(factor)? / FREEDOM).ln_1p();
        let of_gravity = accelerations.as_ref().map_or(0.0, |a| a.log_likelihood(factor * fps));
        let of_steps = steps.map_or(0.0, |steps| steps.log_likelihood(factor));
        Some(of_movements + of_steps + of_gravity)
    };
    let rate = |k: i32| (f64::from(k) * RATE_STEP).exp();
    let compared = RATES.into_par_iter().map(rate).filter_map(|factor| {
        let likelihood = log_likelihood(factor)?;
        Some(Compared { factor, likelihood, posterior: likelihood + log_prior(factor * fps) })
    });
    let compared: Vec<Compared> = compared.collect();
    let best = |value: fn(&Compared) -> f64| compared.iter().max_by(|a, b| value(a).total_cmp(&value(b)));
    let Compared { factor, posterior, .. } = *best(|compared| compared.posterior)?;
    let possible = || compared.iter().filter(|other| other.posterior > posterior - POSSIBLE).map(|other| other.factor);
    let range = [possible().fold(factor, f64::min), possible().fold(factor, f64::max)];
    let moves = best(|compared| compared.likelihood)?.factor < rate(*RATES.end());
    let is_human = moves && squared_distance(factor)? < USUAL_DISTANCE;
    let given = log_likelihood(1.0)? + log_prior(fps);
    Some(MotionRate { factor, range, log_ratio: posterior - given, is_human })
}

/// Logarithms of likelihood and posterior of a factor on the given rate.
struct Compared {
    factor: f64,
    likelihood: f64,
    posterior: f64,
}

fn log_prior(fps: f64) -> f64 {
    -0.5 * ((fps / USUAL_FPS).ln() / FPS_SIGMA).powi(2)
}

fn covariance() -> Cholesky<f64, Const<N>> {
    let other = SMatrix::<f64, N, N>::from_diagonal_element(OTHER * OTHER);
    let components = COMPONENTS.map(SVector::<f64, N>::from).into_iter();
    let sum = components.fold(other, |sum, component| sum + component * component.transpose());
    Cholesky::new(sum).expect("squares plus a positive diagonal are positive definite")
}

/// Hips in the room, ankles and wrists from the hips, of all people.
fn parts(convention: KeypointConvention, people: &[JointTrajectory]) -> Option<[Vec<Series>; PARTS]> {
    let [hips, ankles, wrists] =
        [convention.sides_of("hip")?, convention.sides_of("ankle")?, convention.sides_of("wrist")?];
    let middle = |points: &[Option<Vector3<f64>>]| Some(0.5 * (points[hips[0]]? + points[hips[1]]?));
    let of_hips = people.iter().map(|person| person.points.iter().map(|points| middle(points)).collect()).collect();
    let from_hips = |sides: [usize; 2]| -> Vec<Series> {
        let of_side = |k: usize| {
            people.iter().map(move |person| {
                person.points.iter().map(|points| Some(points[k]? - middle(points)?)).collect::<Series>()
            })
        };
        sides.into_iter().flat_map(of_side).collect()
    };
    Some([of_hips, from_hips(ankles), from_hips(wrists)])
}

/// Logarithms of the root mean square changes, in the order of [`MEAN`]; `None` where people are seen too briefly.
fn statistics(parts: &[Vec<Series>; PARTS], fps: f64) -> Option<SVector<f64, N>> {
    let mut found = Vec::with_capacity(N);
    for series in parts {
        for lag in DIFFERENCE_SECS {
            found.push(at_lag(lag * fps, 2, |n| {
                mean_square(series, |x: &Series, t: usize| Some((*x.get(t + n)?)? - x[t]?))
            })?);
        }
        for lag in SECOND_DIFFERENCE_SECS {
            let bend = |x: &Series, t: usize, n: usize| Some((*x.get(t + 2 * n)?)? - 2.0 * x[t + n]? + x[t]?);
            found.push(at_lag(lag * fps, 4, |n| mean_square(series, |x: &Series, t: usize| bend(x, t, n)))?);
        }
    }
    let log_root = |square: f64| 0.5 * (square + LEAST_M * LEAST_M).ln();
    Some(SVector::from_iterator(found.into_iter().map(log_root)))
}

/// A mean square at a lag between frames; below one frame it falls with this power of the lag.
fn at_lag(frames: f64, power: i32, mean_square: impl Fn(usize) -> Option<f64>) -> Option<f64> {
    if frames < 1.0 {
        return Some(mean_square(1)? * frames.powi(power));
    }
    let (below, rest) = (frames.floor() as usize, frames.fract());
    Some((1.0 - rest) * mean_square(below)? + rest * mean_square(below + 1)?)
}

fn mean_square(series: &[Series], change: impl Fn(&Series, usize) -> Option<Vector3<f64>>) -> Option<f64> {
    let changes = series.iter().flat_map(|x| (0..x.len()).filter_map(|t| change(x, t)));
    let (n, sum) = changes.fold((0, 0.0), |(n, sum), change| (n + 1, sum + change.norm_squared()));
    (n >= MIN_PAIRS).then(|| sum / n as f64)
}
