//! Retiming: moves a recording by its cameras' clocks to what synchronous cameras would have seen.

use crate::body::human_speeds::{RUN_M_S, THROWN_HAND_M_S};
use crate::matching::assignment::assign;
use crate::matching::normalized::{BODY_SPAN_M, NormalizedDetection, NormalizedView, normalized_views};
use crate::matching::tracklets::step_distance;
use crate::pipeline::camera_clock::CameraClock;
use crate::session::{Detection, FrameIndex, Keypoint, Session, View};
use nalgebra::Vector2;

/// Detector noise as a share of the apparent size: three times the 1 to 2 % of OpenPose and COCO detectors.
const NOISE: f64 = 0.05;

/// Moves every view by its clock.
///
/// The whole part moves detections to another frame; their index in the frame is kept. The fractional part moves keypoints
/// along a straight line towards the same person in the neighbouring frame, or if the person is not detected there away
/// from the neighbour on the other side; without both they stay. Frames beyond the ends of the time line are dropped.
pub fn retimed(session: &Session, clocks: &[CameraClock]) -> Session {
    let rays = normalized_views(session);
    let views = session.views.iter().zip(&rays).zip(clocks);
    let views = views.map(|((view, rays), clock)| retimed_view(view, rays, session.fps, clock)).collect();
    let (name, start_timecode) = (session.name.clone(), session.start_timecode.clone());
    Session { name, start_timecode, dense: session.dense.clone(), views, ..*session }
}

fn retimed_view(view: &View, rays: &NormalizedView, fps: f64, clock: &CameraClock) -> View {
    let moved = moved_by(view, rays, fps, clock);
    let n_frames = view.frames.len();
    let target = |frame: usize| clock.common_frame(frame, n_frames);
    let mut frames = vec![Vec::new(); n_frames];
    for (frame, people) in moved.into_iter().enumerate() {
        if let Some(target) = target(frame) {
            frames[target] = people;
        }
    }
    let delivered = view.delivered.iter().filter_map(|frame| target(frame.0)).map(FrameIndex).collect();
    View { id: view.id.clone(), time_offset: 0.0, frames, delivered, ..*view }
}

/// Detections of a camera, moved by the fraction of a frame (at most half) that its clock leaves.
fn moved_by(view: &View, rays: &NormalizedView, fps: f64, clock: &CameraClock) -> Vec<Vec<Detection>> {
    let mut frames = view.frames.clone();
    let n_frames = frames.len();
    for (frame, people) in frames.iter_mut().enumerate() {
        let offset = clock.offset_at(frame, n_frames);
        let rest = offset - offset.round();
        if rest == 0.0 {
            continue;
        }
        let now = &rays.frames[frame];
        let (before, after) = (frame.checked_sub(1), Some(frame + 1).filter(|next| *next < view.frames.len()));
        let (near, far) = if rest > 0.0 { (before, after) } else { (after, before) };
        let neighbours = |other: Option<usize>| -> Vec<Option<&Detection>> {
            let Some(other) = other else { return vec![None; now.len()] };
            let same = same_people(now, &rays.frames[other], fps);
            same.into_iter().map(|place| place.map(|d| &view.frames[other][d])).collect()
        };
        let (near, far) = (neighbours(near), neighbours(far));
        for (d, person) in people.iter_mut().enumerate() {
            let reach = now[d].size * rays.focal * (NOISE + THROWN_HAND_M_S / BODY_SPAN_M / fps);
            for (k, point) in person.keypoints.iter_mut().enumerate() {
                let step = |other: Option<&Detection>| step_to(point, &other?.keypoints[k], reach);
                let towards = step(near[d]).or_else(|| step(far[d]).map(|back| -back));
                point.pixel += towards.unwrap_or_else(Vector2::zeros) * rest.abs();
            }
        }
    }
    frames
}

/// Smallest number of keypoints that two detections share.
const MIN_SHARED: usize = 4;

/// Matches the detections of one frame with those of a neighbouring frame.
///
/// Why not tracklets: they end where a whole path is ambiguous, and a person that is not followed is not moved, which biases
/// the offset towards its current value.
fn same_people(now: &[NormalizedDetection], then: &[NormalizedDetection], fps: f64) -> Vec<Option<usize>> {
    let gate = NOISE + RUN_M_S / BODY_SPAN_M / fps;
    assign(now.len(), then.len(), 1.0, |i, j| {
        step_distance(&now[i], &then[j], MIN_SHARED).map_or(2.0, |distance| distance / gate)
    })
}

fn step_to(point: &Keypoint, other: &Keypoint, reach: f64) -> Option<Vector2<f64>> {
    let step = other.pixel - point.pixel;
    (point.is_present() && other.is_present() && step.norm() <= reach).then_some(step)
}

