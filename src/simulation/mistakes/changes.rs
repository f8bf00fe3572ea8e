//! What the mistakes change in a session.

use crate::geometry::{Intrinsics, rotation};
use crate::session::recording::{Detection, FrameIndex, Keypoint, Session, View};
use nalgebra::{Matrix3, Vector2, Vector3};

/// The camera of most mistakes, and its partner where there are two.
pub(super) const ODD: usize = 1;
pub(super) const PARTNER: usize = 2;

/// Rotation of a knocked camera, rad.
const KNOCK: f64 = 0.5 * std::f64::consts::PI / 180.0;

pub(super) fn everywhere(session: &Session) -> Vec<usize> {
    (0..session.views.len()).collect()
}

/// Coordinate of the last pixel of a row of `n`.
pub(super) fn last(n: u32) -> f64 {
    f64::from(n) - 1.0
}

pub(super) fn upwards(lens: &Intrinsics, pixel: Vector2<f64>) -> Vector2<f64> {
    Vector2::new(pixel.x, last(lens.height) - pixel.y)
}

/// The session with every present keypoint of some views changed.
pub(super) fn mapped(
    session: &Session,
    views: &[usize],
    change: impl Fn(&Intrinsics, Keypoint) -> Keypoint,
) -> Session {
    let mut changed = session.clone();
    for &v in views {
        let Some(View { intrinsics, frames, .. }) = changed.views.get_mut(v) else { continue };
        let keypoints = frames.iter_mut().flatten().flat_map(|detection| &mut detection.keypoints);
        keypoints.filter(|k| k.is_present()).for_each(|k| *k = change(intrinsics, *k));
    }
    changed
}

pub(super) fn moved(
    session: &Session,
    views: &[usize],
    pixel: fn(&Intrinsics, Vector2<f64>) -> Vector2<f64>,
) -> Session {
    mapped(session, views, |lens, k| k.mapped(|at| pixel(lens, at)))
}

pub(super) fn labels_exchanged(session: &Session, views: &[usize]) -> Session {
    let twins = session.mirror();
    let mut changed = session.clone();
    for &v in views {
        let Some(View { frames, .. }) = changed.views.get_mut(v) else { continue };
        for detection in frames.iter_mut().flatten() {
            *detection = detection.with_sides_exchanged(&twins);
        }
    }
    changed
}

pub(super) fn lens_changed(
    session: &Session,
    views: &[usize],
    lens: fn(&Intrinsics, usize) -> Intrinsics,
) -> Option<Session> {
    let mut changed = session.clone();
    for &v in views {
        let intrinsics = &mut changed.views.get_mut(v)?.intrinsics;
        *intrinsics = lens(intrinsics, v);
    }
    Some(changed)
}

/// A video turned by 90 degrees after its camera was calibrated.
pub(super) fn portrait(session: &Session, view: usize) -> Session {
    let mut turned = moved(session, &[view], |lens, p| Vector2::new(p.y, last(lens.width) - p.x));
    if let Some(View { intrinsics: Intrinsics { width, height, .. }, .. }) = turned.views.get_mut(view) {
        std::mem::swap(width, height);
    }
    turned
}

/// One camera shows its middle frame all the time.
pub(super) fn frozen(session: &Session) -> Option<Session> {
    let mut changed = session.clone();
    let frames = &mut changed.views.get_mut(ODD)?.frames;
    let seeing: Vec<usize> = (0..frames.len()).filter(|&f| !frames[f].is_empty()).collect();
    let shown = frames[*seeing.get(seeing.len() / 2)?].clone();
    frames.iter_mut().for_each(|frame| frame.clone_from(&shown));
    Some(changed)
}

/// Every third detection has a second one, 2 % of the person's height beside it.
pub(super) fn doubled(session: &Session) -> Session {
    let mut changed = session.clone();
    let frames = changed.views.iter_mut().flat_map(|view| &mut view.frames).enumerate();
    for (f, people) in frames.filter(|(f, _)| f % 3 == 0) {
        let seconds: Vec<Detection> = people.iter().map(|detection| beside(detection, f)).collect();
        people.extend(seconds);
    }
    changed
}

/// The detection with its keypoints moved, each in its own direction.
pub(super) fn beside(detection: &Detection, seed: usize) -> Detection {
    let heights = detection.keypoints.iter().filter(|k| k.is_present()).map(|k| k.pixel.y);
    let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), y| (low.min(y), high.max(y)));
    let moved = |(k, keypoint): (usize, &Keypoint)| {
        let (sin, cos) = (2.4 * (seed + 7 * k) as f64).sin_cos(); // the golden angle: any direction
        let by = 0.02 * (high - low) * Vector2::new(cos, sin);
        Keypoint { confidence: 0.9 * keypoint.confidence, ..keypoint.mapped(|pixel| pixel + by) }
    };
    let present = |(k, keypoint)| if Keypoint::is_present(keypoint) { moved((k, keypoint)) } else { *keypoint };
    Detection { track_id: None, keypoints: detection.keypoints.iter().enumerate().map(present).collect() }
}

/// The frames of a camera are numbered `n` too high.
pub(super) fn late(session: &Session, view: usize, n: usize) -> Option<Session> {
    let mut changed = session.clone();
    let frames = &mut changed.views.get_mut(view)?.frames;
    frames.rotate_right(n.min(session.n_frames));
    frames.iter_mut().take(n).for_each(Vec::clear);
    Some(changed)
}

