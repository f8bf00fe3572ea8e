//! One tracked person: claimed detections, the last skeleton, its motion.

use super::{Scene, TrackerConfig, one_view};
use crate::body::detector_profile::DETECTOR;
use crate::body::human_speeds::MAX_BODY_M_S;
use crate::estimation::triangulation::triangulate_reweighted;
use crate::geometry::Rigid;
use crate::geometry::projection::project_normalized;
use crate::geometry::triangulation::PointObservation;
use crate::matching::normalized::NormalizedDetection;
use crate::optim::robust::median;
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

/// A skeleton with holes, world frame.
pub type Skeleton = Vec<Option<Vector3<f64>>>;

/// A person followed through the session.
#[derive(Debug, Clone)]
pub struct TrackedPerson {
    /// `(frame, detection of every view)` in rising order of frames; only frames with at least one detection.
    pub claims: Vec<(usize, Vec<Option<usize>>)>,
    /// Skeletons of the same frames.
    pub skeletons: Vec<Skeleton>,
    /// Velocity of the body's middle, m/s.
    velocity: Vector3<f64>,
    /// Frames seen by as many views as bear witness.
    n_witnessed: usize,
}

/// The velocity estimate forgets the past with this time constant, s: the time of half a step.
const VELOCITY_MEMORY: f64 = 0.15;

/// A median joint must be seen by this many points to measure a distance.
const MIN_SHARED: usize = 4;

impl TrackedPerson {
    pub(super) fn new(frame: usize, claim: Vec<Option<usize>>, skeleton: Skeleton) -> Self {
        Self { claims: vec![(frame, claim)], skeletons: vec![skeleton], velocity: Vector3::zeros(), n_witnessed: 1 }
    }

    /// First frame with a detection.
    pub fn first(&self) -> usize {
        self.claims[0].0
    }

    /// Last frame with a detection.
    pub fn last_seen(&self) -> usize {
        self.claims[self.claims.len() - 1].0
    }

    /// Number of detections.
    pub fn support(&self) -> usize {
        self.claims.iter().map(|(_, c)| c.iter().flatten().count()).sum()
    }

    pub(super) fn last_skeleton(&self) -> &Skeleton {
        &self.skeletons[self.skeletons.len() - 1]
    }

    /// Seen by enough views for long enough.
    pub(super) fn is_real(&self, scene: &Scene, config: &TrackerConfig) -> bool {
        let wanted = (config.min_duration * scene.fps).ceil().max(2.0) as usize;
        self.n_witnessed >= wanted.min(scene.n_frames.div_ceil(3).max(1))
    }

    pub(super) fn detections_at(&self, frame: usize) -> Vec<(usize, usize)> {
        let (f, claim) = &self.claims[self.claims.len() - 1];
        if *f != frame {
            return Vec::new();
        }
        claim.iter().enumerate().filter_map(|(v, d)| d.map(|d| (v, d))).collect()
    }

    /// Goes on as a fragment that begins later.
    pub(super) fn continue_as(&mut self, later: Self) {
        self.claims.extend(later.claims);
        self.skeletons.extend(later.skeletons);
        self.velocity = later.velocity;
        self.n_witnessed += later.n_witnessed;
    }

    /// Takes in a fragment that shows the same person in other views.
    pub(super) fn unite(&mut self, scene: &Scene, other: Self) {
        if other.last_seen() > self.last_seen() {
            self.velocity = other.velocity;
        }
        let mine = std::mem::take(&mut self.claims).into_iter().zip(std::mem::take(&mut self.skeletons));
        let mut detections: BTreeMap<usize, (Vec<Option<usize>>, Skeleton)> =
            mine.map(|((frame, claim), skeleton)| (frame, (claim, skeleton))).collect();
        for ((frame, claim), skeleton) in other.claims.into_iter().zip(other.skeletons) {
            match detections.entry(frame) {
                Entry::Vacant(free) => _ = free.insert((claim, skeleton)),
                Entry::Occupied(mut shared) => {
                    let (mine, middle) = shared.get_mut();
                    mine.iter_mut().zip(claim).for_each(|(mine, theirs)| *mine = mine.or(theirs));
                    middle
                        .iter_mut()
                        .zip(skeleton)
                        .for_each(|(a, b)| *a = a.zip(b).map(|(a, b)| (a + b) / 2.0).or(*a).or(b));
                }
            }
        }
        self.n_witnessed = detections.values().filter(|(claim, _)| is_witnessed(scene, claim)).count();
        (self.claims, self.skeletons) =
            detections.into_iter().map(|(frame, (claim, skeleton))| ((frame, claim), skeleton)).unzip();
    }

