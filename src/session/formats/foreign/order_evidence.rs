//! Which joint order a source writes, where the number of points leaves several: the one with the shortest bones.

use crate::session::formats::joints::JointOrder;
use crate::session::recording::{Detection, Keypoint};

/// Pairs that are near each other in every body; a wrong order puts some of them at its two ends.
const NEAR: [(&str, &str); 18] = [
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
];
/// People looked at.
const MAX_PEOPLE: usize = 300;
/// The best order must have bones shorter by this factor than the second best to count as proved.
const MARGIN: f64 = 0.85;

/// An order and whether the points themselves prove it.
pub(super) struct Evidence {
    pub(super) order: JointOrder,
    pub(super) is_proved: bool,
}

/// The candidate with the shortest bones; `None` without candidates. Without people the first.
pub(super) fn best_order<'d>(
    candidates: Vec<JointOrder>,
    people: impl Iterator<Item = &'d Detection>,
) -> Option<Evidence> {
    let people: Vec<&Detection> = people.take(MAX_PEOPLE).collect();
    let mut scored: Vec<(f64, JointOrder)> =
        candidates.into_iter().map(|order| (score(&order, &people), order)).collect();
    // A stable sort: of equals the more common order comes first.
    scored.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    let is_proved = match scored.as_slice() {
        [(best, _), (second, _), ..] => *best < MARGIN * second,
        _ => true,
    };
    let (_, order) = scored.into_iter().next()?;
    Some(Evidence { order, is_proved })
}

/// Mean length of the bones that are seen, in sizes of their person.
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

/// Diagonal of the box around the points that are seen, px.
fn extent(keypoints: &[Keypoint]) -> f64 {
    let seen = || keypoints.iter().filter(|keypoint| keypoint.is_present()).map(|keypoint| keypoint.pixel);
    let Some(first) = seen().next() else { return 0.0 };
    let (low, high) = seen().fold((first, first), |(low, high), pixel| (low.inf(&pixel), high.sup(&pixel)));
    (high - low).norm()
}
