//! The frame rate by gravity: a floor pushes people up, and sideways no more than up, and people off the floor fall with g.
//!
//! With the acceleration $\vec a$ of the centre of mass, the force of the floor is $m (\vec a - \vec g)$; friction keeps its level part
//! below its upward part (coefficient of friction 1), so that $-a_{up} + |a_{level}| \le g$. Accelerations grow with the square of the
//! frame rate: a rate that is too high breaks this, whatever people do, and flights show g at the right rate only.

use crate::body::skeleton::KeypointConvention;
use crate::session::JointTrajectory;
use nalgebra::Vector3;

/// Acceleration of a fall, m/s^2.
const G: f64 = 9.81;

/// Shares of body mass in the keypoints of each side, from masses and centres of segments (de Leva, J. Biomechanics 29:1223, 1996,
/// means of men and women); the head continues the trunk.
const MASS_SHARES: [(&str, f64); 6] =
    [("shoulder", 0.183), ("elbow", 0.025), ("wrist", 0.013), ("hip", 0.164), ("knee", 0.082), ("ankle", 0.033)];

/// Lengths of the windows in which a parabola is fitted to the centre of mass, frames.
const WINDOWS: [usize; 10] = [5, 7, 9, 13, 17, 23, 31, 43, 59, 83];
/// Windows that count, s: shorter ones show noise, longer ones average over whole movements.
const WINDOW_SECS: [f64; 2] = [0.08, 0.5];
/// Standard deviation of the centre of mass, m: 20 mm of a keypoint in a view, over four views and some four independent keypoints.
const CENTRE_SIGMA: f64 = 0.005;
/// Standard errors by which an acceleration is taken smaller than measured.
const SIGMAS: f64 = 3.0;

/// The acceleration that counts is that of the third strongest movement: exchanged persons jump once or twice.
const N_STRONGEST: usize = 3;
/// Standard deviation of the largest possible one in units of g (statures 5 %, centres of mass, supports other than a floor): recorded
/// motion reaches 1.1.
const EXCESS_SIGMA: f64 = 0.1;
/// Degrees of freedom of Student's distribution of that excess.
const FREEDOM: f64 = 3.0;

/// Window for flights, s: jumps take 0.3 to 0.6 s.
const FLIGHT_SECS: f64 = 0.35;
/// Downward and largest level accelerations of flights in units of g.
const FLIGHT_DOWN: [f64; 2] = [0.85, 1.2];
const FLIGHT_LEVEL: f64 = 0.12;
/// Flights of all people that count, each with this logarithm of a likelihood ratio: three and more are seen in 20 % of recordings of
/// several people at the right rate, in 2 % at twice the rate.
const MAX_FLIGHTS: usize = 6;
const OF_ONE_FLIGHT: f64 = 0.8;

/// Accelerations of people's centres of mass, for each window.
#[derive(Debug, Clone)]
pub struct Accelerations {
    windows: Vec<Window>,
}

/// Accelerations from windows of one length, m per squared frame.
#[derive(Debug, Clone)]
struct Window {
    frames: usize,
    /// Of each person and start of a window.
    people: Vec<Vec<Acceleration>>,
    /// Downward plus level part of the third strongest movement, less its errors; `None` where there are fewer.
    strongest: Option<f64>,
}

#[derive(Debug, Clone, Copy)]
struct Acceleration {
    down: f64,
    level: f64,
}

impl Accelerations {
    /// Of all people, `up` of unit length; `None` where the convention lacks a keypoint that carries mass.
    pub fn of_people(convention: KeypointConvention, people: &[JointTrajectory], up: &Vector3<f64>) -> Option<Self> {
        let shares: Vec<([usize; 2], f64)> = MASS_SHARES
            .iter()
            .map(|(part, share)| Some((convention.sides_of(part)?, *share)))
            .collect::<Option<_>>()?;
        let centre = |points: &Vec<Option<Vector3<f64>>>| {
            shares
                .iter()
                .map(|([a, b], share)| Some((points[*a]? + points[*b]?) * *share))
                .sum::<Option<Vector3<f64>>>()
        };
        let centres: Vec<Vec<Option<Vector3<f64>>>> =
            people.iter().map(|person| person.points.iter().map(centre).collect()).collect();
        let windows = WINDOWS.into_iter().map(|frames| Window::of(frames, &centres, up)).collect();
        Some(Self { windows })
    }

