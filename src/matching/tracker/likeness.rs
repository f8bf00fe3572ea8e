//! What speaks for two fragments showing one person, in nats: place, build and the detectors' own track numbers.
//!
//! Each is a log likelihood ratio "the same person" against "somebody else", so that they add up, and so that what cannot
//! be known (a place after a minute, the build of a glimpse, numbers that a detector never uses again) says nothing.

use super::Scene;
use super::person::{Skeleton, TrackedPerson};
use crate::body::bones::LENGTH_SIGMA;
use crate::body::human_speeds::WALK_M_S;
use crate::optim::robust::{NORMAL_SIGMA_OF_MAD, median_and_spread};
use nalgebra::{DMatrix, DVector, Vector3};
use std::collections::BTreeMap;

/// Standard deviation per axis of a prediction that is just made, m: a turn of the body.
const PLACE_SIGMA: f64 = 0.25;

/// People spread at least this far about a scene's middle, m per axis: a room of 4 m.
const MIN_ROOM: f64 = 1.0;

/// Population spread of a limb's log length: of all limbs together with stature, and of each on its own (ANSUR II).
const STATURE_SIGMA: f64 = 0.055;
/// See [`STATURE_SIGMA`].
const LIMB_SIGMA: f64 = 0.03;

/// What a limb's measured log length still varies with how a person stands and turns, however long they are seen.
const POSE_SIGMA: f64 = 0.02;

/// Detectors' errors last so long, s.
const NOISE_MEMORY: f64 = 0.3;

/// A detector's number means the same person still with this probability: trackers swap and start anew.
const NUMBERS_HOLD: f64 = 0.7;

/// Spread of people about the scene's middle, m per axis: they stand among the cameras, a disc of radius R has R / 2.
pub(super) fn room(scene: &Scene) -> f64 {
    let centers: Vec<Vector3<f64>> = scene.cameras.iter().flatten().map(|c| c.inverse().translation).collect();
    let n = centers.len().max(1) as f64;
    let middle = centers.iter().sum::<Vector3<f64>>() / n;
    let radius = (centers.iter().map(|c| (c - middle).norm_squared()).sum::<f64>() / n).sqrt();
    (radius / 2.0).max(MIN_ROOM)
}

/// What a fragment tells of whom it shows.
pub(super) struct Likeness {
    /// Log length of each kind of limb over an adult's, with its variance; `None` where it was never seen.
    limbs: Vec<Option<(f64, f64)>>,
    /// Per view, how often the detector gave which number.
    numbers: Vec<BTreeMap<i64, usize>>,
}

impl Likeness {
    pub(super) fn of(scene: &Scene, person: &TrackedPerson) -> Self {
        // A single view shows limbs foreshortened and tells no build.
        let limbs = if scene.n_witnesses() < 2 { Vec::new() } else { limbs(scene, &person.skeletons) };
        Self { limbs, numbers: numbers(scene, person) }
    }

    /// Evidence of the build.
    ///
    /// With the difference d of all limbs seen in both, N its noise and D what two people differ by:
    /// `ln N(d; 0, N) - ln N(d; 0, N + D)`.
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

    /// Evidence of the detectors' numbers: how often they are the same, against how often two detections share one.
    ///
    /// A number that `before` (all that was seen when `self` ended) does not know is a tracker's new start: no evidence.
    pub(super) fn number_evidence(&self, later: &Self, before: &[BTreeMap<i64, usize>]) -> f64 {
        let of_view = |((mine, theirs), before): ((&BTreeMap<_, usize>, &BTreeMap<_, usize>), &BTreeMap<_, usize>)| {
            let [n_mine, n_theirs, n_before] = [mine, theirs, before].map(|m| m.values().sum::<usize>() as f64);
            if n_mine == 0.0 || n_theirs == 0.0 {
                return 0.0;
            }
            let chance: f64 = before.values().map(|n| (*n as f64 / n_before).powi(2)).sum();
            let ratio = |number: &i64| match before.get(number) {
                Some(_) => {
                    let share = mine.get(number).map_or(0.0, |n| *n as f64 / n_mine);
                    1.0 - NUMBERS_HOLD + NUMBERS_HOLD * share / chance
                }
                None => 1.0,
            };
            theirs.iter().map(|(number, n)| ratio(number) * *n as f64 / n_theirs).sum::<f64>().ln()
        };
        self.numbers.iter().zip(&later.numbers).zip(before).map(of_view).sum()
    }

    /// Adds the fragment's numbers to a table of all.
    pub(super) fn count_numbers(&self, all: &mut [BTreeMap<i64, usize>]) {
        for (all, mine) in all.iter_mut().zip(&self.numbers) {
            mine.iter().for_each(|(number, n)| *all.entry(*number).or_default() += n);
        }
    }
}

