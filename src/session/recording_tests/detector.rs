//! The detector's output: confidences and the order of the keypoints.

use crate::body::detector_profile::DETECTOR;
use crate::body::skeleton::KeypointConvention;
use crate::session::recording::{Detection, Session};
use crate::session::suspicion::{Suspicion, SuspicionCode};

/// Minimum number of present keypoints for a suspicion about confidences, and of detections about conventions.
const MIN_KEYPOINTS: usize = 500;
const MIN_DETECTIONS: usize = 20;
/// Detections that are compared at most, evenly over all.
const MAX_DETECTIONS: usize = 2000;
/// Edges must be this much shorter under another convention. Bodies have edges of a fifth of their size; a wrong order
/// connects points all over the body, which makes the edges two to three times as long.
const SHORTER: f64 = 0.75;

/// Pairs of keypoints that are neighbours on the body.
const EDGES: [(&str, &str); 12] = [
    ("nose", "left_eye"),
    ("nose", "right_eye"),
    ("left_shoulder", "left_elbow"),
    ("right_shoulder", "right_elbow"),
    ("left_elbow", "left_wrist"),
    ("right_elbow", "right_wrist"),
    ("left_hip", "right_hip"),
    ("left_shoulder", "right_shoulder"),
    ("left_hip", "left_knee"),
    ("right_hip", "right_knee"),
    ("left_knee", "left_ankle"),
    ("right_knee", "right_ankle"),
];

/// The confidence that 95 % of the present keypoints do not exceed; `None` with few keypoints.
pub fn best_confidence(session: &Session) -> Option<f64> {
    let keypoints = session.views.iter().flat_map(|view| view.frames.iter().flatten()).flat_map(|d| &d.keypoints);
    let mut confidences: Vec<f64> = keypoints.filter(|k| k.is_present()).map(|k| k.confidence).collect();
    if confidences.len() < MIN_KEYPOINTS {
        return None;
    }
    let at = confidences.len() * 19 / 20;
    Some(*confidences.select_nth_unstable_by(at, f64::total_cmp).1)
}

/// Confidences that even at their best are below what detectors give correct keypoints.
pub(super) fn low_confidence(session: &Session) -> Option<Suspicion> {
    let best = best_confidence(session)?;
    (best < DETECTOR.confident).then(|| {
        Suspicion::new(
            SuspicionCode::LowConfidence,
            Vec::new(),
            format!(
                "95 % of the confidences are below {best:.2}, and keypoints below {} place no camera",
                DETECTOR.confident
            ),
            "give confidences from 0 to 1, where a clearly visible keypoint has 0.6 and more",
        )
    })
}

/// The convention with as many keypoints that makes bodies most compact, and the mean lengths of edges under the declared one and
/// under it.
fn most_compact(session: &Session) -> Option<(KeypointConvention, [f64; 2])> {
    let declared = session.convention;
    let others =
        KeypointConvention::ALL.into_iter().filter(|c| *c != declared && c.n_keypoints() == declared.n_keypoints());
    let own = edge_length(session, declared)?;
    let lengths = others.filter_map(|other| Some((edge_length(session, other)?, other)));
    let (length, best) = lengths.min_by(|a, b| a.0.total_cmp(&b.0))?;
    (length < SHORTER * own).then_some((best, [own, length]))
}

/// The convention that the keypoints are in, where it is clearly not the declared one.
pub fn likelier_convention(session: &Session) -> Option<KeypointConvention> {
    most_compact(session).map(|(convention, _)| convention)
}

/// A convention with as many keypoints that makes bodies much more compact than the declared one.
pub(super) fn convention(session: &Session) -> Option<Suspicion> {
    most_compact(session).map(|(best, [own, length])| {
        Suspicion::new(
            SuspicionCode::Convention,
            Vec::new(),
            format!(
                "neighbouring keypoints are {:.0} % of a person's size apart as {}, but only {:.0} % as {}",
                100.0 * own,
                session.convention.name(),
                100.0 * length,
                best.name()
            ),
            format!("declare the convention {}", best.name()),
        )
    })
}

/// Mean length of the edges between neighbouring keypoints over the size of the detection; `None` with too few detections.
fn edge_length(session: &Session, convention: KeypointConvention) -> Option<f64> {
    let edge = |&(a, b): &(&str, &str)| Some((convention.index_of(a)?, convention.index_of(b)?));
    let edges: Vec<(usize, usize)> = EDGES.iter().filter_map(edge).collect();
    let all: Vec<&Detection> = session.views.iter().flat_map(|view| view.frames.iter().flatten()).collect();
    let step = all.len().div_ceil(MAX_DETECTIONS).max(1);
    let means: Vec<f64> = all.into_iter().step_by(step).filter_map(|d| edge_share(d, &edges)).collect();
    (means.len() >= MIN_DETECTIONS).then(|| means.iter().sum::<f64>() / means.len() as f64)
}

/// The same for one detection that shows most edges.
fn edge_share(detection: &Detection, edges: &[(usize, usize)]) -> Option<f64> {
    let certain = |k: usize| detection.keypoints.get(k).filter(|k| k.confidence >= DETECTOR.judged).map(|k| k.pixel);
    let lengths: Vec<f64> = edges.iter().filter_map(|&(a, b)| Some((certain(a)? - certain(b)?).norm())).collect();
    let points = || (0..detection.keypoints.len()).filter_map(certain);
    let (low, high) = (points().reduce(|a, b| a.inf(&b))?, points().reduce(|a, b| a.sup(&b))?);
    let size = (high - low).norm();
    let is_whole = 2 * lengths.len() > edges.len() && size > 0.0;
    is_whole.then(|| lengths.iter().sum::<f64>() / lengths.len() as f64 / size)
}
