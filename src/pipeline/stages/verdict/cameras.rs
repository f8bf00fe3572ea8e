//! What speaks against the cameras.

use super::{Bounds, Evidence, Reason};
use crate::optim::robust::median;
use crate::session::reconstruction::CameraReport;

/// Shares of explained keypoints below which an association is suspect, or wrong: association failures show 0.5 to 0.8.
const EXPLAINED: Bounds = Bounds { warn: 0.80, reject: 0.60 };

/// Orientation uncertainty, degrees. The stated sigma is of one camera; the error between the two worst cameras is three
/// to four times as large.
const SIGMA_DEG: Bounds = Bounds { warn: 0.4, reject: 2.0 };

/// A different arrangement of the cameras that explains this share of what the chosen one does is a real alternative:
/// wrong ones mistake people for each other and explain a fifth less.
const RIVAL_WARN: f64 = 0.93;

/// A camera whose median error on the body is this many times that of the others stands out: detectors and distances make
/// a difference of a tenth to a quarter.
const ODD_ERROR: f64 = 1.6;

/// A camera that loses so much more of its keypoints, or of its detections, than the others do, share: occlusion makes a
/// difference of 0.1, bystanders more.
const ODD_LOSS: f64 = 0.25;

pub(super) fn reasons(evidence: &Evidence) -> Vec<Reason> {
    let mut reasons: Vec<Reason> =
        unplaced(evidence).chain(odd_cameras(evidence)).chain(disagreement(evidence)).collect();
    if evidence.estimated {
        reasons.extend(uncertain(evidence));
        reasons.extend(ambiguous(evidence));
    }
    reasons
}

fn unplaced(evidence: &Evidence) -> impl Iterator<Item = Reason> {
    let is_rest_solved = evidence.n_placed() >= 2;
    evidence.cameras.iter().filter(|camera| !camera.solved).map(move |camera| {
        let text = format!(
            "camera {} could not be placed: it shares no consistent view of people with the others; check its frames, \
             intrinsics and synchronisation",
            camera.id
        );
        if is_rest_solved { Reason::warn(text) } else { Reason::reject(text) }
    })
}

/// Cameras that fit far worse than the others; of two cameras none stands out.
fn odd_cameras(evidence: &Evidence) -> Vec<Reason> {
    let judged: Vec<&CameraReport> = evidence.cameras.iter().filter(|camera| camera.solved).collect();
    if judged.len() < 3 {
        return Vec::new();
    }
    let others_of = |k: usize| -> Vec<&CameraReport> { [&judged[..k], &judged[k + 1..]].concat() };
    judged.iter().enumerate().filter_map(|(k, camera)| odd_camera(camera, &others_of(k))).collect()
}

fn odd_camera(camera: &CameraReport, others: &[&CameraReport]) -> Option<Reason> {
    let compared = |figure: fn(&CameraReport) -> Option<f64>| {
        let usual = median(&mut others.iter().filter_map(|other| figure(other)).collect::<Vec<_>>())?;
        Some((figure(camera)?, usual))
    };
    let error = compared(|camera| camera.reprojection_mm.map(|mm| mm.median));
    let keypoints = compared(|camera| Some(camera.rejected_keypoints));
    let detections = compared(|camera| Some(rejected_detections(camera)));
    let found = if let Some((own, usual)) = error.filter(|(own, usual)| *own > ODD_ERROR * usual) {
        format!("lies {own:.0} mm off in the median, the others {usual:.0} mm")
    } else if let Some((own, usual)) = keypoints.filter(|(own, usual)| *own > usual + ODD_LOSS) {
        format!("contradicts the others in {:.0} % of its keypoints (theirs: {:.0} %)", 100.0 * own, 100.0 * usual)
    } else if let Some((own, usual)) = detections.filter(|(own, usual)| *own > usual + ODD_LOSS) {
        format!("shows nobody known in {:.0} % of its detections (the others: {:.0} %)", 100.0 * own, 100.0 * usual)
    } else {
        return None;
    };
    let remedy = "check whether it was moved during the take, its intrinsics and its synchronisation, or leave it out";
    Some(Reason::warn(format!("camera {} {found}; {remedy}", camera.id)))
}

/// Share of a camera's detections given to nobody, 0 to 1.
fn rejected_detections(camera: &CameraReport) -> f64 {
    camera.n_rejected_detections as f64 / camera.n_detections.max(1) as f64
}

fn disagreement(evidence: &Evidence) -> Option<Reason> {
    let verdict = EXPLAINED.on_low(evidence.explained).filter(|_| evidence.n_placed() >= 2)?;
    let text = format!(
        "only {:.0} % of confident keypoints agree between cameras (expected above {:.0} %); check synchronisation and \
         intrinsics, or look for people whom a single camera sees",
        100.0 * evidence.explained,
        100.0 * EXPLAINED.warn
    );
    Some(Reason { verdict, text })
}

fn uncertain(evidence: &Evidence) -> Option<Reason> {
    let Some(sigma) = evidence.sigma_angle_deg else {
        let text =
            "the uncertainty of the cameras could not be computed: too few points are shared; record people longer";
        return (evidence.n_placed() >= 2).then(|| Reason::warn(text.to_owned()));
    };
    let text = format!(
        "weak geometry: camera orientations are known to {sigma:.1} degrees only (expected below {}); let people walk \
         through more of the volume, or move cameras that look at each other or stand together",
        SIGMA_DEG.warn
    );
    SIGMA_DEG.on_high(sigma).map(|verdict| Reason { verdict, text })
}

fn ambiguous(evidence: &Evidence) -> Option<Reason> {
    let text = format!(
        "ambiguous: a different arrangement of the cameras explains {:.0} % as much; record people moving independently",
        100.0 * evidence.rival_explained / evidence.explained.max(1e-9)
    );
    (evidence.rival_explained > RIVAL_WARN * evidence.explained).then(|| Reason::warn(text))
}
