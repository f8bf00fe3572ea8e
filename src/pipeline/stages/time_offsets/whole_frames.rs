//! Time offsets in whole frames: two cameras agree best on a relative pose when their frames are paired correctly.
//!
//! Each offset of a pair is scored by a small search for a relative pose that the paired tracklets support (the same
//! hypotheses and score as for synchronous cameras): first on a coarse grid, then frame by frame around its best offsets.
//! Single pairs may be wrong; the sum over all pairs decides. Offsets beyond the first reach are searched between cameras that agree at
//! none of the near ones.

use crate::geometry::Rigid;
use crate::matching::groups::connected_groups;
use crate::matching::normalized::NormalizedView;
use crate::matching::pair_hypotheses::{CameraPair, HypothesisConfig, mix, pair_hypotheses};
use crate::matching::pair_score::{PairObservations, score_pair};
use crate::matching::tracklets::Tracklet;
use crate::pipeline::camera_clock::MAX_OFFSET_SECS;
use crate::pipeline::capture::Capture;
use crate::progress::{Canceled, Progress};
use rayon::prelude::*;

/// Largest offset between two cameras that were started together, s: half as much from a common time either way.
const NEAR_SECS: f64 = 1.25;

/// A pair of cameras agrees with this quality, and with this share of the best pair's: right ones have 0.4 to 0.8, chance 0.1 to 0.25,
/// and up to 0.45 where a single person repeats a movement.
const AGREES: f64 = 0.3;
const AGREES_SHARE: f64 = 0.65;

/// A far offset has to agree this many times as well as the best near one: of many offsets some agree by chance.
const CLEARLY: f64 = 1.5;

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
    /// The pairs of views that were compared.
    pairs: Vec<PairScores>,
}

/// Cameras that did not start with most of the others.
#[derive(Debug, Clone, PartialEq)]
pub struct Apart {
    /// Indices of the cameras, and by how many frames their frame numbers are too high.
    pub late: Vec<(usize, i64)>,
    /// Mean quality of their pairs with the others, 0 to 1: at the frame numbers as they are, and with these corrected.
    pub agreement: [f64; 2],
}

impl WholeOffsets {
    /// Number of pairs of views compared.
    pub fn n_pairs(&self) -> usize {
        self.pairs.len()
    }

    /// Mean quality of the pairs at these offsets, 0 to 1.
    pub fn agreement(&self) -> f64 {
        agreement(self.pairs.iter(), &self.offsets)
    }

    /// The cameras that agree clearly better with most of the others at another time. `fps`: frame rate.
    pub fn apart(&self, fps: f64) -> Option<Apart> {
        let tolerance = grid_step(fps);
        let is_near = |a: i64, b: i64| (a - b).abs() <= tolerance;
        let n_near = |at: i64| self.offsets.iter().filter(|other| is_near(at, **other)).count();
        let common = self.offsets.iter().copied().rev().max_by_key(|at| n_near(*at))?;
        let late = self.offsets.iter().enumerate().filter(|(_, at)| !is_near(**at, common));
        let late: Vec<(usize, i64)> = late.map(|(view, at)| (view, common - at)).collect();
        let is_late = |view: &usize| late.iter().any(|(other, _)| other == view);
        let across = self.pairs.iter().filter(|pair| pair.views.iter().filter(|view| is_late(view)).count() == 1);
        let as_given = vec![0; self.offsets.len()];
        let agreement = [&as_given, &self.offsets].map(|offsets| agreement(across.clone(), offsets));
        let [before, after] = agreement;
        (after > AGREES.max(CLEARLY * before)).then_some(Apart { late, agreement })
    }
}

/// Scores of two views at every offset of the second against the first.
#[derive(Debug, Clone, PartialEq)]
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

    /// At the offsets of all views.
    fn quality(&self, offsets: &[i64]) -> f64 {
        let [a, b] = self.views;
        self.at(offsets[b] - offsets[a])
    }

    fn is_within(&self, groups: &[usize]) -> bool {
        let [a, b] = self.views;
        groups[a] == groups[b]
    }
}

