//! The data term over whole paths: detected pixels whose errors are correlated in time.
//!
//! The residuals of one landmark in one camera form a channel. Each contributes its innovation
//! ([`NoiseProcess`](super::noise_process::NoiseProcess)), which depends on the landmark in up to three successive frames, on
//! the camera, and on what shapes the body.

mod innovation;
mod leverage;
mod likelihood;
pub(crate) mod scores;
pub(crate) mod spread;

#[cfg(doc)]
use super::super::observations::ErrorShape;
use super::super::observations::Observations;
use super::camera_unknowns::{ByCamera, CameraUnknowns, MAX_UNKNOWNS};
use super::noise_process::{NoiseProcess, PathNoise};
use super::unknowns::CameraColumns;
use crate::optim::block_banded::Corner;
use crate::optim::robust::{geman_mcclure, geman_mcclure_ceiling};
use crate::pipeline::calibration::PosedCamera;
use crate::residuals::reprojection::{Reprojection, linearize, residual};
use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2, Vector3};
use rayon::prelude::*;

/// World positions, m: `[frame][observed landmark]`.
pub(crate) type Positions = Vec<Vec<Vector3<f64>>>;

/// A channel's frames and standardised residuals, ascending in time.
pub(crate) type Run = Vec<(usize, Vector2<f64>)>;

/// Of one channel: `[landmark, camera]`, and the innovations' frames and lengths in standard deviations.
pub(crate) type ChannelInnovations = ([usize; 2], Vec<(usize, f64)>);

/// Innovations of all channels of one person. The cameras come with each call, since they move while channels stay.
#[derive(Debug)]
pub(crate) struct WhitenedPixels {
    /// The observed landmarks, ascending; other lists have their order.
    pub landmarks: Vec<usize>,
    /// By observed landmark.
    channels: Vec<Vec<Channel>>,
    robust_scale: f64,
    n_frames: usize,
}

/// One landmark in one camera over time.
#[derive(Debug)]
struct Channel {
    camera: usize,
    /// Weight of an innovation.
    weight: f64,
    /// Ascending in time.
    seen: Vec<Seen>,
}

/// A detected pixel and its part in the channel.
#[derive(Debug)]
struct Seen {
    frame: usize,
    pixel: Vector2<f64>,
    sigma_px: f64,
    /// Whitens the shape of the error, see [`ErrorShape::Whitened`]. On the heap, since few detectors state a shape.
    whitening: Option<Box<Matrix2<f64>>>,
    parts: Parts,
}

/// Positions in the channel and factors of the residuals that make an innovation: the newest, and up to two before it.
#[derive(Debug, Clone, Copy)]
struct Parts {
    factors: [f64; 3],
    positions: [u32; 3],
    len: u32,
}

/// What the innovations ask of one landmark in one frame, to second order.
#[derive(Debug, Clone)]
pub(crate) struct PathBlock {
    pub gradient: Vector3<f64>,
    /// Second derivatives by this frame's position and by that of this frame, one, and two frames earlier.
    pub hessian: [Matrix3<f64>; 3],
}

/// What the innovations ask of one landmark in all frames.
pub(crate) struct LandmarkBlocks {
    /// By frame.
    pub frames: Vec<PathBlock>,
    /// Second derivatives by a position and a camera, `[frame * n_cameras + camera]`; empty where the cameras are held.
    by_camera: Vec<PointByCamera>,
    cameras: Vec<CameraBlock>,
}

/// Second derivatives by a position and a camera's unknowns; columns beyond these are zero.
pub(crate) type PointByCamera = SMatrix<f64, 3, MAX_UNKNOWNS>;

/// Of one camera alone.
#[derive(Clone)]
struct CameraBlock {
    hessian: SMatrix<f64, MAX_UNKNOWNS, MAX_UNKNOWNS>,
    gradient: SVector<f64, MAX_UNKNOWNS>,
}

/// The whole term to second order.
pub(crate) struct PathBlocks {
    /// By observed landmark.
    pub landmarks: Vec<LandmarkBlocks>,
    cameras: CameraColumns,
}

impl PathBlocks {
    /// Adds the blocks of the cameras among themselves; their unknowns begin at `first`.
    pub(crate) fn add_cameras_to(&self, first: usize, corner: &mut Corner) {
        let n = self.cameras.unknowns.len();
        for camera in 0..self.cameras.n_cameras {
            let at = first + n * camera;
            for blocks in &self.landmarks {
                let mut hessian = corner.hessian.view_mut((at, at), (n, n));
                hessian += blocks.cameras[camera].hessian.view((0, 0), (n, n));
                let mut gradient = corner.gradient.rows_mut(at, n);
                gradient += blocks.cameras[camera].gradient.rows(0, n);
            }
        }
    }
}

impl LandmarkBlocks {
    fn zeros(n_frames: usize, n_cameras: usize) -> Self {
        let frame = PathBlock { gradient: Vector3::zeros(), hessian: [Matrix3::zeros(); 3] };
        let camera = CameraBlock { hessian: SMatrix::zeros(), gradient: SVector::zeros() };
        Self {
            frames: vec![frame; n_frames],
            by_camera: vec![SMatrix::zeros(); n_frames * n_cameras],
            cameras: vec![camera; n_cameras],
        }
    }

