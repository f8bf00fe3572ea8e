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
use crate::session::{JointTrajectory, PersonId, PersonTrack};
use std::collections::BTreeMap;

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

/// Standing heights that are known, m.
enum Known<'a> {
    /// Of the tallest person, or of the one with most detections of a track id.
    One(f64, &'a str),
    /// Of these people.
    People(&'a BTreeMap<PersonId, f64>),
}

/// The scale with its interval; `heights`: those that corrections state, which come before the option `scale`; `None` where nothing determines it.
///
/// # Errors
/// [`PipelineError::Option`] where the chosen source is not in the capture; [`PipelineError::Canceled`].
pub fn metric_scale(
    capture: &Capture,
    cameras: &[Option<Rigid>],
    tracks: &[PersonTrack],
    paths: &[JointTrajectory],
    heights: &BTreeMap<PersonId, f64>,
    statures: StaturesAt,
) -> Result<Option<ScaleReport>, PipelineError> {
    if !capture.estimates_extrinsics() {
        if capture.session.views.len() == 1 {
            return Ok(Some(report(scale_of_average_adults(&default_body()))));
        }
        let evidence = "the given extrinsics".to_owned();
        return Ok(Some(ScaleReport { value: 1.0, interval95: [1.0, 1.0], evidence }));
    }
    if !heights.is_empty() {
        let known = Known::People(heights);
        return from_heights(capture, tracks, paths, &known, statures).map(Some);
    }
    match &capture.options.scale {
        ScaleSource::Body {} => Ok(scale_from_people(&default_body(), &measured_people(capture, paths)).map(report)),
        ScaleSource::Height { metres, who } => {
            from_heights(capture, tracks, paths, &Known::One(*metres, who), statures).map(Some)
        }
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

/// From heights of people that two cameras see and the statures of the bodies fitted to them: first at the scale from all bodies,
/// then again at the scale that the heights give. Several people count alike.
fn from_heights(
    capture: &Capture,
    tracks: &[PersonTrack],
    paths: &[JointTrajectory],
    heights: &Known,
    statures: StaturesAt,
) -> Result<ScaleReport, PipelineError> {
    let people = measured_people(capture, paths);
    let seen = |statures: Vec<Option<FittedStature>>| -> Vec<Option<FittedStature>> {
        let of_seen = |(stature, segments): (_, &Vec<_>)| Option::filter(stature, |_| !segments.is_empty());
        statures.into_iter().zip(&people).map(of_seen).collect()
    };
    // Pairs of the known height and the fitted stature.
    let pairs = |statures: Vec<Option<FittedStature>>| -> Result<Vec<[f64; 2]>, PipelineError> {
        let statures = seen(statures);
        match heights {
            Known::One(metres, who) => {
                let stature = match who.parse::<i64>() {
                    Ok(id) => person_of_track(capture, tracks, id).and_then(|person| statures[person]),
                    Err(_) => tallest(&statures),
                };
                Ok(vec![[*metres, stature.ok_or_else(|| unseen(heights, None))?.metres]])
            }
            Known::People(heights_of) => {
                let pair = |(person, metres): (&PersonId, &f64)| {
                    let stature = tracks.iter().position(|track| track.person == *person).and_then(|i| statures[i]);
                    Ok([*metres, stature.ok_or_else(|| unseen(heights, Some(*person)))?.metres])
                };
                heights_of.iter().map(pair).collect()
            }
        }
    };
    let start = scale_from_people(&default_body(), &people).ok_or_else(|| unseen(heights, None))?;
    let (mut scale, mut n) = (start.scale, 1);
    for _ in 0..MAX_HEIGHT_ROUNDS {
        let known = pairs(statures(scale)?)?;
        n = known.len();
        let change = known.iter().map(|[metres, stature]| (metres / stature).ln()).sum::<f64>() / n as f64;
        scale *= change.exp();
        if change.abs() < CONVERGED {
            break;
        }
    }
    let half = INTERVAL_95 * HEIGHT_SIGMA.hypot(STATURE_BIAS) / (n as f64).sqrt();
    let known = match heights {
        Known::One(metres, _) => format!("a height of {metres} m, and the body that fits this person"),
        Known::People(heights) if n == 1 => {
            let metres = heights.values().next().copied().unwrap_or_default();
            format!("a height of {metres} m, and the body that fits this person")
        }
        Known::People(_) => format!("the heights of {n} people, and the bodies that fit them"),
    };
    let evidence = format!(
        "{known}; shoes, posture and keypoint bias of the detector leave the scale uncertain by {:.1} %",
        100.0 * half
    );
    Ok(ScaleReport { value: scale, interval95: [-half, half].map(|edge| scale * edge.exp()), evidence })
}

/// The error that a person of known height has no measurable body.
fn unseen(heights: &Known, person: Option<PersonId>) -> PipelineError {
    let (option, who, remedy) = match (heights, person) {
        (Known::One(_, who), _) => ("/scale/who", format!("{who:?}"), "choose another track id or \"tallest\""),
        (Known::People(_), Some(person)) => {
            ("/corrections", person.0.to_string(), "state the height of another person")
        }
        (Known::People(_), None) => ("/corrections", "of known height".to_owned(), "leave set_height out"),
    };
    PipelineError::Option { option, reason: format!("person {who} was not seen by two cameras; {remedy}") }
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
