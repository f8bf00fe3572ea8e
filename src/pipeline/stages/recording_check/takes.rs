//! Cameras that show other people than the rest, or another take of them: no person is seen from both groups at one time, or those at
//! one place move differently.

use crate::body::detector_profile::DETECTOR;
use crate::geometry::Rigid;
use crate::matching::groups::connected_groups;
use crate::optim::robust::quantile;
use crate::pipeline::calibration::TrackedPeople;
use crate::session::{Detection, Keypoint};
use nalgebra::Vector3;
use rayon::prelude::*;

/// Two cameras see the same people where this share of the people of one, standing in the image of the other, are seen there too:
/// right recordings have 0.6 and more, chance alignments of people of two takes 0.05 to 0.1.
const SHARED: f64 = 0.25;
/// Cameras that share less may see the same people at another time: with these they shared 0.3 by chance.
const SHARED_BY_CLOSE: f64 = 0.5;
/// Fewer people seen in both images may be chance. Where two cameras hardly see the same place, nothing is shown against them either: the
/// seconds of a runner were two takes while 20 people were needed.
const MIN_SHARED: usize = 5;

/// Time over which keypoints' rays are compared with themselves, s: a gesturing hand has changed its direction.
const CHANGE_SECS: f64 = 0.4;
/// Fewer changes show nothing.
const MIN_CHANGES: usize = 500;
/// Rays at smaller angles (sine) have no certain distance.
const MIN_RAY_SINE: f64 = 0.2;
/// Motions are others' where they disagree this many times as much as usual. Another take of people who stand at the same places
/// disagrees twice as much.
const OTHER_MOTION: f64 = 1.5;

/// Groups of placed cameras that are not connected by common people, largest first; one group in a right recording.
#[derive(Debug, Clone, PartialEq)]
pub struct Groups {
    /// By pairs that see some of the people of each other.
    pub connected: Vec<Vec<usize>>,
    /// By pairs that see half of them and more.
    pub close: Vec<Vec<usize>>,
}

/// Groups the cameras by the people that they see at the same places and times, and that move alike in them.
pub fn groups(people: &TrackedPeople) -> Groups {
    let placed: Vec<usize> = (0..people.cameras.len()).filter(|&v| people.cameras[v].is_some()).collect();
    let pairs: Vec<[usize; 2]> =
        placed.iter().enumerate().flat_map(|(i, &a)| placed[..i].iter().map(move |&b| [a, b])).collect();
    let share = |[a, b]: [usize; 2]| Some((shared(people, a, b).filter(|share| *share > SHARED)?, [a, b]));
    let connected: Vec<(f64, [usize; 2])> = pairs.into_par_iter().filter_map(share).collect();
    let disagreements: Vec<Option<f64>> = connected.par_iter().map(|&(_, [a, b])| disagreement(people, a, b)).collect();
    // Cameras of two takes make up half of the pairs or more: those of one take are among the lowest.
    let usual = quantile(&mut disagreements.iter().flatten().copied().collect::<Vec<_>>(), 0.25);
    tracing::debug!(?connected, ?disagreements, "agreement of the cameras about motions");
    let moves_alike = |disagreement: Option<f64>| {
        disagreement.zip(usual).is_none_or(|(disagreement, usual)| disagreement <= OTHER_MOTION * usual)
    };
    let alike = connected.iter().zip(disagreements).filter(|&(_, disagreement)| moves_alike(disagreement));
    let alike: Vec<(f64, [usize; 2])> = alike.map(|(pair, _)| *pair).collect();
    let by_share = |least: f64| largest_first(&placed, alike.iter().filter(|pair| pair.0 > least).map(|pair| pair.1));
    Groups { connected: by_share(SHARED), close: by_share(SHARED_BY_CLOSE) }
}

/// The groups of placed cameras that pairs connect, largest first.
fn largest_first(placed: &[usize], pairs: impl Iterator<Item = [usize; 2]>) -> Vec<Vec<usize>> {
    let n_views = placed.last().map_or(0, |last| last + 1);
    let mut groups = connected_groups(n_views, pairs);
    groups.retain(|group| placed.contains(&group[0]));
    groups.sort_by_key(|group| std::cmp::Reverse(group.len()));
    groups
}

