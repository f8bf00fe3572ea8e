//! Selection of keyframes for bundle adjustment: a fixed number, spread over persons and time, so that the cost of the
//! cameras does not grow with the length of the recording.

use crate::body::detector_profile::DETECTOR;
use crate::geometry::Rigid;
use crate::optim::robust::{MEDIAN_LENGTH_IN_PLANE, median};
use crate::pipeline::calibration::Calibration;
use crate::pipeline::keyframe::{Keyframe, Observation};
use crate::session::recording::Session;
use crate::session::{JointTrajectory, PersonTrack};
use nalgebra::Vector2;

/// Whether a frame may be used.
pub type FrameFilter<'a> = &'a (dyn Fn(usize) -> bool + Sync);

/// Selects at most about `max_keyframes` skeletons seen by at least two `cameras`, evenly over persons and time: in each
/// stretch of time the one that most cameras see. Persons and noise are those of `calibration`.
pub fn select_keyframes(
    session: &Session,
    calibration: &Calibration,
    cameras: &[Option<Rigid>],
    max_keyframes: usize,
    allowed: FrameFilter,
) -> Vec<Keyframe> {
    let tracks = &calibration.association.tracks;
    let candidates: Vec<Vec<(usize, usize)>> = tracks.iter().map(|track| candidates(track, cameras, allowed)).collect();
    let total: usize = candidates.iter().map(Vec::len).sum();
    let mut selected = Vec::new();
    for (person, frames) in candidates.iter().enumerate() {
        let share = (frames.len() * max_keyframes).div_ceil(total.max(1)).min(frames.len());
        for i in 0..share {
            let stretch = &frames[i * frames.len() / share..(i + 1) * frames.len() / share];
            let Some(best) = stretch.iter().max_by_key(|(_, n)| *n) else { continue };
            selected.push(keyframe(session, calibration, cameras, person, best.0));
        }
    }
    selected.retain(|k: &Keyframe| k.observations.len() >= 8);
    selected.sort_by_key(|k| (k.frame, k.person));
    selected
}

/// Frames of a person seen by at least two placed cameras: index in the track and number of views.
fn candidates(track: &PersonTrack, cameras: &[Option<Rigid>], allowed: FrameFilter) -> Vec<(usize, usize)> {
    let n_views = |assignment: &[Option<usize>]| {
        assignment.iter().zip(cameras).filter(|(d, c)| d.is_some() && c.is_some()).count()
    };
    track
        .detections
        .iter()
        .enumerate()
        .filter(|(t, _)| allowed(track.first.0 + t))
        .map(|(t, assignment)| (t, n_views(assignment)))
        .filter(|(_, n)| *n >= 2)
        .collect()
}

fn keyframe(
    session: &Session,
    calibration: &Calibration,
    cameras: &[Option<Rigid>],
    person: usize,
    t: usize,
) -> Keyframe {
    let Calibration { association, noise, .. } = calibration;
    let track = &association.tracks[person];
    let frame = track.first.0 + t;
    let n_keypoints = noise.sigmas_m().len();
    let start = &association.points[person].points[t];
    let mut observations = Vec::new();
    for (view, detection) in track.detections[t].iter().enumerate() {
        let (Some(detection), Some(camera)) = (detection, &cameras[view]) else { continue };
        let intrinsics = &session.views[view].intrinsics;
        for (keypoint, k) in session.views[view].frames[frame][*detection].keypoints[..n_keypoints].iter().enumerate() {
            let Some(point) = start[keypoint].filter(|_| k.confidence >= DETECTOR.judged) else { continue };
            let depth = camera.transform(&point).z.max(0.3);
            let sigma_m = noise.sigma_m(keypoint, k.confidence);
            let sigma_px = sigma_m * intrinsics.focal() / depth;
            observations.push(Observation { keypoint, view, pixel: k.pixel, sigma_px, velocity: Vector2::zeros() });
        }
    }
    let mut n_views = vec![0u8; n_keypoints];
    observations.iter().for_each(|o| n_views[o.keypoint] += 1);
    observations.retain(|o| n_views[o.keypoint] >= 2);
    let points = start.iter().zip(&n_views).map(|(p, n)| p.filter(|_| *n >= 2)).collect();
    Keyframe { person, frame, points, observations }
}

/// Sets every observation's image velocity from its point's smooth trajectory; `trajectories`: per person.
///
/// Why not from the detections themselves: their noise is as large as the motion of a frame, and a velocity that is mostly
/// noise does not explain a delay.
pub fn set_image_velocities(
    keyframes: &mut [Keyframe],
    session: &Session,
    cameras: &[Option<Rigid>],
    trajectories: &[JointTrajectory],
) {
    for keyframe in keyframes {
        let trajectory = &trajectories[keyframe.person];
        let at = |frame: Option<usize>, keypoint: usize| {
            let t = frame?.checked_sub(trajectory.first.0)?;
            trajectory.points.get(t)?[keypoint]
        };
        for o in &mut keyframe.observations {
            let Some(camera) = &cameras[o.view] else { continue };
            let pixel = |frame: Option<usize>| {
                let point = camera.transform(&at(frame, o.keypoint)?);
                session.views[o.view].intrinsics.pixel_from_camera(&point)
            };
            // Central difference.
            let ends = pixel(keyframe.frame.checked_sub(1)).zip(pixel(keyframe.frame.checked_add(1)));
            o.velocity = ends.map_or(Vector2::zeros(), |(before, after)| 0.5 * (after - before));
        }
    }
}

/// Factor by which the residuals of an adjustment exceed the assumed standard deviations: the median of distance over
/// sigma, divided by the median of a normal error in two dimensions.
pub fn noise_factor(session: &Session, cameras: &[Option<Rigid>], keyframes: &[Keyframe]) -> f64 {
    let mut ratios = Vec::new();
    for keyframe in keyframes {
        for o in &keyframe.observations {
            let (Some(point), Some(camera)) = (keyframe.points[o.keypoint], &cameras[o.view]) else { continue };
            if let Some(pixel) = session.views[o.view].intrinsics.pixel_from_camera(&camera.transform(&point)) {
                ratios.push((pixel - o.pixel).norm() / o.sigma_px);
            }
        }
    }
    median(&mut ratios).map_or(1.0, |m| (m / MEDIAN_LENGTH_IN_PLANE).clamp(0.2, 5.0))
}
