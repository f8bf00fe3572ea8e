//! The data term over whole paths: detected pixels whose errors are correlated in time.
//!
//! The residuals of one landmark in one camera form a channel. Each contributes its innovation
//! ([`NoiseProcess`](super::noise_process::NoiseProcess)), which depends on the landmark in up to three successive frames, on
//! the camera, and on what shapes the body.

use super::super::observations::Observations;
use super::noise_process::{NoiseProcess, PathNoise};
use crate::optim::robust::{Robust, geman_mcclure, geman_mcclure_ceiling};
use crate::residuals::reprojection::{Reprojection, linearize, residual};
use nalgebra::{DMatrix, DVector, Matrix2x3, Matrix2x6, Matrix3, Matrix3x6, Vector2, Vector3};
use rayon::prelude::*;

/// World positions, m: `[frame][observed landmark]`.
pub(crate) type Positions = Vec<Vec<Vector3<f64>>>;

/// A channel's frames and standardised residuals, ascending in time.
pub(crate) type Run = Vec<(usize, Vector2<f64>)>;

/// Innovations of all channels of one person.
pub(crate) struct WhitenedPixels<'a> {
    observations: &'a Observations,
    /// The observed landmarks, ascending; other lists have their order.
    pub landmarks: Vec<usize>,
    /// By observed landmark.
    channels: Vec<Vec<Channel>>,
    robust_scale: f64,
    n_frames: usize,
}

/// One landmark in one camera over time.
struct Channel {
    camera: usize,
    /// Ascending in time.
    seen: Vec<Seen>,
}

/// A detected pixel and its part in the channel.
struct Seen {
    frame: usize,
    pixel: Vector2<f64>,
    sigma_px: f64,
    /// Positions in the channel and factors of the residuals that make the innovation, this one first.
    parts: Vec<(usize, f64)>,
}

/// What the innovations ask of one landmark in one frame, to second order.
#[derive(Clone)]
pub(crate) struct PathBlock {
    pub gradient: Vector3<f64>,
    /// Second derivatives by this frame's position and by that of this frame, one, and two frames earlier.
    pub hessian: [Matrix3<f64>; 3],
    /// Second derivatives by this position and each camera; empty where the cameras are held.
    pub by_camera: Vec<Matrix3x6<f64>>,
}

/// The whole term to second order.
pub(crate) struct PathBlocks {
    /// `[observed landmark][frame]`.
    pub landmarks: Vec<Vec<PathBlock>>,
    /// Of the cameras among themselves.
    pub camera_hessian: DMatrix<f64>,
    pub camera_gradient: DVector<f64>,
}

impl<'a> WhitenedPixels<'a> {
    pub(crate) fn new(observations: &'a Observations, noise: &PathNoise, robust_scale: f64) -> Self {
        let n_frames = observations.pixels.len();
        let n_cameras = observations.cameras.len();
        let mut landmarks: Vec<usize> = observations.pixels.iter().flatten().map(|pixel| pixel.landmark).collect();
        landmarks.sort_unstable();
        landmarks.dedup();
        let empty = || (0..n_cameras).map(|camera| Channel { camera, seen: Vec::new() }).collect::<Vec<_>>();
        let mut channels: Vec<Vec<Channel>> = landmarks.iter().map(|_| empty()).collect();
        for (frame, pixels) in observations.pixels.iter().enumerate() {
            for pixel in pixels {
                let Ok(landmark) = landmarks.binary_search(&pixel.landmark) else { continue };
                let seen = &mut channels[landmark][pixel.camera].seen;
                let parts = parts(seen, frame, &noise.processes[pixel.landmark]);
                seen.push(Seen {
                    frame,
                    pixel: pixel.pixel,
                    sigma_px: noise.shares[pixel.landmark] * pixel.scale_px,
                    parts,
                });
            }
        }
        for of_landmark in &mut channels {
            of_landmark.retain(|channel| !channel.seen.is_empty());
        }
        Self { observations, landmarks, channels, robust_scale, n_frames }
    }

    /// Cost of the motion with the landmarks at `positions`, `[frame][observed landmark]`.
    pub(crate) fn cost(&self, positions: &Positions) -> f64 {
        let of_landmark = |landmark: usize| -> f64 {
            self.channels[landmark].iter().map(|channel| self.channel_cost(channel, landmark, positions)).sum()
        };
        let costs: Vec<f64> = (0..self.landmarks.len()).into_par_iter().map(of_landmark).collect();
        costs.iter().sum()
    }

    fn channel_cost(&self, channel: &Channel, landmark: usize, positions: &Positions) -> f64 {
        let residuals = self.channel_residuals(channel, landmark, positions);
        let innovation = |seen: &Seen| match combined(&seen.parts, |i| residuals[i]) {
            Some(e) => geman_mcclure(e.norm_squared(), self.robust_scale).cost,
            None => geman_mcclure_ceiling(self.robust_scale),
        };
        channel.seen.iter().map(innovation).sum()
    }

    /// Residuals of all channels: landmark, and a run of (frame, standardised residual).
    pub(crate) fn residuals(&self, positions: &Positions) -> Vec<(usize, Run)> {
        self.for_channels(positions, |channel, residuals| {
            let seen = channel.seen.iter().zip(residuals);
            seen.filter_map(|(seen, residual)| Some((seen.frame, (*residual)?))).collect()
        })
    }

    /// Innovations of all channels that follow something: landmark, and their lengths in standard deviations.
    pub(crate) fn innovations(&self, positions: &Positions) -> Vec<(usize, Vec<f64>)> {
        self.for_channels(positions, |channel, residuals| {
            let following = channel.seen.iter().filter(|seen| seen.parts.len() > 1);
            following.filter_map(|seen| Some(combined(&seen.parts, |i| residuals[i])?.norm())).collect()
        })
    }