    /// Logarithm of their likelihood at a frame rate, up to a constant.
    pub fn log_likelihood(&self, fps: f64) -> f64 {
        let excess = (self.strongest(fps).unwrap_or(0.0) - 1.0).max(0.0) / EXCESS_SIGMA;
        let of_flights = OF_ONE_FLIGHT * self.n_flights(fps) as f64;
        of_flights - 0.5 * (FREEDOM + 1.0) * (excess * excess / FREEDOM).ln_1p()
    }

    /// Acceleration of the third strongest movement in units of the largest that a floor allows.
    pub fn strongest(&self, fps: f64) -> Option<f64> {
        let [least, most] = WINDOW_SECS;
        let windows = self.windows.iter().filter(|window| (least..=most).contains(&(window.frames as f64 / fps)));
        windows.filter_map(|window| window.strongest).map(|a| a * fps * fps / G).reduce(f64::max)
    }

    /// Flights of all people at a frame rate, up to six.
    pub fn n_flights(&self, fps: f64) -> usize {
        let off = |window: &&Window| (window.frames as f64 / (FLIGHT_SECS * fps)).ln().abs();
        let window = self.windows.iter().min_by(|a, b| off(a).total_cmp(&off(b)));
        let of_window = |window: &Window| {
            let unit = G / (fps * fps);
            let is_flight = |a: &Acceleration| {
                (FLIGHT_DOWN[0]..FLIGHT_DOWN[1]).contains(&(a.down / unit)) && a.level < FLIGHT_LEVEL * unit
            };
            let of_person = |person: &Vec<Acceleration>| {
                let falls = peaks(person, window.frames, MAX_FLIGHTS, |a| a.down);
                falls.into_iter().filter(|&t| is_flight(&person[t])).count()
            };
            window.people.iter().map(of_person).sum::<usize>().min(MAX_FLIGHTS)
        };
        window.map_or(0, of_window)
    }
}

impl Window {
    fn of(frames: usize, centres: &[Vec<Option<Vector3<f64>>>], up: &Vector3<f64>) -> Self {
        let weights = curvature_weights(frames);
        let sigma = CENTRE_SIGMA * weights.iter().map(|w| w * w).sum::<f64>().sqrt();
        let acceleration = |centres: &[Option<Vector3<f64>>]| {
            let terms = centres.iter().zip(&weights).map(|(centre, weight)| centre.map(|centre| centre * *weight));
            let acceleration: Vector3<f64> = terms.sum::<Option<_>>()?;
            let upwards = acceleration.dot(up);
            Some(Acceleration { down: -upwards, level: (acceleration - up * upwards).norm() })
        };
        let people: Vec<Vec<Acceleration>> =
            centres.iter().map(|centres| centres.windows(frames).filter_map(acceleration).collect()).collect();
        let of_floor = |a: &Acceleration| a.down + (a.level - SIGMAS * sigma).max(0.0) - SIGMAS * sigma;
        let of_person = |person: &Vec<Acceleration>| {
            let found = peaks(person, frames, N_STRONGEST, of_floor);
            found.into_iter().map(|t| of_floor(&person[t])).collect::<Vec<_>>()
        };
        let mut strongest: Vec<f64> = people.iter().flat_map(of_person).collect();
        strongest.sort_by(|a, b| b.total_cmp(a));
        let strongest = strongest.get(N_STRONGEST - 1).copied();
        Self { frames, people, strongest }
    }
}

/// Weights of positions in the second derivative of a parabola fitted with weights $(1 - s^2)^3$, s from -1 to 1 over the window.
fn curvature_weights(frames: usize) -> Vec<f64> {
    let half = (frames + 1) as f64 / 2.0;
    let x: Vec<f64> = (1..=frames).map(|t| t as f64 - half).collect();
    let weight = |x: f64| (1.0 - (x / half).powi(2)).powi(3);
    let moment = |power: i32| x.iter().map(|&x| weight(x) * x.powi(power)).sum::<f64>();
    let [m0, m2, m4] = [moment(0), moment(2), moment(4)];
    x.iter().map(|&x| 2.0 * weight(x) * (m0 * x * x - m2) / (m0 * m4 - m2 * m2)).collect()
}

/// Indices of the largest values, at most `n`, more than `apart` from each other.
fn peaks(values: &[Acceleration], apart: usize, n: usize, value: impl Fn(&Acceleration) -> f64) -> Vec<usize> {
    let mut found: Vec<usize> = Vec::with_capacity(n);
    for _ in 0..n {
        let is_free = |t: &usize| found.iter().all(|other| other.abs_diff(*t) > apart);
        let largest =
            (0..values.len()).filter(is_free).max_by(|a, b| value(&values[*a]).total_cmp(&value(&values[*b])));
        let Some(largest) = largest else { break };
        found.push(largest);
    }
    found
}
