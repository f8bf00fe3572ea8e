//! Ground truth of a simulated session, and its files.

use super::config::{Bodies, SimulationConfig};
use super::hands::{HandSource, has_details};
use super::scene::{SimulatedScene, ViewRecording};
use super::skeleton::SimulatedPerson;
use crate::body::default_body;
use crate::body::skeleton::{JOINT_NAMES, N_JOINTS};
use crate::geometry::Rigid;
use crate::session::Session;
use nalgebra::Vector3;
use serde::Serialize;
use serde_json::json;
use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::Path;

/// A simulated session with its truth and configuration.
#[derive(Debug, Clone, PartialEq)]
pub struct Simulated {
    /// The session as a user would upload it.
    pub session: Session,
    /// Its exact truth.
    pub truth: Truth,
    /// Its configuration.
    pub config: SimulationConfig,
}

/// Exact truth. World: y up, m, floor at y = 0.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// `camera_from_world`, per view.
    pub cameras: Vec<Rigid>,
    /// `joints[frame][person][joint]`, SMPL's order.
    pub joints: Vec<Vec<[Vector3<f64>; N_JOINTS]>>,
    /// `keypoints[frame][person][keypoint]`, including the keypoint bias.
    pub keypoints: Vec<Vec<Vec<Vector3<f64>>>>,
    /// `identities[view][frame][detection]`: the true person; `None` for a ghost.
    pub identities: Vec<Vec<Vec<Option<usize>>>>,
    /// `details[frame][person]`: points of face, left and right hand, where the convention has them.
    pub details: Vec<Vec<Vec<Vector3<f64>>>>,
    /// `hands[view][frame][detection]`: whose left and right hand a detection has; empty where the convention has no hands.
    pub hands: Vec<Vec<Vec<[Option<HandSource>; 2]>>>,
    /// Bodies and their motion.
    pub people: Vec<SimulatedPerson>,
    /// Counts and errors of the detections.
    pub statistics: Statistics,
}

/// Counts and errors of a session's detections.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Statistics {
    /// Number of detections of people.
    pub det: usize,
    /// Number of people, views and frames with at least four points in the image.
    pub det_possible: usize,
    /// `det / det_possible`.
    pub det_rate: f64,
    /// Number of points reported.
    pub joints: usize,
    /// Number of points in the image, of the people detected.
    pub joints_in_view: usize,
    /// `joints / joints_in_view`.
    pub joint_rate: f64,
    /// Number of identity swaps.
    pub swaps: usize,
    /// Number of left/right flips.
    pub flips: usize,
    /// Number of outliers reported.
    pub outliers: usize,
    /// Number of detections of ghosts; only with [`RealNoise`](super::RealNoise).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ghosts: Option<usize>,
    /// Number of limbs reported in the detection of another person; only with [`RealNoise`](super::RealNoise).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub merged_limbs: Option<usize>,
    /// Median error of the reported points, before limbs are merged, px.
    pub err_px_median: Option<f64>,
    /// 95th percentile of the error, px.
    pub err_px_p95: Option<f64>,
    /// 99th percentile of the error, px.
    pub err_px_p99: Option<f64>,
    /// Seed of the session.
    pub seed: u64,
    /// Number of people.
    pub people: usize,
    /// Number of cameras.
    pub views: usize,
    /// Number of frames.
    pub frames: usize,
    /// Name of each person's motion source.
    pub sources: Vec<String>,
}

pub(super) fn statistics(
    config: &SimulationConfig,
    scene: &SimulatedScene,
    recordings: &[ViewRecording],
    people: &[SimulatedPerson],
) -> Statistics {
    let sum = |count: fn(&ViewRecording) -> usize| recordings.iter().map(count).sum::<usize>();
    let mut errors: Vec<f64> = recordings.iter().flat_map(|r| r.tally.errors_px.iter().copied()).collect();
    errors.sort_by(f64::total_cmp);
    let percentile = |share: f64| errors.get(((errors.len() as f64 - 1.0).max(0.0) * share).round() as usize).copied();
    let det = sum(|r| r.identities.iter().flatten().flatten().count());
    let (det_possible, joints) = (sum(|r| r.tally.detections_possible), sum(|r| r.tally.joints));
    let joints_in_view = sum(|r| r.tally.joints_in_view);
    Statistics {
        det,
        det_possible,
        det_rate: det as f64 / det_possible.max(1) as f64,
        joints,
        joints_in_view,
        joint_rate: joints as f64 / joints_in_view.max(1) as f64,
        swaps: sum(|r| r.tally.swaps),
        flips: sum(|r| r.tally.flips),
        outliers: sum(|r| r.tally.outliers),
        ghosts: config.noise.real.map(|_| sum(|r| r.tally.ghosts)),
        merged_limbs: config.noise.real.map(|_| sum(|r| r.tally.merged_limbs)),
        err_px_median: percentile(0.5),
        err_px_p95: percentile(0.95),
        err_px_p99: percentile(0.99),
        seed: config.seed,
        people: config.people,
        views: recordings.len(),
        frames: scene.joints.len(),
        sources: people.iter().map(|p| p.source.clone()).collect(),
    }
}

