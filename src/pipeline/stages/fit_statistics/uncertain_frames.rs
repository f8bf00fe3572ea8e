//! Stretches of frames in which a person's joints are uncertain.

use crate::optim::robust::median;
use crate::session::people::JointSigmas;
use crate::session::reconstruction::UncertainFrames;
use crate::session::{BodyMotion, FrameIndex, PersonTrack, Session};
use std::ops::Range;

/// Shortest stretch, s: in less, no frame is farther than a quarter of a second from one that cameras show well. Of 30 stretches of some
/// 0.9 s in which one camera alone showed a person, 7 had joints more than 150 mm off.
const MIN_SECS: f64 = 0.5;

/// The stretches of one person, ascending. Frames that are not valid say so themselves and are left out.
pub fn uncertain_frames(session: &Session, track: &PersonTrack, motion: &BodyMotion) -> Vec<UncertainFrames> {
    let Some(sigmas) = &motion.joint_sigmas else { return Vec::new() };
    let typical_mm = |sigmas: &JointSigmas| 1e3 * median(&mut sigmas.to_vec()).unwrap_or(0.0);
    let typical_mm: Vec<f64> = sigmas.iter().map(typical_mm).collect();
    let is_uncertain = |t: usize| motion.frames[t].valid && typical_mm[t] > UncertainFrames::BOUND_MM;
    let min_frames = (MIN_SECS * session.fps).ceil() as usize;
    let described = |frames: Range<usize>| {
        let number = |t: usize| session.frame_number(FrameIndex(motion.first.0 + t));
        let shows = |view: &usize| {
            let n_shown = track.detections[frames.clone()].iter().filter(|assigned| assigned[*view].is_some()).count();
            2 * n_shown > frames.len()
        };
        UncertainFrames {
            first_frame: number(frames.start),
            last_frame: number(frames.end - 1),
            joint_sigma_mm: median(&mut typical_mm[frames.clone()].to_vec()).unwrap_or(0.0),
            cameras: (0..session.views.len()).filter(shows).map(|view| session.views[view].id.clone()).collect(),
        }
    };
    runs(sigmas.len(), is_uncertain).into_iter().filter(|run| run.len() >= min_frames).map(described).collect()
}

/// The longest ranges in `0..n` of numbers that are all `wanted`.
fn runs(n: usize, wanted: impl Fn(usize) -> bool) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for t in (0..n).filter(|&t| wanted(t)) {
        match runs.last_mut() {
            Some(run) if run.end == t => run.end = t + 1,
            _ => runs.push(t..t + 1),
        }
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_are_the_longest_ranges() {
        let wanted = [true, true, false, true, false, false, true];
        assert_eq!(runs(7, |t| wanted[t]), [0..2, 3..4, 6..7]);
        assert!(runs(0, |_| true).is_empty());
    }
}
