//! Tracklets: consecutive detections of one person within a view. In case of doubt tracklets are split rather than swapped.

use super::assignment::{assign_by_table, lone_pairs, rival};
use super::normalized::{BODY_SPAN_M, NormalizedDetection, NormalizedView};
use crate::body::detector_profile::DETECTOR;
use crate::body::human_speeds::WALK_M_S;
use crate::optim::robust::median;
use nalgebra::Vector2;

/// The detections of one person in one of the views, over consecutive frames.
#[derive(Debug, Clone)]
pub struct Tracklet {
    /// Frame, and index of the detection in that frame; in rising order of frames.
    pub detections: Vec<(usize, usize)>,
}

impl Tracklet {
    /// First frame.
    pub fn first(&self) -> usize {
        self.detections[0].0
    }

    /// Last frame.
    pub fn last(&self) -> usize {
        self.detections[self.detections.len() - 1].0
    }

    /// Index of the detection in a frame; `None` where the tracklet has none.
    pub fn at(&self, frame: usize) -> Option<usize> {
        self.detections.binary_search_by_key(&frame, |s| s.0).ok().map(|i| self.detections[i].1)
    }

    /// How many times larger its errors are than on people 4 m away, in the mean of its detections.
    pub fn error_scale(&self, view: &NormalizedView) -> f64 {
        let scales = self.detections.iter().map(|&(frame, person)| view.frames[frame][person].error_scale());
        scales.sum::<f64>() / self.detections.len().max(1) as f64
    }

    /// Frames in which both tracklets have a detection, with the index of each.
    pub(super) fn shared_with(&self, other: &Self) -> Vec<(usize, usize, usize)> {
        if self.last() < other.first() || other.last() < self.first() {
            return Vec::new();
        }
        self.detections.iter().filter_map(|&(f, p)| other.at(f).map(|q| (f, p, q))).collect()
    }
}

/// Indices of the `n` longest tracklets, longest first.
pub(super) fn longest(tracklets: &[Tracklet], n: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..tracklets.len()).collect();
    order.sort_by_key(|&t| (std::cmp::Reverse(tracklets[t].detections.len()), t));
    order.truncate(n);
    order
}

/// Gates within which two detections may show the same person.
#[derive(Debug, Clone)]
pub struct TrackletConfig {
    /// A body's median joint moves at most this fast, m/s: the tracklet of a faster person goes on only without a rival.
    pub max_speed: f64,
    /// Detector noise, as a share of the apparent size: three times the 1 to 2 % seen on OpenPose and COCO detectors.
    pub noise: f64,
    /// A tracklet without detections for longer than this ends, s: a person walks 0.3 m in this time.
    pub max_gap: f64,
    /// The best match must cost less than this share of the second best; otherwise neither is accepted.
    pub uniqueness: f64,
    /// Outside every gate a detection may be this far from where a tracklet is expected, of the apparent size: half a body, 1 m
    /// from one frame to the next. How fast people are is not known, nor is the frame rate always right.
    pub lone_reach: f64,
    /// Fewest keypoints that two detections must share.
    pub min_shared: usize,
}

impl Default for TrackletConfig {
    fn default() -> Self {
        Self { max_speed: WALK_M_S, noise: 0.03, max_gap: 0.25, uniqueness: 0.6, lone_reach: 0.6, min_shared: 4 }
    }
}

/// Follows all persons through a view.
pub fn tracklets(view: &NormalizedView, fps: f64, config: &TrackletConfig) -> Vec<Tracklet> {
    let max_gap = ((config.max_gap * fps).round() as usize).max(1);
    let mut open: Vec<Tracklet> = Vec::new();
    let mut closed: Vec<Tracklet> = Vec::new();
    for (frame, people) in view.frames.iter().enumerate() {
        let (active, expired): (Vec<_>, Vec<_>) = open.into_iter().partition(|t| frame - t.last() <= max_gap);
        closed.extend(expired);
        open = active;
        let near = gate_costs(view, &open, frame, people, fps, config);
        let lone = lone_matches(view, &open, frame, &near, config);
        for (tracklet, person) in confident_matches(&near, config).into_iter().chain(lone) {
            open[tracklet].detections.push((frame, person));
        }
        let taken: Vec<usize> = open.iter().filter_map(|t| t.at(frame)).collect();
        open.extend(
            (0..people.len()).filter(|p| !taken.contains(p)).map(|p| Tracklet { detections: vec![(frame, p)] }),
        );
    }
    closed.extend(open);
    closed.sort_by_key(|t| (t.first(), t.detections[0].1));
    closed
}

