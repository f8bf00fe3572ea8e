//! The frame rate by people's steps: long steps are quick ones.
//!
//! Length over frequency of a step is nearly the same at all speeds of walking, 0.39 m s (the "walk ratio", Sekiya and Nagasaki,
//! Gait and Posture 7:225, 1998), and slow running keeps it. A wrong frame rate leaves lengths and multiplies frequencies.

use crate::body::skeleton::KeypointConvention;
use crate::optim::robust::median;
use crate::session::JointTrajectory;
use nalgebra::Vector3;

/// Length times duration of a step, m s: people who walk, run, climb and dance freely have 0.39 (median of 81 takes of motion
/// capture, standard deviation of the logarithm 0.26); in a small room steps are shorter, 0.25.
pub const USUAL_RATIO: f64 = 0.33;
/// Beyond these the rate is wrong: the 81 takes have 0.24 to 0.76 (1st and 99th percentile), small rooms 0.22 and more.
pub const POSSIBLE_RATIOS: [f64; 2] = [0.16, 0.75];
/// Fewer steps show no rate by themselves: five and six steps of people who turn on the spot came 2.4 times too slow in 2 of 30
/// captures.
pub const MIN_STEPS_ALONE: usize = 10;

/// Standard deviations of the logarithm of length times duration: of the median between recordings (takes of motion capture 0.26,
/// and small rooms), and of a single step about it.
const BETWEEN_RECORDINGS: f64 = 0.3;
const OF_ONE_STEP: f64 = 0.6;
/// Degrees of freedom of Student's distribution of that median: people who turn on the spot are off by 2.4 times now and then.
const FREEDOM: f64 = 3.0;

/// Time before and after for the direction of travel, s.
const TRAVEL_SECS: f64 = 0.25;
/// The feet have passed each other when one is this far in front, m: ten times a detector's noise on their difference of means.
const IN_FRONT_M: f64 = 0.12;
/// Lengths of steps from place to place: shorter ones shuffle or turn, longer ones are runners' or jumps, or exchanged persons.
const STEP_M: [f64; 2] = [0.3, 1.5];
/// People run where most steps are longer: walkers' reach 0.9 m, whatever the frame rate. A single step may be a jump.
const RUNNING_STEP_M: f64 = 1.1;
const MIN_RUNNING_STEPS: usize = 2;

/// Steps of all people.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Steps {
    /// Their number.
    pub n: usize,
    /// Median of length times duration, m s.
    pub ratio: f64,
    /// Whether people run, at any frame rate.
    pub is_running: bool,
}

impl Steps {
    /// Logarithm of their likelihood, up to a constant, if the frame rate is this factor times the given one.
    pub fn log_likelihood(&self, factor: f64) -> f64 {
        let variance = BETWEEN_RECORDINGS.powi(2) + OF_ONE_STEP.powi(2) / self.n as f64;
        let squared = (self.ratio / (factor * USUAL_RATIO)).ln().powi(2) / variance;
        if self.n == 0 { 0.0 } else { -0.5 * (FREEDOM + 1.0) * (squared / FREEDOM).ln_1p() }
    }
}

/// Steps of all people, `up` of unit length; `None` without any, or where the convention lacks hips or ankles.
pub fn steps(convention: KeypointConvention, people: &[JointTrajectory], up: &Vector3<f64>, fps: f64) -> Option<Steps> {
    let pair = |part: &str| convention.sides_of(part);
    let (hips, ankles) = (pair("hip")?, pair("ankle")?);
    let at = |points: &[Option<Vector3<f64>>], [a, b]: [usize; 2]| Some((points[a]?, points[b]?));
    let level = |v: Vector3<f64>| v - up * v.dot(up);
    let mut steps = Vec::new();
    for person in people {
        let middle: Vec<Option<Vector3<f64>>> =
            person.points.iter().map(|points| at(points, hips).map(|(a, b)| level(0.5 * (a + b)))).collect();
        let spread: Vec<Option<Vector3<f64>>> =
            person.points.iter().map(|points| at(points, ankles).map(|(a, b)| level(a - b))).collect();
        steps.extend(steps_of_person(&middle, &spread, fps));
    }
    if steps.is_empty() {
        return None;
    }
    let n_long = steps.iter().filter(|(length, _)| *length > RUNNING_STEP_M).count();
    let is_running = n_long >= MIN_RUNNING_STEPS && 2 * n_long > steps.len();
    let usual = steps.iter().filter(|(length, _)| *length < STEP_M[1]);
    let mut ratios: Vec<f64> = usual.map(|(length, secs)| length * secs).collect();
    Some(Steps { n: ratios.len(), ratio: median(&mut ratios).unwrap_or(USUAL_RATIO), is_running })
}

/// Length, m, and duration, s, of each step from place to place; `spread`: from the right to the left ankle.
fn steps_of_person(middle: &[Option<Vector3<f64>>], spread: &[Option<Vector3<f64>>], fps: f64) -> Vec<(f64, f64)> {
    let reach = ((TRAVEL_SECS * fps).round() as usize).max(1);
    // Frames in which a foot gets in front, and which.
    let mut passages: Vec<(usize, bool)> = Vec::new();
    for t in reach..middle.len().saturating_sub(reach) {
        let travel =
            middle[t + reach].zip(middle[t - reach]).and_then(|(after, before)| (after - before).try_normalize(1e-6));
        let Some(in_front) = travel.zip(spread[t]).map(|(travel, spread)| spread.dot(&travel)) else { continue };
        let is_left = in_front > 0.0;
        if in_front.abs() > IN_FRONT_M && passages.last().is_none_or(|(_, was_left)| *was_left != is_left) {
            passages.push((t, is_left));
        }
    }
    let step = |pair: &[(usize, bool)]| {
        let (start, end) = (pair[0].0, pair[1].0);
        let length = (middle[end]? - middle[start]?).norm();
        (length >= STEP_M[0]).then_some((length, (end - start) as f64 / fps))
    };
    passages.windows(2).filter_map(step).collect()
}
