//! Time offsets in whole frames: two cameras agree best on a relative pose when their frames are paired correctly.
//!
//! Each offset of a pair is scored by a small search for a relative pose that the paired tracklets support (the same
//! hypotheses and score as for synchronous cameras): first on a coarse grid, then frame by frame around its best offsets.
//! Single pairs may be wrong; the sum over all pairs decides.

use crate::geometry::Rigid;
use crate::matching::normalized::NormalizedView;
use crate::matching::pair_hypotheses::{CameraPair, HypothesisConfig, mix, pair_hypotheses};
use crate::matching::pair_score::{PairObservations, score_pair};
use crate::matching::tracklets::Tracklet;
use crate::pipeline::capture::Capture;
use crate::progress::{Canceled, Progress};
use rayon::prelude::*;

/// Largest offset between two cameras, s: half as much from a common time either way. Texts of `unsolvable` name it.
const MAX_OFFSET_SECS: f64 = 1.25;

/// Spacing of the coarse grid, s: in that time people move by less than the tolerance of the score.
const STEP_SECS: f64 = 0.1;

/// Number of grid offsets refined frame by frame.
const N_PEAKS: usize = 3;

/// Number of frames on which an offset is scored.
const N_JUDGED: usize = 48;

/// Each view is compared with at most this many next views: enough to reconcile, and linear in the number of views.
const N_NEIGHBOURS: usize = 4;

/// A tenth of the work of the search for synchronous cameras: neighbouring offsets and other pairs confirm an offset.
fn hypotheses_of_one_offset() -> HypothesisConfig {
    HypothesisConfig {
        n_tracklets: 4,
        max_points: 100,
        iterations: [20, 60],
        n_singles: 6,
        n_unions: [6, 3],
        n_refits: 4,
        n_kept: 1,
        ..HypothesisConfig::default()
    }
}

/// Offsets reconciled over all pairs.
#[derive(Debug, Clone, PartialEq)]
pub struct WholeOffsets {
    /// Frames, per view; 0 for the first, and for views without evidence.
    pub offsets: Vec<i64>,
    /// Number of pairs of views compared.
    pub n_pairs: usize,
    /// Mean quality of the pairs at these offsets, 0 to 1.
    pub agreement: f64,
}

/// Scores of two views at every offset of the second against the first.
struct PairScores {
    views: [usize; 2],
    /// Index 0 is the offset `-range`.
    scores: Vec<f64>,
}

impl PairScores {
    fn at(&self, offset: i64) -> f64 {
        let index = usize::try_from(offset + (self.scores.len() / 2) as i64);
        index.ok().and_then(|i| self.scores.get(i)).copied().unwrap_or(0.0)
    }
}

/// Estimates the offsets.
pub fn whole_offsets(capture: &Capture, progress: &Progress) -> Result<WholeOffsets, Canceled> {
    let (fps, n_views) = (capture.session.fps, capture.views.len());
    let followed = capture.tracklets();
    // At least half of the recording is in common.
    let range = ((MAX_OFFSET_SECS * fps).round() as i64).min(capture.session.n_frames as i64 / 2);
    let step = ((STEP_SECS * fps).round() as i64).max(1);
    let near = |a: usize, b: usize| b - a <= N_NEIGHBOURS || a + n_views - b <= N_NEIGHBOURS;
    let pairs: Vec<[usize; 2]> =
        (0..n_views).flat_map(|b| (0..b).map(move |a| [a, b])).filter(|[a, b]| near(*a, *b)).collect();
    let scored: Vec<PairScores> = pairs
        .par_iter()
        .map(|&views| {
            let scores = pair_scores(range, step, |offset| {
                progress.check().map(|()| quality(capture, &followed, views, offset))
            })?;
            Ok(PairScores { views, scores })
        })
        .collect::<Result<_, Canceled>>()?;
    let offsets = reconciled(n_views, range, &scored);
    let agreed: f64 = scored.iter().map(|pair| pair.at(relative(pair, &offsets))).sum();
    Ok(WholeOffsets { offsets, n_pairs: scored.len(), agreement: agreed / scored.len().max(1) as f64 })
}

/// Scores of every offset in `-range..=range`: computed on a grid and around its best offsets, interpolated in between.
fn pair_scores(range: i64, step: i64, score: impl Fn(i64) -> Result<f64, Canceled>) -> Result<Vec<f64>, Canceled> {
    let index = |offset: i64| (offset + range) as usize;
    let mut known: Vec<Option<f64>> = vec![None; 2 * range as usize + 1];
    let grid: Vec<i64> = (0..=range / step).flat_map(|i| [i * step, -i * step]).chain([range, -range]).collect();
    for &offset in &grid {
        if known[index(offset)].is_none() {
            known[index(offset)] = Some(score(offset)?);
        }
    }
    let mut best: Vec<i64> = (-range..=range).filter(|&offset| known[index(offset)].is_some()).collect();
    best.sort_by(|&a, &b| known[index(b)].unwrap_or(0.0).total_cmp(&known[index(a)].unwrap_or(0.0)).then(a.cmp(&b)));
    for &peak in best.iter().take(N_PEAKS) {
        for offset in (peak - step + 1).max(-range)..=(peak + step - 1).min(range) {
            if known[index(offset)].is_none() {
                known[index(offset)] = Some(score(offset)?);
            }
        }
    }
    Ok(interpolated(&known))
}