    /// Second derivatives by the position of a frame and each camera.
    pub(crate) fn by_cameras(&self, frame: usize) -> &[PointByCamera] {
        let n = self.cameras.len();
        &self.by_camera[frame * n..(frame + 1) * n]
    }
}

impl WhitenedPixels {
    pub(crate) fn new(observations: &Observations, noise: &PathNoise, robust_scale: f64) -> Self {
        let n_frames = observations.pixels.len();
        let n_cameras = observations.cameras.len();
        let mut n_seen = vec![vec![0; n_cameras]; noise.weights.len()];
        observations.pixels.iter().flatten().for_each(|pixel| n_seen[pixel.landmark][pixel.camera] += 1);
        let empty = |(landmark, n_seen): (usize, &Vec<usize>)| {
            let weight = noise.weights[landmark];
            let channel = |(camera, &n)| Channel { camera, weight, seen: Vec::with_capacity(n) };
            n_seen.iter().enumerate().map(channel).collect::<Vec<_>>()
        };
        let mut by_landmark: Vec<Vec<Channel>> = n_seen.iter().enumerate().map(empty).collect();
        for (frame, pixels) in observations.pixels.iter().enumerate() {
            for pixel in pixels {
                let seen = &mut by_landmark[pixel.landmark][pixel.camera].seen;
                let parts = Parts::new(seen, frame, &noise.processes[pixel.landmark]);
                seen.push(Seen {
                    frame,
                    pixel: pixel.pixel,
                    sigma_px: noise.shares[pixel.landmark] * pixel.scale_px,
                    whitening: pixel.error.whitening().map(Box::new),
                    parts,
                });
            }
        }
        let seen = |channels: Vec<Channel>| channels.into_iter().filter(|channel| !channel.seen.is_empty()).collect();
        let by_landmark = by_landmark.into_iter().map(seen).enumerate();
        let (landmarks, channels) =
            by_landmark.filter(|(_, channels): &(usize, Vec<Channel>)| !channels.is_empty()).unzip();
        Self { landmarks, channels, robust_scale, n_frames }
    }

    /// Cost of the motion with the landmarks at `positions`, `[frame][observed landmark]`.
    pub(crate) fn cost(&self, cameras: &[PosedCamera], positions: &Positions) -> f64 {
        let of_landmark = |landmark: usize| -> f64 {
            let cost = |channel: &Channel| self.channel_cost(channel, landmark, cameras, positions);
            self.channels[landmark].iter().map(cost).sum()
        };
        let costs: Vec<f64> = (0..self.landmarks.len()).into_par_iter().map(of_landmark).collect();
        costs.iter().sum()
    }

    fn channel_cost(&self, channel: &Channel, landmark: usize, cameras: &[PosedCamera], positions: &Positions) -> f64 {
        let residuals = channel.residuals(landmark, cameras, positions);
        let innovation = |seen: &Seen| match seen.parts.combined(|i| residuals[i]) {
            Some(e) => geman_mcclure(e.norm_squared(), self.robust_scale).cost,
            None => geman_mcclure_ceiling(self.robust_scale),
        };
        channel.weight * channel.seen.iter().map(innovation).sum::<f64>()
    }

    /// Residuals of all channels: landmark, and a run of (frame, standardised residual).
    pub(crate) fn residuals(&self, cameras: &[PosedCamera], positions: &Positions) -> Vec<(usize, Run)> {
        self.for_channels(cameras, positions, |channel, residuals| {
            let seen = channel.seen.iter().zip(residuals);
            seen.filter_map(|(seen, residual)| Some((seen.frame, (*residual)?))).collect()
        })
    }

    /// Innovations of all channels that follow something: landmark, and their lengths in standard deviations.
    pub(crate) fn innovations(&self, cameras: &[PosedCamera], positions: &Positions) -> Vec<(usize, Vec<f64>)> {
        self.for_channels(cameras, positions, |channel, residuals| {
            let following = channel.seen.iter().filter(|seen| seen.parts.len > 1);
            following.filter_map(|seen| Some(seen.parts.combined(|i| residuals[i])?.norm())).collect()
        })
    }

    /// Innovations of all channels, landmark by landmark.
    pub(crate) fn innovations_by_channel(
        &self,
        cameras: &[PosedCamera],
        positions: &Positions,
    ) -> Vec<ChannelInnovations> {
        let channels = self.for_channels(cameras, positions, |channel, residuals| {
            let length = |seen: &Seen| Some((seen.frame, seen.parts.combined(|i| residuals[i])?.norm()));
            (channel.camera, channel.seen.iter().filter_map(length).collect())
        });
        channels.into_iter().map(|(landmark, (camera, lengths))| ([landmark, camera], lengths)).collect()
    }

