//! Camera initialisation: first extrinsics from people seen in common; only the intrinsics are known.

use crate::matching::normalized::NormalizedView;
use crate::matching::pair_hypotheses::{CameraPair, HypothesisConfig, best_of, mix, pair_hypotheses};
use crate::matching::pair_score::PairObservations;
use crate::matching::tracklets::Tracklet;
use crate::matching::view_graph::{Rig, ViewGraph, assemble};
use crate::matching::view_pairs::compared_pairs;
use crate::pipeline::capture::Capture;
use crate::pipeline::config::Options;
use crate::progress::{Canceled, Progress};
use crate::session::reconstruction::StageReport;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Number of frames on which every hypothesis is scored: places and poses of people change within two seconds, so 60 frames
/// of a longer recording are nearly independent; more cost time and do not change the ranking.
const N_JUDGED_FRAMES: usize = 60;

/// Where the pairs of a camera have less than this quality, further hypotheses are drawn. The true poses of one person who stands
/// still before a bad detector have 0.37 to 0.45 where fits miss them and 0.23 is found; usual recordings have 0.35 to 0.9.
const GOOD_QUALITY: f64 = 0.3;
/// Of a camera with more pairs, so many of good quality are enough: one alone leaves doubts, and a third one confirms two.
const ENOUGH_PAIRS: usize = 3;
/// Tolerances of the further fits over that of the first, draw by draw.
const FURTHER_TOLERANCES: [f64; 3] = [2.0, 1.4, 2.0];

/// Proposes arrangements of the cameras, best first; each places at least two cameras.
pub fn initial_rigs(
    capture: &Capture,
    tracklets: &[Vec<Tracklet>],
    progress: &Progress,
) -> Result<(Vec<Rig>, StageReport), Canceled> {
    let seed = capture.options.seed;
    let (mut graph, mut rigs) = first_rigs(capture, tracklets, progress)?;
    let config = HypothesisConfig::default();
    for (draw, wider) in (1..).zip(FURTHER_TOLERANCES) {
        if agree_well(graph.n_views, &rigs) {
            break;
        }
        let config = HypothesisConfig { tolerance: wider * config.tolerance, ..config.clone() };
        add_hypotheses(&mut graph, mix(seed, draw), &config, progress)?;
        rigs = assemble(&graph);
    }
    let report = report(&graph, &rigs);
    Ok((rigs, report))
}

/// Quality of the best arrangement by the first hypotheses: 0 without any.
pub fn first_quality(capture: &Capture, progress: &Progress) -> Result<f64, Canceled> {
    let tracklets = capture.tracklets();
    let (_, rigs) = first_rigs(capture, &tracklets, progress)?;
    Ok(rigs.first().map_or(0.0, |rig| rig.quality))
}

/// All compared pairs with their hypotheses, and the arrangements that follow.
fn first_rigs<'a>(
    capture: &'a Capture,
    tracklets: &'a [Vec<Tracklet>],
    progress: &Progress,
) -> Result<(ViewGraph<'a>, Vec<Rig>), Canceled> {
    let Capture { views, bones, options: Options { seed, .. }, .. } = capture;
    let frames = judged_frames(views, *seed);
    let pair = |(a, b): (usize, usize)| CameraPair {
        views: [&views[a], &views[b]],
        tracklets: [&tracklets[a], &tracklets[b]],
        observations: PairObservations::new(&views[a], &views[b], &frames, bones),
    };
    let pairs = compared_pairs(views, &frames, *seed);
    let mut graph = ViewGraph {
        n_views: views.len(),
        hypotheses: pairs.iter().map(|&ids| (ids, Vec::new())).collect(),
        pairs: pairs.iter().map(|&ids| (ids, pair(ids))).collect(),
    };
    add_hypotheses(&mut graph, *seed, &HypothesisConfig::default(), progress)?;
    progress.report(0.9, "assembling arrangements of the cameras");
    let rigs = assemble(&graph);
    Ok((graph, rigs))
}

/// Adds further hypotheses of every pair to those it has.
fn add_hypotheses(
    graph: &mut ViewGraph,
    seed: u64,
    config: &HypothesisConfig,
    progress: &Progress,
) -> Result<(), Canceled> {
    let of_pair = |(&(a, b), pair): (&(usize, usize), &CameraPair)| {
        progress.check()?;
        Ok(pair_hypotheses(pair, mix(seed, (a * graph.n_views + b) as u64), config))
    };
    let found: Vec<_> = graph.pairs.par_iter().map(of_pair).collect::<Result<_, Canceled>>()?;
    for (known, more) in graph.hypotheses.values_mut().zip(found) {
        let all = known.drain(..).chain(more).collect();
        *known = best_of(all, config.n_kept);
    }
    Ok(())
}

/// Whether the pairs of a camera of the best rig have a good quality, in the mean of all cameras.
fn agree_well(n_cameras: usize, rigs: &[Rig]) -> bool {
    let of_camera = rigs.first().map_or(0.0, |rig| 2.0 * rig.quality / n_cameras as f64);
    of_camera >= GOOD_QUALITY * n_cameras.saturating_sub(1).min(ENOUGH_PAIRS) as f64
}

/// Frames in which at least two cameras have detections, one drawn from each equal stretch of time.
fn judged_frames(views: &[NormalizedView], seed: u64) -> Vec<usize> {
    let n_frames = views.first().map_or(0, |v| v.frames.len());
    let useful: Vec<usize> =
        (0..n_frames).filter(|&f| views.iter().filter(|v| !v.frames[f].is_empty()).count() >= 2).collect();
    let n = useful.len().min(N_JUDGED_FRAMES);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let drawn = |i: usize, rng: &mut ChaCha8Rng| {
        let (start, end) = (i * useful.len() / n, (i + 1) * useful.len() / n);
        useful[rng.random_range(start..end)]
    };
    (0..n).map(|i| drawn(i, &mut rng)).collect()
}

fn report(graph: &ViewGraph, rigs: &[Rig]) -> StageReport {
    let mut metrics = vec![
        ("pairs", graph.hypotheses.len() as f64),
        ("hypotheses", graph.hypotheses.values().map(Vec::len).sum::<usize>() as f64),
        ("rigs", rigs.len() as f64),
    ];
    if let Some(best) = rigs.first() {
        metrics.push(("best_quality", best.quality));
        metrics.push(("cameras_placed", best.cameras.iter().flatten().count() as f64));
    }
    metrics.extend(rigs.get(1).map(|second| ("runner_up_quality", second.quality)));
    StageReport::new("camera_init", rigs.len(), "hypotheses_exhausted", metrics)
}

#[cfg(test)]
mod tests;