/// Unknown values on the straight line between their known neighbours.
fn interpolated(known: &[Option<f64>]) -> Vec<f64> {
    let at = |i: usize| known[i].map(|value| (i, value));
    let value = |i: usize| match ((0..=i).rev().find_map(at), (i..known.len()).find_map(at)) {
        (Some((a, x)), Some((b, y))) if b > a => x + (y - x) * (i - a) as f64 / (b - a) as f64,
        (Some((_, x)), _) | (None, Some((_, x))) => x,
        (None, None) => 0.0,
    };
    (0..known.len()).map(value).collect()
}

/// Score of a pair if frame `n` of the second view was taken with frame `n + offset` of the first, 0 to 1.
fn quality(capture: &Capture, followed: &[Vec<Tracklet>], [a, b]: [usize; 2], offset: i64) -> f64 {
    let first = &capture.views[a];
    let second = shifted_view(&capture.views[b], offset);
    let useful: Vec<usize> =
        (0..first.frames.len()).filter(|&f| !first.frames[f].is_empty() && !second.frames[f].is_empty()).collect();
    let n = useful.len().min(N_JUDGED);
    let frames: Vec<usize> = (0..n).map(|i| useful[i * useful.len() / n]).collect();
    let observations = PairObservations::new(first, &second, &frames, &capture.bones);
    if let Some(second_from_first) = known_pose(capture, [a, b]) {
        return score_pair(&observations, &second_from_first).quality;
    }
    let n_frames = first.frames.len();
    let tracklets: Vec<Tracklet> = followed[b].iter().filter_map(|t| shifted_tracklet(t, offset, n_frames)).collect();
    let pair = CameraPair { views: [first, &second], tracklets: [&followed[a], &tracklets], observations };
    let item = ((a * capture.views.len() + b) as u64) << 32 | offset.unsigned_abs() << 1 | u64::from(offset < 0);
    let hypotheses = pair_hypotheses(&pair, mix(capture.options.seed, item), &hypotheses_of_one_offset());
    hypotheses.first().map_or(0.0, |hypothesis| hypothesis.score.quality)
}

fn known_pose(capture: &Capture, [a, b]: [usize; 2]) -> Option<Rigid> {
    let pose = |v: usize| capture.session.views[v].camera_from_world;
    if capture.estimates_extrinsics() { None } else { Some(pose(b)? * pose(a)?.inverse()) }
}

fn shifted_view(view: &NormalizedView, offset: i64) -> NormalizedView {
    let source = |f: usize| usize::try_from(f as i64 - offset).ok().and_then(|f| view.frames.get(f));
    let frames = (0..view.frames.len()).map(|f| source(f).cloned().unwrap_or_default()).collect();
    NormalizedView { focal: view.focal, frames }
}

/// `None` where the whole tracklet lies beyond the time line.
fn shifted_tracklet(tracklet: &Tracklet, offset: i64, n_frames: usize) -> Option<Tracklet> {
    let target = |frame: usize| usize::try_from(frame as i64 + offset).ok().filter(|f| *f < n_frames);
    let detections: Vec<_> = tracklet.detections.iter().filter_map(|&(f, d)| Some((target(f)?, d))).collect();
    (!detections.is_empty()).then_some(Tracklet { detections })
}

fn relative(pair: &PairScores, offsets: &[i64]) -> i64 {
    offsets[pair.views[1]] - offsets[pair.views[0]]
}

/// Largest number of sweeps over all views after the first assignment.
const MAX_SWEEPS: usize = 10;

/// The offsets with the largest sum of scores: views are added one by one at their best offset against those already
/// added, then each is moved while the sum grows. The first view stays at 0.
fn reconciled(n_views: usize, range: i64, pairs: &[PairScores]) -> Vec<i64> {
    let mut offsets = vec![0; n_views];
    let mut is_added = vec![false; n_views];
    if let Some(first) = is_added.first_mut() {
        *first = true;
    }
    let sum = |view: usize, at: i64, offsets: &[i64], is_added: &[bool]| -> f64 {
        let of_pair = |pair: &PairScores| match pair.views {
            [a, b] if b == view && is_added[a] => pair.at(at - offsets[a]),
            [a, b] if a == view && is_added[b] => pair.at(offsets[b] - at),
            _ => 0.0,
        };
        pairs.iter().map(of_pair).sum()
    };
    // The nearest of equal offsets, and of those the first: `max_by` keeps the last.
    let best = |view: usize, offsets: &[i64], is_added: &[bool]| {
        let candidates = (0..=2 * range).rev().flat_map(|i| [-i, i]).map(|at| (sum(view, at, offsets, is_added), at));
        candidates.max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((0.0, 0))
    };
    while let Some((score, view, at)) = (0..n_views)
        .filter(|&view| !is_added[view])
        .map(|view| (best(view, &offsets, &is_added), view))
        .map(|((score, at), view)| (score, view, at))
        .max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)))
    {
        is_added[view] = true;
        offsets[view] = if score > 0.0 { at } else { 0 };
    }
    for _ in 0..MAX_SWEEPS {
        let before = offsets.clone();
        for view in 1..n_views {
            offsets[view] = best(view, &offsets, &is_added).1;
        }
        if offsets == before {
            break;
        }
    }
    offsets
}
