//! Fitting runs of frames anew where something has to change, and nothing else.
//!
//! The two frames at either end of a run stay as they are (an acceleration spans three), so that the motion goes on without
//! a seam.

use super::contacts::Contacts;
use super::evidence::Evidence;
use super::motion_problem::{DataTerm, MotionProblem, MotionState, Shape};
use super::solve::Stages;
use crate::progress::Canceled;
use std::ops::Range;

/// Time on either side in which the motion may prepare for a change, s.
const APPROACH_SECS: f64 = 0.5;
/// Frames at either end of a run that stay.
const HELD: usize = 2;

impl Stages<'_> {
    /// The runs about the frames that ask for a change.
    pub(super) fn runs(&self, asks: impl Iterator<Item = bool>) -> Vec<Range<usize>> {
        let approach = (APPROACH_SECS / self.frame_interval).round() as usize;
        runs(&asks.collect::<Vec<_>>(), approach.max(HELD + 1), self.config.window_frames)
    }

    /// A motion with its runs fitted anew to pixels and with other people in the way, shape held, `steps` steps each. Where
    /// that strays too far from the motion `seen`, fitted to nothing but what was seen, a run stays.
    pub(super) fn refitted(
        &self,
        evidence: &Evidence,
        seen: &MotionState,
        mut state: MotionState,
        runs: Vec<Range<usize>>,
        steps: usize,
        contacts: Contacts,
    ) -> Result<MotionState, Canceled> {
        for run in runs {
            let (evidence, contacts) = (evidence.slice(run.clone()), contacts.slice(run.clone()));
            let start = MotionState { betas: state.betas, poses: state.poses[run.clone()].to_vec() };
            let data = DataTerm::Pixels { share: self.pixel_share(&evidence, &start) };
            let held = held_frames(&run, state.poses.len());
            let problem =
                MotionProblem::new(self.model, &evidence, self.config, data, Shape::Held, self.frame_interval)
                    .paced_by(&start)
                    .with_contacts(contacts)
                    .holding(&held);
            let as_seen = MotionState { betas: seen.betas, poses: seen.poses[run.clone()].to_vec() };
            let alone = problem.cost_alone(&as_seen);
            let moved = self.minimised(&problem, start, steps)?.state;
            let touching = contacts.n_touching() as f64 * problem.time_weight();
            if !self.is_refuted(problem.cost_alone(&moved) - alone, touching) {
                state.poses[run].copy_from_slice(&moved.poses);
            }
        }
        Ok(state)
    }

    /// Whether what was seen and how people move stand against giving way: by much in every frame of the contact, and in
    /// sum by more than errors that are alike for some ten frames could; `touching`: frames of the contact as the cost
    /// counts them.
    fn is_refuted(&self, dearer: f64, touching: f64) -> bool {
        let [of_frame, in_sum] = self.config.contact_refuted;
        dearer > in_sum && dearer > of_frame * touching
    }
}

/// Runs about the frames that ask, `approach` frames longer at either end, none longer than `longest`: one that is cut
/// overlaps the next by `approach`.
fn runs(asks: &[bool], approach: usize, longest: usize) -> Vec<Range<usize>> {
    let mut whole: Vec<Range<usize>> = Vec::new();
    for t in (0..asks.len()).filter(|&t| asks[t]) {
        let (start, end) = (t.saturating_sub(approach), (t + approach + 1).min(asks.len()));
        match whole.last_mut() {
            Some(last) if start <= last.end => last.end = end,
            _ => whole.push(start..end),
        }
    }
    let longest = longest.max(2 * approach + 1);
    let cut = |run: Range<usize>| {
        let starts = run.clone().step_by(longest - approach);
        let starts = starts.take_while(|start| *start == run.start || start + approach < run.end);
        starts.map(|start| start..(start + longest).min(run.end)).collect::<Vec<_>>()
    };
    whole.into_iter().flat_map(cut).collect()
}

/// The ends of a run, counted from its beginning, where the motion goes on beyond them.
fn held_frames(run: &Range<usize>, n_frames: usize) -> Vec<usize> {
    let before = if run.start == 0 { 0 } else { HELD };
    let after = if run.end == n_frames { run.len() } else { run.len().saturating_sub(HELD) };
    (0..before.min(run.len())).chain(after..run.len()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_cover_every_frame_that_asks_and_long_ones_overlap() {
        let mut asks = vec![false; 1000];
        asks[10] = true;
        asks[300..900].fill(true);
        let found = runs(&asks, 15, 100);
        assert_eq!(found[0], 0..26);
        assert_eq!((found[1].clone(), found.last().unwrap().end), (285..385, 915));
        assert!(found[1..].windows(2).all(|w| w[1].start + 15 == w[0].end), "{found:?}");
        assert!(found.iter().all(|run| run.len() <= 100));
        assert!(runs(&[false; 5], 15, 100).is_empty());
    }

    #[test]
    fn a_run_holds_its_ends_but_not_those_of_the_take() {
        assert_eq!(held_frames(&(0..26), 1000), vec![24, 25]);
        assert_eq!(held_frames(&(974..1000), 1000), vec![0, 1]);
        assert_eq!(held_frames(&(0..3), 3), Vec::<usize>::new());
    }
}
