//! A camera that turns or zooms during the recording: its rotation or focal length against the mean, half second by half second, has a
//! step.

use super::block_step::{Step, most_certain_step};
use crate::body::detector_profile::DETECTOR;
use crate::geometry::projection::NEAR_PLANE;
use crate::geometry::rotation;
use crate::optim::robust::{OUTLIER_SIGMAS, geman_mcclure_weight};
use crate::pipeline::calibration::TrackedPeople;
use nalgebra::{Matrix2x3, Matrix2x4, SMatrix, SVector, Vector1, Vector2, Vector3};

/// Length of a block, s: a detector's errors are correlated for about as long.
const BLOCK_SECS: f64 = 0.5;
/// Smallest number of keypoints that show a block's rotation.
const MIN_POINTS: usize = 12;
/// Standard deviation of a rotation, rad, and of a focal length's logarithm before anything is seen: keeps blocks with few points
/// solvable.
const PRIOR: f64 = 0.1;
const REWEIGHTINGS: usize = 3;

/// The most certain step of a camera's rotation about its horizontal and its vertical axis, rad; `None` with too few blocks.
pub fn turn(people: &TrackedPeople, view: usize) -> Option<Step> {
    let block = block_frames(people);
    let turns =
        changes::<3>(people, view, block)?.into_iter().map(|turn| turn.map(|turn| Vector2::new(turn[0], turn[1])));
    most_certain_step(&turns.collect::<Vec<_>>(), block)
}

/// The most certain step of the logarithm of a camera's focal length; `None` with too few blocks.
pub fn zoom(people: &TrackedPeople, view: usize) -> Option<Step> {
    let block = block_frames(people);
    let zooms =
        changes::<4>(people, view, block)?.into_iter().map(|change| change.map(|change| Vector1::new(change[3])));
    most_certain_step(&zooms.collect::<Vec<_>>(), block)
}

fn block_frames(people: &TrackedPeople) -> usize {
    ((BLOCK_SECS * people.session.fps).round() as usize).max(1)
}

/// Normal equations of a block, and its number of keypoints.
type BlockSystem<const N: usize> = (SMatrix<f64, N, N>, SVector<f64, N>, usize);

/// Rotation of the camera in every block, rad, and with `N = 4` the logarithm of its focal length over the given one, from all
/// detections of known people.
///
/// Points are re-weighted thrice: weights of the unturned camera would favour points whose noise hides the turn.
fn changes<const N: usize>(people: &TrackedPeople, view: usize, block: usize) -> Option<Vec<Option<SVector<f64, N>>>> {
    let camera = people.cameras[view].as_ref()?;
    let n_blocks = people.session.n_frames.div_ceil(block);
    let mut changes = vec![Some(SVector::<f64, N>::zeros()); n_blocks];
    for _ in 0..REWEIGHTINGS {
        let start: BlockSystem<N> = (SMatrix::identity() / PRIOR.powi(2), SVector::zeros(), 0);
        let mut systems = vec![start; n_blocks];
        for (frame, points, detection) in people.seen_by(view) {
            let (matrix, right, n) = &mut systems[frame / block];
            let Some(change) = changes[frame / block] else { continue };
            let turned = rotation::exp(&Vector3::new(change[0], change[1], change[2]));
            let zoom = change.get(3).map_or(1.0, |zoom| zoom.exp());
            for (k, (point, seen)) in points.iter().zip(&detection.keypoints).enumerate() {
                let Some(point) = point.filter(|_| seen.confidence >= DETECTOR.judged) else { continue };
                let sigma_m = people.noise.sigma_m(k, seen.confidence);
                let at = people.session.views[view].intrinsics.normalized_from_pixel(&seen.pixel);
                let x = turned * camera.transform(&point);
                if let Some((residual, by_change, weight)) = linearized(&x, zoom, &at, sigma_m) {
                    let by_change = by_change.fixed_columns::<N>(0);
                    *matrix += by_change.tr_mul(&by_change) * weight;
                    *right += by_change.tr_mul(&residual) * weight;
                    *n += 1;
                }
            }
        }
        let solved = |(matrix, right, n): &BlockSystem<N>| {
            (*n >= MIN_POINTS).then(|| Some(matrix.cholesky()?.solve(right))).flatten()
        };
        for (change, system) in changes.iter_mut().zip(&systems) {
            *change = change.zip(solved(system)).map(|(change, step)| change + step);
        }
    }
    Some(changes)
}

/// Residual of a point in the camera, its derivative to a rotation of the camera and to the logarithm of its focal length, and its
/// weight. `zoom`: factor on the focal length.
fn linearized(
    x: &Vector3<f64>,
    zoom: f64,
    seen: &Vector2<f64>,
    sigma_m: f64,
) -> Option<(Vector2<f64>, Matrix2x4<f64>, f64)> {
    if x.z < NEAR_PLANE {
        return None;
    }
    let expected = x.xy() * (zoom / x.z);
    let by_point = Matrix2x3::new(zoom, 0.0, -expected.x, 0.0, zoom, -expected.y) / x.z;
    let (residual, sigma) = (seen - expected, sigma_m / x.z);
    let squared = residual.norm_squared() / (sigma * sigma);
    let weight = geman_mcclure_weight(squared, OUTLIER_SIGMAS * OUTLIER_SIGMAS) / (sigma * sigma);
    let mut by_change = Matrix2x4::zeros();
    by_change.fixed_columns_mut::<3>(0).copy_from(&(-by_point * rotation::skew(x))); // a rotation w moves the point by w x X
    by_change.set_column(3, &expected);
    Some((residual, by_change, weight))
}
