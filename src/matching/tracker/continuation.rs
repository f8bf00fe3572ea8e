//! Continuation: a person lost in this frame goes on as a person new in it, where neither has a rival.
//!
//! Gates about predicted positions assume a speed, and at first that is not known: a person entering at a run would be a new
//! person in every frame. That no other person can be meant is better evidence than a limit on speed, whose unit, the frame
//! interval, is not always right either.

use super::person::TrackedPerson;
use super::scene::{TrackerConfig, TrackerScene};
use super::skeleton::{Skeleton, distance};
use crate::matching::assignment::lone_pairs;
use crate::matching::normalized::BODY_SPAN_M;

/// Farthest continuation, m: half a body, as of tracklets ([`crate::matching::tracklets::TrackletConfig::lone_reach`]).
const REACH_M: f64 = 0.6 * BODY_SPAN_M;

/// A person lost for longer than this, s, is left to stitching, which knows what comes later.
const MAX_GAP_SECS: f64 = 0.2;

/// A continuation must be nearer than this share of the distance to any other person: as for tracklets.
const UNIQUENESS: f64 = 0.6;

/// Lets persons go on whose detections of `frame` have started new ones; those are `people[n_known..]`.
pub(super) fn continue_lost(
    scene: &TrackerScene,
    config: &TrackerConfig,
    frame: usize,
    people: &mut Vec<TrackedPerson>,
    n_known: usize,
) {
    let max_gap = (MAX_GAP_SECS * scene.fps).max(1.0) as usize;
    let is_lost = |p: &TrackedPerson| p.last_seen() < frame && frame - p.last_seen() <= max_gap;
    if n_known == people.len() || !people[..n_known].iter().any(is_lost) {
        return;
    }
    let expected: Vec<Skeleton> = people[..n_known].iter().map(|p| p.predict(frame, scene.fps)).collect();
    let apart = |known: usize, new: usize| {
        let known = if is_lost(&people[known]) { &expected[known] } else { people[known].last_skeleton() };
        distance(known, people[new].last_skeleton()).unwrap_or(f64::INFINITY)
    };
    let is_near = |p: &TrackedPerson| frame - p.last_seen() <= max_gap;
    let distances: Vec<Vec<f64>> = (0..n_known)
        .map(|known| match is_near(&people[known]) {
            true => (n_known..people.len()).map(|new| apart(known, new)).collect(),
            false => vec![f64::INFINITY; people.len() - n_known],
        })
        .collect();
    let found = lone_pairs(&distances, REACH_M, UNIQUENESS, |known, _| is_lost(&people[known]));
    let mut is_merged = vec![false; people.len()];
    for (known, new) in found {
        let mut assignment = people[n_known + new].last_assignment().clone();
        people[known].resume(scene, config, frame, &mut assignment);
        is_merged[n_known + new] = people[known].last_seen() == frame;
    }
    let mut merged = is_merged.into_iter();
    people.retain(|_| !merged.next().unwrap_or(false));
}
