//! Problems of the cameras.

use super::input::{PoseChange, VerdictInput};
use super::reason::{Bounds, Reason};
use crate::optim::robust::median;
use crate::session::reconstruction::CameraReport;

/// Share of explained keypoints: a failed association gives 0.5 to 0.8.
const EXPLAINED: Bounds = Bounds { warn: 0.80, reject: 0.60 };

/// Orientation uncertainty of one camera, degrees; the error between the two worst cameras is three to four times as
/// large.
const SIGMA_DEG: Bounds = Bounds { warn: 0.4, reject: 2.0 };

/// A different arrangement of the cameras that explains this share of what the chosen one explains is an alternative: wrong
/// ones exchange people and explain a fifth less.
const RIVAL_WARN: f64 = 0.93;

/// Logarithm of the likelihood ratio to focal lengths as given, 20 to 1 (strong evidence by Kass and Raftery, JASA 1995, section 3.2).
/// Right lenses of simulated captures reach 2; where each is 3 % off, it is 1 to 8 in half of the sessions, too little to change them.
const LENS_EVIDENCE_WARN: f64 = 3.0;

/// Ratio of a camera's median error on the body to that of the others from which it is reported: detectors and distances
/// give a difference of a tenth to a quarter.
const ODD_ERROR: f64 = 1.6;

/// Excess of a camera's share of rejected keypoints or detections over that of the others: occlusion gives a difference of
/// 0.1, bystanders up to 0.16.
const ODD_LOSS: f64 = 0.2;

/// The same of both together, where the share of keypoints is a multiple of that of the others, which bystanders do not raise: right
/// recordings reach 0.1.
const ODD_LOSS_OF_BOTH: f64 = 0.12;
const ODD_KEYPOINTS: f64 = 3.0;

/// Refined cameras this far from their given poses contradict them: four standard deviations, as which given poses count as known to
/// 0.3 degrees and 20 mm per axis.
const FAR_FROM_GIVEN_DEG: f64 = 1.2;
const FAR_FROM_GIVEN_MM: f64 = 80.0;

pub(super) fn reasons(input: &VerdictInput) -> Vec<Reason> {
    let mut reasons: Vec<Reason> = unsolved(input).chain(odd_cameras(input)).chain(disagreement(input)).collect();
    reasons.extend(input.cameras.iter().filter_map(still));
    reasons.extend(doubtful_lenses(input));
    reasons.extend(input.changes.iter().filter_map(far_from_given));
    if input.estimated {
        reasons.extend(uncertain(input));
        reasons.extend(ambiguous(input));
    }
    reasons
}

/// Whether a suspicion explains what is wrong with a camera.
fn is_named(input: &VerdictInput, camera: &CameraReport) -> bool {
    input.suspicions.iter().any(|suspicion| !suspicion.applied && suspicion.cameras.contains(&camera.id))
}

fn unsolved(input: &VerdictInput) -> impl Iterator<Item = Reason> {
    let is_rest_solved = input.n_placed() >= 2;
    let unsolved = input.cameras.iter().filter(|camera| !camera.solved && !camera.excluded && !is_named(input, camera));
    unsolved.map(move |camera| {
        let why = match camera.n_detections {
            0 => "it has no detections; check its keypoint files",
            _ => "its detections agree with no other camera; check its frames, intrinsics and synchronisation",
        };
        let text = format!("camera {} could not be placed: {why}", camera.id);
        if is_rest_solved { Reason::warn(text) } else { Reason::reject(text) }
    })
}

/// Cameras with much larger errors than the others; two cameras are not compared.
fn odd_cameras(input: &VerdictInput) -> Vec<Reason> {
    let judged: Vec<&CameraReport> = input.cameras.iter().filter(|camera| camera.solved).collect();
    if judged.len() < 3 {
        return Vec::new();
    }
    let others_of = |k: usize| -> Vec<&CameraReport> { [&judged[..k], &judged[k + 1..]].concat() };
    let unnamed = judged.iter().enumerate().filter(|(_, camera)| !is_named(input, camera));
    unnamed.filter_map(|(k, camera)| odd_camera(input, camera, &others_of(k))).collect()
}

/// What given poses add to the things to check.
fn given_poses(input: &VerdictInput) -> &'static str {
    if input.estimated { "" } else { "R and t, " }
}

fn odd_camera(input: &VerdictInput, camera: &CameraReport, others: &[&CameraReport]) -> Option<Reason> {
    let compared = |statistic: fn(&CameraReport) -> Option<f64>| {
        let usual = median(&mut others.iter().filter_map(|other| statistic(other)).collect::<Vec<_>>())?;
        Some((statistic(camera)?, usual))
    };
    let error = compared(|camera| camera.reprojection_mm.map(|mm| mm.median));
    let keypoints = compared(|camera| Some(camera.rejected_keypoints));
    let detections = compared(|camera| Some(rejected_detections(camera)));
    let found = if let Some((own, usual)) = error.filter(|(own, usual)| *own > ODD_ERROR * usual) {
        format!("has a median error of {own:.0} mm, the others {usual:.0} mm")
    } else if let Some((own, usual)) = keypoints.filter(|(own, usual)| *own > usual + ODD_LOSS) {
        format!("contradicts the others in {:.0} % of its keypoints (the others: {:.0} %)", 100.0 * own, 100.0 * usual)
    } else if let Some((own, usual)) = detections.filter(|(own, usual)| *own > usual + ODD_LOSS) {
        format!("shows no known person in {:.0} % of its detections (the others: {:.0} %)", 100.0 * own, 100.0 * usual)
    } else if let (Some((own, usual)), Some((own_lost, usual_lost))) = (keypoints, detections)
        && own > ODD_KEYPOINTS * usual
        && own - usual + own_lost - usual_lost > ODD_LOSS_OF_BOTH
    {
        let percent = [own_lost, own, usual_lost, usual].map(|share| format!("{:.0} %", 100.0 * share));
        format!(
            "shows no known person in {} of its detections and contradicts the others in {} of its keypoints (the others: {} and {})",
            percent[0], percent[1], percent[2], percent[3]
        )
    } else {
        return None;
    };
    Some(Reason::warn(format!(
        "camera {} {found}; check whether it was moved during the recording, its {}intrinsics and synchronisation, or leave it \
         out",
        camera.id,
        given_poses(input)
    )))
}