/// Share of the people of two cameras, standing in both images, that both see at the same places and times; `None` with fewer than
/// [`MIN_SHARED`].
///
/// Frames in which one of them shows no person count neither way: it may have been started later, or stopped before.
fn shared(people: &TrackedPeople, a: usize, b: usize) -> Option<f64> {
    let shows_people =
        |view: usize, frame: usize| people.session.views[view].frames[frame].iter().any(Detection::has_points);
    let (mut n_shared, mut n_expected) = (0, 0);
    for (track, person) in people.tracks.iter().zip(people.points) {
        for (t, (assigned, points)) in track.detections.iter().zip(&person.points).enumerate() {
            let frame = track.first.0 + t;
            let (in_a, in_b) = (assigned[a].is_some(), assigned[b].is_some());
            let stands = |view: usize| shows_people(view, frame) && stands_in(people, view, points);
            let is_expected = (in_a && stands(b)) || (in_b && stands(a));
            n_shared += usize::from(in_a && in_b);
            n_expected += usize::from(is_expected || (in_a && in_b));
        }
    }
    tracing::debug!(a, b, n_shared, n_expected, "people in the images of two cameras");
    (n_shared >= MIN_SHARED).then(|| n_shared as f64 / n_expected as f64)
}

/// How much the motions that two cameras show disagree, m: 75 % quantile of the change over [`CHANGE_SECS`] of the distance between
/// the rays of a keypoint. A wrong lens moves rays apart too, but slowly. `None` with fewer than [`MIN_CHANGES`].
fn disagreement(people: &TrackedPeople, a: usize, b: usize) -> Option<f64> {
    let lag = ((CHANGE_SECS * people.session.fps).round() as usize).max(1);
    let (from_a, from_b) = (people.cameras[a].as_ref()?, people.cameras[b].as_ref()?);
    let baseline = from_a.center() - from_b.center();
    let ray = |view: usize, camera: &Rigid, keypoint: &Keypoint| {
        let seen = (keypoint.confidence >= DETECTOR.judged).then_some(keypoint.pixel)?;
        let ray = people.session.views[view].intrinsics.normalized_from_pixel(&seen).push(1.0);
        Some(camera.rotation.tr_mul(&ray).normalize())
    };
    let mut changes = Vec::new();
    for track in people.tracks {
        let detection = |t: usize, view: usize| {
            let index = track.detections[t][view]?;
            people.session.views[view].frames[track.first.0 + t].get(index)
        };
        let distances = |t: usize| -> Option<Vec<Option<f64>>> {
            let n_named = people.session.convention.names().len();
            let keypoints = detection(t, a)?.keypoints[..n_named].iter().zip(&detection(t, b)?.keypoints);
            let distance = |(in_a, in_b): (&Keypoint, &Keypoint)| {
                let normal = ray(a, from_a, in_a)?.cross(&ray(b, from_b, in_b)?);
                (normal.norm() > MIN_RAY_SINE).then(|| baseline.dot(&normal) / normal.norm())
            };
            Some(keypoints.map(distance).collect())
        };
        let distances: Vec<Option<Vec<Option<f64>>>> = (0..track.detections.len()).map(distances).collect();
        for (before, after) in distances.iter().zip(distances.iter().skip(lag)) {
            let (Some(before), Some(after)) = (before, after) else { continue };
            changes.extend(before.iter().zip(after).filter_map(|(before, after)| Some(((*after)? - (*before)?).abs())));
        }
    }
    (changes.len() >= MIN_CHANGES).then(|| quantile(&mut changes, 0.75)).flatten()
}

/// Whether a person's middle lies in the image of a camera.
fn stands_in(people: &TrackedPeople, view: usize, points: &[Option<Vector3<f64>>]) -> bool {
    let known = || points.iter().flatten();
    let Some(camera) = people.cameras[view].as_ref().filter(|_| known().count() > 0) else { return false };
    let middle = known().sum::<Vector3<f64>>() / known().count() as f64;
    let lens = &people.session.views[view].intrinsics;
    let is_inside = |c: f64, size: u32| (0.0..f64::from(size)).contains(&c);
    lens.pixel_from_camera(&camera.transform(&middle))
        .is_some_and(|pixel| is_inside(pixel.x, lens.width) && is_inside(pixel.y, lens.height))
}
