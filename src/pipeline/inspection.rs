//! Inspection of a session before it is solved: co-visibility of the cameras, degeneracies, expected accuracy and time.
//!
//! Known limit: small baselines and cameras in a row are found only where the session gives `R` and `t`.

use super::passes::synchronisation::Timing;
use super::planned_stages::expected_secs;
use crate::body::detector_noise::keypoint_sigmas;
use crate::geometry::Rigid;
use crate::matching::groups::connected_groups;
use crate::optim::robust::median;
use crate::session::recording_tests::suspicions;
use crate::session::{Detection, Session, Suspicion, View};
use nalgebra::{Matrix3, Vector2, Vector3};
use serde::Serialize;

/// The inspection of one session.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "service", derive(utoipa::ToSchema))]
pub struct Inspection {
    /// Every camera, in the session's order.
    pub cameras: Vec<InspectedCamera>,
    /// Every pair of cameras: the co-visibility graph.
    pub pairs: Vec<InspectedPair>,
    /// Groups of cameras connected by shared frames; a solution needs a single group.
    pub groups: Vec<Vec<String>>,
    /// Expected problems.
    pub findings: Vec<Finding>,
    /// Probable mistakes in the files.
    pub suspicions: Vec<Suspicion>,
    /// Expected result.
    pub expected: Expectation,
}

/// Detections of one camera.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "service", derive(utoipa::ToSchema))]
pub struct InspectedCamera {
    /// The camera's name.
    pub id: String,
    /// Number of frames with detections.
    pub frames_with_people: usize,
    /// Number of detections in all frames.
    pub detections: usize,
    /// Median distance to the people, m, assuming that they stand upright; null without a complete detection.
    #[cfg_attr(feature = "service", schema(required))]
    pub distance_m: Option<f64>,
}

/// Co-visibility of two cameras.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "service", derive(utoipa::ToSchema))]
pub struct InspectedPair {
    /// Names of the two cameras.
    pub cameras: [String; 2],
    /// Number of frames in which both have detections.
    pub frames_together: usize,
    /// Distance between their centres, m, where the session gives both poses.
    #[cfg_attr(feature = "service", schema(required))]
    pub baseline_m: Option<f64>,
}

/// One expected problem.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "service", derive(utoipa::ToSchema))]
pub struct Finding {
    /// `split`, `few_frames`, `no_person`, `static`, `tiny_baseline` or `collinear`.
    #[cfg_attr(feature = "service", schema(pattern = "^(split|few_frames|no_person|static|tiny_baseline|collinear)$"))]
    pub code: &'static str,
    /// One sentence, with the remedy.
    pub detail: String,
    /// The cameras concerned; empty where all are.
    pub cameras: Vec<String>,
}

/// Expected result.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "service", derive(utoipa::ToSchema))]
pub struct Expectation {
    /// RMS error of a joint in space, mm; null where fewer than two cameras see people together.
    #[cfg_attr(feature = "service", schema(required))]
    pub joint_error_mm: Option<f64>,
    /// Wall seconds of the job once it runs.
    pub solve_s: f64,
    /// Average number of cameras that see a person.
    pub cameras_per_person: f64,
}

/// Number of shared frames that connects two cameras: fewer do not constrain a relative pose in practice.
const MIN_TOGETHER: usize = 10;

/// Height of a person from the eyes to the ankles, m.
const SEEN_HEIGHT_M: f64 = 1.5;

/// Smallest baseline that determines depth, as a share of the distance to the people.
const TINY_BASELINE: f64 = 0.05;

/// Ratio of second to first principal spread of the camera centres below which they are collinear.
const COLLINEAR: f64 = 0.05;

/// Movement in every camera, as a share of the own height, below which people count as static.
const STATIC: f64 = 0.1;

/// Frames of a camera that are compared with each other for movement.
const MAX_COMPARED: usize = 12;

/// Time between a job's start and its first stage, and between its last stage and the result, s.
const REST_S: f64 = 0.2;

/// Inspects a session; `n_threads`: number of cores for the expected time.
pub fn inspect(session: &Session, n_threads: usize) -> Inspection {
    let cameras: Vec<InspectedCamera> = session.views.iter().map(inspected).collect();
    // Frames of two cameras belong together by time, not by number.
    let timing = Timing::given(session);
    let timed = timing.applied_to(session);
    let pairs = pairs(&timed);
    let groups = groups(&timed, &pairs);
    let mut findings = Vec::new();
    findings.extend(blind_cameras(&cameras));
    findings.extend(split(&groups, &cameras));
    findings.extend(few_frames(session));
    findings.extend(static_people(session));
    findings.extend(tiny_baselines(&pairs, &cameras));
    findings.extend(in_a_row(session));
    let expected = expectation(&timed, &cameras, n_threads);
    Inspection { cameras, pairs, groups, findings, suspicions: suspicions(session), expected }
}

