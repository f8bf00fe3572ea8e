//! What speaks against the capture as a whole: who walked where, for how long, seen from where.

use super::{Bounds, Evidence, Reason};

/// Shorter tracks than this in sum leave the volume uncovered, s.
const SHORT_SECS: f64 = 3.0;

/// People who keep within this distance of one place (root mean square, m) shape the cameras' places by their own size
/// alone, and a bias of the detector goes into the cameras unseen. Standing and gesturing makes 0.05 m, a few steps 0.25.
const SPREAD_WARN: f64 = 0.15;

/// Median angle under which rays cross, degrees. Two rays at an angle `a` place a point to `sigma / sqrt(1 - cos a)` along
/// them: 2.7 sigma at 30 degrees, 16 sigma at 5.
pub(super) const RAY_ANGLE_DEG: Bounds = Bounds { warn: 30.0, reject: 5.0 };

pub(super) fn reasons(evidence: &Evidence) -> Vec<Reason> {
    let of_estimate = || little_evidence(evidence).into_iter().chain(unmoved(evidence));
    let of_estimate = evidence.estimated.then(of_estimate).into_iter().flatten();
    of_estimate.chain(narrow(evidence)).collect()
}

fn little_evidence(evidence: &Evidence) -> Option<Reason> {
    let frames: i64 = evidence.people.iter().map(|person| person.last_frame - person.first_frame + 1).sum();
    let seconds = frames as f64 / evidence.fps;
    let text =
        format!("little evidence: {seconds:.1} s of people in all (expected above {SHORT_SECS} s); record longer");
    (seconds < SHORT_SECS && frames > 0).then(|| Reason::warn(text))
}

fn unmoved(evidence: &Evidence) -> Option<Reason> {
    let spread = evidence.geometry.people_spread_m.filter(|spread| *spread < SPREAD_WARN)?;
    Some(Reason::warn(format!(
        "weak geometry: people keep within {spread:.2} m of one place (expected above {SPREAD_WARN} m), so the cameras rest \
         on one body's size; let somebody walk through the volume for some seconds"
    )))
}

/// Rays that run nearly along one line: cameras side by side, or face to face.
fn narrow(evidence: &Evidence) -> Option<Reason> {
    let angle = evidence.geometry.ray_angle_deg?;
    let verdict = RAY_ANGLE_DEG.on_low(angle)?;
    let placed: Vec<&str> = evidence.cameras.iter().filter(|c| c.solved).map(|c| c.id.as_str()).collect();
    let text = format!(
        "weak geometry: the rays of cameras {} cross at {angle:.0} degrees (expected above {}), as of cameras side by side \
         or face to face; move one so that it looks across the others",
        placed.join(", "),
        RAY_ANGLE_DEG.warn
    );
    Some(Reason { verdict, text })
}
