//! Repeated keypoints: a detector never finds the same coordinates twice, neither in another camera nor in another image.

use crate::session::recording::{Detection, Session, View};
use crate::session::suspicion::{Suspicion, SuspicionCode};
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::hash::{DefaultHasher, Hasher};

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

/// A hash of the coordinates of a detection, to the bit; `None` with too few of them. The coordinates themselves took as much memory as
/// the session; of a million detections two have the same hash with a probability of 3e-8.
fn fingerprint(detection: &Detection) -> Option<u64> {
    let mut hasher = DefaultHasher::new();
    let mut n = 0;
    for keypoint in detection.keypoints.iter().filter(|k| k.is_present()) {
        let bits = |c: f64| (c + 0.0).to_bits(); // of 0 and -0 the same
        hasher.write_u64(bits(keypoint.pixel.x));
        hasher.write_u64(bits(keypoint.pixel.y));
        n += 1;
    }
    (n >= MIN_KEYPOINTS).then(|| hasher.finish())
}

/// Keypoints that occur twice: in two cameras, or in successive frames of one.
pub(super) fn suspicions(session: &Session) -> Vec<Suspicion> {
    let of_frame = |people: &Vec<Detection>| people.iter().filter_map(fingerprint).collect();
    let of_view = |view: &View| {
        let prints: Vec<Vec<u64>> = view.frames.iter().map(of_frame).collect();
        let distinct: BTreeSet<u64> = prints.iter().flatten().copied().collect();
        (repeated_frames(view, &prints), distinct)
    };
    let (repeated, distinct): (Vec<Option<Suspicion>>, Vec<_>) = session.views.par_iter().map(of_view).unzip();
    duplicate_cameras(session, &distinct).into_iter().chain(repeated.into_iter().flatten()).collect()
}

/// Pairs of cameras with the same keypoints, at the same or at another time.
fn duplicate_cameras(session: &Session, prints: &[BTreeSet<u64>]) -> Vec<Suspicion> {
    let pairs: Vec<(usize, usize)> =
        (0..prints.len()).flat_map(|i| (i + 1..prints.len()).map(move |j| (i, j))).collect();
    let duplicate = |&(i, j): &(usize, usize)| {
        let common = prints[i].intersection(&prints[j]).count();
        let share = common as f64 / prints[i].len().min(prints[j].len()) as f64;
        (common >= MIN_REPEATED && share >= DUPLICATE).then(|| {
            let evidence = format!(
                "{:.0} % of the detections are the same to the last digit: one camera has the keypoints of the other",
                100.0 * share
            );
            let remedy = "give each camera its own keypoints, or leave one of the two out";
            let cameras = [i, j].map(|view| session.views[view].id.clone());
            Suspicion::new(SuspicionCode::DuplicateCamera, cameras.to_vec(), evidence, remedy)
        })
    };
    pairs.par_iter().filter_map(duplicate).collect()
}

/// A camera whose keypoints do not change from frame to frame. `frames`: fingerprints of the detections of each.
fn repeated_frames(view: &View, frames: &[Vec<u64>]) -> Option<Suspicion> {
    let n = frames.iter().filter(|prints| !prints.is_empty()).count();
    let repeats = |pair: &&[Vec<u64>]| !pair[1].is_empty() && pair[0] == pair[1];
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
