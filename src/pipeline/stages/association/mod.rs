//! Association: assigns detections to persons across views and time, under known cameras.

use crate::body::detector_profile::DETECTOR;
use crate::geometry::Rigid;
use crate::geometry::projection::project_normalized;
use crate::matching::clusters::Cluster;
use crate::matching::normalized::NormalizedDetection;
use crate::matching::tracker::{Shown, TrackedPerson, TrackerConfig, TrackerScene, skeleton, track};
use crate::matching::tracklets::Tracklet;
use crate::pipeline::calibration::Association;
use crate::pipeline::capture::Capture;
use crate::progress::{Canceled, Progress};
use crate::session::reconstruction::StageReport;
use crate::session::recording::{FrameIndex, PersonId, Session};
use crate::session::{JointTrajectory, PersonTrack};
use nalgebra::Vector3;
use rayon::prelude::*;

/// A person is as real as another with this many times as many detections: pieces of a person that the tracker does not
/// join, reflections and bystanders at the edge have fewer.
const AS_WELL: f64 = 0.5;

/// Assigns each detection to one person or rejects it; where the number of persons is known, the best supported are kept.
pub fn associate(
    capture: &Capture,
    cameras: &[Option<Rigid>],
    progress: &Progress,
) -> Result<(Association, StageReport), Canceled> {
    let scene = &capture.scene(cameras);
    let mut people = track(scene, &TrackerConfig::default(), progress)?;
    let n_left_out = capture.options.people.map_or(0, |n| left_out(&people, n));
    people.truncate(capture.options.people.unwrap_or(people.len()));
    let n_views = scene.views.len();
    let tracks: Vec<PersonTrack> = people.iter().enumerate().map(|(i, p)| as_track(i, p, n_views)).collect();
    let points: Vec<JointTrajectory> = people.iter().enumerate().map(|(i, p)| as_points(i, p)).collect();
    let explained = explained(scene, &tracks, &points);
    let metrics = [("people", people.len() as f64), ("explained_share", explained)];
    let report = StageReport::new("association", scene.n_frames, "all_frames", metrics);
    let n_views_placed = scene.cameras.iter().flatten().count();
    Ok((Association { tracks, points, explained, n_views_placed, n_left_out }, report))
}

/// Number of the persons after the first `n` with at least half as many detections as the last of these.
fn left_out(people: &[TrackedPerson], n: usize) -> usize {
    let Some(last) = people.get(n.wrapping_sub(1)) else { return 0 };
    people[n..].iter().filter(|person| person.support() as f64 >= AS_WELL * last.support() as f64).count()
}

/// The association of groups of tracklets: the start, before persons are tracked in 3D.
pub fn from_clusters(scene: &TrackerScene, tracklets: &[Vec<Tracklet>], groups: &[Cluster]) -> Association {
    let of_group = |(person, group): (usize, &Cluster)| {
        let members = || group.iter().map(|&(view, t)| (view, &tracklets[view][t]));
        let first = members().map(|(_, t)| t.first()).min().unwrap_or(0);
        let last = members().map(|(_, t)| t.last()).max().unwrap_or(0);
        let mut detections = vec![vec![None; scene.views.len()]; last - first + 1];
        for (view, tracklet) in members() {
            tracklet.detections.iter().for_each(|&(frame, d)| detections[frame - first][view] = Some(d));
        }
        PersonTrack { person: PersonId(person), first: FrameIndex(first), detections }
    };
    let tracks: Vec<PersonTrack> = groups.iter().enumerate().map(of_group).collect();
    let points = tracks.iter().map(|track| triangulated(scene, track)).collect();
    let n_views_placed = scene.cameras.iter().flatten().count();
    Association { tracks, points, explained: 0.0, n_views_placed, n_left_out: 0 }
}

/// The association of people that are known.
pub fn from_tracks(scene: &TrackerScene, tracks: Vec<PersonTrack>) -> Association {
    let points: Vec<JointTrajectory> = tracks.iter().map(|track| triangulated(scene, track)).collect();
    let explained = explained(scene, &tracks, &points);
    Association { tracks, points, explained, n_views_placed: scene.cameras.iter().flatten().count(), n_left_out: 0 }
}