/// Evidence of the place: `distance` from the predicted one after `seconds` out of sight, in a scene of spread `room`.
///
/// Somebody else is anywhere: a difference of standard deviation `sqrt(2) room` per axis of the floor.
pub(super) fn place_evidence(distance: f64, seconds: f64, room: f64) -> f64 {
    let anywhere = 2.0 * room * room;
    let near = (PLACE_SIGMA * PLACE_SIGMA + (WALK_M_S * seconds).powi(2)).min(anywhere);
    (anywhere / near).ln() - 0.5 * distance * distance * (1.0 / near - 1.0 / anywhere)
}

/// Left and right limbs are one kind: bones of equal reference length.
fn limbs(scene: &Scene, skeletons: &[Skeleton]) -> Vec<Option<(f64, f64)>> {
    let mut kinds: Vec<f64> = scene.bones.iter().map(|b| b.length).collect();
    kinds.dedup();
    let of_kind = |&length: &f64| {
        let twins = || scene.bones.iter().filter(move |b| b.length == length);
        let ratio = |s: &Skeleton, a: usize, b: usize| Some(((s[a]? - s[b]?).norm() / length).ln());
        let mut ratios: Vec<f64> =
            skeletons.iter().flat_map(|s| twins().filter_map(move |b| ratio(s, b.a, b.b))).collect();
        let n_independent = (ratios.len() as f64 / (NOISE_MEMORY * scene.fps)).max(1.0);
        let (center, spread) = (!ratios.is_empty()).then(|| median_and_spread(&mut ratios))?;
        // A glimpse cannot measure the spread of a length.
        let sigma = (NORMAL_SIGMA_OF_MAD * spread).max(if n_independent > 1.0 { 0.0 } else { LENGTH_SIGMA });
        Some((center, POSE_SIGMA * POSE_SIGMA + sigma * sigma / n_independent))
    };
    kinds.iter().map(of_kind).collect()
}

fn numbers(scene: &Scene, person: &TrackedPerson) -> Vec<BTreeMap<i64, usize>> {
    let mut numbers = vec![BTreeMap::new(); scene.views.len()];
    for (frame, claim) in &person.claims {
        for (view, detection) in claim.iter().enumerate().filter_map(|(v, d)| d.map(|d| (v, d))) {
            if let Some(number) = scene.views[view].frames[*frame][detection].track_id {
                *numbers[view].entry(number).or_default() += 1;
            }
        }
    }
    numbers
}

/// Logarithm of a centred normal density but for the constant; 0 for no dimensions.
fn log_density(value: &DVector<f64>, covariance: DMatrix<f64>) -> f64 {
    let Some(factor) = covariance.cholesky() else { return 0.0 };
    let whitened = factor.l_dirty().solve_lower_triangular(value).map_or(f64::INFINITY, |w| w.norm_squared());
    -factor.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>() - 0.5 * whitened
}

#[cfg(test)]
mod tests {
    use super::*;

    fn likeness(limbs: &[f64], numbers: &[&[(i64, usize)]]) -> Likeness {
        Likeness {
            limbs: limbs.iter().map(|l| Some((*l, POSE_SIGMA * POSE_SIGMA))).collect(),
            numbers: numbers.iter().map(|of_view| of_view.iter().copied().collect()).collect(),
        }
    }

    #[test]
    fn near_soon_is_the_same_far_soon_is_not_and_late_says_nothing() {
        assert!(place_evidence(0.1, 0.2, 2.0) > 3.0);
        assert!(place_evidence(3.0, 0.2, 2.0) < -5.0);
        assert!(place_evidence(3.0, 60.0, 2.0).abs() < 1e-12);
    }

    #[test]
    fn the_same_build_speaks_for_one_person_and_another_against() {
        let tall = likeness(&[0.06, 0.05, 0.06, 0.07], &[]);
        let same = likeness(&[0.05, 0.06, 0.05, 0.08], &[]);
        let short = likeness(&[-0.08, -0.07, -0.09, -0.06], &[]);
        assert!(tall.build_evidence(&same) > 1.0);
        assert!(tall.build_evidence(&short) < -3.0);
        assert_eq!(tall.build_evidence(&likeness(&[], &[])), 0.0);
    }

    #[test]
    fn kept_numbers_speak_for_one_person_new_ones_say_nothing_and_others_numbers_against() {
        let mine = likeness(&[], &[&[(1, 40), (2, 2)], &[(7, 30)]]);
        let other = likeness(&[], &[&[(2, 40)], &[(8, 30)]]);
        let mut before = vec![BTreeMap::new(); 2];
        mine.count_numbers(&mut before);
        other.count_numbers(&mut before);
        let evidence = |numbers: &[&[(i64, usize)]]| mine.number_evidence(&likeness(&[], numbers), &before);
        assert!(evidence(&[&[(1, 20)], &[(7, 20)]]) > 1.0);
        assert!(evidence(&[&[(2, 20)], &[(8, 20)]]) < -1.5);
        assert!(evidence(&[&[(5, 20)], &[(9, 20)]]).abs() < 1e-12);
        assert!(evidence(&[&[], &[]]).abs() < 1e-12);
    }
}