    /// Some of the detections; the last velocity is known for the last piece alone.
    pub(super) fn piece(&self, scene: &Scene, range: std::ops::Range<usize>) -> Self {
        let (claims, skeletons) = (self.claims[range.clone()].to_vec(), self.skeletons[range.clone()].to_vec());
        let velocity = if range.end == self.claims.len() { self.velocity } else { Vector3::zeros() };
        let n_witnessed = claims.iter().filter(|(_, claim)| is_witnessed(scene, claim)).count();
        Self { claims, skeletons, velocity, n_witnessed }
    }

    /// Where the skeleton should be at `frame`.
    pub(super) fn predict(&self, frame: usize, fps: f64) -> Skeleton {
        // Beyond the memory of the velocity a body is as likely to have stopped as to have gone on.
        let seconds = ((frame - self.last_seen()) as f64 / fps).min(VELOCITY_MEMORY);
        let step = self.velocity * seconds;
        self.last_skeleton().iter().map(|p| p.map(|p| p + step)).collect()
    }

    /// Takes the claimed detections of a frame; views that contradict the others are given back in `claim`.
    pub(super) fn update(&mut self, scene: &Scene, config: &TrackerConfig, frame: usize, claim: &mut [Option<usize>]) {
        let predicted = self.predict(frame, scene.fps);
        let skeleton = loop {
            let seen: Vec<(usize, &NormalizedDetection)> = detections_of(scene, frame, claim);
            if seen.is_empty() {
                return;
            }
            if let [(_, detection)] = seen[..]
                && scene.n_witnesses() == 1
            {
                let Some(figure) = one_view::figure(scene, detection, Some(&predicted)) else { return };
                break figure;
            }
            let skeleton = triangulated(scene, &seen);
            match worst_view(scene, config, &seen, &skeleton, &predicted) {
                Some(view) => claim[view] = None,
                None => break completed(scene, &seen, skeleton, &predicted),
            }
        };
        self.n_witnessed += usize::from(is_witnessed(scene, claim));
        self.learn_velocity(scene, &skeleton, frame, claim);
        self.claims.push((frame, claim.to_vec()));
        self.skeletons.push(skeleton);
    }

    fn learn_velocity(&mut self, scene: &Scene, skeleton: &Skeleton, frame: usize, claim: &[Option<usize>]) {
        // Whom one view alone held has moved in depth ever since others saw them, and shows it only now.
        let since = match is_witnessed(scene, claim) {
            true => {
                self.claims.iter().rev().find(|(_, claim)| is_witnessed(scene, claim)).map_or(self.first(), |(f, _)| *f)
            }
            false => self.last_seen(),
        };
        let seconds = (frame - since) as f64 / scene.fps;
        let shift = |axis: usize| {
            let mut moves: Vec<f64> = skeleton
                .iter()
                .zip(self.last_skeleton())
                .filter_map(|(a, b)| Some((*a)?[axis] - (*b)?[axis]))
                .collect();
            median(&mut moves).unwrap_or(0.0) / seconds
        };
        let measured = Vector3::new(shift(0), shift(1), shift(2));
        let keep = (-seconds / VELOCITY_MEMORY).exp();
        self.velocity = self.velocity * keep + measured * (1.0 - keep);
        let speed = self.velocity.norm();
        if speed > MAX_BODY_M_S {
            self.velocity *= MAX_BODY_M_S / speed;
        }
    }
}

/// Whether as many views see a person as bear witness.
fn is_witnessed(scene: &Scene, claim: &[Option<usize>]) -> bool {
    claim.iter().flatten().count() >= scene.n_witnesses()
}

pub(super) fn detections_of<'a>(
    scene: &Scene<'a>,
    frame: usize,
    claim: &[Option<usize>],
) -> Vec<(usize, &'a NormalizedDetection)> {
    claim.iter().enumerate().filter_map(|(v, d)| d.map(|d| (v, &scene.views[v].frames[frame][d]))).collect()
}

/// Median distance of two skeletons' shared points.
pub(super) fn distance(one: &Skeleton, other: &Skeleton) -> Option<f64> {
    let mut distances: Vec<f64> = one.iter().zip(other).filter_map(|(a, b)| Some(((*a)? - (*b)?).norm())).collect();
    median(&mut distances)
}

