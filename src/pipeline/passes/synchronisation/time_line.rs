//! The common time line: which frames of the cameras it holds, and where it begins.
//!
//! It has as many frames as the recording. Clocks that are far apart move frames beyond its ends, where they are lost. Only
//! differences between clocks matter to the solution, so that clocks which agree with each other, whatever their offsets are (a
//! clock of the day, a recorder that was started later), lose nothing.

use crate::pipeline::camera_clock::CameraClock;
use crate::pipeline::error::PipelineError;
use crate::session::reconstruction::TimeOffset;
use crate::session::{Session, View};

/// Share of a camera's frames with people that may lie beyond the ends of the time line without a word: offsets of a second or two in a
/// usual take.
const MAX_LOST: f64 = 0.1;

/// A camera many of whose frames lie beyond the ends of the time line.
pub(super) struct Loss<'s> {
    view: &'s View,
    /// As reported, s.
    offset: f64,
    /// Frames with people, and how many of them are lost.
    n_frames: usize,
    n_lost: usize,
}

/// What is subtracted from all clocks, whole frames: the median of their offsets where they lose many frames as they are. Otherwise
/// nothing, so that a camera without an offset keeps its frame numbers.
pub(super) fn common_part(session: &Session, clocks: &[CameraClock]) -> f64 {
    let loses_many = session.views.iter().zip(clocks).any(|(view, clock)| lost(view, clock).is_some());
    let mut offsets: Vec<f64> = clocks.iter().map(|clock| clock.offset).collect();
    offsets.sort_unstable_by(f64::total_cmp);
    // Of two cameras the earlier one.
    let middle = offsets.get(offsets.len().saturating_sub(1) / 2);
    middle.filter(|_| loses_many).map_or(0.0, |offset| offset.round())
}

/// Frames with people and the lost ones among them, where these are many.
fn lost(view: &View, clock: &CameraClock) -> Option<[usize; 2]> {
    let n_all = view.frames.len();
    let with_people = || (0..n_all).filter(|&frame| !view.frames[frame].is_empty());
    let n_lost = with_people().filter(|&frame| clock.common_frame(frame, n_all).is_none()).count();
    let n_frames = with_people().count();
    (n_lost as f64 > MAX_LOST * n_frames as f64).then_some([n_frames, n_lost])
}

/// Cameras many of whose frames lie beyond the ends of the time line; `offsets`: as reported, s.
pub(super) fn losses<'s>(session: &'s Session, clocks: &[CameraClock], offsets: &[TimeOffset]) -> Vec<Loss<'s>> {
    let of_view = |((view, clock), offset): ((&'s View, &CameraClock), &TimeOffset)| {
        lost(view, clock).map(|[n_frames, n_lost]| Loss { view, offset: offset.secs, n_frames, n_lost })
    };
    session.views.iter().zip(clocks).zip(offsets).filter_map(of_view).collect()
}

impl Loss<'_> {
    /// Whether the camera recorded at another time than the others.
    pub(super) fn is_of_all_frames(&self) -> bool {
        self.n_lost == self.n_frames
    }

    /// Why the recording cannot be solved with such a camera.
    pub(super) fn error(&self) -> PipelineError {
        let reason = format!(
            "camera {} recorded at another time than the other cameras: with a time offset of {:.3} s all its {} frames with people \
             lie outside of theirs; correct its time_offset_s, or leave the camera out",
            self.view.id, self.offset, self.n_frames
        );
        PipelineError::unsolvable("time_offsets_disjoint", &reason, Vec::new())
    }

    /// The reason of a warning.
    pub(super) fn sentence(&self) -> String {
        format!(
            "camera {}: with a time offset of {:.3} s {} of its {} frames with people lie before or after the recording of the other \
             cameras and are not used; correct its time_offset_s, or start all cameras together",
            self.view.id, self.offset, self.n_lost, self.n_frames
        )
    }
}

#[cfg(test)]
mod tests {
    use super::super::Timing;
    use super::*;
    use crate::session::reconstruction::{Quality, Verdict};
    use crate::simulation::{NoiseConfig, Preset, SimulationConfig, simulate};

    /// 90 frames of three cameras that see a walking person throughout, with these offsets, s.
    fn recording(offsets: [f64; 3]) -> Session {
        let preset = SimulationConfig::preset(Preset::Easy);
        let config = SimulationConfig { noise: NoiseConfig::NONE, frames: 90, views: 3, ..preset };
        let mut session = simulate(&config).unwrap().session;
        let person = session.views[0].frames.iter().flatten().next().unwrap().clone();
        for (view, offset) in session.views.iter_mut().zip(offsets) {
            view.time_offset = offset;
            for (frame, people) in view.frames.iter_mut().enumerate() {
                *people = vec![person.clone()];
                people[0].keypoints.iter_mut().for_each(|keypoint| keypoint.pixel.x += frame as f64);
            }
        }
        session
    }

    /// Half of the recording was thrown away where all cameras were 1.5 s late, and all of it where they counted 100 s.
    #[test]
    fn an_offset_of_all_cameras_threw_frames_away() {
        let right = recording([0.0; 3]);
        let frames = |session: &Session| session.views.iter().map(|view| view.frames.clone()).collect::<Vec<_>>();
        for common in [1.5, -100.0] {
            let late = recording([common; 3]);
            let timing = Timing::given(&late);
            assert_eq!(frames(&timing.applied_to(&late)), frames(&right), "{common}");
            assert!(timing.offsets.iter().all(|offset| offset.secs == common), "reported as given");
            assert!(timing.require_common_time(&late).is_ok());
        }
        let apart = recording([100.0, 100.1, 100.0]);
        let moved = Timing::given(&apart).applied_to(&apart).into_owned();
        let n_people = |view: usize| moved.views[view].frames.iter().map(Vec::len).collect::<Vec<_>>();
        assert_eq!((n_people(0), &n_people(1)[..4]), (vec![1; 90], &[0, 0, 0, 1][..]));
    }

    #[test]
    fn small_offsets_keep_the_numbers_of_frames() {
        let session = recording([0.0, 0.2, 0.2]);
        let numbers = Timing::given(&session).clocks(&session).iter().map(|clock| clock.offset).collect::<Vec<_>>();
        assert_eq!(numbers, [0.0, 0.2 * session.fps, 0.2 * session.fps]);
    }

    #[test]
    fn frames_beyond_the_time_line_were_lost_silently() {
        let warned = |offsets: [f64; 3]| {
            let session = recording(offsets);
            let mut quality = Quality { verdict: Verdict::Pass, reasons: Vec::new() };
            let timing = Timing::given(&session);
            timing.warn_of_lost_frames(&session, &mut quality);
            (quality, timing.require_common_time(&session).err().map(|error| error.to_string()))
        };
        let (quality, error) = warned([0.0, 0.0, 1.0]);
        assert!(error.is_none() && quality.verdict == Verdict::Warn && quality.reasons.len() == 1);
        assert!(quality.reasons[0].contains("time offset of 1.000 s 30 of its 90 frames"), "{}", quality.reasons[0]);
        assert_eq!(warned([0.0, 0.2, -0.2]).0.reasons, [""; 0]);
        let error = warned([0.0, 50.0, 0.0]).1.unwrap();
        assert!(error.contains("50.000 s all its 90 frames"), "{error}");
    }
}
