//! Metres: from the people's bones, from one known height, from the distance of two cameras, or from given extrinsics.

use super::calibration::Calibration;
use super::config::{Extrinsics, ScaleSource};
use super::{Capture, PipelineError};
use crate::matching::pair_score::median;
use crate::session::JointTrajectory;
use crate::session::reconstruction::ScaleReport;
use nalgebra::Vector3;

/// From the top keypoint of the face (eyes, ears: 0.93 of stature, Drillis and Contini 1966) and the ankles (0.04) to
/// the whole stature.
const EYE_TO_ANKLE_OF_STATURE: f64 = 0.89;

/// Standard deviation of a height measured on keypoints against the true one: posture and shoes, log units.
const HEIGHT_SIGMA: f64 = 0.02;

/// Standard deviation of a camera distance measured by hand, log units.
const DISTANCE_SIGMA: f64 = 0.01;

/// The scale with its interval.
///
/// # Errors
/// [`PipelineError::Option`] where the chosen source is not in the capture.
pub fn metric_scale(
    capture: &Capture,
    calibration: &Calibration,
    paths: &[JointTrajectory],
) -> Result<Option<ScaleReport>, PipelineError> {
    if capture.options.extrinsics != Extrinsics::Estimate {
        let evidence = "the given extrinsics".to_owned();
        return Ok(Some(ScaleReport { value: 1.0, interval95: [1.0, 1.0], evidence }));
    }
    match &capture.options.scale {
        ScaleSource::Body => Ok(from_bones(capture, paths)),
        ScaleSource::Height { metres, who } => from_height(capture, calibration, paths, *metres, who).map(Some),
        ScaleSource::CameraDistance { cameras, metres } => {
            from_distance(capture, calibration, cameras, *metres).map(Some)
        }
    }
}

fn report(log_scale: f64, sigma: f64, evidence: String) -> ScaleReport {
    let at = |z: f64| (log_scale + z * sigma).exp();
    ScaleReport { value: at(0.0), interval95: [at(-1.96), at(1.96)], evidence }
}

fn from_distance(
    capture: &Capture,
    calibration: &Calibration,
    cameras: &[String; 2],
    metres: f64,
) -> Result<ScaleReport, PipelineError> {
    let center = |id: &String| {
        let view = capture.session.views.iter().position(|v| v.id == *id);
        view.and_then(|v| calibration.cameras[v]).map(|c| c.center())
    };
    match (center(&cameras[0]), center(&cameras[1])) {
        (Some(a), Some(b)) if (a - b).norm() > 1e-6 => {
            let evidence = format!("{metres} m between cameras {} and {}", cameras[0], cameras[1]);
            Ok(report((metres / (a - b).norm()).ln(), DISTANCE_SIGMA, evidence))
        }
        _ => Err(PipelineError::Option {
            option: "/scale/cameras",
            reason: format!("cameras {} and {} could not both be placed; name two others", cameras[0], cameras[1]),
        }),
    }
}

/// Standing height of each person: the upper tenth of the length from ankles to eyes or ears.
fn from_height(
    capture: &Capture,
    calibration: &Calibration,
    paths: &[JointTrajectory],
    metres: f64,
    who: &str,
) -> Result<ScaleReport, PipelineError> {
    let heights: Vec<Option<f64>> = paths.iter().map(|p| standing_height(capture, p)).collect();
    let chosen = match who.parse::<i64>() {
        Ok(id) => person_of_track(capture, calibration, id),
        Err(_) => (0..heights.len())
            .filter(|&i| heights[i].is_some())
            .max_by(|&a, &b| heights[a].unwrap_or(0.0).total_cmp(&heights[b].unwrap_or(0.0))),
    };
    match chosen.and_then(|i| heights[i]) {
        Some(height) => {
            let evidence = format!("{metres} m as the height of {who}");
            Ok(report((metres / height).ln(), HEIGHT_SIGMA, evidence))
        }
        None => Err(PipelineError::Option {
            option: "/scale/who",
            reason: format!(
                "{who:?}: nobody of that name was seen standing from head to foot; choose another or \"tallest\""
            ),
        }),
    }
}

