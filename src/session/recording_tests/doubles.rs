//! Double detections: one person detected twice in the same image, where a detector's non-maximum suppression is off or weak.

use crate::session::recording::{Detection, Keypoint, Session, View};
use crate::session::suspicion::{Suspicion, SuspicionCode};
use rayon::prelude::*;

/// Minimum number of double detections for a suspicion, and their share of a camera's detections. From 2 % on
/// persons are found that do not exist, at 30 % tracks within a camera end after some frames.
const MIN_DOUBLES: usize = 20;
const SUSPICIOUS: f64 = 0.01;

/// Cameras in which people are detected twice.
pub(super) fn suspicion(session: &Session) -> Option<Suspicion> {
    let n_keypoints = session.convention.names().len();
    let share = |view: &View| {
        let n = view.frames.iter().flatten().filter(|detection| detection.has_points()).count();
        let n_doubles: usize = view.frames.iter().map(|people| doubles(people, n_keypoints).len()).sum();
        (n_doubles >= MIN_DOUBLES).then_some(n_doubles as f64 / n as f64).filter(|share| *share >= SUSPICIOUS)
    };
    let shares: Vec<Option<f64>> = session.views.par_iter().map(share).collect();
    let largest = shares.iter().flatten().copied().reduce(f64::max)?;
    let cameras =
        session.views.iter().zip(&shares).filter(|(_, share)| share.is_some()).map(|(view, _)| view.id.clone());
    let is_everywhere = shares.iter().all(Option::is_some);
    Some(Suspicion::new(
        SuspicionCode::DoubleDetections,
        if is_everywhere { Vec::new() } else { cameras.collect() },
        format!("up to {:.0} % of the detections are a second one of the same person", 100.0 * largest),
        "let the detector suppress overlapping detections; the solve takes those of higher confidence",
    ))
}

/// The session without them: the points of the less confident of two detections count as missing.
pub fn without_doubles(session: &Session) -> Session {
    let n_keypoints = session.convention.names().len();
    let mut single = session.clone();
    for people in single.views.iter_mut().flat_map(|view| &mut view.frames) {
        for double in doubles(people, n_keypoints) {
            people[double].keypoints.fill(Keypoint::MISSING);
        }
    }
    single
}

/// The detections of one image that show the same person as a more confident one.
fn doubles(people: &[Detection], n_keypoints: usize) -> Vec<usize> {
    let named = |detection: &Detection| detection.keypoints[..n_keypoints].iter().map(|k| k.confidence).sum::<f64>();
    let mut order: Vec<usize> = (0..people.len()).collect();
    order.sort_by(|&a, &b| named(&people[b]).total_cmp(&named(&people[a]))); // stable: the first of equal ones stays
    let (mut kept, mut found): (Vec<usize>, Vec<usize>) = (Vec::new(), Vec::new());
    for index in order {
        let is_double = |&other: &usize| people[index].coincides_with(&people[other], n_keypoints);
        if kept.iter().any(is_double) { found.push(index) } else { kept.push(index) }
    }
    found
}
