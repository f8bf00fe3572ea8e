//! Detections of no known person that stay at one place.

use crate::session::reconstruction::StillDetections;
use crate::session::{Detection, FrameIndex, PersonTrack, Session};
use nalgebra::Vector2;

/// Shortest time at one place, s.
const MIN_SECS: f64 = 5.0;

/// Longest time in which the detector misses it, s.
const MAX_MISSED_SECS: f64 = 1.0;

/// Smallest share of the frames in which it is detected: the detector's chance finds come and go.
const MIN_SHARE: f64 = 0.5;

/// A place at which something is detected.
struct Place<'a> {
    /// The first detection, to which all others are compared: what drifts away leaves the place.
    shown: &'a Detection,
    first: usize,
    last: usize,
    n_detections: usize,
}

/// Those of a view, in the order of their first frames.
pub(super) fn still_detections(session: &Session, tracks: &[PersonTrack], view: usize) -> Vec<StillDetections> {
    let n_keypoints = session.convention.names().len();
    let frames = |secs: f64| (secs * session.fps).round() as usize;
    let (min_frames, max_missed) = (frames(MIN_SECS), frames(MAX_MISSED_SECS).max(1));
    let (mut places, mut left): (Vec<Place>, Vec<Place>) = (Vec::new(), Vec::new());
    for (frame, people) in session.views[view].frames.iter().enumerate() {
        let assigned: Vec<usize> = tracks.iter().filter_map(|track| assigned(track, frame, view)).collect();
        for (index, detection) in people.iter().enumerate().filter(|(index, _)| !assigned.contains(index)) {
            if !detection.has_points() {
                continue;
            }
            match places
                .iter_mut()
                .find(|place| place.last < frame && place.shown.coincides_with(detection, n_keypoints))
            {
                Some(place) => (place.last, place.n_detections) = (frame, place.n_detections + 1),
                None => places.push(Place { shown: &people[index], first: frame, last: frame, n_detections: 1 }),
            }
        }
        left.extend(places.extract_if(.., |place| place.last + max_missed < frame));
    }
    left.extend(places);
    let is_still = |place: &&Place| {
        let n_frames = place.last - place.first + 1;
        n_frames >= min_frames && place.n_detections as f64 >= MIN_SHARE * n_frames as f64
    };
    let mut still: Vec<&Place> = left.iter().filter(is_still).collect();
    still.sort_by_key(|place| place.first);
    let reported = |place: &Place| StillDetections {
        n_detections: place.n_detections,
        first_frame: session.frame_number(FrameIndex(place.first)),
        last_frame: session.frame_number(FrameIndex(place.last)),
        pixel: middle(place.shown).data.0[0],
    };
    still.into_iter().map(reported).collect()
}

/// The detection of a view that shows a person in a frame.
fn assigned(track: &PersonTrack, frame: usize, view: usize) -> Option<usize> {
    track.detections.get(frame.checked_sub(track.first.0)?)?[view]
}

/// Mean of the present points, px.
fn middle(detection: &Detection) -> Vector2<f64> {
    let present: Vec<Vector2<f64>> = detection.keypoints.iter().filter(|k| k.is_present()).map(|k| k.pixel).collect();
    present.iter().sum::<Vector2<f64>>() / present.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::PersonId;
    use crate::simulation::{Preset, SimulationConfig, simulate};

    #[test]
    fn a_picture_on_the_wall_does_not_move() {
        let preset = SimulationConfig::preset(Preset::Easy);
        let mut session = simulate(&SimulationConfig { frames: 200, people: 1, ..preset }).unwrap().session;
        let detections: Vec<Vec<Option<usize>>> = (0..200)
            .map(|f| session.views.iter().map(|view| (!view.frames[f].is_empty()).then_some(0)).collect())
            .collect();
        let track = PersonTrack { person: PersonId(0), first: FrameIndex(0), detections };
        let picture = session.views[1].frames.iter().flatten().next().unwrap().clone();
        let moved = |by: f64| {
            let mut moved = picture.clone();
            moved.keypoints.iter_mut().for_each(|k| k.pixel.x += by);
            moved
        };
        for f in (20..190).filter(|f| f % 10 != 0) {
            session.views[1].frames[f].push(moved(0.5 * (f % 3) as f64)); // the detector's noise
            session.views[2].frames[f].push(moved(20.0 * f as f64)); // a passer-by
        }
        let found = |view: usize| still_detections(&session, std::slice::from_ref(&track), view);
        assert!(found(0).is_empty() && found(2).is_empty());
        let [still] = found(1).try_into().unwrap();
        let fps_frames = [still.first_frame, still.last_frame].map(|n| n - session.first_frame);
        assert_eq!((still.n_detections, fps_frames), (153, [21, 189]));
        let off = Vector2::from(still.pixel) - middle(&picture);
        assert!(off.norm() < 1.5, "{off}");
    }
}
