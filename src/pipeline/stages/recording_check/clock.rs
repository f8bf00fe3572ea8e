//! A camera whose frames slip against the others: frames that were dropped or doubled, or a clock at another rate.
//!
//! A detection that is `d` frames late lies where the person was: its error against the person's path is `-d` times the velocity in
//! the image. Per block of time `d` follows by least squares; a constant delay is none of this test's business, a step is.

use super::block_step::{Step, most_certain_step};
use crate::body::detector_profile::DETECTOR;
use crate::geometry::projection::project_normalized;
use crate::optim::robust::{OUTLIER_SIGMAS, geman_mcclure_weight};
use crate::pipeline::calibration::TrackedPeople;
use nalgebra::{SVector, Vector2};

/// Length of a block, s: a detector's errors are correlated for about as long, and a walker makes a step.
const BLOCK_SECS: f64 = 0.5;
/// A block counts where its delay is known this well under independent errors, frames: errors of neighbouring frames are alike, so that
/// the true standard error is some three times larger.
const MAX_SIGMA: f64 = 0.3;
const REWEIGHTINGS: usize = 3;

/// Delay of a block: the normal equation of one unknown, and its solution so far.
#[derive(Clone, Copy, Default)]
struct Delay {
    information: f64,
    right: f64,
    frames: f64,
}

/// The most certain step of a camera's delay, frames; `None` with too few blocks in which people move.
pub fn slip(people: &TrackedPeople, view: usize) -> Option<Step> {
    let block = ((BLOCK_SECS * people.session.fps).round() as usize).max(1);
    let mut delays = vec![Delay::default(); people.session.n_frames.div_ceil(block)];
    for _ in 0..REWEIGHTINGS {
        delays.iter_mut().for_each(|delay| (delay.information, delay.right) = (0.0, 0.0));
        accumulate(people, view, block, &mut delays)?;
        for delay in delays.iter_mut().filter(|delay| delay.information > 0.0) {
            delay.frames = delay.right / delay.information;
        }
    }
    let is_known = |delay: &&Delay| delay.information > MAX_SIGMA.powi(-2);
    let series: Vec<_> =
        delays.iter().map(|delay| Some(delay).filter(is_known).map(|delay| SVector::from([delay.frames]))).collect();
    most_certain_step(&series, block)
}

/// Adds what every keypoint shows of the delay of its block; `None` for a camera without a pose.
fn accumulate(people: &TrackedPeople, view: usize, block: usize, delays: &mut [Delay]) -> Option<()> {
    let camera = people.cameras[view].as_ref()?;
    let session_view = &people.session.views[view];
    for (track, person) in people.tracks.iter().zip(people.points) {
        for t in 1..person.points.len().saturating_sub(1) {
            let frame = track.first.0 + t;
            let Some(seen) = track.detections[t][view].and_then(|d| session_view.frames[frame].get(d)) else {
                continue;
            };
            let delay = &mut delays[frame / block];
            // Points after the named ones have no trajectory.
            let named = seen.keypoints.iter().take(person.points[t].len()).enumerate();
            for (k, keypoint) in named.filter(|(_, k)| k.confidence >= DETECTOR.judged) {
                let at = |t: usize| project_normalized(camera, person.points[t][k].as_ref()?);
                let Some(((before, now), after)) = at(t - 1).zip(at(t)).zip(at(t + 1)) else { continue };
                let velocity: Vector2<f64> = 0.5 * (after.normalized - before.normalized);
                let error = session_view.intrinsics.normalized_from_pixel(&keypoint.pixel) - now.normalized;
                let precision = (now.depth / people.noise.sigma_m(k, keypoint.confidence)).powi(2);
                let squared = (error + delay.frames * velocity).norm_squared() * precision;
                let weight = precision * geman_mcclure_weight(squared, OUTLIER_SIGMAS * OUTLIER_SIGMAS);
                delay.information += weight * velocity.norm_squared();
                delay.right -= weight * velocity.dot(&error);
            }
        }
    }
    Some(())
}
