//! People who stand in each other's way give way, both by half, as far as what was seen allows.
//!
//! In rounds: who touches whom is found for all frames, then everybody's frames near a contact are fitted anew with the
//! others held ([`super::local_fit`]).

use super::contacts::{CapsuleBody, Contact, Contacts, Touch};
use super::evidence::Evidence;
use super::motion_problem::MotionState;
use super::solve::{FittedMotion, Stages};
use crate::body::BodyModel;
use crate::body::capsules::BodyCapsules;
use crate::body::skeleton::JOINT_NAMES;
use crate::progress::Canceled;
use crate::session::PersonId;
use crate::session::reconstruction::{Overlap, PenetrationReport};
use rayon::prelude::*;

/// One person's fit on the session's time line.
pub(super) struct PlacedFit {
    /// Who.
    pub person: PersonId,
    /// The session's frame at which the motion begins.
    pub first: usize,
    pub evidence: Evidence,
    pub fitted: FittedMotion,
    /// False where the person is carried through a gap: whoever was not seen stands in nobody's way.
    pub valid: Vec<bool>,
}

/// Who touches whom, and when.
struct Meetings {
    /// By person and frame of the person's motion.
    contacts: Vec<Vec<Vec<Contact>>>,
    /// Deepest overlap, by person and frame, m.
    depths: Vec<Vec<f64>>,
    deepest: Option<Overlap>,
    /// Number of the session's first frame.
    first_frame: i64,
}

/// Each round leaves a half of what the evidence does not hold in place; more bring less than a millimetre.
const ROUNDS: usize = 6;
/// Steps of each round: the start is near.
const STEPS: usize = 3;
/// Overlaps below this are the capsules' own misfit to the skin, m.
const TOLERATED: f64 = 0.01;

/// Parts whoever overlaps, if `give_way`, and says how deep overlaps are before and after; `first_frame`: the number of
/// the session's first frame.
///
/// # Errors
/// [`Canceled`].
pub(super) fn separate(
    stages: &Stages,
    people: &mut [PlacedFit],
    give_way: bool,
    first_frame: i64,
) -> Result<PenetrationReport, Canceled> {
    if !anybody_is_near(people) {
        return Ok(PenetrationReport::default());
    }
    let capsules = BodyCapsules::fitted(stages.model);
    let mut found = meetings(stages.model, &capsules, people, first_frame);
    let before = found.deepest.clone();
    let seen: Vec<MotionState> = people.iter().map(|person| person.fitted.state.clone()).collect();
    for _ in 0..if give_way { ROUNDS } else { 0 } {
        if found.deepest.as_ref().is_none_or(|overlap| 1e-3 * overlap.depth_mm <= TOLERATED) {
            break;
        }
        let part = |(k, person): (usize, &PlacedFit)| {
            let contacts =
                Contacts { capsules: &capsules, by_frame: &found.contacts[k], sigma: stages.config.contact_sigma };
            stages.parted(person, &seen[k], contacts, &found.depths[k])
        };
        let states: Vec<MotionState> = people.par_iter().enumerate().map(part).collect::<Result<Vec<_>, Canceled>>()?;
        people.iter_mut().zip(states).for_each(|(person, state)| person.fitted.state = state);
        found = meetings(stages.model, &capsules, people, first_frame);
    }
    let n_frames = |depths: &Vec<f64>| depths.iter().filter(|depth| **depth > TOLERATED).count();
    Ok(PenetrationReport {
        deepest: found.deepest,
        deepest_before: before.filter(|_| give_way),
        person_frames: found.depths.iter().map(n_frames).sum(),
    })
}

/// Whether two people come within reach of each other at all: capsules cost time to prepare.
fn anybody_is_near(people: &[PlacedFit]) -> bool {
    pairs(people).any(|(one, other)| {
        shared_frames(one, other).any(|t| {
            let pelvis = |p: &PlacedFit| p.fitted.state.poses[t - p.first].translation;
            (pelvis(one) - pelvis(other)).norm() < super::contacts::REACH
        })
    })
}

fn pairs(people: &[PlacedFit]) -> impl Iterator<Item = (&PlacedFit, &PlacedFit)> {
    people.iter().enumerate().flat_map(|(i, one)| people[i + 1..].iter().map(move |other| (one, other)))
}

/// Frames in which both are there and neither is carried through a gap.
fn shared_frames<'a>(one: &'a PlacedFit, other: &'a PlacedFit) -> impl Iterator<Item = usize> + 'a {
    let end = |p: &PlacedFit| p.first + p.valid.len();
    let both = one.first.max(other.first)..end(one).min(end(other));
    both.filter(|t| one.valid[t - one.first] && other.valid[t - other.first])
}

