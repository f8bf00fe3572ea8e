//! The verdict: what a user must know before trusting a result, in sentences that can be acted on.

use crate::session::reconstruction::{Quality, Verdict};
use crate::session::recording::Session;

/// What the verdict is made from.
#[derive(Debug, Clone, Copy)]
pub struct Evidence<'a> {
    /// The recording.
    pub session: &'a Session,
    /// Whether each camera was placed.
    pub placed: &'a [bool],
    /// Share of confident keypoints explained.
    pub explained: f64,
    /// Largest standard deviation of a camera's orientation, degrees, where it is known.
    pub sigma_angle_deg: Option<f64>,
    /// Share of keypoints that the best truly different arrangement of the cameras explained; 0 without one.
    pub rival_explained: f64,
    /// Seconds of each person's track.
    pub track_secs: &'a [f64],
    /// Whether the cameras were estimated from nothing.
    pub estimated: bool,
}

/// Below these shares of explained keypoints an association is suspect, or wrong: association failures show 0.5 to 0.8.
const EXPLAINED_WARN: f64 = 0.80;
const EXPLAINED_REJECT: f64 = 0.60;

/// Orientation uncertainty beyond which a result needs a look, or is of no use, degrees. The stated sigma is of one
/// camera; the error between the two worst cameras is three to four times as large.
const SIGMA_WARN_DEG: f64 = 0.4;
const SIGMA_REJECT_DEG: f64 = 2.0;

/// A different arrangement of the cameras that explains this share of what the chosen one does is a real alternative:
/// wrong ones mistake people for each other and explain a fifth less.
const RIVAL_WARN: f64 = 0.93;

/// Shorter tracks than this in sum leave the volume uncovered, s.
const SHORT_SECS: f64 = 3.0;

/// Judges a result.
pub fn quality(evidence: &Evidence) -> Quality {
    let mut reasons: Vec<(Verdict, String)> = Vec::new();
    let n_placed = evidence.placed.iter().filter(|p| **p).count();
    if evidence.session.views.len() == 1 {
        reasons.push(one_view_reason(n_placed == 1));
    } else {
        camera_reasons(evidence, n_placed, &mut reasons);
    }
    if evidence.track_secs.is_empty() && n_placed >= evidence.session.views.len().min(2) {
        let text = match n_placed {
            1 => "nobody was seen for 0.3 s; check that the keypoint file is that of this take",
            _ => {
                "nobody was seen by two cameras at once for 0.3 s; check that the cameras overlap and are synchronised"
            }
        };
        reasons.push((Verdict::Reject, text.to_owned()));
    }
    let verdict = reasons.iter().map(|(v, _)| *v).max().unwrap_or(Verdict::Pass);
    Quality { verdict, reasons: reasons.into_iter().map(|(_, text)| text).collect() }
}

/// What a single camera leaves open.
fn one_view_reason(is_placed: bool) -> (Verdict, String) {
    if is_placed {
        let text = "one view: depth rests on body size, taken to be an average adult's, and which of two joints is nearer \
                    on how people move; add a second synchronised camera";
        (Verdict::Warn, text.to_owned())
    } else {
        let text = "monocular: one camera alone tells neither where it stands nor depth; add a second synchronised camera, or \
                    give the camera's R and t and choose \"fixed\" extrinsics";
        (Verdict::Reject, text.to_owned())
    }
}

fn camera_reasons(evidence: &Evidence, n_placed: usize, reasons: &mut Vec<(Verdict, String)>) {
    for (view, placed) in evidence.session.views.iter().zip(evidence.placed) {
        if !placed {
            let verdict = if n_placed >= 2 { Verdict::Warn } else { Verdict::Reject };
            let text = format!(
                "camera {} could not be placed: it shares no consistent view of people with the others; check its frames, \
                 intrinsics and synchronisation",
                view.id
            );
            reasons.push((verdict, text));
        }
    }
    if evidence.explained < EXPLAINED_WARN && n_placed >= 2 {
        let verdict = if evidence.explained < EXPLAINED_REJECT { Verdict::Reject } else { Verdict::Warn };
        let text = format!(
            "only {:.0} % of confident keypoints agree between cameras (expected above {:.0} %); check synchronisation and \
             intrinsics, or look for people whom a single camera sees",
            100.0 * evidence.explained,
            100.0 * EXPLAINED_WARN
        );
        reasons.push((verdict, text));
    }
    if !evidence.estimated {
        return;
    }
    match evidence.sigma_angle_deg {
        Some(sigma) if sigma > SIGMA_WARN_DEG => {
            let verdict = if sigma > SIGMA_REJECT_DEG { Verdict::Reject } else { Verdict::Warn };
            let text = format!(
                "weak geometry: camera orientations are known to {sigma:.1} degrees only (expected below {SIGMA_WARN_DEG}); let \
                 people walk through more of the volume, or move cameras that look at each other or stand together"
            );
            reasons.push((verdict, text));
        }
        None if n_placed >= 2 => reasons.push((
            Verdict::Warn,
            "the uncertainty of the cameras could not be computed: too few points are shared; record people longer"
                .to_owned(),
        )),
        _ => {}
    }
    if evidence.rival_explained > RIVAL_WARN * evidence.explained {
        let text = format!(
            "ambiguous: a different arrangement of the cameras explains {:.0} % as much; record people moving independently",
            100.0 * evidence.rival_explained / evidence.explained.max(1e-9)
        );
        reasons.push((Verdict::Warn, text));
    }
    let seconds: f64 = evidence.track_secs.iter().sum();
    if seconds < SHORT_SECS && !evidence.track_secs.is_empty() {
        let text =
            format!("little evidence: {seconds:.1} s of people in all (expected above {SHORT_SECS} s); record longer");
        reasons.push((Verdict::Warn, text));
    }
}
