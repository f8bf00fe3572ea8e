//! Clusters of tracklets of one person, across views: agglomeration under approximate camera poses.

use super::normalized::NormalizedView;
use super::pair_score::agreement;
use super::tracklets::{Tracklet, longest};
use crate::geometry::Rigid;
use crate::geometry::epipolar::essential_from_pose;
use nalgebra::Matrix3;
use rayon::prelude::*;

/// Similarity at which two tracklets are as likely one person as two.
const NEUTRAL: f64 = 0.45;

/// Frames of an overlap that are compared, at most.
const MAX_FRAMES: usize = 30;

/// Tracklets per view that are clustered, longest first: bounds the cost of long sessions; the longest determine the poses.
const MAX_TRACKLETS: usize = 60;

/// Tracklets of one person: pairs of view and index into that view's tracklets.
pub type Cluster = Vec<(usize, usize)>;

/// Groups tracklets into persons, never two of the same view in the same frame. Clusters of at least two views, largest first.
pub fn clusters(views: &[NormalizedView], tracklets: &[Vec<Tracklet>], cameras: &[Option<Rigid>]) -> Vec<Cluster> {
    let nodes = nodes(tracklets, cameras);
    let affinity = affinities(views, tracklets, cameras, &nodes);
    let mut groups = agglomerate(&nodes, tracklets, affinity);
    groups.retain(|g| g.iter().any(|&(v, _)| v != g[0].0));
    let support = |g: &Cluster| g.iter().map(|&(v, t)| tracklets[v][t].detections.len()).sum::<usize>();
    groups.sort_by_key(|g| (std::cmp::Reverse(support(g)), g[0]));
    groups
}

fn nodes(tracklets: &[Vec<Tracklet>], cameras: &[Option<Rigid>]) -> Vec<(usize, usize)> {
    let mut nodes = Vec::new();
    for (view, list) in tracklets.iter().enumerate().filter(|(v, _)| cameras[*v].is_some()) {
        let mut order = longest(list, MAX_TRACKLETS);
        order.sort_unstable();
        nodes.extend(order.into_iter().map(|t| (view, t)));
    }
    nodes
}

/// Sum of (similarity - neutral) over the overlap of every two tracklets of different views.
fn affinities(
    views: &[NormalizedView],
    tracklets: &[Vec<Tracklet>],
    cameras: &[Option<Rigid>],
    nodes: &[(usize, usize)],
) -> Vec<Vec<f64>> {
    let essential = |v: usize, w: usize| {
        let (first, second) = (cameras[v].filter(|_| v != w)?, cameras[w]?);
        Some(essential_from_pose(&(second * first.inverse())))
    };
    let essentials: Vec<Vec<Option<Matrix3<f64>>>> =
        (0..cameras.len()).map(|v| (0..cameras.len()).map(|w| essential(v, w)).collect()).collect();
    let row = |i: usize| {
        let (v, a) = nodes[i];
        (0..i)
            .map(|j| {
                let (w, b) = nodes[j];
                let Some(essential) = &essentials[v][w] else { return 0.0 };
                let (s, t) = (&tracklets[v][a], &tracklets[w][b]);
                let shared = s.shared_with(t);
                let n = shared.len().min(MAX_FRAMES);
                let sum: f64 = (0..n)
                    .map(|k| {
                        let (f, p, q) = shared[k * shared.len() / n];
                        agreement(essential, &views[v].frames[f][p], &views[w].frames[f][q]) - NEUTRAL
                    })
                    .sum();
                if n == 0 { 0.0 } else { sum * shared.len() as f64 / n as f64 }
            })
            .collect()
    };
    (0..nodes.len()).into_par_iter().map(row).collect()
}

/// Merges the two groups with the largest summed affinity until none is positive.
fn agglomerate(nodes: &[(usize, usize)], tracklets: &[Vec<Tracklet>], affinity: Vec<Vec<f64>>) -> Vec<Cluster> {
    let n = nodes.len();
    let is_conflict = |i: usize, j: usize| nodes[i].0 == nodes[j].0 && share_a_frame(nodes[i], nodes[j], tracklets);
    // Symmetric; `-inf` for groups that hold two detections of the same view and frame.
    let mut sum = vec![vec![0.0f64; n]; n];
    for i in 0..n {
        for j in 0..i {
            let value = if is_conflict(i, j) { f64::NEG_INFINITY } else { affinity[i][j] };
            sum[i][j] = value;
            sum[j][i] = value;
        }
    }
    let mut members: Vec<Vec<usize>> = (0..n).map(|i| vec![i]).collect();
    let mut is_open: Vec<bool> = vec![true; n];
    loop {
        let mut best = (0.0, 0, 0);
        for i in (0..n).filter(|&i| is_open[i]) {
            for j in (0..i).filter(|&j| is_open[j]) {
                if sum[i][j] > best.0 {
                    best = (sum[i][j], i, j);
                }
            }
        }
        let (value, i, j) = best;
        if value <= 0.0 {
            break;
        }
        is_open[i] = false;
        let moved = std::mem::take(&mut members[i]);
        members[j].extend(moved);
        for k in (0..n).filter(|&k| is_open[k] && k != j) {
            let merged = sum[i][k] + sum[j][k];
            sum[j][k] = merged;
            sum[k][j] = merged;
        }
    }
    let mut groups: Vec<Cluster> = Vec::new();
    for list in members.iter().filter(|m| !m.is_empty()) {
        let mut group: Cluster = list.iter().map(|&i| nodes[i]).collect();
        group.sort_unstable();
        groups.push(group);
    }
    groups
}

fn share_a_frame(a: (usize, usize), b: (usize, usize), tracklets: &[Vec<Tracklet>]) -> bool {
    let (s, t) = (&tracklets[a.0][a.1], &tracklets[b.0][b.1]);
    s.first() <= t.last() && t.first() <= s.last() && s.detections.iter().any(|&(f, _)| t.at(f).is_some())
}
