//! Metric scale: from the people's bodies, one known height, the distance of two cameras, or given extrinsics.

use crate::body::default_body;
use crate::body::scale::{FittedStature, ScaleEstimate, scale_from_people, scale_of_average_adults};
use crate::body::segments::{MeasuredSegment, measured_segments};
use crate::geometry::Rigid;
use crate::optim::robust::INTERVAL_95;
use crate::pipeline::capture::Capture;
use crate::pipeline::config::ScaleSource;
use crate::pipeline::error::PipelineError;
use crate::progress::Canceled;
use crate::session::reconstruction::ScaleReport;
use crate::session::{JointTrajectory, PersonTrack};

/// Standard deviation of a stated height against the stature without shoes, log units: 17 mm of shoes, posture and memory.
const HEIGHT_SIGMA: f64 = 0.01;

/// Standard deviation of a fitted stature's logarithm: 25 mm, since detectors place ankles up to 15 mm (Needham et al. 2021)
/// and ears some 17 mm beside those of the body.
const STATURE_BIAS: f64 = 0.015;

/// Bodies are fitted again at the new scale, since proportions depend on size, until it changes by less than this, log
/// units, and at most so many times.
const CONVERGED: f64 = 0.002;
const MAX_HEIGHT_ROUNDS: usize = 4;

/// Smallest number of keypoints of the tallest person, as a share of those of the person seen best.
const MIN_SHARE_SEEN: f64 = 0.25;

/// Standard deviation of a camera distance measured by hand, log units.
const DISTANCE_SIGMA: f64 = 0.01;

/// Statures of all persons at a scale in metres per unit, by track; `None` where a body could not be fitted.
pub type StaturesAt<'a> = &'a dyn Fn(f64) -> Result<Vec<Option<FittedStature>>, Canceled>;

/// The scale with its interval; `None` where nothing determines it.
///
/// # Errors
/// [`PipelineError::Option`] where the chosen source is not in the capture; [`PipelineError::Canceled`].
pub fn metric_scale(
    capture: &Capture,
    cameras: &[Option<Rigid>],
    tracks: &[PersonTrack],
    paths: &[JointTrajectory],
    statures: StaturesAt,
) -> Result<Option<ScaleReport>, PipelineError> {
    if !capture.estimates_extrinsics() {
        if capture.session.views.len() == 1 {
            return Ok(Some(report(scale_of_average_adults(&default_body()))));
        }
        let evidence = "the given extrinsics".to_owned();
        return Ok(Some(ScaleReport { value: 1.0, interval95: [1.0, 1.0], evidence }));
    }
    match &capture.options.scale {
        ScaleSource::Body => Ok(scale_from_people(&default_body(), &measured_people(capture, paths)).map(report)),
        ScaleSource::Height { metres, who } => from_height(capture, tracks, paths, (*metres, who), statures).map(Some),
        ScaleSource::CameraDistance { cameras: ids, metres } => from_distance(capture, cameras, ids, *metres).map(Some),
    }
}

fn report(estimate: ScaleEstimate) -> ScaleReport {
    ScaleReport { value: estimate.scale, interval95: estimate.interval95, evidence: estimate.evidence }
}

/// All persons' segments, measured on points that two views see, in the order of `paths`.
fn measured_people(capture: &Capture, paths: &[JointTrajectory]) -> Vec<Vec<MeasuredSegment>> {
    let seen = |path: &JointTrajectory| {
        let rows = path.points.iter().zip(&path.n_views);
        rows.map(|(points, n)| points.iter().zip(n).map(|(p, n)| p.filter(|_| *n >= 2)).collect()).collect::<Vec<_>>()
    };
    paths.iter().map(|path| measured_segments(&seen(path), capture.session.convention)).collect()
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
            let value = metres / (a - b).norm();
            let interval95 = [-INTERVAL_95, INTERVAL_95].map(|z: f64| value * (z * DISTANCE_SIGMA).exp());
            Ok(ScaleReport { value, interval95, evidence })
        }
        _ => Err(PipelineError::Option {
            option: "/scale/cameras",
            reason: format!("cameras {} and {} could not both be placed; choose two other cameras", ids[0], ids[1]),
        }),
    }
}

/// From the height of one person that two cameras see and the stature of the body fitted to this person: first at the
/// scale from all bodies, then again at the scale that the height gives.
fn from_height(
    capture: &Capture,
    tracks: &[PersonTrack],
    paths: &[JointTrajectory],
    (metres, who): (f64, &str),
    statures: StaturesAt,
) -> Result<ScaleReport, PipelineError> {
    let people = measured_people(capture, paths);
    let known = |statures: Vec<Option<FittedStature>>| {
        let of_seen = |(stature, segments): (_, &Vec<_>)| Option::filter(stature, |_| !segments.is_empty());
        let statures: Vec<Option<FittedStature>> = statures.into_iter().zip(&people).map(of_seen).collect();
        match who.parse::<i64>() {
            Ok(id) => person_of_track(capture, tracks, id).and_then(|person| statures[person]),
            Err(_) => tallest(&statures),
        }
    };
    let no_such_person = || PipelineError::Option {
        option: "/scale/who",
        reason: format!("person {who:?} was not seen by two cameras; choose another track id or \"tallest\""),
    };
    let mut scale = scale_from_people(&default_body(), &people).ok_or_else(no_such_person)?.scale;
    for _ in 0..MAX_HEIGHT_ROUNDS {
        let factor = metres / known(statures(scale)?).ok_or_else(no_such_person)?.metres;
        scale *= factor;
        if factor.ln().abs() < CONVERGED {
            break;
        }
    }
    let half = INTERVAL_95 * HEIGHT_SIGMA.hypot(STATURE_BIAS);
    let evidence = format!(
        "a height of {metres} m, and the body that fits this person; shoes, posture and keypoint bias of the detector leave \
         the scale uncertain by {:.1} %",
        100.0 * half
    );
    Ok(ScaleReport { value: scale, interval95: [-half, half].map(|edge| scale * edge.exp()), evidence })
}

/// The tallest of the persons with enough keypoints.
fn tallest(statures: &[Option<FittedStature>]) -> Option<FittedStature> {
    let people = || statures.iter().flatten();
    let most = people().map(|stature| stature.n_keypoints).max()?;
    let is_well_seen = |stature: &&FittedStature| stature.n_keypoints as f64 >= MIN_SHARE_SEEN * most as f64;
    people().filter(is_well_seen).max_by(|a, b| a.metres.total_cmp(&b.metres)).copied()
}

/// The person with the most detections of a track id.
fn person_of_track(capture: &Capture, tracks: &[PersonTrack], id: i64) -> Option<usize> {
    let count = |track: &PersonTrack| {
        let mut n = 0usize;
        for (t, assignment) in track.detections.iter().enumerate() {
            for (view, detection) in assignment.iter().enumerate() {
                let detection = detection.map(|d| &capture.views[view].frames[track.first.0 + t][d]);
                n += usize::from(detection.is_some_and(|s| s.track_id == Some(id)));
            }
        }
        n
    };
    let counts: Vec<usize> = tracks.iter().map(count).collect();
    (0..counts.len()).filter(|&i| counts[i] > 0).max_by_key(|&i| counts[i])
}
