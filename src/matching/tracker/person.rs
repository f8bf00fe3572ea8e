//! One tracked person: assigned detections, skeletons, velocity.

use super::monocular;
use super::scene::{Assignment, Seen, Shown, TrackerConfig, TrackerScene};
use super::skeleton::{Skeleton, completed, distance_to_detection, triangulated};
use crate::optim::robust::median;
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

/// A person followed through the session.
#[derive(Debug, Clone, Default)]
pub struct TrackedPerson {
    /// Frame and detections, in rising order of frames; only frames with at least one detection.
    pub assignments: Vec<(usize, Assignment)>,
    /// Skeletons of the same frames.
    pub skeletons: Vec<Skeleton>,
    /// Velocity of the body's middle, m/s.
    velocity: Vector3<f64>,
    /// Frames seen by enough views to confirm the person.
    n_confirmed: usize,
}

/// The velocity estimate forgets the past with this time constant, s: the time of half a step.
const VELOCITY_MEMORY: f64 = 0.15;

/// A body out of sight is expected to go on for half of the time in which it would stop, braking at 4 m/s^2 (a stride of a
/// runner takes off 1 to 2 m/s): the inverse, s^2/m. At a walk that is the memory of the velocity.
const COASTING_S2_M: f64 = 0.125;

impl TrackedPerson {
    pub(super) fn new(frame: usize, assignment: Assignment, skeleton: Skeleton) -> Self {
        let (assignments, skeletons) = (vec![(frame, assignment)], vec![skeleton]);
        Self { assignments, skeletons, velocity: Vector3::zeros(), n_confirmed: 1 }
    }

    /// First frame with a detection.
    pub fn first(&self) -> usize {
        self.assignments[0].0
    }

    /// Last frame with a detection.
    pub fn last_seen(&self) -> usize {
        self.assignments[self.assignments.len() - 1].0
    }

    /// Number of detections.
    pub fn support(&self) -> usize {
        self.assignments.iter().map(|(_, a)| a.iter().flatten().count()).sum()
    }

    pub(super) fn last_assignment(&self) -> &Assignment {
        &self.assignments[self.assignments.len() - 1].1
    }

    /// Speed of the body's middle at the end, m/s.
    pub(super) fn speed(&self) -> f64 {
        self.velocity.norm()
    }

    pub(super) fn last_skeleton(&self) -> &Skeleton {
        &self.skeletons[self.skeletons.len() - 1]
    }

    /// Whether enough views saw the person for long enough.
    pub(super) fn is_real(&self, scene: &TrackerScene, config: &TrackerConfig) -> bool {
        let required = (config.min_duration * scene.fps).ceil().max(2.0) as usize;
        self.n_confirmed >= required.min(scene.n_frames.div_ceil(3).max(1))
    }

    /// View and index of the detections of the last frame; empty where that is not `frame`.
    pub(super) fn detections_at(&self, frame: usize) -> Vec<(usize, usize)> {
        let (f, assignment) = &self.assignments[self.assignments.len() - 1];
        if *f != frame {
            return Vec::new();
        }
        assignment.iter().enumerate().filter_map(|(v, shown)| shown.map(|shown| (v, shown.detection))).collect()
    }

    /// Appends a fragment that begins later.
    pub(super) fn append(&mut self, later: Self) {
        self.assignments.extend(later.assignments);
        self.skeletons.extend(later.skeletons);
        self.velocity = later.velocity;
        self.n_confirmed += later.n_confirmed;
    }

