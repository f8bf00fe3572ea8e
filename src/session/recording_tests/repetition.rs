//! Repeated keypoints: a detector never finds the same coordinates twice, neither in another camera nor in another image.

use crate::session::recording::{Detection, Session, View};
use crate::session::suspicion::{Suspicion, SuspicionCode};
use std::collections::BTreeSet;

/// Fewer present keypoints than this may agree by chance where coordinates are whole pixels.
const MIN_KEYPOINTS: usize = 6;
/// Minimum number of repeated detections for a suspicion.
const MIN_REPEATED: usize = 20;
/// Share of a camera's detections that another camera repeats.
const DUPLICATE: f64 = 0.5;
/// Share of a camera's frames that repeat the frame before: a video of a higher rate than its camera repeats a sixth and
/// more (25 frames per second stored as 30); a dropped frame now and then is harmless.
const REPEATED: f64 = 0.1;
/// Largest period of gaps.
const MAX_PERIOD: usize = 5;
/// Minimum number of frames with people, and the share of them that follow the period.
const MIN_FRAMES: usize = 20;
const PERIODIC: f64 = 0.98;

/// The coordinates of a detection, to the bit; `None` with too few of them.
fn fingerprint(detection: &Detection) -> Option<Vec<[u64; 2]>> {
    let bits = |c: f64| (c + 0.0).to_bits();
    let present = detection.keypoints.iter().filter(|k| k.is_present());
    let prints: Vec<[u64; 2]> = present.map(|k| [bits(k.pixel.x), bits(k.pixel.y)]).collect();
    (prints.len() >= MIN_KEYPOINTS).then_some(prints)
}

/// Pairs of cameras with the same keypoints, at the same or at another time.
pub(super) fn duplicate_cameras(session: &Session) -> Vec<Suspicion> {
    let prints: Vec<BTreeSet<Vec<[u64; 2]>>> =
        session.views.iter().map(|view| view.frames.iter().flatten().filter_map(fingerprint).collect()).collect();
    let mut found = Vec::new();
    for (i, a) in prints.iter().enumerate() {
        for (j, b) in prints.iter().enumerate().skip(i + 1) {
            let common = a.intersection(b).count();
            let least = a.len().min(b.len());
            if common >= MIN_REPEATED && common as f64 >= DUPLICATE * least as f64 {
                found.push(Suspicion::new(SuspicionCode::DuplicateCamera, vec![session.views[i].id.clone(), session.views[j].id.clone()], format!(
                        "{:.0} % of the detections are the same to the last digit: one camera has the keypoints of the other",
                        100.0 * common as f64 / least as f64
                    ), "give each camera its own keypoints, or leave one of the two out"));
            }
        }
    }
    found
}

/// A camera whose keypoints do not change from frame to frame.
pub(super) fn repeated_frames(view: &View) -> Option<Suspicion> {
    let frames: Vec<Vec<_>> =
        view.frames.iter().map(|people| people.iter().filter_map(fingerprint).collect()).collect();
    let n = frames.iter().filter(|prints| !prints.is_empty()).count();
    let repeats = |pair: &&[Vec<Vec<[u64; 2]>>]| !pair[1].is_empty() && pair[0] == pair[1];
    let repeated = frames.windows(2).filter(repeats).count();
    let share = repeated as f64 / n.max(1) as f64;
    (repeated >= MIN_REPEATED && share > REPEATED).then(|| {
        Suspicion::new(
            SuspicionCode::RepeatedFrames,
            vec![view.id.clone()],
            format!("{:.0} % of its frames repeat the keypoints of the frame before to the last digit", 100.0 * share),
            "detect people in the original video, at its own frame rate; a frozen camera must be left out",
        )
    })
}

/// All cameras have people in every n-th frame only.
pub(super) fn periodic_gaps(session: &Session) -> Option<Suspicion> {
    let period = |view: &View| {
        let frames: Vec<usize> = (0..view.frames.len()).filter(|&f| !view.frames[f].is_empty()).collect();
        let follows = |n: usize| {
            let most = (0..n).map(|rest| frames.iter().filter(|&&f| f % n == rest).count()).max().unwrap_or(0);
            most as f64 >= PERIODIC * frames.len() as f64
        };
        (2..=MAX_PERIOD).rev().find(|&n| frames.len() >= MIN_FRAMES && follows(n))
    };
    let found: Vec<(&View, usize)> = session.views.iter().filter_map(|view| Some((view, period(view)?))).collect();
    let n = found.first()?.1;
    let cameras: Vec<String> = found.iter().map(|(view, _)| view.id.clone()).collect();
    let is_everywhere = cameras.len() == session.views.len();
    Some(Suspicion::new(
        SuspicionCode::PeriodicGaps,
        if is_everywhere { Vec::new() } else { cameras },
        format!("people are detected in one of {n} frames only"),
        format!(
            "number the frames without gaps and give the rate of the detected frames ({} frames per second), or detect \
             people in every frame",
            session.fps / n as f64
        ),
    ))
}
