//! Metres: from the people's bones, from one known height, from the distance of two cameras, or from given extrinsics.

use super::config::{Extrinsics, ScaleSource};
use super::{Capture, PipelineError};
use crate::body::default_body;
use crate::body::scale::{measured_limbs, scale_from_people};
use crate::geometry::Rigid;
use crate::session::reconstruction::ScaleReport;
use crate::session::{JointTrajectory, PersonTrack};
use nalgebra::Vector3;

/// Standard deviation of a fitted body's stature against the height a user states: shoes, posture, proportions that the
/// shape directions miss; log units.
const HEIGHT_SIGMA: f64 = 0.015;

/// Standard deviation of a camera distance measured by hand, log units.
const DISTANCE_SIGMA: f64 = 0.01;

/// The scale with its interval.
///
/// `statures`: by track, in the cameras' own unit; needed where one person's height is given.
///
/// # Errors
/// [`PipelineError::Option`] where the chosen source is not in the capture.
pub fn metric_scale(
    capture: &Capture,
    cameras: &[Option<Rigid>],
    tracks: &[PersonTrack],
    paths: &[JointTrajectory],
    statures: &[Option<f64>],
) -> Result<Option<ScaleReport>, PipelineError> {
    if capture.options.extrinsics != Extrinsics::Estimate {
        let evidence = "the given extrinsics".to_owned();
        return Ok(Some(ScaleReport { value: 1.0, interval95: [1.0, 1.0], evidence }));
    }
    match &capture.options.scale {
        ScaleSource::Body => Ok(from_bones(capture, paths)),
        ScaleSource::Height { metres, who } => from_height(capture, tracks, statures, *metres, who).map(Some),
        ScaleSource::CameraDistance { cameras: ids, metres } => from_distance(capture, cameras, ids, *metres).map(Some),
    }
}

fn report(log_scale: f64, sigma: f64, evidence: String) -> ScaleReport {
    let at = |z: f64| (log_scale + z * sigma).exp();
    ScaleReport { value: at(0.0), interval95: [at(-1.96), at(1.96)], evidence }
}

fn from_distance(
    capture: &Capture,
    cameras: &[Option<Rigid>],
    ids: &[String; 2],
    metres: f64,
) -> Result<ScaleReport, PipelineError> {
    let center = |id: &String| {
        let view = capture.session.views.iter().position(|v| v.id == *id);
        view.and_then(|v| cameras[v]).map(|c| c.center())
    };
    match (center(&ids[0]), center(&ids[1])) {
        (Some(a), Some(b)) if (a - b).norm() > 1e-6 => {
            let evidence = format!("{metres} m between cameras {} and {}", ids[0], ids[1]);
            Ok(report((metres / (a - b).norm()).ln(), DISTANCE_SIGMA, evidence))
        }
        _ => Err(PipelineError::Option {
            option: "/scale/cameras",
            reason: format!("cameras {} and {} could not both be placed; name two others", ids[0], ids[1]),
        }),
    }
}

/// From the statures of fitted bodies: no posture and no single keypoint decides.
fn from_height(
    capture: &Capture,
    tracks: &[PersonTrack],
    statures: &[Option<f64>],
    metres: f64,
    who: &str,
) -> Result<ScaleReport, PipelineError> {
    let chosen = match who.parse::<i64>() {
        Ok(id) => person_of_track(capture, tracks, id),
        Err(_) => (0..statures.len())
            .filter(|&i| statures[i].is_some())
            .max_by(|&a, &b| statures[a].unwrap_or(0.0).total_cmp(&statures[b].unwrap_or(0.0))),
    };
    match chosen.and_then(|i| statures.get(i).copied().flatten()) {
        Some(height) => {
            let evidence = format!("{metres} m as the height of {who}");
            Ok(report((metres / height).ln(), HEIGHT_SIGMA, evidence))
        }
        None => Err(PipelineError::Option {
            option: "/scale/who",
            reason: format!("{who:?}: nobody of that name was seen by two cameras; choose another or \"tallest\""),
        }),
    }
}

/// The person most of whose detections carry a track id.
fn person_of_track(capture: &Capture, tracks: &[PersonTrack], id: i64) -> Option<usize> {
    let votes = |track: &PersonTrack| {
        let mut n = 0usize;
        for (t, claim) in track.detections.iter().enumerate() {
            for (view, detection) in claim.iter().enumerate() {
                let sighting = detection.map(|d| &capture.views[view].frames[track.first.0 + t][d]);
                n += usize::from(sighting.is_some_and(|s| s.track_id == Some(id)));
            }
        }
        n
    };
    let counts: Vec<usize> = tracks.iter().map(votes).collect();
    (0..counts.len()).filter(|&i| counts[i] > 0).max_by_key(|&i| counts[i])
}

/// From limb bones, as far as two views saw both ends.
pub fn from_bones(capture: &Capture, paths: &[JointTrajectory]) -> Option<ScaleReport> {
    let seen = |path: &JointTrajectory| {
        let row = |(points, n_views): (&Vec<Option<Vector3<f64>>>, &Vec<u8>)| {
            points.iter().zip(n_views).map(|(p, n)| p.filter(|_| *n >= 2)).collect::<Vec<_>>()
        };
        path.points.iter().zip(&path.n_views).map(row).collect::<Vec<_>>()
    };
    let people: Vec<_> = paths.iter().map(|p| measured_limbs(&seen(p), capture.session.convention)).collect();
    let estimate = scale_from_people(&default_body(), &people)?;
    Some(ScaleReport { value: estimate.scale, interval95: estimate.interval95, evidence: estimate.evidence })
}
