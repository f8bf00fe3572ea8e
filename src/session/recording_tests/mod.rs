//! Tests of a recording that need no solution: each looks for one mistake in the files and returns a suspicion.
//!
//! They run when a session is read (as warnings), when it is inspected, and in every job, whose verdict states them.
//!
//! - `image`: pixels outside or in a corner of the image, principal point, normalised coordinates
//! - `quarter_turn`: people who lie on their sides where the images were turned after the calibration
//! - `repetition`: the same keypoints in two cameras or in successive frames, periodic gaps
//! - `doubles`: people who are detected twice in an image
//! - `detector`: confidences, order of the keypoints
//! - `given_poses`: given poses of the cameras against epipolar lines

mod detector;
mod doubles;
mod given_poses;
mod image;
mod quarter_turn;
mod repetition;
#[cfg(test)]
mod tests;

pub use detector::{best_confidence, likelier_convention};
pub use doubles::without_doubles;
pub use image::{centred, turned_with_images};

use super::recording::Session;
use super::suspicion::Suspicion;
use rayon::prelude::*;

/// Every suspicion that the keypoints and the calibration raise by themselves.
pub fn suspicions(session: &Session) -> Vec<Suspicion> {
    with_test_of_poses(session, |session| given_poses::suspicion(session).into_iter().collect())
}

/// Those that concern a solve which estimates the poses of the cameras: it does not read the given ones, which may be wrong.
pub fn suspicions_beside_poses(session: &Session) -> Vec<Suspicion> {
    with_test_of_poses(session, |session| given_poses::suspicion_of_pixels(session).into_iter().collect())
}

fn with_test_of_poses(session: &Session, test_of_poses: fn(&Session) -> Vec<Suspicion>) -> Vec<Suspicion> {
    let tests: [fn(&Session) -> Vec<Suspicion>; 7] = [
        image::suspicions,
        repetition::suspicions,
        |session| doubles::suspicion(session).into_iter().collect(),
        |session| repetition::periodic_gaps(session).into_iter().collect(),
        |session| detector::low_confidence(session).into_iter().collect(),
        |session| detector::convention(session).into_iter().collect(),
        test_of_poses,
    ];
    tests.par_iter().flat_map_iter(|test| test(session)).collect()
}
