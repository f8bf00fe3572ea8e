//! How well the result meets what was seen: reprojection per camera and person, bone spread, jitter.

use crate::body::bones::Bone;
use crate::geometry::Rigid;
use crate::optim::robust::median;
use crate::session::reconstruction::{CameraReport, ErrorSummary, PersonReport};
use crate::session::recording::Session;
use crate::session::{JointTrajectory, PersonTrack};

/// Keypoints below this confidence are not judged.
const MIN_CONFIDENCE: f64 = 0.3;

/// A keypoint further from its reprojection than this is a wrong detection, rad (24 px at a focal length of 1,060 px): it
/// is counted as rejected, not averaged.
const EXPLAINED_RADIUS: f64 = 0.0225;

/// Distances of explained keypoints, px, by view and by person.
#[derive(Debug, Clone, Default)]
pub struct Distances {
    /// By view.
    pub by_view: Vec<Vec<f64>>,
    /// By person, in the order of the tracks.
    pub by_person: Vec<Vec<f64>>,
    /// Detections given to each person.
    pub n_detections: Vec<usize>,
}

/// Reprojects all paths into all views that saw them.
pub fn distances(
    session: &Session,
    cameras: &[Option<Rigid>],
    tracks: &[PersonTrack],
    paths: &[JointTrajectory],
) -> Distances {
    let mut found = Distances {
        by_view: vec![Vec::new(); session.views.len()],
        by_person: vec![Vec::new(); tracks.len()],
        n_detections: vec![0; tracks.len()],
    };
    for (person, (track, path)) in tracks.iter().zip(paths).enumerate() {
        for (t, claim) in track.detections.iter().enumerate() {
            for (view, detection) in claim.iter().enumerate() {
                let (Some(d), Some(camera)) = (detection, &cameras[view]) else { continue };
                found.n_detections[person] += 1;
                let intrinsics = &session.views[view].intrinsics;
                let keypoints = &session.views[view].frames[track.first.0 + t][*d].keypoints;
                for (point, keypoint) in path.points[t].iter().zip(keypoints) {
                    let Some(point) = point.filter(|_| keypoint.confidence >= MIN_CONFIDENCE) else { continue };
                    let Some(pixel) = intrinsics.pixel_from_camera(&camera.transform(&point)) else { continue };
                    let distance = (pixel - keypoint.pixel).norm();
                    if distance < EXPLAINED_RADIUS * intrinsics.focal() {
                        found.by_view[view].push(distance);
                        found.by_person[person].push(distance);
                    }
                }
            }
        }
    }
    found
}

/// Mean and median; `None` of nothing.
pub fn summary(values: &[f64]) -> Option<ErrorSummary> {
    let mut sorted = values.to_vec();
    let median = median(&mut sorted)?;
    Some(ErrorSummary { mean: values.iter().sum::<f64>() / values.len() as f64, median })
}

/// One line per camera.
pub fn camera_reports(
    session: &Session,
    cameras: &[Option<Rigid>],
    tracks: &[PersonTrack],
    distances: &Distances,
) -> Vec<CameraReport> {
    let given = |view: usize| tracks.iter().flat_map(|t| &t.detections).filter(|claim| claim[view].is_some()).count();
    session
        .views
        .iter()
        .enumerate()
        .map(|(v, view)| {
            let n_detections = view.frames.iter().map(Vec::len).sum();
            CameraReport {
                id: view.id.clone(),
                solved: cameras[v].is_some(),
                n_detections,
                n_rejected_detections: n_detections - given(v),
                reprojection_px: summary(&distances.by_view[v]),
                time_offset: None,
            }
        })
        .collect()
}

/// One line per person; `joints` (posed 24 joints over time, m) tell the jitter.
pub fn person_report(
    session: &Session,
    bones: &[Bone],
    track: &PersonTrack,
    path: &JointTrajectory,
    distances: &Distances,
    person: usize,
) -> PersonReport {
    let last = track.first.0 + track.detections.len() - 1;
    PersonReport {
        id: track.person.0,
        first_frame: session.frame_number(track.first),
        last_frame: session.frame_number(crate::session::FrameIndex(last)),
        n_detections: distances.n_detections[person],
        reprojection_px: summary(&distances.by_person[person]),
        bone_length_spread: bone_spread(bones, path),
        jitter_m_per_s2: mean_acceleration(path, session.fps),
    }
}

/// Relative standard deviation of bone lengths over frames in which two views saw both ends, mean over bones.
fn bone_spread(bones: &[Bone], path: &JointTrajectory) -> Option<f64> {
    let spreads: Vec<f64> = bones
        .iter()
        .filter_map(|bone| {
            let lengths: Vec<f64> = path
                .points
                .iter()
                .zip(&path.n_views)
                .filter(|(_, n)| n[bone.a] >= 2 && n[bone.b] >= 2)
                .filter_map(|(p, _)| Some((p[bone.a]? - p[bone.b]?).norm()))
                .collect();
            if lengths.len() < 10 {
                return None;
            }
            let n = lengths.len() as f64;
            let mean = lengths.iter().sum::<f64>() / n;
            let variance = lengths.iter().map(|l| (l - mean) * (l - mean)).sum::<f64>() / n;
            Some(variance.sqrt() / mean)
        })
        .collect();
    (!spreads.is_empty()).then(|| spreads.iter().sum::<f64>() / spreads.len() as f64)
}

fn mean_acceleration(path: &JointTrajectory, fps: f64) -> Option<f64> {
    let (mut sum, mut n) = (0.0, 0usize);
    for window in path.points.windows(3) {
        for k in 0..window[0].len() {
            if let (Some(a), Some(b), Some(c)) = (window[0][k], window[1][k], window[2][k]) {
                sum += (a - b * 2.0 + c).norm() * fps * fps;
                n += 1;
            }
        }
    }
    (n > 0).then(|| sum / n as f64)
}