/// Median distance of a detection to a projected skeleton, in metres on the body; `None` with too few shared points.
pub(super) fn distance_m(skeleton: &Skeleton, camera: &Rigid, detection: &NormalizedDetection) -> Option<f64> {
    let mut distances: Vec<f64> = Vec::with_capacity(skeleton.len());
    for (k, point) in skeleton.iter().enumerate() {
        if detection.confidence[k] < DETECTOR.comparable {
            continue;
        }
        if let Some(expected) = point.and_then(|p| project_normalized(camera, &p)) {
            distances.push((expected.normalized - detection.normalized[k]).norm() * expected.depth);
        }
    }
    if distances.len() < MIN_SHARED { None } else { median(&mut distances) }
}

/// Points seen by at least two views, re-weighted so that one bad view does not drag them.
pub(super) fn triangulated(scene: &Scene, seen: &[(usize, &NormalizedDetection)]) -> Skeleton {
    let n = seen[0].1.normalized.len();
    (0..n).map(|k| triangulated_point(scene, seen, k)).collect()
}

fn triangulated_point(scene: &Scene, seen: &[(usize, &NormalizedDetection)], k: usize) -> Option<Vector3<f64>> {
    let mut rays = Vec::with_capacity(seen.len());
    for (view, detection) in seen {
        if detection.confidence[k] > 0.0 {
            let camera = scene.cameras[*view].as_ref()?;
            let (normalized, weight) = (detection.normalized[k], detection.confidence[k]);
            rays.push(PointObservation { camera_from_world: camera, normalized, weight });
        }
    }
    triangulate_reweighted(rays, ROBUST_SCALE_M)
}

/// Residual at which a ray loses three quarters of its weight, m on the body: three times a good detector's noise.
const ROBUST_SCALE_M: f64 = 0.06;

/// The view that contradicts the rest most, if any does beyond the limit. With two views the prediction decides.
fn worst_view(
    scene: &Scene,
    config: &TrackerConfig,
    seen: &[(usize, &NormalizedDetection)],
    skeleton: &Skeleton,
    predicted: &Skeleton,
) -> Option<usize> {
    if seen.len() < 2 {
        return None;
    }
    let residual = |skeleton: &Skeleton, view: usize, detection: &NormalizedDetection| {
        scene.cameras[view].as_ref().and_then(|c| distance_m(skeleton, c, detection)).unwrap_or(0.0)
    };
    let worst = seen.iter().map(|(v, s)| residual(skeleton, *v, s)).fold(0.0, f64::max);
    if worst <= config.max_residual {
        return None;
    }
    // Which view to blame: the one whose absence makes the others agree best; two views cannot tell, time can.
    let blame = |out: usize| {
        if seen.len() == 2 {
            return -residual(predicted, seen[out].0, seen[out].1);
        }
        let rest: Vec<(usize, &NormalizedDetection)> =
            seen.iter().enumerate().filter(|(i, _)| *i != out).map(|(_, s)| *s).collect();
        let without = triangulated(scene, &rest);
        rest.iter().map(|(v, s)| residual(&without, *v, s)).fold(0.0, f64::max)
    };
    let blamed = (0..seen.len()).min_by(|a, b| blame(*a).total_cmp(&blame(*b)))?;
    Some(seen[blamed].0)
}

/// Fills points that two views did not see: one ray moves the prediction sideways, none carries it along.
fn completed(
    scene: &Scene,
    seen: &[(usize, &NormalizedDetection)],
    mut skeleton: Skeleton,
    predicted: &Skeleton,
) -> Skeleton {
    let mut moves: Vec<Vector3<f64>> =
        skeleton.iter().zip(predicted).filter_map(|(a, b)| Some((*a)? - (*b)?)).collect();
    let drift = componentwise_median(&mut moves);
    for (k, point) in skeleton.iter_mut().enumerate() {
        if point.is_some() {
            continue;
        }
        let Some(start) = predicted[k].map(|p| p + drift) else { continue };
        let ray = seen.iter().find(|(_, s)| s.confidence[k] > DETECTOR.comparable);
        *point = Some(match ray.and_then(|(v, s)| Some((scene.cameras[*v].as_ref()?, s.normalized[k]))) {
            Some((camera, normalized)) => {
                let in_camera = camera.transform(&start);
                let on_ray = Vector3::new(normalized.x * in_camera.z, normalized.y * in_camera.z, in_camera.z);
                camera.inverse().transform(&on_ray)
            }
            None => start,
        });
    }
    skeleton
}

fn componentwise_median(moves: &mut [Vector3<f64>]) -> Vector3<f64> {
    let axis = |a: usize| median(&mut moves.iter().map(|m| m[a]).collect::<Vec<_>>()).unwrap_or(0.0);
    Vector3::new(axis(0), axis(1), axis(2))
}