/// A camera drops `n` frames halfway: what follows is numbered `n` too low.
pub(super) fn dropped(session: &Session, view: usize, n: usize) -> Option<Session> {
    let mut changed = session.clone();
    let frames = &mut changed.views.get_mut(view)?.frames;
    let halfway = frames.len() / 2;
    if halfway <= n {
        return None;
    }
    frames.drain(halfway..halfway + n);
    frames.extend(std::iter::repeat_n(Vec::new(), n));
    Some(changed)
}

/// A camera's clock is slow by `share`: its frames show later and later times, here those of the nearest frames.
pub(super) fn slowed(session: &Session, view: usize, share: f64) -> Option<Session> {
    let mut changed = session.clone();
    let frames = &mut changed.views.get_mut(view)?.frames;
    let middle = 0.5 * (frames.len() as f64 - 1.0);
    if share * middle < LEAST_DRIFT {
        return None;
    }
    let shown = |frame: usize| {
        let time = (frame as f64 + share * (frame as f64 - middle)).round();
        if time < 0.0 { None } else { session.views[view].frames.get(time as usize) }
    };
    *frames = (0..frames.len()).map(|frame| shown(frame).cloned().unwrap_or_default()).collect();
    Some(changed)
}

/// Smallest drift to either end of a take that a slow clock has here, frames: less does no harm.
const LEAST_DRIFT: f64 = 1.0;

/// Smallest difference between the focal lengths of two cameras whose files are exchanged: with equal calibrations the result is
/// right but for their names, which nothing in the files shows. Two people in ten seconds leave a focal length open to 2 to 3 %.
const OTHER_FOCAL: f64 = 0.05;

pub(super) fn exchanged(session: &Session) -> Option<Session> {
    let focal = |view: usize| session.views.get(view).map(|view| view.intrinsics.focal());
    let difference = (focal(ODD)? / focal(PARTNER)?).ln().abs();
    (difference >= OTHER_FOCAL).then(|| session.with_keypoints_exchanged(ODD, PARTNER))
}

/// The second half of the cameras shows another take: the same one backwards and half of its length later.
pub(super) fn two_takes(session: &Session) -> Option<Session> {
    let mut changed = session.clone();
    for view in changed.views.iter_mut().skip(session.views.len().div_ceil(2)) {
        view.frames.reverse();
        view.frames.rotate_right(session.n_frames / 2);
    }
    (session.views.len() >= 4).then_some(changed)
}

pub(super) fn halved(session: &Session) -> Session {
    let mut changed = session.clone();
    for View { frames, delivered, .. } in &mut changed.views {
        frames.iter_mut().skip(1).step_by(2).for_each(Vec::clear);
        delivered.retain(|FrameIndex(frame)| frame % 2 == 0);
    }
    changed
}

/// A camera turns about its vertical axis halfway through the recording.
pub(super) fn knocked(session: &Session, view: usize) -> Option<Session> {
    let turn = rotation::exp(&Vector3::new(0.0, KNOCK, 0.0));
    let mut changed = session.clone();
    let View { intrinsics, frames, .. } = changed.views.get_mut(view)?;
    let after = frames.iter_mut().skip(session.n_frames / 2).flatten();
    for keypoint in after.flat_map(|Detection { keypoints, .. }| keypoints).filter(|k| k.is_present()) {
        let ray = turn * intrinsics.normalized_from_pixel(&keypoint.pixel).push(1.0);
        keypoint.pixel = intrinsics.pixel_from_camera(&ray).unwrap_or(keypoint.pixel);
    }
    Some(changed)
}

/// A camera zooms halfway through the recording.
pub(super) fn zoomed(session: &Session, view: usize) -> Option<Session> {
    let mut changed = session.clone();
    let View { intrinsics: Intrinsics { cx, cy, .. }, frames, .. } = changed.views.get_mut(view)?;
    let centre = Vector2::new(*cx, *cy);
    let after = frames.iter_mut().skip(session.n_frames / 2).flatten();
    for keypoint in after.flat_map(|Detection { keypoints, .. }| keypoints).filter(|k| k.is_present()) {
        *keypoint = keypoint.mapped(|pixel| centre + 1.1 * (pixel - centre));
    }
    Some(changed)
}

/// The session as it is where two people and more are seen in most frames.
pub(super) fn crowded(session: &Session) -> Option<Session> {
    let n_people = |frame: usize| session.views.iter().map(|view| view.frames[frame].len()).max().unwrap_or(0);
    let n_crowded = (0..session.n_frames).filter(|&frame| n_people(frame) > 1).count();
    (2 * n_crowded > session.n_frames).then(|| session.clone())
}

/// Given poses of two cameras, each of which has that of the other.
pub(super) fn poses_exchanged(session: &Session) -> Option<Session> {
    let pose = |view: usize| session.views.get(view)?.camera_from_world;
    let (odd, partner) = (pose(ODD)?, pose(PARTNER)?);
    let mut changed = session.clone();
    changed.views[ODD].camera_from_world = Some(partner);
    changed.views[PARTNER].camera_from_world = Some(odd);
    Some(changed)
}

/// Given poses of cameras that look along -z with y up.
pub(super) fn opengl(session: &Session) -> Option<Session> {
    let flip = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
    let mut changed = session.clone();
    for view in &mut changed.views {
        let pose = view.camera_from_world.as_mut()?;
        (pose.rotation, pose.translation) = (flip * pose.rotation, flip * pose.translation);
    }
    Some(changed)
}
