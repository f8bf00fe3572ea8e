//! Cycle-consistent matching of the detections of one frame in all views at once, by convex relaxation.
//!
//! $\min_X \langle \alpha 1 - A, X \rangle + \lambda \lVert X \rVert_*$ over symmetric $0 \le X \le 1$ with $X_{ii} = 1$ and
//! $X_{ab} = 0$ for two candidates of one group (a view): docs/method.md 3.3, after Huang and Guibas 2013. The nuclear norm
//! favours few persons, and thereby transitivity. Solved by ADMM: singular-value thresholding and projection alternate.
//! `X` is symmetric, so its singular values are the magnitudes of its eigenvalues.

use nalgebra::DMatrix;

/// Parameters of the relaxation. Defaults as published with mvpose, the origin of this solver (docs/method.md 3.3); affinities
/// have no unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MatcherConfig {
    /// Weight $\lambda$ of the nuclear norm.
    pub rank_weight: f64,
    /// Affinities below this $\alpha$ count against a match.
    pub sparsity: f64,
    /// First penalty of ADMM.
    pub penalty: f64,
    /// Greatest number of rounds.
    pub max_rounds: usize,
    /// Primal and dual residual per entry below which it has converged.
    pub tolerance: f64,
    /// Two candidates are matched where their entry of the relaxation is at least this.
    pub threshold: f64,
}

impl Default for MatcherConfig {
    fn default() -> Self {
        Self { rank_weight: 50.0, sparsity: 0.1, penalty: 64.0, max_rounds: 20, tolerance: 1e-4, threshold: 0.3 }
    }
}

/// Candidates of one person: indices, ascending; at most one per group.
pub type Match = Vec<usize>;

/// Partitions candidates into matches, one per person; every candidate is in exactly one.
///
/// `affinity`: symmetric, 0 to 1. `group[i]`: the view of candidate `i`; no two candidates of a group are matched. Deterministic.
pub fn match_all(affinity: &DMatrix<f64>, group: &[usize], config: &MatcherConfig) -> Vec<Match> {
    let relaxed = relaxed(affinity, group, config);
    // Where the relaxation is undecided the order of rounding matters: the best of a few orders is kept.
    let starts = [(&relaxed, config.threshold), (&relaxed, 0.6), (affinity, config.threshold), (affinity, 0.6)];
    let tries = starts.map(|(x, threshold)| rounded(affinity, x, group, &MatcherConfig { threshold, ..*config }));
    let value = |matches: &Vec<Match>| objective(affinity, matches, config);
    tries
        .into_iter()
        .reduce(|best, other| if value(&other) > value(&best) + 1e-9 { other } else { best })
        .unwrap_or_default()
}

/// Objective of a matching: the sum of (affinity - [`MatcherConfig::sparsity`]) over all matched pairs.
pub fn objective(affinity: &DMatrix<f64>, matches: &[Match], config: &MatcherConfig) -> f64 {
    let pairs = |m: &Match| -> f64 {
        (0..m.len())
            .flat_map(|i| (0..i).map(move |j| (i, j)))
            .map(|(i, j)| affinity[(m[i], m[j])] - config.sparsity)
            .sum()
    };
    matches.iter().map(pairs).sum()
}

/// The solution of the relaxation.
fn relaxed(affinity: &DMatrix<f64>, group: &[usize], config: &MatcherConfig) -> DMatrix<f64> {
    let n = group.len();
    let mut x = affinity.clone();
    // An empty matrix has no eigenvalues.
    if n == 0 {
        return x;
    }
    project(&mut x, group);
    let mut dual = DMatrix::<f64>::zeros(n, n);
    let mut penalty = config.penalty;
    for _ in 0..config.max_rounds {
        let low_rank = thresholded(&x + &dual / penalty, config.rank_weight / penalty);
        let before = x.clone();
        x = &low_rank - (affinity.map(|a| config.sparsity - a) + &dual) / penalty;
        project(&mut x, group);
        dual += (&x - &low_rank) * penalty;
        let primal = (&x - &low_rank).norm() / n as f64;
        let dual_residual = penalty * (&x - &before).norm() / n as f64;
        if primal < config.tolerance && dual_residual < config.tolerance {
            break;
        }
        if primal > 10.0 * dual_residual {
            penalty *= 2.0;
        } else if dual_residual > 10.0 * primal {
            penalty /= 2.0;
        }
    }
    x
}

