//! Tracklets: consecutive detections of one person within a view. In case of doubt tracklets are split rather than swapped.

use super::assignment::assign;
use super::normalized::{BODY_SPAN_M, NormalizedDetection, NormalizedView};
use crate::body::detector_profile::DETECTOR;
use crate::body::human_speeds::WALK_M_S;
use crate::optim::robust::median;

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

    /// Frames in which both tracklets have a detection, with the index of each.
    pub(super) fn shared_with(&self, other: &Self) -> Vec<(usize, usize, usize)> {
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
    /// A body's median joint moves at most this fast, m/s: the tracklet of a faster person is split.
    pub max_speed: f64,
    /// Detector noise, as a share of the apparent size: three times the 1 to 2 % seen on OpenPose and COCO detectors.
    pub noise: f64,
    /// A tracklet without detections for longer than this ends, s: a person walks 0.3 m in this time.
    pub max_gap: f64,
    /// The best match must cost less than this share of the second best; otherwise neither is accepted.
    pub uniqueness: f64,
    /// Fewest keypoints that two detections must share.
    pub min_shared: usize,
}

impl Default for TrackletConfig {
    fn default() -> Self {
        Self { max_speed: WALK_M_S, noise: 0.03, max_gap: 0.25, uniqueness: 0.6, min_shared: 4 }
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
        for (tracklet, person) in confident_matches(view, &open, frame, people, fps, config) {
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

/// Pairs of open tracklet and detection without a competing pair of similar cost.
fn confident_matches(
    view: &NormalizedView,
    open: &[Tracklet],
    frame: usize,
    people: &[NormalizedDetection],
    fps: f64,
    config: &TrackletConfig,
) -> Vec<(usize, usize)> {
    let cost = |t: usize, p: usize| {
        let (last_frame, last_person) = open[t].detections[open[t].detections.len() - 1];
        let seconds = (frame - last_frame) as f64 / fps;
        let gate = config.noise + config.max_speed / BODY_SPAN_M * seconds;
        step_distance(&view.frames[last_frame][last_person], &people[p], config.min_shared).map_or(2.0, |d| d / gate)
    };
    let costs: Vec<Vec<f64>> = (0..open.len()).map(|t| (0..people.len()).map(|p| cost(t, p)).collect()).collect();
    let matches = assign(open.len(), people.len(), 1.0, |t, p| costs[t][p]);
    let pairs = matches.iter().enumerate().filter_map(|(t, p)| p.map(|p| (t, p)));
    pairs
        .filter(|&(t, p)| {
            let rival_person = (0..people.len()).filter(|&q| q != p).map(|q| costs[t][q]);
            let rival_track = (0..open.len()).filter(|&s| s != t).map(|s| costs[s][p]);
            let rival = rival_person.chain(rival_track).fold(f64::INFINITY, f64::min);
            costs[t][p] < config.uniqueness * rival
        })
        .collect()
}

/// Median distance of the shared keypoints as a share of the apparent size; `None` for fewer than `min_shared`.
pub fn step_distance(a: &NormalizedDetection, b: &NormalizedDetection, min_shared: usize) -> Option<f64> {
    let mut distances: Vec<f64> = (0..a.normalized.len())
        .filter(|&k| a.confidence[k] > DETECTOR.comparable && b.confidence[k] > DETECTOR.comparable)
        .map(|k| (a.normalized[k] - b.normalized[k]).norm())
        .collect();
    if distances.len() < min_shared { None } else { Some(median(&mut distances)? / a.size.max(b.size)) }
}