    /// Merges a fragment that shows the same person in other views; skeletons of shared frames are averaged.
    pub(super) fn merge(&mut self, scene: &TrackerScene, other: Self) {
        if other.last_seen() > self.last_seen() {
            self.velocity = other.velocity;
        }
        let own = std::mem::take(&mut self.assignments).into_iter().zip(std::mem::take(&mut self.skeletons));
        let mut by_frame: BTreeMap<usize, (Assignment, Skeleton)> =
            own.map(|((frame, assignment), skeleton)| (frame, (assignment, skeleton))).collect();
        for ((frame, assignment), skeleton) in other.assignments.into_iter().zip(other.skeletons) {
            match by_frame.entry(frame) {
                Entry::Vacant(free) => _ = free.insert((assignment, skeleton)),
                Entry::Occupied(mut shared) => {
                    let (own, mean) = shared.get_mut();
                    own.iter_mut().zip(assignment).for_each(|(own, other)| *own = own.or(other));
                    mean.iter_mut()
                        .zip(skeleton)
                        .for_each(|(a, b)| *a = a.zip(b).map(|(a, b)| (a + b) / 2.0).or(*a).or(b));
                }
            }
        }
        self.n_confirmed = by_frame.values().filter(|(assignment, _)| scene.is_confirmed(assignment)).count();
        (self.assignments, self.skeletons) =
            by_frame.into_iter().map(|(frame, (assignment, skeleton))| ((frame, assignment), skeleton)).unzip();
    }

    /// Some of the frames; the velocity is known at the end of the last piece only.
    pub(super) fn piece(&self, scene: &TrackerScene, range: std::ops::Range<usize>) -> Self {
        let (assignments, skeletons) =
            (self.assignments[range.clone()].to_vec(), self.skeletons[range.clone()].to_vec());
        let velocity = if range.end == self.assignments.len() { self.velocity } else { Vector3::zeros() };
        let n_confirmed = assignments.iter().filter(|(_, a)| scene.is_confirmed(a)).count();
        Self { assignments, skeletons, velocity, n_confirmed }
    }

    /// The person's first frame alone, from which it is followed backwards.
    pub(super) fn backwards_from_start(&self, backwards: &TrackerScene) -> Self {
        let later =
            self.assignments.partition_point(|(f, _)| (f - self.first()) as f64 <= VELOCITY_MEMORY * backwards.fps);
        let seconds = (self.assignments[later - 1].0 - self.first()) as f64 / backwards.fps;
        let velocity = match seconds > 0.0 {
            true => shift(&self.skeletons[0], &self.skeletons[later - 1]) / seconds,
            false => Vector3::zeros(),
        };
        let first = (backwards.mirrored_frame(self.first()), self.assignments[0].1.clone());
        let (assignments, skeletons) = (vec![first], vec![self.skeletons[0].clone()]);
        Self { assignments, skeletons, velocity, n_confirmed: self.n_confirmed }
    }

    /// The person with what following it backwards has found after its first frame.
    pub(super) fn with_beginning(self, scene: &TrackerScene, beginning: &Self) -> Self {
        let n_found = beginning.assignments.len();
        if n_found < 2 {
            return self;
        }
        let mut whole = beginning.piece(scene, 1..n_found);
        whole.assignments.reverse();
        whole.skeletons.reverse();
        whole.assignments.iter_mut().for_each(|(frame, _)| *frame = scene.mirrored_frame(*frame));
        whole.append(self);
        whole
    }

    /// The skeleton predicted for `frame`, at constant velocity.
    pub(super) fn predict(&self, frame: usize, fps: f64) -> Skeleton {
        // Beyond the memory of the velocity a walker is as likely to have stopped as to have gone on.
        let coasting = VELOCITY_MEMORY.max(COASTING_S2_M * self.speed());
        let seconds = ((frame - self.last_seen()) as f64 / fps).min(coasting);
        let step = self.velocity * seconds;
        self.last_skeleton().iter().map(|p| p.map(|p| p + step)).collect()
    }

    /// Adds the detections of a frame in which the person was found far from the prediction: how far is the velocity.
    pub(super) fn resume(
        &mut self,
        scene: &TrackerScene,
        config: &TrackerConfig,
        frame: usize,
        assignment: &mut [Option<Shown>],
    ) {
        let n = self.assignments.len();
        self.update(scene, config, frame, assignment);
        if self.assignments.len() > n {
            let seconds = (frame - self.assignments[n - 1].0) as f64 / scene.fps;
            self.velocity = shift(&self.skeletons[n], &self.skeletons[n - 1]) / seconds;
        }
    }

