//! Solved cameras paired with the true ones.

use crate::geometry::Rigid;
use crate::session::Reconstruction;

/// Solved and true `camera_from_world` of every view whose camera was solved.
pub(super) fn solved_and_true(result: &Reconstruction, truth: &[Rigid]) -> (Vec<Rigid>, Vec<Rigid>) {
    let pairs = result.cameras.iter().zip(truth);
    pairs.filter_map(|(solved, truth)| Some((solved.camera_from_world?, *truth))).unzip()
}