fn standing_height(capture: &Capture, path: &JointTrajectory) -> Option<f64> {
    let index = |name: &str| capture.session.convention.index_of(name);
    let heads: Vec<usize> =
        ["left_eye", "right_eye", "left_ear", "right_ear", "nose"].iter().filter_map(|n| index(n)).collect();
    let ankles = [index("left_ankle")?, index("right_ankle")?];
    let mean = |points: &[Option<Vector3<f64>>], of: &[usize]| {
        let found: Vec<Vector3<f64>> = of.iter().filter_map(|&k| points[k]).collect();
        (!found.is_empty()).then(|| found.iter().sum::<Vector3<f64>>() / found.len() as f64)
    };
    let mut heights: Vec<f64> = path
        .points
        .iter()
        .filter_map(|p| Some((mean(p, &heads)? - mean(p, &ankles)?).norm() / EYE_TO_ANKLE_OF_STATURE))
        .collect();
    if heights.is_empty() {
        return None;
    }
    let at = (heights.len() * 9 / 10).min(heights.len() - 1);
    Some(*heights.select_nth_unstable_by(at, f64::total_cmp).1)
}

/// The person most of whose detections carry a track id.
fn person_of_track(capture: &Capture, calibration: &Calibration, id: i64) -> Option<usize> {
    let votes = |track: &crate::session::PersonTrack| {
        let mut n = 0usize;
        for (t, claim) in track.detections.iter().enumerate() {
            for (view, detection) in claim.iter().enumerate() {
                let sighting = detection.map(|d| &capture.views[view].frames[track.first.0 + t][d]);
                n += usize::from(sighting.is_some_and(|s| s.track_id == Some(id)));
            }
        }
        n
    };
    let counts: Vec<usize> = calibration.association.tracks.iter().map(votes).collect();
    (0..counts.len()).filter(|&i| counts[i] > 0).max_by_key(|&i| counts[i])
}

/// Standard deviation of the mean log bone length of one adult about the population's, and of detectors' own bias, log
/// units: leave-one-out on simulated captures gave 4.4, 3.2 and 2.5 % for one, two and four people.
const PERSON_SIGMA: f64 = 0.042;
const BIAS_SIGMA: f64 = 0.013;

/// From limb bones: per person the mean log ratio of reference to measured median length, over people by support.
fn from_bones(capture: &Capture, paths: &[JointTrajectory]) -> Option<ScaleReport> {
    let (mut sum, mut weight, mut square) = (0.0, 0.0, 0.0);
    for path in paths {
        let Some((log_ratio, support)) = person_ratio(capture, path) else { continue };
        // A person seen for a second says all there is to say of their bones; less says less.
        let w = (support as f64 / capture.session.fps).min(1.0);
        sum += w * log_ratio;
        weight += w;
        square += w * w;
    }
    if weight <= 0.0 {
        return None;
    }
    let n_effective = weight * weight / square;
    let sigma = (PERSON_SIGMA * PERSON_SIGMA / n_effective + BIAS_SIGMA * BIAS_SIGMA).sqrt();
    Some(report(sum / weight, sigma, format!("limb lengths of {n_effective:.1} people against adult means")))
}

fn person_ratio(capture: &Capture, path: &JointTrajectory) -> Option<(f64, usize)> {
    let (mut ratios, mut support) = (Vec::new(), 0);
    for bone in &capture.bones {
        let mut lengths: Vec<f64> = path
            .points
            .iter()
            .zip(&path.n_views)
            .filter(|(_, n)| n[bone.a] >= 2 && n[bone.b] >= 2)
            .filter_map(|(p, _)| Some((p[bone.a]? - p[bone.b]?).norm()))
            .collect();
        support = support.max(lengths.len());
        if lengths.len() >= 5 {
            ratios.extend(median(&mut lengths).map(|l| (bone.length / l).ln()));
        }
    }
    (ratios.len() >= 2).then(|| (ratios.iter().sum::<f64>() / ratios.len() as f64, support))
}
