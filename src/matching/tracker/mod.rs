//! The 3D tracker: every detection given to a person, frame by frame, under known cameras.
//!
//! A person is a predicted skeleton; each view gives its detections to the predictions that they lie nearest to; what is
//! left over starts new people where two views agree, or where the session has a single camera (`one_view`). Not physics
//! yet: predictions move with the body's own velocity.

mod birth;
mod doubles;
mod likeness;
mod link;
mod one_view;
mod person;
mod rejoin;

use super::assignment::assign;
use super::normalized::NormalizedView;
use crate::body::bones::LimbBone;
use crate::geometry::Rigid;
use crate::progress::{Canceled, Progress};
pub use person::{Skeleton, TrackedPerson};

/// Gates of the tracker. Lengths are metres on a body: what a pixel is worth follows from the depth.
#[derive(Debug, Clone)]
pub struct TrackerConfig {
    /// A detection belongs to a prediction when their median joint distance is below this, m.
    pub gate: f64,
    /// The gate widens by this for every second without a detection, m/s: people turn and stop.
    pub gate_growth: f64,
    /// A view whose median residual to the triangulated skeleton exceeds this is given back, m.
    pub max_residual: f64,
    /// Radius within which rays of two views agree on a new person, m.
    pub birth_radius: f64,
    /// A person must be seen by two views (by the only one of a single camera) for this long to exist, s.
    pub min_duration: f64,
    /// A person unseen for this long has left, s.
    pub max_gap: f64,
}

impl Default for TrackerConfig {
    fn default() -> Self {
        Self { gate: 0.18, gate_growth: 0.4, max_residual: 0.13, birth_radius: 0.08, min_duration: 0.3, max_gap: 1.0 }
    }
}

/// What the tracker works on.
pub struct Scene<'a> {
    /// Sightings of every view.
    pub views: &'a [NormalizedView],
    /// Placed cameras.
    pub cameras: &'a [Option<Rigid>],
    /// Bones with reference lengths.
    pub bones: &'a [LimbBone],
    /// Frames per second.
    pub fps: f64,
    /// Number of frames.
    pub n_frames: usize,
}

impl Scene<'_> {
    /// How many views must see a person at once to bear witness of them.
    fn n_witnesses(&self) -> usize {
        self.views.len().min(2)
    }
}

/// Follows everybody through the session; people in order of support, best first.
///
/// # Errors
/// [`Canceled`].
pub fn track(scene: &Scene, config: &TrackerConfig, progress: &Progress) -> Result<Vec<TrackedPerson>, Canceled> {
    let mut people: Vec<TrackedPerson> = Vec::new();
    let mut finished: Vec<TrackedPerson> = Vec::new();
    for frame in 0..scene.n_frames {
        if frame % 64 == 0 {
            progress.check()?;
        }
        let max_gap = (config.max_gap * scene.fps) as usize;
        let (alive, gone): (Vec<_>, Vec<_>) = people.into_iter().partition(|p| frame - p.last_seen() <= max_gap);
        finished.extend(gone.into_iter().filter(|p| p.is_real(scene, config)));
        people = alive;
        step(scene, config, frame, &mut people);
    }
    finished.extend(people.into_iter().filter(|p| p.is_real(scene, config)));
    let mut people = link::join_fragments(scene, finished);
    people.retain(|p| p.is_real(scene, config));
    people.sort_by_key(|p| (std::cmp::Reverse(p.support()), p.first()));
    Ok(people)
}

/// One frame: claim, check, start, forget.
fn step(scene: &Scene, config: &TrackerConfig, frame: usize, people: &mut Vec<TrackedPerson>) {
    let mut claims = claims(scene, config, frame, people);
    rejoin::rejoin(scene, config, frame, &mut claims);
    for (person, claim) in people.iter_mut().zip(&mut claims) {
        person.update(scene, config, frame, claim);
    }
    let mut free = unclaimed(scene, frame, &claims);
    while let Some(newborn) = newborn(scene, config, frame, &free, people) {
        for (view, detection) in newborn.detections_at(frame) {
            free[view].retain(|d| *d != detection);
        }
        people.push(newborn);
    }
}

/// The best supported new person among the free detections of a frame.
fn newborn(
    scene: &Scene,
    config: &TrackerConfig,
    frame: usize,
    free: &[Vec<usize>],
    people: &[TrackedPerson],
) -> Option<TrackedPerson> {
    match scene.views.len() {
        1 => one_view::strongest(scene, frame, &free[0], people),
        _ => birth::strongest(scene, config, frame, free, people),
    }
}

/// For each person the detection of every view that lies nearest to the prediction, one detection to one person.
fn claims(scene: &Scene, config: &TrackerConfig, frame: usize, people: &[TrackedPerson]) -> Vec<Vec<Option<usize>>> {
    let mut claims = vec![vec![None; scene.views.len()]; people.len()];
    let predictions: Vec<_> = people.iter().map(|p| p.predict(frame, scene.fps)).collect();
    for (view, camera) in scene.cameras.iter().enumerate() {
        let Some(camera) = camera else { continue };
        let detections = &scene.views[view].frames[frame];
        let cost = |p: usize, d: usize| {
            let gate = config.gate + config.gate_growth * (frame - people[p].last_seen() - 1) as f64 / scene.fps;
            let doubt = if people[p].is_real(scene, config) { 1.0 } else { 1.3 };
            let distance = person::distance_m(&predictions[p], camera, &detections[d]);
            distance.map_or(2.0, |m| claim_cost(m * doubt, gate, config.gate))
        };
        let costs: Vec<Vec<f64>> =
            (0..people.len()).map(|p| (0..detections.len()).map(|d| cost(p, d)).collect()).collect();
        for (p, d) in assign(people.len(), detections.len(), 1.0, |p, d| costs[p][d]).into_iter().enumerate() {
            claims[p][view] = d;
        }
    }
    claims
}

/// Cost of a detection `distance` m off a prediction that is good to `gate` m; 1 is nobody's.
///
/// With the gate at three standard deviations the negative log likelihood over the 4.5 nats of a gate just made: a lost
/// person's wide gate takes in many detections, and each of them is the less likely theirs.
fn claim_cost(distance: f64, gate: f64, fresh_gate: f64) -> f64 {
    if distance < gate { (distance / gate).powi(2) + 2.0 / 4.5 * (gate / fresh_gate).ln() } else { 2.0 }
}

/// Detections of a frame that nobody claims, per view.
fn unclaimed(scene: &Scene, frame: usize, claims: &[Vec<Option<usize>>]) -> Vec<Vec<usize>> {
    let of_view = |view: usize| {
        let n = if scene.cameras[view].is_some() { scene.views[view].frames[frame].len() } else { 0 };
        (0..n).filter(|d| !claims.iter().any(|c| c[view] == Some(*d))).collect()
    };
    (0..scene.views.len()).map(of_view).collect()
}

/// The skeleton that the claimed detections of a frame (one per view at most) agree on; holes where fewer than two see.
pub fn skeleton(scene: &Scene, frame: usize, claim: &[Option<usize>]) -> Skeleton {
    let seen = person::detections_of(scene, frame, claim);
    match seen[..] {
        [] => Vec::new(),
        [(_, detection)] if scene.n_witnesses() == 1 => one_view::figure(scene, detection, None).unwrap_or_default(),
        _ => person::triangulated(scene, &seen),
    }
}