/// Writes `gt/cameras.json`, `gt/poses3d.json`, `gt/keypoints3d.json`, `gt/identities.json`, `gt/simulation.json`, and
/// `gt/bodies.json` if people are default bodies, `gt/hands3d.json` (points of face, left and right hand) and `gt/hands.json` (whose
/// hands a detection has) if the convention has hands, under `session_folder`, which is created if it does not exist. Points are
/// rounded to a thousandth of a millimetre; the identity of a ghost is `null`.
///
/// # Errors
/// What the file system reports.
pub fn write_truth(simulated: &Simulated, session_folder: &Path) -> io::Result<()> {
    let (session, truth) = (&simulated.session, &simulated.truth);
    let folder = session_folder.join("gt");
    fs::create_dir_all(&folder)?;
    let write = |name: &str, value: &serde_json::Value| fs::write(folder.join(name), format!("{value}\n"));
    let ids = || session.views.iter().map(|view| view.id.as_str());
    let offsets = simulated.config.time_offsets.iter().copied().chain(std::iter::repeat(0.0));
    let camera = |((id, camera), offset): ((&str, &Rigid), f64)| {
        let rows: Vec<Vec<f64>> = camera.rotation.row_iter().map(|row| row.iter().copied().collect()).collect();
        let mut camera = json!({"id": id, "R": rows, "t": camera.translation.as_slice(), "units": "m"});
        if offset != 0.0 {
            camera["time_offset_s"] = json!(offset / session.fps);
        }
        camera
    };
    write("cameras.json", &ids().zip(&truth.cameras).zip(offsets).map(camera).collect())?;
    let joints = frames(truth.joints.iter().map(|people| people.iter().map(|j| j.as_slice())));
    write("poses3d.json", &json!({"joint_names": JOINT_NAMES, "units": "m", "up": "y", "frames": joints}))?;
    let points = frames(truth.keypoints.iter().map(|people| people.iter().map(Vec::as_slice)));
    let names = session.convention.names();
    write("keypoints3d.json", &json!({"keypoint_names": names, "units": "m", "up": "y", "frames": points}))?;
    if has_details(session.convention) {
        let points = frames(truth.details.iter().map(|people| people.iter().map(Vec::as_slice)));
        let hands: BTreeMap<&str, _> = ids().zip(&truth.hands).collect();
        write("hands3d.json", &json!({"units": "m", "up": "y", "face": 68, "hand": 21, "frames": points}))?;
        write("hands.json", &json!(hands))?;
    }
    let identities: BTreeMap<&str, &Vec<Vec<Option<usize>>>> = ids().zip(&truth.identities).collect();
    write("identities.json", &json!(identities))?;
    let model = default_body();
    let body = |person: &SimulatedPerson| {
        let betas = person.betas?;
        let mut body = json!({"betas": betas.as_slice(), "stature_m": model.surface.stature(&betas)});
        if simulated.config.bodies == Bodies::Individual {
            body["joint_shifts_m"] = json!(person.joint_shifts.map(|shift| [shift.x, shift.y, shift.z]));
        }
        Some(body)
    };
    if let Some(bodies) = truth.people.iter().map(body).collect() {
        write("bodies.json", &serde_json::Value::Array(bodies))?;
    }
    write("simulation.json", &json!({"params": simulated.config, "stats": truth.statistics}))
}

type Frames = BTreeMap<usize, BTreeMap<usize, Vec<[f64; 3]>>>;

fn frames<'a>(frames: impl Iterator<Item = impl Iterator<Item = &'a [Vector3<f64>]>>) -> Frames {
    let rounded = |point: &Vector3<f64>| [point.x, point.y, point.z].map(|v| (v * 1e6).round() / 1e6);
    let people = |people: &mut dyn Iterator<Item = &'a [Vector3<f64>]>| {
        people.enumerate().map(|(person, points)| (person, points.iter().map(rounded).collect())).collect()
    };
    frames.enumerate().map(|(frame, mut of_frame)| (frame, people(&mut of_frame))).collect()
}