/// Moves what is known of a synchronous recording's detections (`[frame][detection]`) to the camera's frame numbers; `beyond`: of a
/// detection that lies beyond the time line, by its index in the frame.
pub fn as_recorded<T: Clone>(
    view: &View,
    synchronous: &[Vec<T>],
    clock: &CameraClock,
    beyond: impl Fn(usize) -> T,
) -> Vec<Vec<T>> {
    let of_frame = |(frame, people): (usize, &Vec<Detection>)| {
        let found = clock.common_frame(frame, synchronous.len()).map(|target| synchronous[target].clone());
        let found = found.filter(|found| found.len() == people.len());
        found.unwrap_or_else(|| (0..people.len()).map(&beyond).collect())
    };
    view.frames.iter().enumerate().map(of_frame).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::hand::Side;
    use crate::session::PersonId;
    use crate::session::reconstruction::HandPlace;
    use crate::simulation::{NoiseConfig, Preset, SimulationConfig, simulate};

    /// A scene recorded with these offsets and without noise, so that positions are exact to 0.01 px.
    fn recorded(offsets: &[f64]) -> Session {
        let config = SimulationConfig {
            noise: NoiseConfig::NONE,
            frames: 60,
            views: 2,
            time_offsets: offsets.to_vec(),
            ..SimulationConfig::preset(Preset::Easy)
        };
        simulate(&config).unwrap().session
    }

    #[test]
    fn retimed_recording_matches_synchronous_cameras() {
        let (synchronous, offsets) = (recorded(&[]), [3.0, -2.6]);
        let moved = retimed(&recorded(&offsets), &offsets.map(CameraClock::shifted));
        let (mut n, mut worst, mut worst_unmoved) = (0, 0.0_f64, 0.0_f64);
        let late = retimed(&recorded(&offsets), &[3.0, -3.0].map(CameraClock::shifted));
        for frame in 8..50 {
            for (view, (a, b)) in synchronous.views.iter().zip(&moved.views).enumerate() {
                for person in &a.frames[frame] {
                    let of = |people: &[Detection]| people.iter().find(|p| p.track_id == person.track_id).cloned();
                    let (Some(found), Some(left)) = (of(&b.frames[frame]), of(&late.views[view].frames[frame])) else {
                        continue;
                    };
                    for (k, point) in person.keypoints.iter().enumerate().filter(|(_, k)| k.is_present()) {
                        let off = |other: &Detection| (other.keypoints[k].pixel - point.pixel).norm();
                        worst = worst.max(off(&found));
                        worst_unmoved = worst_unmoved.max(off(&left));
                        n += 1;
                    }
                }
            }
        }
        // A landing foot turns within a frame: the straight line is off by an eighth of its step.
        assert!(n > 2000 && worst < 4.0 && worst_unmoved > 2.0 * worst, "{n} points, {worst} px, {worst_unmoved} px");
    }

    #[test]
    fn identities_return_to_the_recorded_frames() {
        let session = recorded(&[4.0]);
        let clocks = [4.0, 0.0].map(CameraClock::shifted);
        let moved = retimed(&session, &clocks);
        let numbered = |people: &Vec<Detection>| (0..people.len()).map(|i| Some(PersonId(i))).collect::<Vec<_>>();
        let synchronous: Vec<_> = moved.views[0].frames.iter().map(numbered).collect();
        let recorded = as_recorded(&session.views[0], &synchronous, &clocks[0], |_| None);
        for (frame, people) in session.views[0].frames.iter().enumerate() {
            let is_lost = frame + 4 >= session.n_frames;
            let expected = if is_lost { vec![None; people.len()] } else { numbered(people) };
            assert_eq!(recorded[frame], expected, "frame {frame}");
        }
    }

    /// Where hands are shown stayed at the frames of the time line.
    #[test]
    fn hands_stayed_at_frames_of_the_time_line() {
        let session = recorded(&[4.0]);
        let view = &session.views[0];
        let own = |detection: usize| Side::BOTH.map(|side| (detection, side));
        let exchanged = |detection: usize| [(detection, Side::Right), (detection, Side::Left)];
        let mut synchronous: Vec<Vec<[HandPlace; 2]>> = retimed(&session, &[4.0, 0.0].map(CameraClock::shifted)).views
            [0]
        .frames
        .iter()
        .map(|people| (0..people.len()).map(own).collect())
        .collect();
        synchronous[30].iter_mut().enumerate().for_each(|(detection, hands)| *hands = exchanged(detection));
        let recorded = as_recorded(view, &synchronous, &CameraClock::shifted(4.0), own);
        for (frame, hands) in recorded.iter().enumerate() {
            assert_eq!(hands.len(), view.frames[frame].len());
            let expected = |detection: usize| if frame == 26 { exchanged(detection) } else { own(detection) };
            assert!(hands.iter().enumerate().all(|(d, hands)| *hands == expected(d)), "frame {frame}");
        }
        assert!(!recorded[26].is_empty());
    }
}
