//! Re-identification: evidence that two fragments show one person, in nats, from position, build and the detectors' track
//! numbers.
//!
//! Each is a log likelihood ratio of "the same person" to "another person". Hence they add up, and an uninformative one
//! (a position after a minute, the build seen in a few frames, numbers that a detector never uses again) is 0.

use super::person::TrackedPerson;
use super::scene::TrackerScene;
use super::skeleton::Skeleton;
use crate::body::bones::LENGTH_SIGMA;
use crate::body::human_speeds::WALK_M_S;
use crate::optim::determinant::half_log_det;
use crate::optim::robust::{NORMAL_SIGMA_OF_MAD, median_and_spread};
use nalgebra::{DMatrix, DVector, Vector3};
use std::collections::{BTreeMap, BTreeSet};

/// Standard deviation per axis of a prediction of the next frame, m: a turn of the body.
const POSITION_SIGMA: f64 = 0.25;

/// Least spread of people about a scene's middle, m per axis: a room of 4 m.
const MIN_SPREAD: f64 = 1.0;

/// Population spread of a limb's log length: of all limbs together with stature, and of each on its own (ANSUR II).
const STATURE_SIGMA: f64 = 0.055;
/// See [`STATURE_SIGMA`].
const LIMB_SIGMA: f64 = 0.03;

/// Variation of a limb's measured log length with pose and viewing direction, however long the person is seen.
const POSE_SIGMA: f64 = 0.02;

/// Correlation time of detectors' errors, s.
const NOISE_MEMORY: f64 = 0.3;

/// Probability that a detector's track number still means the same person: trackers swap and restart.
const TRACK_ID_HOLDS: f64 = 0.7;

/// Spread of people about the scene's middle, m per axis: people stand among the cameras, and a disc of radius R has R / 2.
pub(super) fn scene_spread(scene: &TrackerScene) -> f64 {
    let centers: Vec<Vector3<f64>> = scene.cameras.iter().flatten().map(|c| c.inverse().translation).collect();
    let n = centers.len().max(1) as f64;
    let middle = centers.iter().sum::<Vector3<f64>>() / n;
    let radius = (centers.iter().map(|c| (c - middle).norm_squared()).sum::<f64>() / n).sqrt();
    (radius / 2.0).max(MIN_SPREAD)
}

/// What identifies the person of a fragment.
pub(super) struct Appearance {
    /// Log ratio of each kind of limb's length to an adult's, with its variance; `None` for limbs that were never seen.
    limbs: Vec<Option<(f64, f64)>>,
    /// Per view, how often the detector gave which track number.
    track_ids: Vec<BTreeMap<i64, usize>>,
}

impl Appearance {
    pub(super) fn of(scene: &TrackerScene, person: &TrackedPerson) -> Self {
        // A single view shows limbs foreshortened, which says nothing about the build.
        let limbs = if scene.n_confirming_views() < 2 { Vec::new() } else { limbs(scene, &person.skeletons) };
        Self { limbs, track_ids: track_ids(scene, person) }
    }

    /// Evidence of the build: `ln N(d; 0, N) - ln N(d; 0, N + D)`, with the difference d of all limbs seen in both, the
    /// covariance N of its noise and the covariance D of differences between two people.
    pub(super) fn build_evidence(&self, other: &Self) -> f64 {
        let shared = self.limbs.iter().zip(&other.limbs).filter_map(|(a, b)| Some(((*a)?, (*b)?)));
        let (differences, variances): (Vec<f64>, Vec<f64>) = shared.map(|(a, b)| (a.0 - b.0, a.1 + b.1)).unzip();
        let n = differences.len();
        let (stature, limb) = (2.0 * STATURE_SIGMA * STATURE_SIGMA, 2.0 * LIMB_SIGMA * LIMB_SIGMA);
        let difference = DVector::from_vec(differences);
        let noise = DMatrix::from_diagonal(&DVector::from_vec(variances));
        let strangers = &noise + DMatrix::from_fn(n, n, |i, j| if i == j { stature + limb } else { stature });
        log_density(&difference, noise) - log_density(&difference, strangers)
    }

