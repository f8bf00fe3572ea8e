//! Offsets to a frame, from nothing: two cameras agree on a relative pose best when their frames are paired rightly.
//!
//! Every offset of a pair is a small search of its own for a relative pose that the paired tracklets vote for (the same
//! hypotheses and the same judgement as for synchronous cameras). A coarse grid comes first, every frame round its best
//! places after it. Pairs may be wrong; what counts is the sum over all pairs.

use crate::geometry::Rigid;
use crate::matching::normalized::NormalizedView;
use crate::matching::pair_hypotheses::{CameraPair, HypothesisConfig, mix, pair_hypotheses};
use crate::matching::pair_score::{PairEvidence, score_pair};
use crate::matching::tracklets::{Tracklet, TrackletConfig, tracklets};
use crate::pipeline::Capture;
use crate::pipeline::config::Extrinsics;
use crate::progress::{Canceled, Progress};
use rayon::prelude::*;

/// Two cameras may be this far apart, s: half as much from a common time either way.
const MAX_OFFSET_SECS: f64 = 1.25;

/// Distance of the first offsets tried, s: in that time people move by less than the votes forgive.
const STEP_SECS: f64 = 0.1;

/// Places of the coarse grid that are looked at frame by frame.
const N_PEAKS: usize = 3;

/// Frames that an offset is judged on.
const N_JUDGED: usize = 48;

/// A view is compared with so many next ones at most: enough to reconcile, and linear in their number.
const N_NEIGHBOURS: usize = 4;

/// A tenth of the work of a search for synchronous cameras: an offset is confirmed by its neighbours, and by other pairs.
fn hypotheses_of_one_offset() -> HypothesisConfig {
    HypothesisConfig {
        n_tracklets: 4,
        max_points: 100,
        iterations: 60,
        n_unions: 6,
        n_refits: 4,
        n_kept: 1,
        ..HypothesisConfig::default()
    }
}

/// What all pairs agree on.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct WholeOffsets {
    /// Frames, per view; 0 for the first, and for views that nothing speaks of.
    pub(super) offsets: Vec<i64>,
    /// Pairs of views compared.
    pub(super) n_pairs: usize,
    /// Mean quality of the pairs at these offsets, 0 to 1.
    pub(super) agreement: f64,
}

/// How well two views agree at every offset of the second against the first.
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

/// Finds the offsets.
///
/// # Errors
/// [`Canceled`].
pub(super) fn whole_offsets(capture: &Capture, progress: &Progress) -> Result<WholeOffsets, Canceled> {
    let (fps, n_views) = (capture.session.fps, capture.views.len());
    let config = TrackletConfig::default();
    let followed: Vec<Vec<Tracklet>> = capture.views.par_iter().map(|view| tracklets(view, fps, &config)).collect();
    // Less than half of the take in common is no evidence.
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
    progress.report(1.0, "cameras compared at all offsets");
    let offsets = reconciled(n_views, range, &scored);
    let agreed: f64 = scored.iter().map(|pair| pair.at(relative(pair, &offsets))).sum();
    Ok(WholeOffsets { offsets, n_pairs: scored.len(), agreement: agreed / scored.len().max(1) as f64 })
}

