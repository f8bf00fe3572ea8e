//! Selection of a source's joint order among those with its number of points: the one with the shortest bones.

use crate::session::formats::joints::JointOrder;
use crate::session::recording::{Detection, Keypoint};

/// Neighbouring joints of every body; in a wrong order some of them are far apart.
const NEAR: [(&str, &str); 20] = [
    ("left_hip", "left_knee"),
    ("right_hip", "right_knee"),
    ("left_knee", "left_ankle"),
    ("right_knee", "right_ankle"),
    ("left_shoulder", "left_elbow"),
    ("right_shoulder", "right_elbow"),
    ("left_elbow", "left_wrist"),
    ("right_elbow", "right_wrist"),
    ("left_shoulder", "right_shoulder"),
    ("left_hip", "right_hip"),
    ("mid_hip", "left_hip"),
    ("neck", "left_shoulder"),
    ("nose", "left_eye"),
    ("nose", "right_eye"),
    ("left_eye", "left_ear"),
    ("right_eye", "right_ear"),
    ("left_ankle", "left_heel"),
    ("right_ankle", "right_heel"),
    // A hand begins with its own wrist.
    ("left_wrist", "left_hand_0"),
    ("right_wrist", "right_hand_0"),
];
/// Number of people examined, evenly over all: hands may be detected late.
const MAX_PEOPLE: usize = 300;
/// Largest ratio of bone lengths of the best order to the second best for an unambiguous selection.
const MARGIN: f64 = 0.85;

/// A selected order.
pub(super) struct Evidence {
    pub(super) order: JointOrder,
    pub(super) is_unambiguous: bool,
}

/// Selects the candidate with the shortest bones; `None` without candidates, the first one without people.
pub(super) fn best_order<'d>(
    candidates: Vec<JointOrder>,
    people: impl Iterator<Item = &'d Detection>,
) -> Option<Evidence> {
    let all: Vec<&Detection> = people.collect();
    let step = all.len().div_ceil(MAX_PEOPLE).max(1);
    let people: Vec<&Detection> = all.into_iter().step_by(step).collect();
    let mut scored: Vec<(f64, JointOrder)> =
        candidates.into_iter().map(|order| (score(&order, &people), order)).collect();
    // A stable sort: of equal candidates the more common order comes first.
    scored.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    let is_unambiguous = match scored.as_slice() {
        [(best, _), (second, _), ..] => *best < MARGIN * second,
        _ => true,
    };
    let (_, order) = scored.into_iter().next()?;
    Some(Evidence { order, is_unambiguous })
}

/// Mean length of the detected bones, relative to the size of their person.
fn score(order: &JointOrder, people: &[&Detection]) -> f64 {
    let place = |joint: &str| order.joints.iter().position(|own| own.as_deref() == Some(joint));
    let bones: Vec<(usize, usize)> = NEAR.iter().filter_map(|(a, b)| Some((place(a)?, place(b)?))).collect();
    let (mut sum, mut n) = (0.0, 0usize);
    for person in people {
        let size = extent(&person.keypoints);
        for (a, b) in &bones {
            let (Some(a), Some(b)) = (person.keypoints.get(*a), person.keypoints.get(*b)) else { continue };
            if a.is_present() && b.is_present() && size > 0.0 {
                sum += (a.pixel - b.pixel).norm() / size;
                n += 1;
            }
        }
    }
    if n == 0 { 0.0 } else { sum / n as f64 }
}

/// Diagonal of the bounding box of the detected points, px.
fn extent(keypoints: &[Keypoint]) -> f64 {
    let seen = || keypoints.iter().filter(|keypoint| keypoint.is_present()).map(|keypoint| keypoint.pixel);
    let Some(first) = seen().next() else { return 0.0 };
    let (low, high) = seen().fold((first, first), |(low, high), pixel| (low.inf(&pixel), high.sup(&pixel)));
    (high - low).norm()
}