    /// Evidence of the track numbers: how often they are equal, against how often two detections share one by chance.
    ///
    /// `before`: of each view, the numbers seen when `self` ended. A number not among them is new: no evidence.
    pub(super) fn track_id_evidence(&self, later: &Self, before: &[NumbersBefore]) -> f64 {
        let of_view = |((own, later), before): ((&BTreeMap<_, usize>, &BTreeMap<_, usize>), &NumbersBefore)| {
            let [n_own, n_later] = [own, later].map(|m| m.values().sum::<usize>() as f64);
            if n_own == 0.0 || n_later == 0.0 {
                return 0.0;
            }
            let ratio = |number: &i64| match before.numbers.contains(number) {
                true => {
                    let share = own.get(number).map_or(0.0, |n| *n as f64 / n_own);
                    1.0 - TRACK_ID_HOLDS + TRACK_ID_HOLDS * share / before.chance
                }
                false => 1.0,
            };
            later.iter().map(|(number, n)| ratio(number) * *n as f64 / n_later).sum::<f64>().ln()
        };
        self.track_ids.iter().zip(&later.track_ids).zip(before).map(of_view).sum()
    }

    /// Adds the fragment's track numbers to the counts of all.
    pub(super) fn count_track_ids(&self, all: &mut [BTreeMap<i64, usize>]) {
        for (all, own) in all.iter_mut().zip(&self.track_ids) {
            own.iter().for_each(|(number, n)| *all.entry(*number).or_default() += n);
        }
    }
}

/// The track numbers of a view that were seen until some time.
pub(super) struct NumbersBefore {
    numbers: BTreeSet<i64>,
    /// Probability that two of the detections share their number.
    chance: f64,
}

impl NumbersBefore {
    /// From how often each was seen.
    pub(super) fn of(counts: BTreeMap<i64, usize>) -> Self {
        let total = counts.values().sum::<usize>() as f64;
        let chance = counts.values().map(|n| (*n as f64 / total).powi(2)).sum();
        Self { numbers: counts.into_keys().collect(), chance }
    }
}

/// Evidence of the position: `distance` m from the predicted one after `seconds` out of sight of a person who went at `speed`
/// m/s. Who is fast may be slower or faster by half.
///
/// Another person may be anywhere: the difference has standard deviation `sqrt(2) spread` per axis of the floor (m).
pub(super) fn position_evidence(distance: f64, seconds: f64, speed: f64, spread: f64) -> f64 {
    let anywhere = 2.0 * spread * spread;
    let near = near_variance(seconds, speed).min(anywhere);
    (anywhere / near).ln() - 0.5 * distance * distance * (1.0 / near - 1.0 / anywhere)
}

/// Whether a person out of sight for so long may be as far from the prediction as another one: [`position_evidence`] is 0.
pub(super) fn may_be_anywhere(seconds: f64, speed: f64, spread: f64) -> bool {
    near_variance(seconds, speed) >= 2.0 * spread * spread
}

/// Variance per axis of the place of a person from the predicted one, m^2.
fn near_variance(seconds: f64, speed: f64) -> f64 {
    POSITION_SIGMA * POSITION_SIGMA + (WALK_M_S.max(speed / 2.0) * seconds).powi(2)
}

/// Log ratio and variance of each kind of limb. Left and right limbs are one kind: bones of equal reference length.
fn limbs(scene: &TrackerScene, skeletons: &[Skeleton]) -> Vec<Option<(f64, f64)>> {
    let mut kinds: Vec<f64> = scene.bones.iter().map(|b| b.length).collect();
    kinds.dedup();
    let of_kind = |&length: &f64| {
        let twins = || scene.bones.iter().filter(move |b| b.length == length);
        let ratio = |s: &Skeleton, a: usize, b: usize| Some(((s[a]? - s[b]?).norm() / length).ln());
        let mut ratios: Vec<f64> =
            skeletons.iter().flat_map(|s| twins().filter_map(move |b| ratio(s, b.a, b.b))).collect();
        let n_independent = (ratios.len() as f64 / (NOISE_MEMORY * scene.fps)).max(1.0);
        let (center, spread) = (!ratios.is_empty()).then(|| median_and_spread(&mut ratios))?;
        // A few frames cannot measure the spread of a length.
        let sigma = (NORMAL_SIGMA_OF_MAD * spread).max(if n_independent > 1.0 { 0.0 } else { LENGTH_SIGMA });
        Some((center, POSE_SIGMA * POSE_SIGMA + sigma * sigma / n_independent))
    };
    kinds.iter().map(of_kind).collect()
}