/// Scores of every offset in `-range..=range`: of a grid, of all places round the grid's best, and between them on lines.
fn pair_scores(range: i64, step: i64, score: impl Fn(i64) -> Result<f64, Canceled>) -> Result<Vec<f64>, Canceled> {
    let place = |offset: i64| (offset + range) as usize;
    let mut known: Vec<Option<f64>> = vec![None; 2 * range as usize + 1];
    let grid: Vec<i64> = (0..=range / step).flat_map(|i| [i * step, -i * step]).chain([range, -range]).collect();
    for &offset in &grid {
        if known[place(offset)].is_none() {
            known[place(offset)] = Some(score(offset)?);
        }
    }
    let mut best: Vec<i64> = (-range..=range).filter(|&offset| known[place(offset)].is_some()).collect();
    best.sort_by(|&a, &b| known[place(b)].unwrap_or(0.0).total_cmp(&known[place(a)].unwrap_or(0.0)).then(a.cmp(&b)));
    for &peak in best.iter().take(N_PEAKS) {
        for offset in (peak - step + 1).max(-range)..=(peak + step - 1).min(range) {
            if known[place(offset)].is_none() {
                known[place(offset)] = Some(score(offset)?);
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

/// How well a pair agrees if frame `n` of the second view was taken with frame `n + offset` of the first.
fn quality(capture: &Capture, followed: &[Vec<Tracklet>], [a, b]: [usize; 2], offset: i64) -> f64 {
    let first = &capture.views[a];
    let second = shifted_view(&capture.views[b], offset);
    let useful: Vec<usize> =
        (0..first.frames.len()).filter(|&f| !first.frames[f].is_empty() && !second.frames[f].is_empty()).collect();
    let n = useful.len().min(N_JUDGED);
    let frames: Vec<usize> = (0..n).map(|i| useful[i * useful.len() / n]).collect();
    let evidence = PairEvidence::new(first, &second, &frames, &capture.bones);
    if let Some(second_from_first) = known_pose(capture, [a, b]) {
        return score_pair(&evidence, &second_from_first).quality;
    }
    let n_frames = first.frames.len();
    let tracklets: Vec<Tracklet> = followed[b].iter().filter_map(|t| shifted_tracklet(t, offset, n_frames)).collect();
    let pair = CameraPair { views: [first, &second], tracklets: [&followed[a], &tracklets], evidence };
    let item = ((a * capture.views.len() + b) as u64) << 32 | offset.unsigned_abs() << 1 | u64::from(offset < 0);
    let hypotheses = pair_hypotheses(&pair, mix(capture.options.seed, item), &hypotheses_of_one_offset());
    hypotheses.first().map_or(0.0, |hypothesis| hypothesis.score.quality)
}

fn known_pose(capture: &Capture, [a, b]: [usize; 2]) -> Option<Rigid> {
    let pose = |v: usize| capture.session.views[v].camera_from_world;
    let is_given = capture.options.extrinsics != Extrinsics::Estimate;
    if is_given { Some(pose(b)? * pose(a)?.inverse()) } else { None }
}

fn shifted_view(view: &NormalizedView, offset: i64) -> NormalizedView {
    let source = |f: usize| usize::try_from(f as i64 - offset).ok().and_then(|f| view.frames.get(f));
    let frames = (0..view.frames.len()).map(|f| source(f).cloned().unwrap_or_default()).collect();
    NormalizedView { focal: view.focal, frames }
}

/// `None` where nothing of it is left on the time line.
fn shifted_tracklet(tracklet: &Tracklet, offset: i64, n_frames: usize) -> Option<Tracklet> {
    let target = |frame: usize| usize::try_from(frame as i64 + offset).ok().filter(|f| *f < n_frames);
    let detections: Vec<_> = tracklet.detections.iter().filter_map(|&(f, d)| Some((target(f)?, d))).collect();
    (!detections.is_empty()).then_some(Tracklet { detections })
}

fn relative(pair: &PairScores, offsets: &[i64]) -> i64 {
    offsets[pair.views[1]] - offsets[pair.views[0]]
}

/// Sweeps over all views after the first arrangement.
const MAX_SWEEPS: usize = 10;

/// The offsets with the largest sum of scores: view after view is added where it agrees best with those that stand, then
/// each is moved while that adds to the sum. The first view stays at 0.
fn reconciled(n_views: usize, range: i64, pairs: &[PairScores]) -> Vec<i64> {
    let mut offsets = vec![0; n_views];
    let mut stands = vec![false; n_views];
    if let Some(first) = stands.first_mut() {
        *first = true;
    }
    let sum = |view: usize, at: i64, offsets: &[i64], stands: &[bool]| -> f64 {
        let of_pair = |pair: &PairScores| match pair.views {
            [a, b] if b == view && stands[a] => pair.at(at - offsets[a]),
            [a, b] if a == view && stands[b] => pair.at(offsets[b] - at),
            _ => 0.0,
        };
        pairs.iter().map(of_pair).sum()
    };
    // The nearest of equals, and of those the first: `max_by` keeps the last.
    let best = |view: usize, offsets: &[i64], stands: &[bool]| {
        let candidates = (0..=2 * range).rev().flat_map(|i| [-i, i]).map(|at| (sum(view, at, offsets, stands), at));
        candidates.max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((0.0, 0))
    };
    while let Some((score, view, at)) = (0..n_views)
        .filter(|&view| !stands[view])
        .map(|view| (best(view, &offsets, &stands), view))
        .map(|((score, at), view)| (score, view, at))
        .max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)))
    {
        stands[view] = true;
        offsets[view] = if score > 0.0 { at } else { 0 };
    }
    for _ in 0..MAX_SWEEPS {
        let before = offsets.clone();
        for view in 1..n_views {
            offsets[view] = best(view, &offsets, &stands).1;
        }
        if offsets == before {
            break;
        }
    }
    offsets
}