fn inspected(view: &View) -> InspectedCamera {
    let mut heights: Vec<f64> = view.frames.iter().flatten().filter_map(height_px).collect();
    let distance_m = median(&mut heights).map(|height| view.intrinsics.fy * SEEN_HEIGHT_M / height);
    InspectedCamera {
        id: view.id.clone(),
        frames_with_people: view.frames.iter().filter(|people| !people.is_empty()).count(),
        detections: view.frames.iter().map(Vec::len).sum(),
        distance_m,
    }
}

/// Extent from the highest to the lowest keypoint, px, of nearly complete detections.
fn height_px(person: &Detection) -> Option<f64> {
    let rows: Vec<f64> = person.keypoints.iter().filter(|k| k.is_present()).map(|k| k.pixel.y).collect();
    let is_whole = 10 * rows.len() >= 8 * person.keypoints.len();
    let low = rows.iter().copied().reduce(f64::max)?;
    let high = rows.iter().copied().reduce(f64::min)?;
    (is_whole && low - high > 1.0).then_some(low - high)
}

fn pairs(session: &Session) -> Vec<InspectedPair> {
    let views = &session.views;
    let mut pairs = Vec::new();
    for (i, a) in views.iter().enumerate() {
        for b in &views[i + 1..] {
            let together = a.frames.iter().zip(&b.frames).filter(|(a, b)| !a.is_empty() && !b.is_empty()).count();
            let center = |view: &View| view.camera_from_world.as_ref().map(Rigid::center);
            pairs.push(InspectedPair {
                cameras: [a.id.clone(), b.id.clone()],
                frames_together: together,
                baseline_m: center(a).zip(center(b)).map(|(a, b)| (a - b).norm()),
            });
        }
    }
    pairs
}

/// Connected components of the co-visibility graph, in the order of their first cameras.
fn groups(session: &Session, pairs: &[InspectedPair]) -> Vec<Vec<String>> {
    let needed = MIN_TOGETHER.min(session.n_frames.max(1));
    let view = |id: &String| session.views.iter().position(|view| view.id == *id);
    let connected = pairs.iter().filter(|pair| pair.frames_together >= needed).filter_map(|pair| {
        let [a, b] = pair.cameras.each_ref().map(view);
        Some([a?, b?])
    });
    let groups = connected_groups(session.views.len(), connected);
    groups.into_iter().map(|group| group.into_iter().map(|view| session.views[view].id.clone()).collect()).collect()
}

fn blind_cameras(cameras: &[InspectedCamera]) -> Option<Finding> {
    let blind: Vec<String> = cameras.iter().filter(|c| c.detections == 0).map(|c| c.id.clone()).collect();
    let detail = "these cameras have no detections and cannot be solved; check their keypoint files".to_owned();
    (!blind.is_empty()).then_some(Finding { code: "no_person", detail, cameras: blind })
}

fn split(groups: &[Vec<String>], cameras: &[InspectedCamera]) -> Option<Finding> {
    let sees = |group: &&Vec<String>| cameras.iter().any(|c| c.detections > 0 && group.contains(&c.id));
    let seeing: Vec<&Vec<String>> = groups.iter().filter(sees).collect();
    let [_, others @ ..] = seeing.as_slice() else { return None };
    let detail = format!(
        "the cameras form {} groups that never see people at the same time; have people walk through views of all groups",
        seeing.len()
    );
    (!others.is_empty()).then(|| Finding {
        code: "split",
        detail,
        cameras: others.iter().copied().flatten().cloned().collect(),
    })
}

fn few_frames(session: &Session) -> Option<Finding> {
    let seconds = session.n_frames as f64 / session.fps;
    let detail = format!("the recording lasts {seconds:.1} s; cameras need some seconds of walking people");
    (seconds < 2.0).then_some(Finding { code: "few_frames", detail, cameras: Vec::new() })
}

/// Whether people are static in all cameras, which leaves the cameras undetermined.
fn static_people(session: &Session) -> Option<Finding> {
    let spreads: Vec<f64> = session.views.iter().filter_map(spread).collect();
    let detail = "people do not move, which leaves the cameras undetermined; have them walk about".to_owned();
    let is_static = !spreads.is_empty() && spreads.iter().all(|spread| *spread < STATIC);
    is_static.then_some(Finding { code: "static", detail, cameras: Vec::new() })
}

