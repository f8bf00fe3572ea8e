//! Collision resolution: persons whose bodies overlap are moved apart, each by half, as far as the observations allow.
//!
//! In rounds: all overlaps are found, then the frames of each person near an overlap are fitted again with the others held
//! ([`super::local_fit`]).

use super::capsule_overlaps::{BodyOverlap, CapsuleBody, CapsuleOverlap, REACH};
use super::context::FitContext;
use super::local_fit::{refitted, runs_around};
use super::person_motion::PersonFit;
use super::terms::collision::Collisions;
use super::terms::unknowns::MotionState;
use crate::body::BodyModel;
use crate::body::capsules::BodyCapsules;
use crate::body::skeleton::JOINT_NAMES;
use crate::progress::Canceled;
use crate::session::reconstruction::{Overlap, PenetrationReport};
use rayon::prelude::*;
use std::ops::Range;

/// Each round halves the overlaps that the observations do not hold in place; more rounds change less than a millimetre.
const ROUNDS: usize = 6;
/// Steps of each round, few since the start is near.
const STEPS: usize = 3;
/// Overlaps up to this depth are errors of the capsules against the skin, m.
const TOLERATED: f64 = 0.01;
/// An overlap is tried again where it is less than this share of what it was when it was last tried. What observations hold in place stays,
/// unless the other person moves out of it.
const TRIED_AGAIN: f64 = 0.9;

/// Moves overlapping persons apart if `resolve`, and reports the depth of overlaps before and after. `first_frame`: number of
/// the session's first frame.
pub(super) fn resolve_collisions(
    context: &FitContext,
    people: &mut [PersonFit],
    resolve: bool,
    first_frame: i64,
) -> Result<PenetrationReport, Canceled> {
    if !is_any_pair_near(people) {
        return Ok(PenetrationReport::default());
    }
    let capsules = BodyCapsules::of(context.model);
    let mut found = overlaps(context.model, &capsules, people, first_frame);
    if resolve {
        settle(context, &capsules, people, &found.depths)?;
        found = overlaps(context.model, &capsules, people, first_frame);
    }
    let deepest_before = found.deepest.clone();
    let before: Vec<MotionState> = people.iter().map(|person| person.fitted.state.clone()).collect();
    // By person and frame the depth of the overlap when it was last tried, m.
    let mut tried: Vec<Vec<f64>> = found.depths.iter().map(|depths| vec![f64::INFINITY; depths.len()]).collect();
    for _ in 0..if resolve { ROUNDS } else { 0 } {
        let runs_of = |(depths, tried): (&Vec<f64>, &mut Vec<f64>)| runs_around(context, now_tried(depths, tried));
        let runs: Vec<Vec<Range<usize>>> = found.depths.iter().zip(&mut tried).map(runs_of).collect();
        if runs.iter().all(Vec::is_empty) {
            break;
        }
        let resolved = |(k, (person, runs)): (usize, (&PersonFit, Vec<Range<usize>>))| {
            let collisions =
                Collisions { capsules: &capsules, by_frame: &found.by_frame[k], sigma: context.config.overlap_sigma };
            let state = person.fitted.state.clone();
            refitted(context, &person.observations, &before[k], state, runs, STEPS, collisions)
        };
        let resolved: Vec<MotionState> =
            people.par_iter().zip(runs).enumerate().map(resolved).collect::<Result<_, Canceled>>()?;
        for (person, state) in people.iter_mut().zip(resolved) {
            person.fitted.state = state;
        }
        found = overlaps(context.model, &capsules, people, first_frame);
    }
    let n_frames = |depths: &Vec<f64>| depths.iter().filter(|depth| **depth > TOLERATED).count();
    Ok(PenetrationReport {
        deepest: found.deepest,
        deepest_before: deepest_before.filter(|_| resolve),
        person_frames: found.depths.iter().map(n_frames).sum(),
    })
}

/// Which frames are tried, by their depths now and when they were last tried, which is now where they are.
fn now_tried(depths: &[f64], last_tried: &mut [f64]) -> Vec<bool> {
    let is_tried = |(depth, last): (&f64, &mut f64)| {
        let is_tried = *depth > TOLERATED && *depth <= TRIED_AGAIN * *last;
        if is_tried {
            *last = *depth;
        }
        is_tried
    };
    depths.iter().zip(last_tried).map(is_tried).collect()
}