fn meetings(model: &BodyModel, capsules: &BodyCapsules, people: &[PlacedFit], first_frame: i64) -> Meetings {
    let bodies_of = |p: &PlacedFit| -> Vec<CapsuleBody> {
        let state = &p.fitted.state;
        state.poses.iter().map(|pose| CapsuleBody::new(model, capsules, &state.betas, pose)).collect()
    };
    let bodies: Vec<Vec<CapsuleBody>> = people.par_iter().map(bodies_of).collect();
    let mut found = Meetings {
        contacts: bodies.iter().map(|b| vec![Vec::new(); b.len()]).collect(),
        depths: bodies.iter().map(|b| vec![0.0; b.len()]).collect(),
        deepest: None,
        first_frame,
    };
    let indices = (0..people.len()).flat_map(|a| (a + 1..people.len()).map(move |b| [a, b]));
    for pair in indices {
        let [one, other] = pair.map(|k| &people[k]);
        let frames: Vec<usize> = shared_frames(one, other).collect();
        let touch = |&t: &usize| bodies[pair[0]][t - one.first].touch(&bodies[pair[1]][t - other.first], capsules);
        let touches: Vec<Touch> = frames.par_iter().map(touch).collect();
        for (t, touch) in frames.into_iter().zip(touches) {
            found.add(people, pair, t, touch);
        }
    }
    found
}

impl Meetings {
    fn add(&mut self, people: &[PlacedFit], pair: [usize; 2], frame: usize, touch: Touch) {
        for (k, contacts) in pair.into_iter().zip(touch.contacts) {
            let own = frame - people[k].first;
            self.contacts[k][own].extend(contacts);
            self.depths[k][own] = self.depths[k][own].max(touch.depth);
        }
        let depth_mm = 1e3 * touch.depth;
        if self.deepest.as_ref().is_none_or(|overlap| depth_mm > overlap.depth_mm) && depth_mm > 0.0 {
            let frame = self.first_frame + frame as i64;
            let people = pair.map(|k| people[k].person.0);
            self.deepest =
                Some(Overlap { depth_mm, frame, people, joints: touch.joints.map(|j| JOINT_NAMES[j].to_owned()) });
        }
    }
}

impl Stages<'_> {
    /// One person with all contacts given way to.
    fn parted(
        &self,
        person: &PlacedFit,
        seen: &MotionState,
        contacts: Contacts,
        depths: &[f64],
    ) -> Result<MotionState, Canceled> {
        let state = person.fitted.state.clone();
        let runs = self.runs(depths.iter().map(|depth| *depth > TOLERATED));
        self.refitted(&person.evidence, seen, state, runs, STEPS, contacts)
    }
}

#[cfg(test)]
mod tests {
    use super::super::BodyFitConfig;
    use super::*;
    use crate::body::default_body;
    use crate::body::joint_ranges::natural_pose;
    use crate::body::kinematics::Pose;
    use crate::body::model::Betas;
    use crate::progress::Progress;
    use nalgebra::Vector3;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn placed(person: usize, first: usize, poses: Vec<Pose>) -> PlacedFit {
        let n = poses.len();
        let state = MotionState { betas: Betas::zeros(), poses };
        let evidence = Evidence { cameras: Vec::new(), points: vec![Vec::new(); n], pixels: vec![Vec::new(); n] };
        let fitted = FittedMotion::unmoved(state);
        PlacedFit { person: PersonId(person), first, evidence, fitted, valid: vec![true; n] }
    }

    /// Both stand too near to each other; nothing was seen, so that both may give way.
    #[test]
    fn whoever_overlaps_parts_and_neither_stays() {
        let model = default_body();
        let rotations = natural_pose(&mut ChaCha8Rng::seed_from_u64(0), 0.0).rotations;
        let at = |x: f64| Pose { rotations, translation: Vector3::x() * x };
        let make = || [placed(3, 10, vec![at(0.0); 30]), placed(5, 10, vec![at(0.45); 30])];
        let (config, progress) = (BodyFitConfig::default(), Progress::silent());
        let stages = Stages {
            model: &model,
            config: &config,
            as_seen: &config,
            frame_interval: 1.0 / 30.0,
            progress: &progress,
        };
        let mut people = make();
        let kept = separate(&stages, &mut people, false, 100).unwrap();
        let before = kept.deepest.clone().unwrap();
        assert!(before.depth_mm > 30.0 && before.frame == 110 && before.people == [3, 5], "{before:?}");
        assert!(kept.deepest_before.is_none() && people[0].fitted == make()[0].fitted);

        let refuted = BodyFitConfig { contact_refuted: [f64::NEG_INFINITY; 2], ..config.clone() };
        let stayed = separate(&Stages { config: &refuted, ..stages }, &mut people, true, 100).unwrap();
        assert!(stayed.deepest.as_ref() == Some(&before) && people[1].fitted == make()[1].fitted);

        let parted = separate(&stages, &mut people, true, 100).unwrap();
        assert_eq!(parted.deepest_before.as_ref(), Some(&before));
        let after = parted.deepest.map_or(0.0, |overlap| overlap.depth_mm);
        assert!(after < 10.0, "{after}");
        let has_moved = |k: usize| people[k].fitted.state.poses[15] != make()[k].fitted.state.poses[15];
        assert!(has_moved(0) && has_moved(1));
    }
}