/// Median distance from a person to the nearest one in other frames, as a share of the people's median height: several people who
/// stand apart do not move.
fn spread(view: &View) -> Option<f64> {
    let height = median(&mut view.frames.iter().flatten().filter_map(height_px).collect::<Vec<_>>())?;
    let middles = view.frames.iter().map(|people| people.iter().filter_map(middle).collect::<Vec<_>>());
    let seen: Vec<Vec<Vector2<f64>>> = middles.filter(|people| !people.is_empty()).collect();
    let compared: Vec<_> = seen.iter().step_by(seen.len().div_ceil(MAX_COMPARED).max(1)).collect();
    let mut distances = Vec::new();
    for (i, people) in compared.iter().enumerate() {
        for (_, others) in compared.iter().enumerate().filter(|(k, _)| *k != i) {
            let nearest = |person: &Vector2<f64>| others.iter().map(|other| (other - person).norm()).reduce(f64::min);
            distances.extend(people.iter().filter_map(nearest));
        }
    }
    Some(median(&mut distances)? / height)
}

fn middle(person: &Detection) -> Option<Vector2<f64>> {
    let seen: Vec<Vector2<f64>> = person.keypoints.iter().filter(|k| k.is_present()).map(|k| k.pixel).collect();
    (!seen.is_empty()).then(|| seen.iter().sum::<Vector2<f64>>() / seen.len() as f64)
}

fn tiny_baselines(pairs: &[InspectedPair], cameras: &[InspectedCamera]) -> Vec<Finding> {
    let distance = |id: &String| cameras.iter().find(|c| c.id == *id).and_then(|c| c.distance_m);
    let tiny = pairs.iter().filter_map(|pair| {
        let far = pair.cameras.iter().filter_map(distance).reduce(f64::min)?;
        let baseline = pair.baseline_m?;
        let detail = format!(
            "the cameras are {baseline:.2} m apart and {far:.1} m from the people, which hardly determines depth; move \
             one of them"
        );
        let cameras = pair.cameras.to_vec();
        (baseline < TINY_BASELINE * far).then_some(Finding { code: "tiny_baseline", detail, cameras })
    });
    tiny.collect()
}

/// Whether three or more given cameras are collinear.
fn in_a_row(session: &Session) -> Option<Finding> {
    let centers: Option<Vec<Vector3<f64>>> =
        session.views.iter().map(|view| view.camera_from_world.as_ref().map(Rigid::center)).collect();
    let centers = centers.filter(|centers| centers.len() > 2)?;
    let mean = centers.iter().sum::<Vector3<f64>>() / centers.len() as f64;
    let scatter: Matrix3<f64> = centers.iter().map(|c| (c - mean) * (c - mean).transpose()).sum();
    let mut spreads: Vec<f64> = scatter.symmetric_eigenvalues().iter().map(|v| v.max(0.0).sqrt()).collect();
    spreads.sort_by(|a, b| b.total_cmp(a));
    let detail =
        "the cameras stand in one line, which leaves depth uncertain where all look from one side; move one of them";
    let finding = Finding { code: "collinear", detail: detail.to_owned(), cameras: Vec::new() };
    (spreads[1] < COLLINEAR * spreads[0]).then_some(finding)
}

/// Expected accuracy and time. For a joint seen by n cameras from all around each ray fixes two of three directions, so the
/// information of one direction is 2n / (3 sigma^2), and the RMS error in space sigma sqrt(9 / 2n).
fn expectation(session: &Session, cameras: &[InspectedCamera], n_threads: usize) -> Expectation {
    let sigmas = keypoint_sigmas(session.convention);
    let sigma_m = sigmas.iter().sum::<f64>() / sigmas.len().max(1) as f64;
    let detections: usize = cameras.iter().map(|camera| camera.detections).sum();
    let most_at_once = |frame: usize| session.views.iter().map(|view| view.frames[frame].len()).max().unwrap_or(0);
    let people: usize = (0..session.n_frames).map(most_at_once).sum();
    let cameras_per_person = if people == 0 { 0.0 } else { detections as f64 / people as f64 };
    let joint_error_mm = (cameras_per_person >= 1.5).then(|| 1000.0 * sigma_m * (4.5 / cameras_per_person).sqrt());
    let solve_s = REST_S + expected_secs(session, n_threads);
    Expectation { joint_error_mm, solve_s, cameras_per_person }
}

#[cfg(test)]
mod tests;