/// Estimates the offsets: near ones, and far ones between cameras that these leave unconnected. The cameras of a group in `synchronous`
/// are compared at offset 0 alone.
pub fn whole_offsets(
    capture: &Capture,
    synchronous: &[Vec<usize>],
    progress: &Progress,
) -> Result<WholeOffsets, Canceled> {
    let n_views = capture.views.len();
    let followed = capture.tracklets();
    let [near, far] = [NEAR_SECS, MAX_OFFSET_SECS].map(|secs| reach(capture, secs));
    let given_groups = group_of_view(n_views, synchronous);
    let compared = |pairs: Vec<[usize; 2]>, reach: i64| {
        let reach_of = |[a, b]: [usize; 2]| if given_groups[a] == given_groups[b] { 0 } else { reach };
        compared(capture, &followed, pairs, reach_of, progress)
    };

    let mut pairs = compared(neighbours(n_views), near)?;
    let mut offsets = reconciled(n_views, near, &pairs);
    let groups = group_of_view(n_views, &agreeing(&pairs, &offsets, synchronous));
    let (across, within): (Vec<_>, Vec<_>) = pairs.iter().cloned().partition(|pair| !pair.is_within(&groups));
    if !across.is_empty() && far > near {
        let apart = compared(across.iter().map(|pair| pair.views).collect(), far)?;
        let all = [within, apart.clone()].concat();
        let moved = reconciled(n_views, far, &all);
        let [before, after] = [agreement(across.iter(), &offsets), agreement(apart.iter(), &moved)];
        tracing::debug!(?groups, before, after, ?moved, "cameras at far time offsets");
        if after > CLEARLY * before {
            (pairs, offsets) = (all, moved);
        }
    }
    Ok(WholeOffsets { offsets, pairs })
}

/// By view the first view of its group; its own index where it is in none.
fn group_of_view(n_views: usize, groups: &[Vec<usize>]) -> Vec<usize> {
    let group_of = |view| groups.iter().find(|group| group.contains(&view)).and_then(|group| group.first());
    (0..n_views).map(|view| group_of(view).copied().unwrap_or(view)).collect()
}

/// Largest offset that is tried, frames: at least half of the recording is in common.
fn reach(capture: &Capture, secs: f64) -> i64 {
    ((secs * capture.session.fps).round() as i64).min(capture.session.n_frames as i64 / 2)
}

/// The pairs of cameras that are compared.
fn neighbours(n_views: usize) -> Vec<[usize; 2]> {
    let near = |[a, b]: &[usize; 2]| b - a <= N_NEIGHBOURS || a + n_views - b <= N_NEIGHBOURS;
    (0..n_views).flat_map(|b| (0..b).map(move |a| [a, b])).filter(near).collect()
}

fn compared(
    capture: &Capture,
    followed: &[Vec<Tracklet>],
    pairs: Vec<[usize; 2]>,
    reach_of: impl Fn([usize; 2]) -> i64 + Sync,
    progress: &Progress,
) -> Result<Vec<PairScores>, Canceled> {
    let step = grid_step(capture.session.fps);
    let of_pair = |views: [usize; 2]| {
        let score = |offset| progress.check().map(|()| quality(capture, followed, views, offset));
        Ok(PairScores { views, scores: pair_scores(reach_of(views), step, score)? })
    };
    pairs.into_par_iter().map(of_pair).collect()
}

/// Mean quality of the pairs at these offsets, 0 to 1.
fn agreement<'a>(pairs: impl Iterator<Item = &'a PairScores>, offsets: &[i64]) -> f64 {
    let (sum, n) = pairs.fold((0.0, 0), |(sum, n), pair| (sum + pair.quality(offsets), n + 1));
    sum / f64::from(n.max(1))
}

/// Spacing of the coarse grid, frames.
fn grid_step(fps: f64) -> i64 {
    ((STEP_SECS * fps).round() as i64).max(1)
}

/// The given groups, joined where pairs agree at these offsets.
fn agreeing(pairs: &[PairScores], offsets: &[i64], given: &[Vec<usize>]) -> Vec<Vec<usize>> {
    let best = pairs.iter().map(|pair| pair.quality(offsets)).fold(0.0, f64::max);
    let agree = pairs.iter().filter(|pair| pair.quality(offsets) >= AGREES.max(AGREES_SHARE * best));
    let known = given.iter().flat_map(|group| group.windows(2).map(|neighbours| [neighbours[0], neighbours[1]]));
    connected_groups(offsets.len(), known.chain(agree.map(|pair| pair.views)))
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
