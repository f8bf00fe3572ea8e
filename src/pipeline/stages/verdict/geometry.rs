//! Problems of the recording as a whole: its length, the movement of people, the angles between views, and the scale.

use super::input::VerdictInput;
use super::reason::{Bounds, Reason};

/// Total length of all tracks below which the volume is not covered, s.
const SHORT_SECS: f64 = 3.0;

/// Root mean square distance of people from their mean position, m, below which the cameras depend on body size alone, and
/// a bias of the detector goes into the cameras. Standing and gesturing gives 0.05 m, a few steps 0.25 m.
const SPREAD_WARN: f64 = 0.15;

/// Median angle between rays, degrees. Two rays at an angle `a` place a point to `sigma / sqrt(1 - cos a)` along
/// them: 2.7 sigma at 30 degrees, 16 sigma at 5.
pub(super) const RAY_ANGLE_DEG: Bounds = Bounds { warn: 30.0, reject: 5.0 };

/// Half of the 95 % interval of the scale's logarithm. One adult gives 0.11, a group that may hold a child more.
const SCALE_WARN: f64 = 0.15;

/// How many times likelier than any other the way up has to be. Two cameras of upright people make it ten times as likely, two of people
/// who lie leave it open.
const UP_RATIO: f64 = 7.0;

pub(super) fn reasons(input: &VerdictInput) -> Vec<Reason> {
    let of_estimate = || short_recording(input).into_iter().chain(static_people(input)).chain(uncertain_up(input));
    let of_estimate = input.estimated.then(of_estimate).into_iter().flatten();
    of_estimate.chain(narrow_angles(input)).chain(uncertain_scale(input)).collect()
}

fn short_recording(input: &VerdictInput) -> Option<Reason> {
    let frames: i64 = input.people.iter().map(|person| person.last_frame - person.first_frame + 1).sum();
    let seconds = frames as f64 / input.fps;
    let text =
        format!("short recording: {seconds:.1} s of people in total (expected above {SHORT_SECS} s); record longer");
    (seconds < SHORT_SECS && frames > 0).then(|| Reason::warn(text))
}

fn static_people(input: &VerdictInput) -> Option<Reason> {
    let spread = input.geometry.people_spread_m.filter(|spread| *spread < SPREAD_WARN)?;
    Some(Reason::warn(format!(
        "weak geometry: people stay within {spread:.2} m of one place (expected above {SPREAD_WARN} m), so the cameras depend \
         on body size alone; have a person walk through the volume for some seconds"
    )))
}

/// Rays that are nearly parallel: cameras side by side, or face to face.
fn narrow_angles(input: &VerdictInput) -> Option<Reason> {
    let angle = input.geometry.ray_angle_deg?;
    let verdict = RAY_ANGLE_DEG.on_low(angle)?;
    let placed: Vec<&str> = input.cameras.iter().filter(|c| c.solved).map(|c| c.id.as_str()).collect();
    let text = format!(
        "weak geometry: the rays of cameras {} cross at {angle:.0} degrees (expected above {}), as with cameras side by \
         side or face to face; move one so that it looks across the others",
        placed.join(", "),
        RAY_ANGLE_DEG.warn
    );
    Some(Reason { verdict, text })
}

/// People who lie or stand on their hands before few cameras.
fn uncertain_up(input: &VerdictInput) -> Option<Reason> {
    let rival = input.up_rival.filter(|rival| rival.ratio < UP_RATIO)?;
    let text = format!(
        "weak geometry: which way is up is uncertain: by how cameras stand and people hold themselves, a direction {:.0} degrees away is \
         only {:.1} times less likely (expected above {UP_RATIO}); have a person stand upright for some seconds, or set the cameras level",
        rival.angle_deg, rival.ratio
    );
    Some(Reason::warn(text))
}

/// A group that may hold children or not.
fn uncertain_scale(input: &VerdictInput) -> Option<Reason> {
    let [low, high] = input.scale?.interval95;
    let half = (high / low).ln() / 2.0;
    let text = format!(
        "metric scale: all lengths are uncertain by {:.0} % (expected below {:.0} %), as where one of two people may be a child; give \
         the height of a person or the distance of two cameras (option scale)",
        100.0 * half,
        100.0 * SCALE_WARN
    );
    (half > SCALE_WARN).then(|| Reason::warn(text))
}
