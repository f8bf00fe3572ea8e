//! Fingers of all persons: the articulated fit of 21 points a hand, after the bodies.
//!
//! Unknowns of a hand and frame: an offset of its wrist from the body's, a rotation from the body's, and 21 angles of hinges;
//! of a person the size of both hands. Pixels of all placed cameras, smooth in time, angles within their ranges. The rotation
//! then becomes part of the body's wrist; the offset is a nuisance (a hand detector's wrist is not the body's) and is dropped.
//!
//! | file | content |
//! |---|---|
//! | `observations` | pixels of a hand by frame |
//! | `state` | the unknowns, and the hand that they pose |
//! | `terms` | pixels, ranges and smoothness with their derivatives |
//! | `problem` | both hands of a person as one least-squares problem |
//! | `person` | the fit of a person, window by window; the published hands |

mod observations;
mod person;
mod problem;
mod state;
mod terms;
#[cfg(test)]
mod tests;

use crate::body::BodyModel;
use crate::body::hand::{Side, hand_keypoints};
use crate::pipeline::calibration::TrackedPeople;
use crate::progress::{Canceled, Progress};
use crate::session::BodyMotion;
use crate::session::reconstruction::HandReport;
use person::with_fingers;
use rayon::prelude::*;

/// Fits the hands of all persons with a motion: turns their wrists, and gives each motion its fingers where at least two cameras
/// are placed and the convention has hands. Returns the statistics by motion; empty where hands were not fitted.
///
/// # Errors
/// [`Canceled`] when `progress` is canceled.
pub fn fit_hands(
    people: &TrackedPeople,
    model: &BodyModel,
    motions: &mut [BodyMotion],
    progress: &Progress,
) -> Result<Vec<Vec<HandReport>>, Canceled> {
    let n_placed = people.cameras.iter().flatten().count();
    if hand_keypoints(people.session.convention, Side::Left).is_none() || n_placed < 2 {
        return Ok(Vec::new());
    }
    progress.report(0.95, "fitting hands");
    motions.par_iter_mut().map(|motion| with_fingers(people, model, motion, progress)).collect()
}