    fn for_channels<T>(
        &self,
        positions: &Positions,
        of: impl Fn(&Channel, &[Option<Vector2<f64>>]) -> T,
    ) -> Vec<(usize, T)> {
        let mut all = Vec::new();
        for (l, channels) in self.channels.iter().enumerate() {
            for channel in channels {
                all.push((self.landmarks[l], of(channel, &self.channel_residuals(channel, l, positions))));
            }
        }
        all
    }

    fn channel_residuals(
        &self,
        channel: &Channel,
        landmark: usize,
        positions: &Positions,
    ) -> Vec<Option<Vector2<f64>>> {
        let camera = &self.observations.cameras[channel.camera];
        let residual = |seen: &Seen| {
            let position = &positions[seen.frame][landmark];
            residual(&camera.intrinsics, &camera.camera_from_world, position, &seen.pixel, seen.sigma_px)
        };
        channel.seen.iter().map(residual).collect()
    }

    /// Gradient and Gauss-Newton blocks; those of the cameras only where `moves_cameras`.
    pub(crate) fn blocks(&self, positions: &Positions, moves_cameras: bool) -> PathBlocks {
        let n_cameras = if moves_cameras { self.observations.cameras.len() } else { 0 };
        let of_landmark = |landmark: usize| {
            let zero = PathBlock {
                gradient: Vector3::zeros(),
                hessian: [Matrix3::zeros(); 3],
                by_camera: vec![Matrix3x6::zeros(); n_cameras],
            };
            let mut frames = vec![zero; self.n_frames];
            let mut hessian = DMatrix::zeros(6 * n_cameras, 6 * n_cameras);
            let mut gradient = DVector::zeros(6 * n_cameras);
            for channel in &self.channels[landmark] {
                self.add_channel(channel, landmark, positions, &mut frames, (&mut hessian, &mut gradient));
            }
            (frames, hessian, gradient)
        };
        let parts: Vec<_> = (0..self.landmarks.len()).into_par_iter().map(of_landmark).collect();
        let mut camera_hessian = DMatrix::zeros(6 * n_cameras, 6 * n_cameras);
        let mut camera_gradient = DVector::zeros(6 * n_cameras);
        let mut landmarks = Vec::with_capacity(parts.len());
        for (frames, hessian, gradient) in parts {
            camera_hessian += hessian;
            camera_gradient += gradient;
            landmarks.push(frames);
        }
        PathBlocks { landmarks, camera_hessian, camera_gradient }
    }

    fn add_channel(
        &self,
        channel: &Channel,
        landmark: usize,
        positions: &Positions,
        frames: &mut [PathBlock],
        (hessian, gradient): (&mut DMatrix<f64>, &mut DVector<f64>),
    ) {
        let camera = &self.observations.cameras[channel.camera];
        let linear: Vec<Option<Reprojection>> = channel
            .seen
            .iter()
            .map(|seen| {
                let position = &positions[seen.frame][landmark];
                linearize(&camera.intrinsics, &camera.camera_from_world, position, &seen.pixel, seen.sigma_px)
            })
            .collect();
        let moves_cameras = !gradient.is_empty();
        let first = 6 * channel.camera;
        for seen in &channel.seen {
            let Some(e) = combined(&seen.parts, |i| linear[i].map(|l| l.residual)) else { continue };
            let Robust { weight, .. } = geman_mcclure(e.norm_squared(), self.robust_scale);
            let part = |&(i, factor): &(usize, f64)| linear[i].map(|l| (channel.seen[i].frame, l.by_point * factor));
            let parts: Vec<(usize, Matrix2x3<f64>)> = seen.parts.iter().filter_map(part).collect();
            let mut by_camera = Matrix2x6::zeros();
            if moves_cameras {
                for &(i, factor) in &seen.parts {
                    by_camera += linear[i].map_or_else(Matrix2x6::zeros, |l| l.by_camera * factor);
                }
                let mut block = hessian.fixed_view_mut::<6, 6>(first, first);
                block += by_camera.tr_mul(&by_camera) * weight;
                let mut rows = gradient.fixed_rows_mut::<6>(first);
                rows += by_camera.tr_mul(&e) * weight;
            }
            for (later, a) in &parts {
                let left = a.transpose() * weight;
                frames[*later].gradient += left * e;
                if moves_cameras {
                    frames[*later].by_camera[channel.camera] += left * by_camera;
                }
                for (earlier, b) in parts.iter().filter(|(earlier, _)| earlier <= later) {
                    frames[*later].hessian[later - earlier] += left * b;
                }
            }
        }
    }
}

/// The parts of the innovation of a pixel of `frame` that follows `seen`.
fn parts(seen: &[Seen], frame: usize, process: &NoiseProcess) -> Vec<(usize, f64)> {
    let ago = |lag: usize| (0..seen.len()).rev().take(2).find(|&i| seen[i].frame + lag == frame);
    let (one, two) = (ago(1), ago(2));
    let gap = seen.last().map(|last| frame - last.frame);
    let [own, by_one, by_two] = process.innovation([one.is_some(), two.is_some()], gap);
    let mut parts = vec![(seen.len(), own)];
    parts.extend(one.map(|i| (i, by_one)));
    parts.extend(two.map(|i| (i, by_two)));
    parts
}

/// The sum of residuals times their factors; `None` where one of them has no residual.
fn combined(parts: &[(usize, f64)], residual: impl Fn(usize) -> Option<Vector2<f64>>) -> Option<Vector2<f64>> {
    parts.iter().try_fold(Vector2::zeros(), |sum, &(i, factor)| Some(sum + residual(i)? * factor))
}
