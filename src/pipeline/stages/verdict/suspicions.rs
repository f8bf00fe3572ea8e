//! Probable mistakes in the files of the recording.

use super::input::VerdictInput;
use super::reason::Reason;
use crate::session::{Suspicion, SuspicionCode as Code};

pub(super) fn reasons(input: &VerdictInput) -> Vec<Reason> {
    let reason = |code: Code, text: String| match code {
        // People or space are mirrored, or nothing is where it was.
        Code::Handedness | Code::YUpwards | Code::NormalizedCoordinates => Reason::reject(text),
        _ => Reason::warn(text),
    };
    let of = |suspicion: &Suspicion| match suspicion.applied {
        true => Reason::warn(format!("repaired: {suspicion}")),
        false => reason(suspicion.code, suspicion.sentence()),
    };
    input.suspicions.iter().map(of).collect()
}
