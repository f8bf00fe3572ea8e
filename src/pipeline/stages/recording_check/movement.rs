//! A camera that turns during the recording: its rotation against the mean pose, half second by half second, has a step.

use super::block_step::{Step, most_certain_step};
use crate::body::detector_profile::DETECTOR;
use crate::geometry::projection::NEAR_PLANE;
use crate::geometry::rotation;
use crate::optim::robust::{OUTLIER_SIGMAS, geman_mcclure_weight};
use crate::pipeline::calibration::TrackedPeople;
use nalgebra::{Matrix2x3, Matrix3, Vector2, Vector3};

/// Length of a block, s: a detector's errors are correlated for about as long.
const BLOCK_SECS: f64 = 0.5;
/// Smallest number of keypoints that show a block's rotation.
const MIN_POINTS: usize = 12;
/// Standard deviation of a rotation before anything is seen, rad: keeps blocks with few points solvable.
const PRIOR: f64 = 0.1;
const REWEIGHTINGS: usize = 3;

/// The most certain step of a camera's rotation, rad; `None` with too few blocks.
pub fn turn(people: &TrackedPeople, view: usize) -> Option<Step> {
    let block = ((BLOCK_SECS * people.session.fps).round() as usize).max(1);
    most_certain_step(&turns(people, view, block)?, block)
}

/// Rotation of the camera about its horizontal and its vertical axis in every block, rad, from all detections of known people.
///
/// Points are re-weighted thrice: weights of the unturned camera would favour points whose noise hides the turn.
fn turns(people: &TrackedPeople, view: usize, block: usize) -> Option<Vec<Option<Vector2<f64>>>> {
    let camera = people.cameras[view].as_ref()?;
    let n_blocks = people.session.n_frames.div_ceil(block);
    let mut turns = vec![Some(Vector3::zeros()); n_blocks];
    for _ in 0..REWEIGHTINGS {
        let mut systems = vec![(Matrix3::<f64>::identity() / PRIOR.powi(2), Vector3::<f64>::zeros(), 0usize); n_blocks];
        for (frame, points, detection) in people.seen_by(view) {
            let (matrix, right, n) = &mut systems[frame / block];
            let Some(turn) = turns[frame / block] else { continue };
            let turned = rotation::exp(&turn);
            for (k, (point, seen)) in points.iter().zip(&detection.keypoints).enumerate() {
                let Some(point) = point.filter(|_| seen.confidence >= DETECTOR.judged) else { continue };
                let sigma_m = people.noise.sigma_m(k, seen.confidence);
                let at = people.session.views[view].intrinsics.normalized_from_pixel(&seen.pixel);
                let x = turned * camera.transform(&point);
                if let Some((residual, by_turn, weight)) = linearized(&x, &at, sigma_m) {
                    *matrix += by_turn.tr_mul(&by_turn) * weight;
                    *right += by_turn.tr_mul(&residual) * weight;
                    *n += 1;
                }
            }
        }
        let solved = |(matrix, right, n): &(Matrix3<f64>, Vector3<f64>, usize)| {
            (*n >= MIN_POINTS).then(|| Some(matrix.cholesky()?.solve(right))).flatten()
        };
        for (turn, system) in turns.iter_mut().zip(&systems) {
            *turn = turn.zip(solved(system)).map(|(turn, step)| turn + step);
        }
    }
    Some(turns.into_iter().map(|turn| turn.map(|turn| turn.xy())).collect())
}

/// Residual of a point in the camera, its derivative to a rotation of the camera, and its weight.
fn linearized(x: &Vector3<f64>, seen: &Vector2<f64>, sigma_m: f64) -> Option<(Vector2<f64>, Matrix2x3<f64>, f64)> {
    if x.z < NEAR_PLANE {
        return None;
    }
    let expected = x.xy() / x.z;
    let by_point = Matrix2x3::new(1.0, 0.0, -expected.x, 0.0, 1.0, -expected.y) / x.z;
    let (residual, sigma) = (seen - expected, sigma_m / x.z);
    let squared = residual.norm_squared() / (sigma * sigma);
    let weight = geman_mcclure_weight(squared, OUTLIER_SIGMAS * OUTLIER_SIGMAS) / (sigma * sigma);
    // A rotation w moves the point by w x X.
    Some((residual, -by_point * rotation::skew(x), weight))
}
