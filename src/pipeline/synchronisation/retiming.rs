//! A recording moved in time: what synchronous cameras would have seen.

use crate::matching::sightings::{BODY_SPAN_M, ViewSightings, sightings};
use crate::matching::tracklets::{TrackletConfig, tracklets};
use crate::session::{Detection, FrameIndex, Keypoint, PersonId, Session, View};
use nalgebra::Vector2;

/// A hand in a throw, m/s: a point that seems faster is another point, and not followed.
const MAX_SPEED: f64 = 10.0;

/// Detector noise, as a share of the apparent size: three times the 1 to 2 % seen on OpenPose and COCO detectors.
const NOISE: f64 = 0.05;

/// The recording as cameras without offsets would have made it; `offsets`: frames per view.
///
/// Every detection stays in its place in the list of its frame. By whole frames it goes to another frame, by the rest its
/// points go along a straight line to where they are in the neighbouring frame; where the person is not seen there, along
/// the line to the neighbour on the other side; where there is none, they stay. Frames that fall off the time line are lost.
pub(super) fn retimed(session: &Session, offsets: &[f64]) -> Session {
    let rays = sightings(session);
    let views = session.views.iter().zip(&rays).zip(offsets);
    let views = views.map(|((view, rays), &offset)| retimed_view(view, rays, session.fps, offset)).collect();
    Session { views, ..without_views(session) }
}

fn without_views(session: &Session) -> Session {
    Session { name: session.name.clone(), start_timecode: session.start_timecode.clone(), views: Vec::new(), ..*session }
}

fn retimed_view(view: &View, rays: &ViewSightings, fps: f64, offset: f64) -> View {
    let whole = offset.round();
    let moved = moved_by(view, rays, fps, offset - whole);
    let n_frames = view.frames.len();
    let target = |frame: usize| shifted(frame, whole, n_frames);
    let mut frames = vec![Vec::new(); n_frames];
    for (frame, people) in moved.into_iter().enumerate() {
        if let Some(target) = target(frame) {
            frames[target] = people;
        }
    }
    let delivered = view.delivered.iter().filter_map(|frame| target(frame.0)).map(FrameIndex).collect();
    View { id: view.id.clone(), time_offset: 0.0, frames, delivered, ..*view }
}

/// Where a camera's frame lies on the common time line, to the nearest frame.
fn shifted(frame: usize, whole: f64, n_frames: usize) -> Option<usize> {
    let target = frame as f64 + whole;
    (0.0..n_frames as f64).contains(&target).then_some(target as usize)
}

/// Detections of a camera whose frames are `rest` frames late (at most half of one), as they were in time.
fn moved_by(view: &View, rays: &ViewSightings, fps: f64, rest: f64) -> Vec<Vec<Detection>> {
    let mut frames = view.frames.clone();
    if rest == 0.0 {
        return frames;
    }
    for tracklet in tracklets(rays, fps, &TrackletConfig::default()) {
        for (i, &(frame, detection)) in tracklet.sightings.iter().enumerate() {
            let neighbour = |j: Option<usize>| {
                let &(other, d) = tracklet.sightings.get(j?)?;
                (other.abs_diff(frame) == 1).then(|| &view.frames[other][d])
            };
            let (before, after) = (neighbour(i.checked_sub(1)), neighbour(Some(i + 1)));
            let (near, far) = if rest > 0.0 { (before, after) } else { (after, before) };
            let size_px = rays.frames[frame][detection].size * rays.focal;
            let reach = size_px * (NOISE + MAX_SPEED / BODY_SPAN_M / fps);
            for (k, point) in frames[frame][detection].keypoints.iter_mut().enumerate() {
                let step = |other: Option<&Detection>| step_to(point, &other?.keypoints[k], reach);
                let towards = step(near).or_else(|| step(far).map(|back| -back));
                point.pixel += towards.unwrap_or_else(Vector2::zeros) * rest.abs();
            }
        }
    }
    frames
}

fn step_to(point: &Keypoint, other: &Keypoint, reach: f64) -> Option<Vector2<f64>> {
    let step = other.pixel - point.pixel;
    (point.is_present() && other.is_present() && step.norm() <= reach).then_some(step)
}

/// What is known of a synchronous recording's detections (`[frame][detection]`), in the frames as the camera numbers them.
pub(super) fn as_recorded(
    view: &View,
    synchronous: Vec<Vec<Option<PersonId>>>,
    offset: f64,
) -> Vec<Vec<Option<PersonId>>> {
    let of_frame = |(frame, people): (usize, &Vec<Detection>)| {
        let found = shifted(frame, offset.round(), synchronous.len()).map(|target| synchronous[target].clone());
        // What fell off the time line is nobody's.
        found.filter(|found| found.len() == people.len()).unwrap_or_else(|| vec![None; people.len()])
    };
    view.frames.iter().enumerate().map(of_frame).collect()
}