/// The points that the detections of a person agree on, frame by frame.
fn triangulated(scene: &TrackerScene, track: &PersonTrack) -> JointTrajectory {
    let frames = track.detections.par_iter().enumerate();
    let skeletons: Vec<_> = frames.map(|(t, assignment)| skeleton(scene, track.first.0 + t, assignment)).collect();
    let n_keypoints = skeletons.iter().map(Vec::len).max().unwrap_or(0);
    let whole = |s: Vec<_>| if s.is_empty() { vec![None; n_keypoints] } else { s };
    let n_views = vec![vec![0; n_keypoints]; skeletons.len()];
    let points = skeletons.into_iter().map(whole).collect();
    JointTrajectory { person: track.person, first: track.first, points, n_views }
}

/// Detections whose left and right are exchanged are left to the repair of detections.
fn as_track(person: usize, tracked: &TrackedPerson, n_views: usize) -> PersonTrack {
    let first = tracked.first();
    let mut detections = vec![vec![None; n_views]; tracked.last_seen() - first + 1];
    for (frame, assignment) in &tracked.assignments {
        let usable = |shown: &Option<Shown>| shown.filter(|shown| !shown.is_exchanged).map(|shown| shown.detection);
        detections[frame - first] = assignment.iter().map(usable).collect();
    }
    PersonTrack { person: PersonId(person), first: FrameIndex(first), detections }
}

fn as_points(person: usize, tracked: &TrackedPerson) -> JointTrajectory {
    let first = tracked.first();
    let n_keypoints = tracked.skeletons[0].len();
    let mut points = vec![vec![None; n_keypoints]; tracked.last_seen() - first + 1];
    for ((frame, _), skeleton) in tracked.assignments.iter().zip(&tracked.skeletons) {
        points[frame - first].clone_from(skeleton);
    }
    let n_views = vec![vec![0; n_keypoints]; points.len()];
    JointTrajectory { person: PersonId(person), first: FrameIndex(first), points, n_views }
}

/// Share of confident keypoints of all placed views that lie near a person's reprojection, 0 to 1.
fn explained(scene: &TrackerScene, tracks: &[PersonTrack], points: &[JointTrajectory]) -> f64 {
    let confident = |d: &NormalizedDetection| d.confidence.iter().filter(|c| **c > DETECTOR.confident).count();
    let all: usize = scene
        .views
        .iter()
        .zip(scene.cameras)
        .filter(|(_, c)| c.is_some())
        .flat_map(|(v, _)| v.frames.iter().flatten())
        .map(confident)
        .sum();
    let near_in = |track: &PersonTrack, t: usize, skeleton: &[Option<Vector3<f64>>]| -> usize {
        let assignment = &track.detections[t];
        if assignment.iter().flatten().count() < 2 {
            return 0; // a single view always agrees with itself
        }
        let seen = assignment.iter().enumerate().filter_map(|(view, detection)| {
            Some((scene.cameras[view].as_ref()?, &scene.views[view].frames[track.first.0 + t][(*detection)?]))
        });
        seen.map(|(camera, detection)| n_near(camera, detection, skeleton)).sum()
    };
    let near_person = |(track, person): (&PersonTrack, &JointTrajectory)| -> usize {
        person.points.par_iter().enumerate().map(|(t, skeleton)| near_in(track, t, skeleton)).sum()
    };
    let near: usize = tracks.iter().zip(points).map(near_person).sum();
    near as f64 / all.max(1) as f64
}

/// Number of a detection's confident keypoints near the projection of a skeleton.
fn n_near(camera: &Rigid, detection: &NormalizedDetection, skeleton: &[Option<Vector3<f64>>]) -> usize {
    let radius = DETECTOR.explained_radius * detection.error_scale();
    let is_near = |(k, point): &(usize, &Option<Vector3<f64>>)| {
        let Some(expected) = point.and_then(|p| project_normalized(camera, &p)) else { return false };
        let offset = (expected.normalized - detection.normalized[*k]).norm();
        detection.confidence[*k] > DETECTOR.confident && offset < radius
    };
    skeleton.iter().enumerate().filter(is_near).count()
}

/// The person of every detection: `identities[view][frame][detection]`.
pub fn identities(session: &Session, tracks: &[PersonTrack]) -> Vec<Vec<Vec<Option<PersonId>>>> {
    let mut table: Vec<Vec<Vec<Option<PersonId>>>> =
        session.views.iter().map(|v| v.frames.iter().map(|f| vec![None; f.len()]).collect()).collect();
    for track in tracks {
        for (t, assignment) in track.detections.iter().enumerate() {
            for (view, detection) in assignment.iter().enumerate() {
                if let Some(d) = detection {
                    table[view][track.first.0 + t][*d] = Some(track.person);
                }
            }
        }
    }
    table
}
