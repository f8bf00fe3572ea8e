//! A fixed budget of well-spread skeletons for the adjustment: cameras cost the same however long the take.

use crate::body::detector_noise::DetectorNoise;
use crate::body::detector_profile::DETECTOR;
use crate::geometry::Rigid;
use crate::optim::robust::{MEDIAN_LENGTH_IN_PLANE, median};
use crate::pipeline::stages::association::Association;
use crate::pipeline::stages::bundle_adjustment::{Instant, Observation};
use crate::session::JointTrajectory;
use crate::session::recording::Session;
use nalgebra::Vector2;

/// How instants are chosen.
#[derive(Debug, Clone, Copy)]
pub(super) struct InstantBudget<'a> {
    /// At most so many skeletons.
    pub(super) max_instants: usize,
    /// How far the detector errs.
    pub(super) noise: &'a DetectorNoise,
    /// Metres that one unit of the cameras' world stands for.
    pub(super) metres_per_unit: f64,
}

/// Which frames may be used.
pub(super) type FrameFilter<'a> = &'a (dyn Fn(usize) -> bool + Sync);

/// Chooses skeletons seen by at least two cameras, evenly over people and time; in each stretch the best seen one.
pub(super) fn instants(
    session: &Session,
    cameras: &[Option<Rigid>],
    association: &Association,
    budget: InstantBudget,
    allowed: FrameFilter,
) -> Vec<Instant> {
    let candidates: Vec<Vec<(usize, usize)>> =
        (0..association.tracks.len()).map(|p| candidates(association, cameras, p, allowed)).collect();
    let total: usize = candidates.iter().map(Vec::len).sum();
    let mut chosen = Vec::new();
    for (person, frames) in candidates.iter().enumerate() {
        let share = (frames.len() * budget.max_instants).div_ceil(total.max(1)).min(frames.len());
        for i in 0..share {
            let stretch = &frames[i * frames.len() / share..(i + 1) * frames.len() / share];
            let Some(best) = stretch.iter().max_by_key(|(_, n)| *n) else { continue };
            chosen.push(instant(session, cameras, association, person, best.0, budget));
        }
    }
    chosen.retain(|i: &Instant| i.observations.len() >= 8);
    chosen.sort_by_key(|i| (i.frame, i.person));
    chosen
}

/// Frames of a person seen by two placed cameras, as offset in the track and number of views.
fn candidates(
    association: &Association,
    cameras: &[Option<Rigid>],
    person: usize,
    allowed: FrameFilter,
) -> Vec<(usize, usize)> {
    let track = &association.tracks[person];
    let n_views =
        |claim: &[Option<usize>]| claim.iter().zip(cameras).filter(|(d, c)| d.is_some() && c.is_some()).count();
    track
        .detections
        .iter()
        .enumerate()
        .filter(|(t, _)| allowed(track.first.0 + t))
        .map(|(t, claim)| (t, n_views(claim)))
        .filter(|(_, n)| *n >= 2)
        .collect()
}

fn instant(
    session: &Session,
    cameras: &[Option<Rigid>],
    association: &Association,
    person: usize,
    t: usize,
    budget: InstantBudget,
) -> Instant {
    let track = &association.tracks[person];
    let frame = track.first.0 + t;
    let n_keypoints = budget.noise.sigmas_m().len();
    let guess = &association.points[person].points[t];
    let mut observations = Vec::new();
    for (view, detection) in track.detections[t].iter().enumerate() {
        let (Some(detection), Some(camera)) = (detection, &cameras[view]) else { continue };
        let intrinsics = &session.views[view].intrinsics;
        for (keypoint, k) in session.views[view].frames[frame][*detection].keypoints[..n_keypoints].iter().enumerate() {
            let Some(point) = guess[keypoint].filter(|_| k.confidence >= DETECTOR.judged) else { continue };
            let depth = (camera.transform(&point).z * budget.metres_per_unit).max(0.3);
            let sigma_m = budget.noise.sigma_m(keypoint, k.confidence);
            let sigma_px = sigma_m * intrinsics.focal() / depth;
            observations.push(Observation { keypoint, view, pixel: k.pixel, sigma_px, velocity: Vector2::zeros() });
        }
    }
    let mut seen = vec![0u8; n_keypoints];
    observations.iter().for_each(|o| seen[o.keypoint] += 1);
    observations.retain(|o| seen[o.keypoint] >= 2);
    let points = guess.iter().zip(&seen).map(|(p, n)| p.filter(|_| *n >= 2)).collect();
    Instant { person, frame, points, observations }
}

/// Gives every observation the velocity in the image of its point's smooth path; `paths`: per person.
///
/// Why not of the detections themselves: their noise is as large as a frame's motion, and a velocity that is mostly noise
/// explains no delay.
pub(super) fn set_in_motion(
    instants: &mut [Instant],
    session: &Session,
    cameras: &[Option<Rigid>],
    paths: &[JointTrajectory],
) {
    for instant in instants {
        let path = &paths[instant.person];
        let at = |frame: Option<usize>, keypoint: usize| {
            let t = frame?.checked_sub(path.first.0)?;
            path.points.get(t)?[keypoint]
        };
        for o in &mut instant.observations {
            let Some(camera) = &cameras[o.view] else { continue };
            let pixel = |frame: Option<usize>| {
                let point = camera.transform(&at(frame, o.keypoint)?);
                session.views[o.view].intrinsics.pixel_from_camera(&point)
            };
            // Half a step either way is without preference for the past or the future.
            let ends = pixel(instant.frame.checked_sub(1)).zip(pixel(instant.frame.checked_add(1)));
            o.velocity = ends.map_or(Vector2::zeros(), |(before, after)| 0.5 * (after - before));
        }
    }
}

/// By how much the residuals of an adjustment exceed the standard deviations it was given: median of the distance over
/// sigma against that of a normal error in two dimensions.
pub(super) fn noise_factor(session: &Session, cameras: &[Option<Rigid>], instants: &[Instant]) -> f64 {
    let mut ratios = Vec::new();
    for instant in instants {
        for o in &instant.observations {
            let (Some(point), Some(camera)) = (instant.points[o.keypoint], &cameras[o.view]) else { continue };
            if let Some(pixel) = session.views[o.view].intrinsics.pixel_from_camera(&camera.transform(&point)) {
                ratios.push((pixel - o.pixel).norm() / o.sigma_px);
            }
        }
    }
    median(&mut ratios).map_or(1.0, |m| (m / MEDIAN_LENGTH_IN_PLANE).clamp(0.2, 5.0))
}
