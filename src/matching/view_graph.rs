//! One pose per camera from relative poses of pairs: cameras are added one by one, each by the hypothesis that agrees best
//! with all cameras added so far.

use super::pair_hypotheses::{CameraPair, PairHypothesis, SAME_POSE_DEG, is_same_pose};
use super::pair_score::score_pair;
use crate::geometry::Rigid;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Poses of all cameras, from one set of consistent hypotheses.
#[derive(Debug, Clone)]
pub struct Rig {
    /// `camera_from_world`, in metres as far as the lengths of bones determine them; `None` without a good hypothesis.
    pub cameras: Vec<Option<Rigid>>,
    /// Sum of the quality of all pairs of posed cameras.
    pub quality: f64,
}

/// Hypotheses and detections of every compared pair `(first, second)` with `first < second`.
pub struct ViewGraph<'a> {
    /// Number of cameras.
    pub n_views: usize,
    /// Hypotheses by pair, best first.
    pub hypotheses: BTreeMap<(usize, usize), Vec<PairHypothesis>>,
    /// Detections of both cameras of a pair.
    pub pairs: BTreeMap<(usize, usize), CameraPair<'a>>,
}

/// Spread of log scale between chained pairs at which the factor of a quality falls to 1/e: bones give each baseline to
/// some 10 %, and a difference of a third means another arrangement.
const SCALE_SPREAD: f64 = 0.35;

/// Least summed quality of a camera's pairs for it to be added: below it votes are chance.
const MIN_QUALITY: f64 = 0.04;

/// Differences of relative poses that a first adjustment removes, degrees: of rotation and of the baseline's direction.
const SAME_ARRANGEMENT_DEG: [f64; 2] = [12.0, 30.0];

/// Most seed pairs that are grown, and most rigs returned.
const MAX_SEEDS: usize = 8;

/// Grows rigs from the best hypotheses; best rig first.
pub fn assemble(graph: &ViewGraph) -> Vec<Rig> {
    let mut seeds: Vec<((usize, usize), &PairHypothesis)> =
        graph.hypotheses.iter().flat_map(|(pair, hs)| hs.iter().map(move |h| (*pair, h))).collect();
    seeds.sort_by(|a, b| b.1.score.quality.total_cmp(&a.1.score.quality));
    let mut rigs: Vec<Rig> = Vec::new();
    let mut n_grown = 0;
    for (pair, seed) in seeds {
        let known = rigs.iter().any(|rig| contains(rig, pair, &seed.second_from_first));
        if known || n_grown == MAX_SEEDS {
            continue;
        }
        n_grown += 1;
        rigs.push(grow(graph, pair, seed));
    }
    rigs.sort_by(|a, b| b.quality.total_cmp(&a.quality));
    let mut distinct: Vec<Rig> = Vec::new();
    for rig in rigs {
        if !distinct.iter().any(|better| same_arrangement(better, &rig)) {
            distinct.push(rig);
        }
    }
    distinct
}

/// Whether `better` poses every camera of `rig` alike, within [`SAME_ARRANGEMENT_DEG`].
fn same_arrangement(better: &Rig, rig: &Rig) -> bool {
    let both: Vec<(Rigid, Rigid)> =
        better.cameras.iter().zip(&rig.cameras).filter_map(|(a, b)| b.map(|b| a.map(|a| (a, b)))).flatten().collect();
    if both.len() < rig.cameras.iter().flatten().count() {
        return false;
    }
    both.iter().enumerate().all(|(i, (a, b))| {
        both[..i].iter().all(|(c, d)| {
            let (one, other) = (*a * c.inverse(), *b * d.inverse());
            is_same_pose(&one, &other, SAME_ARRANGEMENT_DEG)
        })
    })
}

/// Whether a rig already contains a hypothesis, within the noise of hypotheses.
fn contains(rig: &Rig, (first, second): (usize, usize), second_from_first: &Rigid) -> bool {
    let (Some(a), Some(b)) = (rig.cameras[first], rig.cameras[second]) else { return false };
    let relative = b * a.inverse();
    is_same_pose(&relative, second_from_first, SAME_POSE_DEG)
}

struct Candidate {
    view: usize,
    camera_from_world: Rigid,
    /// Sum of its quality with every posed camera.
    quality: f64,
}

/// Adds camera after camera to a seed pair.
fn grow(graph: &ViewGraph, (first, second): (usize, usize), seed: &PairHypothesis) -> Rig {
    let mut cameras = vec![None; graph.n_views];
    cameras[first] = Some(Rigid::identity());
    let mut candidates = candidates_from(graph, &cameras, first, &[]);
    let mut quality = seed.score.quality;
    let mut newest = Some((second, seed.second_from_first));
    while let Some((view, camera_from_world)) = newest {
        let placed: Vec<usize> = (0..graph.n_views).filter(|&v| cameras[v].is_some()).collect();
        cameras[view] = Some(camera_from_world);
        candidates.retain(|c| c.view != view);
        candidates.par_iter_mut().for_each(|c| c.quality += agreement(graph, &cameras, view, c));
        candidates.extend(candidates_from(graph, &cameras, view, &placed));
        let best = candidates
            .iter()
            .max_by(|a, b| a.quality.total_cmp(&b.quality).then_with(|| b.view.cmp(&a.view)))
            .filter(|c| c.quality > MIN_QUALITY);
        quality += best.map_or(0.0, |c| c.quality);
        newest = best.map(|c| (c.view, c.camera_from_world));
    }
    Rig { cameras, quality }
}

/// Poses of further cameras from the hypotheses with `anchor`, scored against `anchor` and `placed`.
fn candidates_from(graph: &ViewGraph, cameras: &[Option<Rigid>], anchor: usize, placed: &[usize]) -> Vec<Candidate> {
    let Some(anchor_from_world) = cameras[anchor] else { return Vec::new() };
    let mut candidates = Vec::new();
    for ((i, j), hypotheses) in &graph.hypotheses {
        let view = if *i == anchor { *j } else { *i };
        if (*i != anchor && *j != anchor) || cameras[view].is_some() {
            continue;
        }
        for h in hypotheses {
            let view_from_anchor = if *i == anchor { h.second_from_first } else { h.second_from_first.inverse() };
            let camera_from_world = view_from_anchor * anchor_from_world;
            candidates.push(Candidate { view, camera_from_world, quality: h.score.quality });
        }
    }
    candidates.par_iter_mut().for_each(|c| {
        c.quality += placed.iter().map(|&other| agreement(graph, cameras, other, c)).sum::<f64>();
    });
    candidates
}

/// Quality of the pair of a candidate and a posed camera, including its scale.
fn agreement(graph: &ViewGraph, cameras: &[Option<Rigid>], other: usize, candidate: &Candidate) -> f64 {
    let Some(other_from_world) = cameras[other] else { return 0.0 };
    let pair = (other.min(candidate.view), other.max(candidate.view));
    let (first, second) = if other < candidate.view {
        (other_from_world, candidate.camera_from_world)
    } else {
        (candidate.camera_from_world, other_from_world)
    };
    let second_from_first = second * first.inverse();
    let Some(pair) = graph.pairs.get(&pair) else { return 0.0 };
    if second_from_first.translation.norm() < 1e-3 {
        return 0.0; // two cameras in one place have no epipolar geometry
    }
    let score = score_pair(&pair.observations, &second_from_first);
    score.quality * (-(score.log_metres / SCALE_SPREAD).powi(2)).exp()
}
