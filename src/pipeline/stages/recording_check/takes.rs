//! Cameras that show other people than the rest: no person is seen from both groups at one time.

use crate::geometry::Rigid;
use crate::session::{PersonTrack, Session};

/// Two cameras see the same people where this share of the frames in which both have detections has a person of both.
const SHARED: f64 = 0.15;
/// Fewer frames with detections in both cameras show nothing.
const MIN_FRAMES: usize = 20;

/// Groups of placed cameras that are not connected by common people, largest first; one group in a right recording.
pub fn groups(session: &Session, cameras: &[Option<Rigid>], tracks: &[PersonTrack]) -> Vec<Vec<usize>> {
    let placed: Vec<usize> = (0..cameras.len()).filter(|&v| cameras[v].is_some()).collect();
    let mut groups: Vec<Vec<usize>> = placed.iter().map(|&v| vec![v]).collect();
    for (i, &a) in placed.iter().enumerate() {
        for &b in &placed[..i] {
            if !are_connected(session, tracks, a, b) {
                continue;
            }
            let position = |v: usize, groups: &[Vec<usize>]| groups.iter().position(|group| group.contains(&v));
            let (Some(of_a), Some(of_b)) = (position(a, &groups), position(b, &groups)) else { continue };
            if of_a != of_b {
                let joined = groups.swap_remove(of_a.max(of_b));
                groups[of_a.min(of_b)].extend(joined);
            }
        }
    }
    groups.sort_by_key(|group| std::cmp::Reverse(group.len()));
    groups
}

fn are_connected(session: &Session, tracks: &[PersonTrack], a: usize, b: usize) -> bool {
    let has_people = |view: usize, frame: usize| !session.views[view].frames[frame].is_empty();
    let n_frames = (0..session.n_frames).filter(|&f| has_people(a, f) && has_people(b, f)).count();
    let mut is_shared = vec![false; session.n_frames];
    for track in tracks {
        for (t, assigned) in track.detections.iter().enumerate() {
            is_shared[track.first.0 + t] |= assigned[a].is_some() && assigned[b].is_some();
        }
    }
    let n_shared = is_shared.iter().filter(|shared| **shared).count();
    n_frames >= MIN_FRAMES && n_shared as f64 > SHARED * n_frames as f64
}
