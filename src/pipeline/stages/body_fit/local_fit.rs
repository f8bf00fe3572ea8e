//! Fitting runs of frames of a motion again, where other persons' bodies overlap.
//!
//! The two frames at either end of a run are held (an acceleration spans three), so that the motion continues without a
//! seam.

use super::completed_joints::GapCompletion;
use super::context::FitContext;
use super::gap_completion::{Purpose, completed_gaps};
use super::minimisation::{Budget, DAMPING_FROM_FIT, minimised};
use super::objective::Objective;
use super::observations::Observations;
use super::pixel_residuals::DetectedPixels;
use super::single_camera::SingleCamera;
use super::terms::collision::{CollisionTerm, Collisions};
use super::terms::unknowns::{MotionState, Shape};
use crate::optim::block_banded::BlockBanded;
use crate::progress::Canceled;
use rayon::prelude::*;
use std::ops::Range;

/// Time on either side of a change over which the motion may adapt, s.
const APPROACH_SECS: f64 = 0.5;
/// Frames held at either end of a run.
const HELD: usize = 2;

/// The runs around the frames that need a change.
pub(super) fn runs_around(context: &FitContext, needs_change: Vec<bool>) -> Vec<Range<usize>> {
    let approach = (APPROACH_SECS / context.frame_interval).round() as usize;
    runs(&needs_change, approach.max(HELD + 1), context.window_frames())
}

/// A motion with its runs fitted again to pixels and against collisions, shape held, `steps` steps each. A run stays as it is
/// where this raises the other terms too much over those of `before`, the motion fitted without collisions.
pub(super) fn refitted(
    context: &FitContext,
    observations: &Observations,
    before: &MotionState,
    mut state: MotionState,
    runs: Vec<Range<usize>>,
    steps: usize,
    collisions: Collisions,
) -> Result<MotionState, Canceled> {
    // Runs that overlap follow each other, all others are independent.
    let chains: Vec<&[Range<usize>]> = runs.chunk_by(|run, next| next.start < run.end).collect();
    let of_chain = |chain: &&[Range<usize>]| -> Result<MotionState, Canceled> {
        let mut system = context.systems.take();
        let first = chain[0].start;
        let whole = first..chain[chain.len() - 1].end;
        let unseen = Unseen::around(context, observations, &state, &whole);
        let mut refitted = state.of(&whole);
        for run in chain.iter() {
            let own = run.start - first..run.end - first;
            let data = Run {
                observations: &observations.slice(run.clone()),
                collisions: collisions.slice(run.clone()),
                unseen: unseen.of(run),
                held: held_frames(run, state.poses.len()),
            };
            let states = [before.of(run), refitted.of(&own)];
            if let Some(moved) = fitted_run(context, &data, &states, steps, &mut system)? {
                refitted.poses[own].copy_from_slice(&moved.poses);
            }
        }
        context.systems.put_back([system]);
        Ok(refitted)
    };
    let of_chains: Vec<MotionState> = chains.par_iter().map(of_chain).collect::<Result<_, Canceled>>()?;
    for (chain, refitted) in chains.iter().zip(of_chains) {
        let first = chain[0].start;
        state.poses[first..first + refitted.poses.len()].copy_from_slice(&refitted.poses);
    }
    Ok(state)
}

/// What a run is fitted to.
struct Run<'a> {
    observations: &'a Observations,
    collisions: Collisions<'a>,
    unseen: Unseen,
    /// Frames that stay.
    held: Vec<usize>,
}

/// What less than two cameras show, as the last fit had it: near other people limbs are hidden by these.
struct Unseen {
    /// The frames of the track that it is about.
    frames: Range<usize>,
    completion: Option<GapCompletion>,
    is_open: Vec<bool>,
}

impl Unseen {
    /// In a run and its surroundings.
    fn around(context: &FitContext, observations: &Observations, state: &MotionState, run: &Range<usize>) -> Self {
        let frames = context.with_halo(run, state.poses.len());
        let observations = observations.slice(frames.clone());
        let alone = SingleCamera::new(context.model, &observations, context.frame_interval);
        let completed = || completed_gaps(context, &observations, &alone, &state.of(&frames), Purpose::FromGood);
        let completion = context.config.completes_gaps.then(completed).flatten();
        Self { is_open: alone.open_frames(), completion, frames }
    }

    /// In some of the frames.
    fn of(&self, run: &Range<usize>) -> Self {
        let own = run.start - self.frames.start..run.end - self.frames.start;
        let completion = self.completion.as_ref().map(|completion| completion.of(own.clone()));
        Self { frames: run.clone(), completion, is_open: self.is_open[own].to_vec() }
    }
}

/// A run fitted from `start`, in the memory of `system`; `None` where the observations rule it out.
fn fitted_run(
    context: &FitContext,
    Run { observations, collisions, unseen, held }: &Run,
    [before, start]: &[MotionState; 2],
    steps: usize,
    system: &mut BlockBanded,
) -> Result<Option<MotionState>, Canceled> {
    let pixels = DetectedPixels::new(context, observations, start);
    let extra_joints: Vec<usize> = collisions.joints().into_iter().collect();
    let mut problem = Objective {
        speeds: Some(start),
        completion: unseen.completion.as_ref(),
        is_open: &unseen.is_open,
        extra_joints: &extra_joints,
        held,
        ..Objective::new(context, context.config, observations, pixels.source(), Shape::Held)
    }
    .problem();
    let cost_before = problem.cost(before);
    problem.frame_terms.push(Box::new(CollisionTerm::new(*collisions, &problem.unknowns)));
    let min_decrease = context.config.min_decrease;
    let budget = Budget { max_iterations: steps, min_decrease, damping: DAMPING_FROM_FIT };
    let moved = minimised(context, &problem, start.clone(), budget, system)?.state;
    problem.frame_terms.pop();
    let increase = problem.cost(&moved) - cost_before;
    let n_frames = collisions.n_frames_with_overlap() as f64 * problem.time_weight;
    Ok((!is_rejected(context, increase, n_frames)).then_some(moved))
}

/// Whether the other terms rule out a resolution that raises their cost by `increase`: by much in every frame of the
/// collision, and in sum by more than errors that are alike for some ten frames could. `n_frames`: frames of the collision as
/// the cost counts them.
fn is_rejected(context: &FitContext, increase: f64, n_frames: f64) -> bool {
    let [per_frame, in_sum] = context.config.max_resolution_cost;
    increase > in_sum && increase > per_frame * n_frames
}

/// Runs around the frames that need a change, `approach` frames longer at either end, none longer than `longest`: one that is
/// cut overlaps the next by `approach`.
fn runs(needs_change: &[bool], approach: usize, longest: usize) -> Vec<Range<usize>> {
    let mut whole: Vec<Range<usize>> = Vec::new();
    for t in (0..needs_change.len()).filter(|&t| needs_change[t]) {
        let (start, end) = (t.saturating_sub(approach), (t + approach + 1).min(needs_change.len()));
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

/// The ends of a run, counted from its beginning, where the motion continues beyond them.
fn held_frames(run: &Range<usize>, n_frames: usize) -> Vec<usize> {
    let before = if run.start == 0 { 0 } else { HELD };
    let after = if run.end == n_frames { run.len() } else { run.len().saturating_sub(HELD) };
    (0..before.min(run.len())).chain(after..run.len()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_cover_all_changes_and_long_ones_overlap() {
        let mut needs_change = vec![false; 1000];
        needs_change[10] = true;
        needs_change[300..900].fill(true);
        let found = runs(&needs_change, 15, 100);
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
