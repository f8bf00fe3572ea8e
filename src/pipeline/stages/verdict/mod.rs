//! The verdict: problems that a user must know before using a result, each with a remedy.
//!
//! A reason states what was found, on which camera or person, what was expected, and after its last semicolon what to do.
//! Why fixed bounds and not comparisons alone: in a recording that is bad throughout, no camera or person differs from the
//! others.

mod cameras;
mod geometry;
pub mod input;
mod people;
mod reason;
mod suspicions;
#[cfg(test)]
mod tests;

use crate::session::reconstruction::{Quality, Verdict};
use input::VerdictInput;
use reason::Reason;

/// Judges a result.
pub fn quality(input: &VerdictInput) -> Quality {
    let mut reasons = suspicions::reasons(input);
    if input.cameras.len() == 1 {
        reasons.push(monocular(input.n_placed() == 1));
    } else {
        reasons.extend(cameras::reasons(input));
        reasons.extend(geometry::reasons(input));
        reasons.extend(people::reasons(input));
    }
    reasons.extend(people::without_body(input));
    reasons.extend(no_person(input));
    let verdict = reasons.iter().map(|reason| reason.verdict).max().unwrap_or(Verdict::Pass);
    Quality { verdict, reasons: reasons.into_iter().map(|reason| reason.text).collect() }
}

/// Limits of a single camera.
fn monocular(is_placed: bool) -> Reason {
    if is_placed {
        let text = "monocular: depth is estimated from an average adult's body size, and the depth order of joints from typical \
                    poses; add a second synchronised camera";
        Reason::warn(text.to_owned())
    } else {
        let text = "monocular: a single camera determines neither its own pose nor depth; add a second synchronised camera, or \
                    choose \"fixed\" extrinsics, which takes the camera's R and t from the session";
        Reason::reject(text.to_owned())
    }
}

fn no_person(input: &VerdictInput) -> Option<Reason> {
    let n_placed = input.n_placed();
    let text = match n_placed {
        1 => "no person was detected for 0.3 s; check that the keypoint file belongs to this recording",
        _ if input.estimated => {
            "no person was seen by two cameras at once for 0.3 s; check that the cameras overlap and are synchronised"
        }
        _ => {
            "no person was seen by two cameras at once for 0.3 s; check that R and t are right, in metres, and that the cameras \
             overlap and are synchronised"
        }
    };
    let is_possible = n_placed >= input.cameras.len().min(2);
    (is_possible && input.people.is_empty() && input.without_body.is_empty()).then(|| Reason::reject(text.to_owned()))
}