/// Share of a camera's detections without a person, 0 to 1; what stays at one place has a reason of its own.
fn rejected_detections(camera: &CameraReport) -> f64 {
    let n_still = n_still(camera);
    camera.n_rejected_detections.saturating_sub(n_still) as f64 / (camera.n_detections - n_still).max(1) as f64
}

fn n_still(camera: &CameraReport) -> usize {
    camera.still_detections.iter().map(|still| still.n_detections).sum()
}

/// Something that does not move, and that no other camera shows.
fn still(camera: &CameraReport) -> Option<Reason> {
    let longest = camera.still_detections.iter().filter(|_| camera.solved).max_by_key(|still| still.n_detections)?;
    let [x, y] = longest.pixel;
    let others = match camera.still_detections.len() - 1 {
        0 => String::new(),
        n => format!(", {n} more at other places"),
    };
    Some(Reason::warn(format!(
        "camera {} has {} detections about pixel ({x:.0}, {y:.0}) in frames {} to {} that do not move{others}, where no other camera \
         shows a person: a picture, a mirror image, or a person who sits still; they are left out, mask that place unless it is a \
         person",
        camera.id, longest.n_detections, longest.first_frame, longest.last_frame
    )))
}

fn disagreement(input: &VerdictInput) -> Option<Reason> {
    let explained = explained_of_moving(input);
    let verdict = EXPLAINED.on_low(explained).filter(|_| input.n_placed() >= 2)?;
    let text = format!(
        "only {:.0} % of confident keypoints agree between cameras (expected above {:.0} %); check {}intrinsics and \
         synchronisation, or look for people that only one camera sees",
        100.0 * explained,
        100.0 * EXPLAINED.warn,
        given_poses(input)
    );
    Some(Reason { verdict, text })
}

/// Share of confident keypoints that are explained, without those that stay at one place.
fn explained_of_moving(input: &VerdictInput) -> f64 {
    let placed = || input.cameras.iter().filter(|camera| camera.solved);
    let n_detections: usize = placed().map(|camera| camera.n_detections).sum();
    let n_moving = n_detections - placed().map(n_still).sum::<usize>();
    (input.explained * n_detections as f64 / n_moving.max(1) as f64).min(1.0)
}

fn uncertain(input: &VerdictInput) -> Option<Reason> {
    let Some(sigma) = input.sigma_angle_deg else {
        let text =
            "the uncertainty of the cameras could not be computed: too few points are shared; record people longer";
        return (input.n_placed() >= 2).then(|| Reason::warn(text.to_owned()));
    };
    let text = format!(
        "weak geometry: camera orientations are uncertain by {sigma:.1} degrees (expected below {}); have people walk \
         through more of the volume, or move cameras that face each other or are close together",
        SIGMA_DEG.warn
    );
    SIGMA_DEG.on_high(sigma).map(|verdict| Reason { verdict, text })
}

fn doubtful_lenses(input: &VerdictInput) -> Option<Reason> {
    let evidence = input.lens_evidence.filter(|evidence| *evidence > LENS_EVIDENCE_WARN)?;
    Some(Reason::warn(format!(
        "focal lengths stay as given, but the recording is {:.0} times likelier under others, too little to change them: they may be wrong \
         by some per cent, and cameras by centimetres; calibrate the lenses, or have people walk through more of the volume for longer",
        evidence.exp()
    )))
}

/// A camera whose given pose the recording contradicts, and which that pose holds back.
fn far_from_given(change: &PoseChange) -> Option<Reason> {
    let PoseChange { camera, angle_deg, distance_mm } = change;
    let text = format!(
        "camera {camera} is {angle_deg:.1} degrees and {distance_mm:.0} mm from its given pose (expected below {FAR_FROM_GIVEN_DEG} and \
         {FAR_FROM_GIVEN_MM}), which draws it and the others towards a wrong place; correct its R and t, or choose extrinsics: estimate"
    );
    (*angle_deg > FAR_FROM_GIVEN_DEG || *distance_mm > FAR_FROM_GIVEN_MM).then(|| Reason::warn(text))
}

fn ambiguous(input: &VerdictInput) -> Option<Reason> {
    let text = format!(
        "ambiguous: a different arrangement of the cameras explains {:.0} % as much; record people who move independently",
        100.0 * input.rival_explained / input.explained.max(1e-9)
    );
    (input.rival_explained > RIVAL_WARN * input.explained).then(|| Reason::warn(text))
}