/// Fits frames near overlaps to their minimum without regard to these. What a last step lowers the cost by would otherwise hide by how much
/// resolutions raise it, and those that the observations rule out would pass.
fn settle(
    context: &FitContext,
    capsules: &BodyCapsules,
    people: &mut [PersonFit],
    depths: &[Vec<f64>],
) -> Result<(), Canceled> {
    let settled = |(person, depths): (&mut PersonFit, &Vec<f64>)| {
        let runs = runs_around(context, depths.iter().map(|depth| *depth > TOLERATED).collect());
        let none = vec![Vec::new(); depths.len()];
        let collisions = Collisions { capsules, by_frame: &none, sigma: context.config.overlap_sigma };
        let state = person.fitted.state.clone();
        person.fitted.state = refitted(context, &person.observations, &state, state.clone(), runs, STEPS, collisions)?;
        Ok(())
    };
    people.par_iter_mut().zip(depths).try_for_each(settled)
}

/// Whether any two persons come within reach of each other; if not, the capsules need not be prepared.
fn is_any_pair_near(people: &[PersonFit]) -> bool {
    pairs(people).any(|(one, other)| {
        shared_frames(one, other).any(|t| {
            let pelvis = |p: &PersonFit| p.fitted.state.poses[t - p.first].translation;
            (pelvis(one) - pelvis(other)).norm() < REACH
        })
    })
}

fn pairs(people: &[PersonFit]) -> impl Iterator<Item = (&PersonFit, &PersonFit)> {
    people.iter().enumerate().flat_map(|(i, one)| people[i + 1..].iter().map(move |other| (one, other)))
}

/// Frames of the session in which both persons have a valid pose.
fn shared_frames<'a>(one: &'a PersonFit, other: &'a PersonFit) -> impl Iterator<Item = usize> + 'a {
    let both = one.first.max(other.first)..one.frames().end.min(other.frames().end);
    both.filter(|t| one.valid[t - one.first] && other.valid[t - other.first])
}

/// The overlaps of all pairs in all frames.
struct SessionOverlaps {
    /// By person and frame of the person's motion.
    by_frame: Vec<Vec<Vec<CapsuleOverlap>>>,
    /// Deepest overlap, by person and frame, m.
    depths: Vec<Vec<f64>>,
    deepest: Option<Overlap>,
    /// Number of the session's first frame.
    first_frame: i64,
}

fn overlaps(model: &BodyModel, capsules: &BodyCapsules, people: &[PersonFit], first_frame: i64) -> SessionOverlaps {
    let bodies_of = |p: &PersonFit| -> Vec<CapsuleBody> {
        let MotionState { betas, poses } = &p.fitted.state;
        let body = model.shaped(betas);
        poses.iter().map(|pose| CapsuleBody::new(capsules, (&body, betas), pose)).collect()
    };
    let bodies: Vec<Vec<CapsuleBody>> = people.par_iter().map(bodies_of).collect();
    let mut found = SessionOverlaps {
        by_frame: bodies.iter().map(|b| vec![Vec::new(); b.len()]).collect(),
        depths: bodies.iter().map(|b| vec![0.0; b.len()]).collect(),
        deepest: None,
        first_frame,
    };
    let indices = (0..people.len()).flat_map(|a| (a + 1..people.len()).map(move |b| [a, b]));
    for pair in indices {
        let [one, other] = pair.map(|k| &people[k]);
        let frames: Vec<usize> = shared_frames(one, other).collect();
        let overlap = |&t: &usize| bodies[pair[0]][t - one.first].overlap(&bodies[pair[1]][t - other.first], capsules);
        let overlaps: Vec<BodyOverlap> = frames.par_iter().map(overlap).collect();
        for (t, overlap) in frames.into_iter().zip(overlaps) {
            found.add(people, pair, t, overlap);
        }
    }
    found
}