    /// Adds the assigned detections of a frame; detections of views that contradict the others are removed from
    /// `assignment`.
    pub(super) fn update(
        &mut self,
        scene: &TrackerScene,
        config: &TrackerConfig,
        frame: usize,
        assignment: &mut [Option<Shown>],
    ) {
        let predicted = self.predict(frame, scene.fps);
        let skeleton = loop {
            let seen: Vec<(usize, Seen)> = scene.detections_of(frame, assignment);
            if seen.is_empty() {
                return;
            }
            if let [(_, detection)] = seen[..]
                && scene.n_confirming_views() == 1
            {
                let Some(figure) = monocular::flat_figure(scene, detection.detection, Some(&predicted)) else { return };
                break figure;
            }
            let skeleton = triangulated(scene, &seen);
            match worst_view(scene, config, &seen, &skeleton, &predicted) {
                Some(view) => assignment[view] = None,
                None => break completed(scene, &seen, skeleton, &predicted),
            }
        };
        self.n_confirmed += usize::from(scene.is_confirmed(assignment));
        self.update_velocity(scene, &skeleton, frame, assignment);
        self.assignments.push((frame, assignment.to_vec()));
        self.skeletons.push(skeleton);
    }

    fn update_velocity(
        &mut self,
        scene: &TrackerScene,
        skeleton: &Skeleton,
        frame: usize,
        assignment: &[Option<Shown>],
    ) {
        // A single view does not show motion in depth: when a second view sees the person again, the shift since the
        // last confirmed frame appears at once.
        let since = if scene.is_confirmed(assignment) {
            let confirmed = self.assignments.iter().rev().find(|(_, a)| scene.is_confirmed(a));
            confirmed.map_or(self.first(), |(f, _)| *f)
        } else {
            self.last_seen()
        };
        let seconds = (frame - since) as f64 / scene.fps;
        let measured = shift(skeleton, self.last_skeleton()) / seconds;
        let keep = (-seconds / VELOCITY_MEMORY).exp();
        self.velocity = self.velocity * keep + measured * (1.0 - keep);
    }
}

/// Median shift of the keypoints per axis, m.
fn shift(to: &Skeleton, from: &Skeleton) -> Vector3<f64> {
    let axis = |axis: usize| {
        let mut moves: Vec<f64> = to.iter().zip(from).filter_map(|(a, b)| Some((*a)?[axis] - (*b)?[axis])).collect();
        median(&mut moves).unwrap_or(0.0)
    };
    Vector3::new(axis(0), axis(1), axis(2))
}

/// The view that contradicts the rest most, if any does beyond the limit. With two views the prediction decides.
fn worst_view(
    scene: &TrackerScene,
    config: &TrackerConfig,
    seen: &[(usize, Seen)],
    skeleton: &Skeleton,
    predicted: &Skeleton,
) -> Option<usize> {
    if seen.len() < 2 {
        return None;
    }
    let residual = |skeleton: &Skeleton, view: usize, detection: Seen| {
        scene.cameras[view].as_ref().and_then(|c| distance_to_detection(skeleton, c, detection)).unwrap_or(0.0)
    };
    let worst = seen.iter().map(|(v, s)| residual(skeleton, *v, *s)).fold(0.0, f64::max);
    if worst <= config.max_residual {
        return None;
    }
    // The wrong view is the one whose absence makes the others agree best.
    let residual_without = |out: usize| {
        if seen.len() == 2 {
            return -residual(predicted, seen[out].0, seen[out].1);
        }
        let rest: Vec<(usize, Seen)> = seen.iter().enumerate().filter(|(i, _)| *i != out).map(|(_, s)| *s).collect();
        let without = triangulated(scene, &rest);
        rest.iter().map(|(v, s)| residual(&without, *v, *s)).fold(0.0, f64::max)
    };
    let without = (0..seen.len()).map(|out| (residual_without(out), seen[out].0));
    without.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, view)| view)
}