    fn for_channels<T>(
        &self,
        cameras: &[PosedCamera],
        positions: &Positions,
        of: impl Fn(&Channel, &[Option<Vector2<f64>>]) -> T,
    ) -> Vec<(usize, T)> {
        let mut all = Vec::new();
        for (l, channels) in self.channels.iter().enumerate() {
            for channel in channels {
                all.push((self.landmarks[l], of(channel, &channel.residuals(l, cameras, positions))));
            }
        }
        all
    }

    /// Gradient and Gauss-Newton blocks, those of the cameras by the unknowns of `columns`.
    pub(crate) fn blocks(&self, cameras: &[PosedCamera], positions: &Positions, columns: CameraColumns) -> PathBlocks {
        let of_landmark = |landmark: usize| {
            let mut blocks = LandmarkBlocks::zeros(self.n_frames, columns.n_cameras);
            for channel in &self.channels[landmark] {
                let linear = channel.linearised(landmark, cameras, positions);
                self.add_channel(channel, &linear, columns.unknowns, &mut blocks);
            }
            blocks
        };
        PathBlocks { landmarks: (0..self.landmarks.len()).into_par_iter().map(of_landmark).collect(), cameras: columns }
    }

    fn add_channel(
        &self,
        channel: &Channel,
        linear: &[Option<Reprojection>],
        unknowns: CameraUnknowns,
        blocks: &mut LandmarkBlocks,
    ) {
        let n_cameras = blocks.cameras.len();
        for innovation in self.linear_innovations(channel, linear) {
            let (e, weight) = (innovation.e, innovation.weight);
            let parts = || innovation.parts().map(|(i, l, factor)| (channel.seen[i].frame, l, factor));
            let mut by_camera = ByCamera::zeros();
            if n_cameras > 0 {
                by_camera = innovation.by_camera(unknowns);
                let own = &mut blocks.cameras[channel.camera];
                own.hessian += by_camera.tr_mul(&by_camera) * weight;
                own.gradient += by_camera.tr_mul(&e) * weight;
            }
            for (later, l, factor) in parts() {
                let left = l.by_point.transpose() * (weight * factor);
                blocks.frames[later].gradient += left * e;
                if n_cameras > 0 {
                    blocks.by_camera[later * n_cameras + channel.camera] += left * by_camera;
                }
                for (earlier, l, factor) in parts().filter(|(earlier, ..)| *earlier <= later) {
                    blocks.frames[later].hessian[later - earlier] += left * l.by_point * factor;
                }
            }
        }
    }
}

impl Channel {
    fn residuals(&self, landmark: usize, cameras: &[PosedCamera], positions: &Positions) -> Vec<Option<Vector2<f64>>> {
        let camera = &cameras[self.camera];
        let residual = |seen: &Seen| {
            let position = &positions[seen.frame][landmark];
            let found = residual(&camera.intrinsics, &camera.camera_from_world, position, &seen.pixel, seen.sigma_px)?;
            Some(seen.whitening.as_ref().map_or(found, |whitening| **whitening * found))
        };
        self.seen.iter().map(residual).collect()
    }

    fn linearised(&self, landmark: usize, cameras: &[PosedCamera], positions: &Positions) -> Vec<Option<Reprojection>> {
        let camera = &cameras[self.camera];
        let linear = |seen: &Seen| {
            let position = &positions[seen.frame][landmark];
            let found = linearize(&camera.intrinsics, &camera.camera_from_world, position, &seen.pixel, seen.sigma_px)?;
            Some(seen.whitening.as_ref().map_or(found, |whitening| found.whitened(whitening)))
        };
        self.seen.iter().map(linear).collect()
    }
}

impl Parts {
    /// The parts of the innovation of a pixel of `frame` that follows `seen`.
    fn new(seen: &[Seen], frame: usize, process: &NoiseProcess) -> Self {
        let ago = |lag: usize| (0..seen.len()).rev().take(2).find(|&i| seen[i].frame + lag == frame);
        let (one, two) = (ago(1), ago(2));
        let gap = seen.last().map(|last| frame - last.frame);
        let [own, by_one, by_two] = process.innovation([one.is_some(), two.is_some()], gap);
        let mut parts = Self { factors: [0.0; 3], positions: [0; 3], len: 0 };
        for (i, factor) in [(Some(seen.len()), own), (one, by_one), (two, by_two)] {
            let Some(i) = i else { continue };
            parts.factors[parts.len as usize] = factor;
            parts.positions[parts.len as usize] = i as u32;
            parts.len += 1;
        }
        parts
    }

    /// Factor of the newest residual.
    fn own(&self) -> f64 {
        self.factors[0]
    }

    fn iter(&self) -> impl Iterator<Item = (usize, f64)> {
        let positions = self.positions.iter().map(|i| *i as usize);
        positions.zip(self.factors).take(self.len as usize)
    }

    /// The sum of residuals times their factors; `None` where one of them has no residual.
    fn combined(&self, residual: impl Fn(usize) -> Option<Vector2<f64>>) -> Option<Vector2<f64>> {
        self.iter().try_fold(Vector2::zeros(), |sum, (i, factor)| Some(sum + residual(i)? * factor))
    }
}