impl SessionOverlaps {
    fn add(&mut self, people: &[PersonFit], pair: [usize; 2], frame: usize, found: BodyOverlap) {
        for (k, capsules) in pair.into_iter().zip(found.capsules) {
            let own = frame - people[k].first;
            self.by_frame[k][own].extend(capsules);
            self.depths[k][own] = self.depths[k][own].max(found.depth);
        }
        let depth_mm = 1e3 * found.depth;
        if self.deepest.as_ref().is_none_or(|overlap| depth_mm > overlap.depth_mm) && depth_mm > 0.0 {
            let frame = self.first_frame + frame as i64;
            let people = pair.map(|k| people[k].person.0);
            self.deepest =
                Some(Overlap { depth_mm, frame, people, joints: found.joints.map(|j| JOINT_NAMES[j].to_owned()) });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::config::BodyFitConfig;
    use super::super::minimisation::FittedMotion;
    use super::super::observations::Observations;
    use super::super::test_fixtures::{Surroundings, detected};
    use super::*;
    use crate::body::joint_ranges::natural_pose;
    use crate::body::kinematics::Pose;
    use crate::body::model::Betas;
    use crate::session::PersonId;
    use nalgebra::Vector3;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    /// The last fit ends a step or two from its minimum. What resolutions lowered the cost by beside the overlap hid that the
    /// observations hold it in place, and people were pulled apart.
    #[test]
    fn overlaps_that_observations_hold_stay_from_a_rough_fit() {
        let rotations = natural_pose(&mut ChaCha8Rng::seed_from_u64(0), 0.0).rotations;
        let at = |x: f64, y: f64| vec![Pose { rotations, translation: Vector3::new(x, y, 0.0) }; 60];
        let surroundings = Surroundings::new();
        let mut people = [(3, 0.0), (5, 0.45)].map(|(person, x)| {
            let observations = detected(&surroundings.model, &at(x, 0.0));
            PersonFit { observations, ..person_fit(person, 10, at(x, 0.03)) }
        });
        let resolved = resolve_collisions(&surroundings.context(), &mut people, true, 100).unwrap();
        let [before, after] = [resolved.deepest_before, resolved.deepest].map(|overlap| overlap.unwrap().depth_mm);
        assert!(before > 30.0 && after > before - 5.0, "{before} {after}");
        let height = people[0].fitted.state.poses[30].translation.y;
        assert!(height.abs() < 0.005, "{height}");
    }

    fn person_fit(person: usize, first: usize, poses: Vec<Pose>) -> PersonFit {
        let n = poses.len();
        let state = MotionState { betas: Betas::zeros(), poses };
        let observations =
            Observations { cameras: Vec::new(), points: vec![Vec::new(); n], pixels: vec![Vec::new(); n] };
        let fitted = FittedMotion::initial(state);
        PersonFit { person: PersonId(person), first, observations, fitted, valid: vec![true; n] }
    }

    /// Both stand too near to each other; without observations nothing holds either in place.
    #[test]
    fn overlapping_persons_both_move_apart() {
        let rotations = natural_pose(&mut ChaCha8Rng::seed_from_u64(0), 0.0).rotations;
        let at = |x: f64| Pose { rotations, translation: Vector3::x() * x };
        let make = || [person_fit(3, 10, vec![at(0.0); 30]), person_fit(5, 10, vec![at(0.45); 30])];
        let surroundings = Surroundings::new();
        let context = surroundings.context();
        let mut people = make();
        let kept = resolve_collisions(&context, &mut people, false, 100).unwrap();
        let before = kept.deepest.clone().unwrap();
        assert!(before.depth_mm > 30.0 && before.frame == 110 && before.people == [3, 5], "{before:?}");
        assert!(kept.deepest_before.is_none() && people[0].fitted == make()[0].fitted);

        let rejecting = BodyFitConfig { max_resolution_cost: [f64::NEG_INFINITY; 2], ..BodyFitConfig::default() };
        let rejected =
            resolve_collisions(&FitContext { config: &rejecting, ..context }, &mut people, true, 100).unwrap();
        assert!(rejected.deepest.as_ref() == Some(&before) && people[1].fitted == make()[1].fitted);

        let resolved = resolve_collisions(&context, &mut people, true, 100).unwrap();
        assert_eq!(resolved.deepest_before.as_ref(), Some(&before));
        let after = resolved.deepest.map_or(0.0, |overlap| overlap.depth_mm);
        assert!(after < 10.0, "{after}");
        let has_moved = |k: usize| people[k].fitted.state.poses[15] != make()[k].fitted.state.poses[15];
        assert!(has_moved(0) && has_moved(1));
    }
}
