//! Camera initialisation: first extrinsics from people seen in common; only the intrinsics are known.

use crate::matching::normalized::NormalizedView;
use crate::matching::pair_hypotheses::{CameraPair, HypothesisConfig, mix, pair_hypotheses};
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
use std::collections::BTreeMap;

/// Number of frames on which every hypothesis is scored: places and poses of people change within two seconds, so 60 frames
/// of a longer recording are nearly independent; more cost time and do not change the ranking.
const N_JUDGED_FRAMES: usize = 60;

/// Proposes arrangements of the cameras, best first; each places at least two cameras.
pub fn initial_rigs(
    capture: &Capture,
    tracklets: &[Vec<Tracklet>],
    progress: &Progress,
) -> Result<(Vec<Rig>, StageReport), Canceled> {
    let Capture { views, bones, options: Options { seed, .. }, .. } = capture;
    let frames = judged_frames(views, *seed);
    let pairs = compared_pairs(views, &frames, *seed);
    let config = HypothesisConfig::default();
    let found: Vec<Result<_, Canceled>> = pairs
        .par_iter()
        .map(|&(a, b)| {
            progress.check()?;
            let observations = PairObservations::new(&views[a], &views[b], &frames, bones);
            let pair =
                CameraPair { views: [&views[a], &views[b]], tracklets: [&tracklets[a], &tracklets[b]], observations };
            let hypotheses = pair_hypotheses(&pair, mix(*seed, (a * views.len() + b) as u64), &config);
            Ok(((a, b), hypotheses, pair.observations))
        })
        .collect();
    let mut graph = ViewGraph { n_views: views.len(), hypotheses: BTreeMap::new(), observations: BTreeMap::new() };
    for item in found {
        let (pair, hypotheses, observations) = item?;
        graph.hypotheses.insert(pair, hypotheses);
        graph.observations.insert(pair, observations);
    }
    progress.report(0.9, "assembling arrangements of the cameras");
    let rigs = assemble(&graph);
    let report = report(&graph, &rigs);
    Ok((rigs, report))
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