/// Cost of a pair that lies at least this many gates apart: however far, it cannot match, nor rival a match.
const FAR: f64 = 2.0;

/// Cost of each pair of open tracklet and detection; 1 at the gate.
fn gate_costs(
    view: &NormalizedView,
    open: &[Tracklet],
    frame: usize,
    people: &[NormalizedDetection],
    fps: f64,
    config: &TrackletConfig,
) -> Vec<Vec<f64>> {
    let cost = |t: usize, p: usize| {
        let (last_frame, last_person) = open[t].detections[open[t].detections.len() - 1];
        let seconds = (frame - last_frame) as f64 / fps;
        let gate = config.noise + config.max_speed / BODY_SPAN_M * seconds;
        gate_cost(&view.frames[last_frame][last_person], &people[p], config.min_shared, gate)
    };
    (0..open.len()).map(|t| (0..people.len()).map(|p| cost(t, p)).collect()).collect()
}

/// Pairs of open tracklet and detection within the gates without a competing pair of similar cost.
fn confident_matches(costs: &[Vec<f64>], config: &TrackletConfig) -> Vec<(usize, usize)> {
    let matches = assign_by_table(costs, 1.0);
    let pairs = matches.iter().enumerate().filter_map(|(t, p)| p.map(|p| (t, p)));
    pairs.filter(|&(t, p)| costs[t][p] < config.uniqueness * rival(costs, t, p)).collect()
}

/// Pairs outside every gate that have no rival: a runner alone, or one whose neighbours are followed. Distances are from where
/// the tracklet's last step leads, so that the second step of a runner is near.
fn lone_matches(
    view: &NormalizedView,
    open: &[Tracklet],
    frame: usize,
    gate_costs: &[Vec<f64>],
    config: &TrackletConfig,
) -> Vec<(usize, usize)> {
    let people = &view.frames[frame];
    let is_lost: Vec<bool> = gate_costs.iter().map(|row| row.iter().all(|c| *c >= 1.0)).collect();
    let is_new: Vec<bool> = (0..people.len()).map(|p| gate_costs.iter().all(|row| row[p] >= 1.0)).collect();
    if !is_lost.contains(&true) || !is_new.contains(&true) {
        return Vec::new();
    }
    let distances_of = |(t, tracklet): (usize, &Tracklet)| {
        let expected = expected(view, tracklet, frame, config.min_shared);
        // Other pairs are neither outside every gate nor rivals of those that are.
        let asked = |p: usize| (is_lost[t] || is_new[p]).then(|| &people[p]);
        let distance = |p| step_distance(&expected, asked(p)?, config.min_shared);
        (0..people.len()).map(|p| distance(p).unwrap_or(f64::INFINITY)).collect()
    };
    let distances: Vec<Vec<f64>> = open.iter().enumerate().map(distances_of).collect();
    let is_outside = |t: usize, p: usize| is_lost[t] && is_new[p];
    lone_pairs(&distances, config.lone_reach, config.uniqueness, is_outside)
}

/// A tracklet's last detection, moved on at the speed of its last step.
fn expected(view: &NormalizedView, tracklet: &Tracklet, frame: usize, min_shared: usize) -> NormalizedDetection {
    let at = |(frame, person): (usize, usize)| &view.frames[frame][person];
    let mut seen = tracklet.detections.iter().rev().copied();
    let Some(last) = seen.next() else { return NormalizedDetection::default() };
    let mut moved = at(last).clone();
    if let Some(before) = seen.next()
        && let Some(step) = median_step(at(before), at(last), min_shared)
    {
        let n_steps = (frame - last.0) as f64 / (last.0 - before.0) as f64;
        moved.normalized.iter_mut().for_each(|point| *point += step * n_steps);
    }
    moved
}

/// Median displacement of the shared keypoints per axis; `None` for fewer than `min_shared`.
fn median_step(from: &NormalizedDetection, to: &NormalizedDetection, min_shared: usize) -> Option<Vector2<f64>> {
    let (mut x, mut y): (Vec<f64>, Vec<f64>) =
        shared_keypoints(from, to).map(|k| to.normalized[k] - from.normalized[k]).map(|step| (step.x, step.y)).unzip();
    if x.len() < min_shared { None } else { Some(Vector2::new(median(&mut x)?, median(&mut y)?)) }
}

