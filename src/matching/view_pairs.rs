//! Which pairs of cameras are compared: all of a small rig; of a large one a graph in which every camera has a bounded number of
//! partners, so that work grows with the number of cameras, not with its square.

use super::normalized::NormalizedView;
use super::pair_hypotheses::mix;
use std::cmp::Reverse;

/// Most partners of a camera. A camera is placed by its agreement with those partners that are placed already, and rigs of five
/// cameras, which have four, are placed reliably; pairs that see each other from unsuited angles fail.
const MAX_PARTNERS: usize = 8;

/// Most pairs of `n_views` cameras that are compared.
pub fn max_pairs(n_views: usize) -> usize {
    n_views * n_views.saturating_sub(1).min(MAX_PARTNERS) / 2
}

/// Pairs `(first, second)` with `first < second`, ascending: those who see most people at the same time in `frames` (of `seed` where
/// they see as many), each camera with at most eight partners, and those without which parts of the rig would stay apart.
pub fn compared_pairs(views: &[NormalizedView], frames: &[usize], seed: u64) -> Vec<(usize, usize)> {
    let n = views.len();
    let mut pairs: Vec<(usize, usize)> = (0..n).flat_map(|b| (0..b).map(move |a| (a, b))).collect();
    if n <= MAX_PARTNERS + 1 {
        return pairs;
    }
    let people = |view: usize, frame: usize| views[view].frames[frame].len();
    let shared = |&(a, b): &(usize, usize)| frames.iter().map(|&f| people(a, f).min(people(b, f))).sum::<usize>();
    pairs.retain(|pair| shared(pair) > 0);
    pairs.sort_by_cached_key(|pair| (Reverse(shared(pair)), mix(seed, (pair.0 * n + pair.1) as u64)));
    let (mut graph, mut left) = (PairGraph::new(n), Vec::new());
    // A tree first: pairs that fill up partners within one part could leave no way to another.
    for &pair in &pairs {
        if !graph.are_connected(pair) && graph.has_room(pair) {
            graph.add(pair);
        } else {
            left.push(pair);
        }
    }
    for pair in left {
        if graph.has_room(pair) || !graph.are_connected(pair) {
            graph.add(pair);
        }
    }
    graph.pairs.sort_unstable();
    graph.pairs
}

/// Pairs of cameras chosen so far.
struct PairGraph {
    pairs: Vec<(usize, usize)>,
    n_partners: Vec<usize>,
    /// Of each camera the part of the graph that it belongs to.
    part: Vec<usize>,
}

impl PairGraph {
    fn new(n: usize) -> Self {
        Self { pairs: Vec::new(), n_partners: vec![0; n], part: (0..n).collect() }
    }

    fn has_room(&self, (a, b): (usize, usize)) -> bool {
        self.n_partners[a].max(self.n_partners[b]) < MAX_PARTNERS
    }

    fn are_connected(&self, (a, b): (usize, usize)) -> bool {
        self.part[a] == self.part[b]
    }

    fn add(&mut self, (a, b): (usize, usize)) {
        self.pairs.push((a, b));
        self.n_partners[a] += 1;
        self.n_partners[b] += 1;
        let (kept, merged) = (self.part[a], self.part[b]);
        self.part.iter_mut().filter(|part| **part == merged).for_each(|part| *part = kept);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matching::normalized::NormalizedDetection;

    /// Cameras that see a person in the frames for which `sees(view, frame)`.
    fn views(n: usize, n_frames: usize, sees: impl Fn(usize, usize) -> bool) -> Vec<NormalizedView> {
        let frame = |view, frame| if sees(view, frame) { vec![NormalizedDetection::default()] } else { Vec::new() };
        let of_view = |view| NormalizedView { focal: 1.0, frames: (0..n_frames).map(|f| frame(view, f)).collect() };
        (0..n).map(of_view).collect()
    }

    #[test]
    fn a_small_rig_compares_all_pairs() {
        let pairs = compared_pairs(&views(9, 1, |_, _| true), &[0], 1);
        assert_eq!(pairs.len(), 36);
    }

    #[test]
    fn a_large_rig_has_few_partners_and_one_part() {
        for (n, seed) in [(10, 1), (24, 2), (64, 3)] {
            let pairs = compared_pairs(&views(n, 3, |_, _| true), &[0, 1, 2], seed);
            assert!(
                pairs.len() <= n * MAX_PARTNERS / 2 && pairs.len() >= n * (MAX_PARTNERS - 1) / 2,
                "{}",
                pairs.len()
            );
            assert!(pairs.is_sorted() && pairs.iter().all(|(a, b)| a < b));
            let mut graph = PairGraph::new(n);
            pairs.iter().for_each(|pair| graph.add(*pair));
            assert!(graph.part.iter().all(|part| *part == graph.part[0]) && graph.n_partners.iter().all(|n| *n <= 8));
        }
    }

    /// Two halls of cameras that share one camera's view of the door.
    #[test]
    fn cameras_are_compared_with_those_who_see_the_same_people() {
        let sees = |view: usize, frame: usize| if frame == 0 { view <= 10 } else { view >= 10 };
        let pairs = compared_pairs(&views(21, 2, sees), &[0, 1], 5);
        assert!(pairs.iter().any(|(a, b)| *a < 10 && *b == 10) && pairs.iter().any(|(a, b)| *a == 10 && *b > 10));
        assert!(pairs.iter().all(|(a, b)| *a >= 10 || *b <= 10), "a pair without a person in common: {pairs:?}");
    }
}