fn track_ids(scene: &TrackerScene, person: &TrackedPerson) -> Vec<BTreeMap<i64, usize>> {
    let mut counts = vec![BTreeMap::new(); scene.views.len()];
    for (frame, assignment) in &person.assignments {
        for (view, detection) in scene.detections_of(*frame, assignment) {
            if let Some(number) = detection.detection.track_id {
                *counts[view].entry(number).or_default() += 1;
            }
        }
    }
    counts
}

/// Logarithm of a centred normal density up to a constant; 0 for no dimensions.
fn log_density(value: &DVector<f64>, covariance: DMatrix<f64>) -> f64 {
    let Some(factor) = covariance.cholesky() else { return 0.0 };
    let whitened = factor.l_dirty().solve_lower_triangular(value).map_or(f64::INFINITY, |w| w.norm_squared());
    -half_log_det(&factor) - 0.5 * whitened
}

#[cfg(test)]
mod tests {
    use super::*;

    fn appearance(limbs: &[f64], numbers: &[&[(i64, usize)]]) -> Appearance {
        Appearance {
            limbs: limbs.iter().map(|l| Some((*l, POSE_SIGMA * POSE_SIGMA))).collect(),
            track_ids: numbers.iter().map(|of_view| of_view.iter().copied().collect()).collect(),
        }
    }

    #[test]
    fn position_counts_soon_after_sight_and_not_later() {
        assert!(position_evidence(0.1, 0.2, 0.0, 2.0) > 3.0);
        assert!(position_evidence(3.0, 0.2, 0.0, 2.0) < -5.0);
        assert!(position_evidence(3.0, 60.0, 0.0, 2.0).abs() < 1e-12);
        for seconds in (0..40).map(|tenth| 0.1 * f64::from(tenth)) {
            assert_eq!(may_be_anywhere(seconds, 0.0, 2.0), position_evidence(3.0, seconds, 0.0, 2.0) == 0.0);
        }
    }

    #[test]
    fn equal_build_is_evidence_for_one_person() {
        let tall = appearance(&[0.06, 0.05, 0.06, 0.07], &[]);
        let same = appearance(&[0.05, 0.06, 0.05, 0.08], &[]);
        let short = appearance(&[-0.08, -0.07, -0.09, -0.06], &[]);
        assert!(tall.build_evidence(&same) > 1.0);
        assert!(tall.build_evidence(&short) < -3.0);
        assert_eq!(tall.build_evidence(&appearance(&[], &[])), 0.0);
    }

    #[test]
    fn kept_track_numbers_are_evidence_and_new_ones_are_not() {
        let own = appearance(&[], &[&[(1, 40), (2, 2)], &[(7, 30)]]);
        let other = appearance(&[], &[&[(2, 40)], &[(8, 30)]]);
        let mut before = vec![BTreeMap::new(); 2];
        own.count_track_ids(&mut before);
        other.count_track_ids(&mut before);
        let before: Vec<NumbersBefore> = before.into_iter().map(NumbersBefore::of).collect();
        let evidence = |numbers: &[&[(i64, usize)]]| own.track_id_evidence(&appearance(&[], numbers), &before);
        assert!(evidence(&[&[(1, 20)], &[(7, 20)]]) > 1.0);
        assert!(evidence(&[&[(2, 20)], &[(8, 20)]]) < -1.5);
        assert!(evidence(&[&[(5, 20)], &[(9, 20)]]).abs() < 1e-12);
        assert!(evidence(&[&[], &[]]).abs() < 1e-12);
    }
}