/// [`step_distance`] in gates, at most [`FAR`]: most pairs show two people, and whether half of the keypoints are far is soon
/// counted.
fn gate_cost(a: &NormalizedDetection, b: &NormalizedDetection, min_shared: usize, gate: f64) -> f64 {
    let far = FAR * gate * a.size.max(b.size);
    let (mut n_shared, mut n_near) = (0, 0);
    for k in shared_keypoints(a, b) {
        n_shared += 1;
        n_near += usize::from((a.normalized[k] - b.normalized[k]).norm_squared() < far * far);
        if n_shared - n_near > a.normalized.len() / 2 {
            return FAR;
        }
    }
    if n_near <= n_shared / 2 { FAR } else { step_distance(a, b, min_shared).map_or(FAR, |d| (d / gate).min(FAR)) }
}

fn shared_keypoints<'a>(a: &'a NormalizedDetection, b: &'a NormalizedDetection) -> impl Iterator<Item = usize> + 'a {
    let comparable = |d: &NormalizedDetection, k: usize| d.confidence[k] > DETECTOR.comparable;
    (0..a.normalized.len()).filter(move |&k| comparable(a, k) && comparable(b, k))
}

/// Median distance of the shared keypoints as a share of the apparent size; `None` for fewer than `min_shared`.
pub fn step_distance(a: &NormalizedDetection, b: &NormalizedDetection, min_shared: usize) -> Option<f64> {
    let mut distances: Vec<f64> = shared_keypoints(a, b).map(|k| (a.normalized[k] - b.normalized[k]).norm()).collect();
    if distances.len() < min_shared { None } else { Some(median(&mut distances)? / a.size.max(b.size)) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// A detection of six keypoints, one apparent size high, at `x` sizes.
    fn at(x: f64) -> NormalizedDetection {
        NormalizedDetection::of_points((0..6).map(|k| Vector2::new(0.4 * x, 0.08 * f64::from(k))).collect(), 0.4)
    }

    fn lengths(frames: Vec<Vec<NormalizedDetection>>) -> Vec<usize> {
        let view = NormalizedView { focal: 1000.0, frames };
        let found = tracklets(&view, 25.0, &TrackletConfig::default());
        found.iter().map(|t| t.detections.len()).collect()
    }

    /// 10 m/s at 25 Hz are a quarter of a body from frame to frame; the gate is a twentieth.
    #[test]
    fn a_runner_alone_was_split_at_every_frame() {
        assert_eq!(lengths((0..12).map(|f| vec![at(0.25 * f64::from(f))]).collect()), [12]);
        let two = (0..12).map(|f| vec![at(0.25 * f64::from(f)), at(0.25 * f64::from(f) + 2.0)]).collect();
        assert_eq!(lengths(two), [12, 12]);
        let past_a_standing_one = (0..12).map(|f| vec![at(0.25 * f64::from(f)), at(1.37)]).collect();
        assert_eq!(lengths(past_a_standing_one).into_iter().max(), Some(12));
    }

    #[test]
    fn costs_in_gates_are_median_distances_until_these_are_far() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for trial in 0..500 {
            let n = 4 + trial % 5;
            let mut spread = |scale: f64| {
                let points = (0..n).map(|_| Vector2::from_fn(|_, _| scale * rng.random_range(-1.0..1.0))).collect();
                let confidence = (0..n).map(|_| rng.random_range(0.2..1.0)).collect();
                NormalizedDetection { confidence, ..NormalizedDetection::of_points(points, 0.4) }
            };
            let (a, b) = (spread(0.05), spread(0.05));
            let expected = step_distance(&a, &b, 4).map_or(FAR, |d| (d / 0.06).min(FAR));
            assert_eq!(gate_cost(&a, &b, 4, 0.06), expected);
        }
    }

    #[test]
    fn another_person_elsewhere_is_another_tracklet() {
        let frames = |to: f64| vec![vec![at(0.0)], vec![at(0.01)], vec![at(to)], vec![at(to + 0.01)]];
        assert_eq!(lengths(frames(0.8)), [2, 2]);
        // Two that are equally far may be either.
        assert_eq!(lengths(vec![vec![at(0.0)], vec![at(0.3), at(-0.3)]]), [1, 1, 1]);
    }
}