/// Shrinks the singular values of a symmetric matrix by `by`.
fn thresholded(matrix: DMatrix<f64>, by: f64) -> DMatrix<f64> {
    let mut eigen = matrix.symmetric_eigen();
    eigen.eigenvalues.apply(|v| *v = v.signum() * (v.abs() - by).max(0.0));
    eigen.recompose()
}

/// Projects onto the constraints: symmetric, 0 to 1, ones on the diagonal, zeros between candidates of one group.
fn project(x: &mut DMatrix<f64>, group: &[usize]) {
    for i in 0..group.len() {
        for j in 0..i {
            let value = if group[i] == group[j] { 0.0 } else { (0.5 * (x[(i, j)] + x[(j, i)])).clamp(0.0, 1.0) };
            x[(i, j)] = value;
            x[(j, i)] = value;
        }
        x[(i, i)] = 1.0;
    }
}

/// Joins candidates, strongest pairs first, where the parts share no group and the objective rises; then moves single
/// candidates while that raises the objective.
fn rounded(affinity: &DMatrix<f64>, x: &DMatrix<f64>, group: &[usize], config: &MatcherConfig) -> Vec<Match> {
    let n = group.len();
    let mut pairs: Vec<(usize, usize)> = (0..n).flat_map(|i| (0..i).map(move |j| (j, i))).collect();
    pairs.retain(|&(i, j)| group[i] != group[j] && x[(i, j)] >= config.threshold);
    pairs.sort_by(|a, b| x[*b].total_cmp(&x[*a]).then(a.cmp(b)));
    let mut part_of: Vec<usize> = (0..n).collect();
    for (i, j) in pairs {
        let (a, b) = (part_of[i], part_of[j]);
        let members = |p: usize| (0..n).filter(|&k| part_of[k] == p).collect::<Vec<_>>();
        let (of_a, of_b) = (members(a), members(b));
        let clashes = a != b && of_a.iter().any(|&k| of_b.iter().any(|&l| group[k] == group[l]));
        if a != b && !clashes && gain(affinity, &of_a, &of_b, config) > 0.0 {
            of_b.iter().for_each(|&k| part_of[k] = a);
        }
    }
    improve(affinity, group, config, &mut part_of);
    let mut matches: Vec<Match> = vec![Vec::new(); n];
    (0..n).for_each(|k| matches[part_of[k]].push(k));
    matches.retain(|m| !m.is_empty());
    matches.sort();
    matches
}

fn gain(affinity: &DMatrix<f64>, some: &[usize], others: &[usize], config: &MatcherConfig) -> f64 {
    some.iter().flat_map(|&k| others.iter().map(move |&l| (k, l))).map(|k| affinity[k] - config.sparsity).sum()
}

/// Local search over moves of a candidate to another part, best first (a candidate of the same group there is exchanged).
/// It ends because every move raises a bounded objective.
fn improve(affinity: &DMatrix<f64>, group: &[usize], config: &MatcherConfig, part_of: &mut [usize]) {
    let n = group.len();
    let worth = |k: usize, part: usize, without: Option<usize>, part_of: &[usize]| -> f64 {
        let members = (0..n).filter(|&l| l != k && Some(l) != without && part_of[l] == part);
        members.map(|l| affinity[(k, l)] - config.sparsity).sum()
    };
    for _ in 0..4 * n {
        let mut best: Option<(f64, usize, usize, Option<usize>)> = None;
        for k in 0..n {
            // An empty part of the list stands for a new part.
            for to in (0..n).filter(|&p| p != part_of[k]) {
                let from = part_of[k];
                let rival = (0..n).find(|&l| part_of[l] == to && group[l] == group[k]);
                let mut rise = worth(k, to, rival, part_of) - worth(k, from, None, part_of);
                if let Some(l) = rival {
                    rise += worth(l, from, Some(k), part_of) - worth(l, to, None, part_of);
                }
                if rise > best.map_or(1e-9, |b| b.0) {
                    best = Some((rise, k, to, rival));
                }
            }
        }
        let Some((_, k, to, rival)) = best else { return };
        if let Some(l) = rival {
            part_of[l] = part_of[k];
        }
        part_of[k] = to;
    }
}

#[cfg(test)]
mod tests;
