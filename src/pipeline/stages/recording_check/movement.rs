//! A camera that turns during the recording: its rotation against the mean pose, half second by half second, has a step.

use crate::body::detector_profile::DETECTOR;
use crate::geometry::projection::NEAR_PLANE;
use crate::geometry::rotation;
use crate::optim::robust::{OUTLIER_SIGMAS, geman_mcclure_weight};
use crate::pipeline::calibration::TrackedPeople;
use nalgebra::{Matrix2x3, Matrix3, Vector2, Vector3};

/// Length of a block, s: a detector's errors are correlated for about as long.
const BLOCK_SECS: f64 = 0.5;
/// Smallest number of keypoints that show a block's rotation, and of blocks on each side of a step.
const MIN_POINTS: usize = 12;
const MIN_BLOCKS: usize = 4;
/// Standard deviation of a rotation before anything is seen, rad: keeps blocks with few points solvable.
const PRIOR: f64 = 0.1;
const REWEIGHTINGS: usize = 3;
/// Largest correlation between neighbouring blocks that is allowed for.
const MAX_CORRELATION: f64 = 0.8;

/// The most certain step of a camera's rotation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// First frame after it.
    pub frame: usize,
    /// Angle, rad.
    pub angle: f64,
    /// Angle over its standard error, both axes across the view together.
    pub sigmas: f64,
}

/// The most certain step of a camera; `None` with too few blocks.
pub fn step(people: &TrackedPeople, view: usize) -> Option<Step> {
    let block = ((BLOCK_SECS * people.session.fps).round() as usize).max(1);
    let turns = turns(people, view, block)?;
    let known: Vec<(usize, Vector2<f64>)> =
        turns.iter().enumerate().filter_map(|(b, turn)| turn.map(|turn| (b, turn))).collect();
    let splits = MIN_BLOCKS..(known.len() + 1).saturating_sub(MIN_BLOCKS);
    let steps = splits.filter_map(|at| {
        let (before, after) = known.split_at(at);
        let (sigmas, angle) = difference(before, after)?;
        Some(Step { frame: after[0].0 * block, angle, sigmas })
    });
    steps.max_by(|a, b| a.sigmas.total_cmp(&b.sigmas))
}

/// Difference of two means over its standard error, and its size; the variance is that within the two, with the correlation of
/// neighbouring blocks.
fn difference(before: &[(usize, Vector2<f64>)], after: &[(usize, Vector2<f64>)]) -> Option<(f64, f64)> {
    let mean =
        |part: &[(usize, Vector2<f64>)]| part.iter().map(|(_, turn)| turn).sum::<Vector2<f64>>() / part.len() as f64;
    let means = [mean(before), mean(after)];
    let rests: Vec<Vec<Vector2<f64>>> = [before, after]
        .iter()
        .zip(&means)
        .map(|(part, mean)| part.iter().map(|(_, turn)| turn - mean).collect())
        .collect();
    let (mut variance, mut lagged, mut n_lagged) = (Vector2::zeros(), Vector2::zeros(), 0.0);
    for rests in &rests {
        rests.iter().for_each(|rest| variance += rest.component_mul(rest));
        rests.windows(2).for_each(|pair| lagged += pair[0].component_mul(&pair[1]));
        n_lagged += rests.len() as f64 - 1.0;
    }
    let n = (before.len() + after.len()) as f64;
    let variance: Vector2<f64> = variance / (n - 2.0);
    let (angle, share) = (means[1] - means[0], 1.0 / before.len() as f64 + 1.0 / after.len() as f64);
    let mut squared = 0.0;
    for axis in 0..2 {
        // A mean of n correlated values: n (1 - r) / (1 + r) count.
        let correlation = (lagged[axis] / n_lagged / variance[axis].max(f64::MIN_POSITIVE)).clamp(0.0, MAX_CORRELATION);
        let error = variance[axis] * share * (1.0 + correlation) / (1.0 - correlation);
        squared += angle[axis] * angle[axis] / error.max(f64::MIN_POSITIVE);
    }
    squared.is_finite().then(|| (squared.sqrt(), angle.norm()))
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
