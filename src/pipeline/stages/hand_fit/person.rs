//! The fit of one person's hands, and what is published of it.

use super::observations::{HandPixel, hand_pixels};
use super::problem::{Hand, HandProblem, HandState};
use super::state::{FIRST_ANGLE, FramedHand, Unknowns, Wrist, angles, turn};
use super::terms::Known;
use crate::body::BodyModel;
use crate::body::hand::{HandShape, Side, finger_rotations, hinge_ranges, posed_hand, relative_hand_size};
use crate::body::kinematics::{Pose, posed};
use crate::body::model::Betas;
use crate::body::skeleton::chain_to_root;
use crate::geometry::rotation::exp;
use crate::optim::levenberg_marquardt::{Stopping, minimize};
use crate::optim::robust::{MEDIAN_LENGTH_IN_PLANE, median, variance_per_residual};
use crate::pipeline::calibration::{PosedCamera, TrackedPeople};
use crate::pipeline::time_windows::windows;
use crate::progress::{Canceled, Progress};
use crate::session::BodyMotion;
use crate::session::people::{BodyPose, HandMotion, HandPose};
use crate::session::reconstruction::HandReport;
use nalgebra::Matrix3;
use rayon::prelude::*;
use std::ops::Range;

/// Standard deviations of the passes before the errors are measured, of the hand's image: fingers at rest may lie a hand's length
/// from where they are.
const FIRST_SHARES: [f64; 2] = [0.2, 0.07];
/// Bounds of the measured one.
const SHARE_BOUNDS: [f64; 2] = [0.01, 0.1];
/// Unknowns over equations of a frame with few views; residuals are smaller than errors by that.
const UNKNOWNS_PER_FRAME: f64 = 20.0;
/// Steps of a pass.
const STOPPING: Stopping = Stopping { max_iterations: 12, relative_decrease: 1e-3 };
/// Frames solved at once, and those beyond on each side.
const WINDOW: usize = 480;
const HALO: usize = 30;
/// Points that a view must show of a hand in order to count as one that sees it.
const MIN_POINTS: usize = 8;

/// Fits both hands of a person.
pub(super) fn with_fingers(
    people: &TrackedPeople,
    model: &BodyModel,
    motion: &mut BodyMotion,
    progress: &Progress,
) -> Result<Vec<HandReport>, Canceled> {
    let Some(track) = people.tracks.iter().find(|track| track.person == motion.person) else { return Ok(Vec::new()) };
    let posed = people.posed_cameras();
    let pixels = Side::BOTH.map(|side| hand_pixels(people, &posed, motion, track, side));
    let n_seen = |t: &usize| pixels.iter().map(|hand| hand[*t].len()).sum::<usize>();
    if (0..motion.frames.len()).all(|t| n_seen(&t) == 0) {
        return Ok(Vec::new());
    }
    let betas = Betas::from(motion.betas);
    let size = Side::BOTH.map(|side| relative_hand_size(model, side, &betas)).iter().sum::<f64>() / 2.0;
    let fit = PersonHands {
        cameras: &posed.0,
        pixels: &pixels,
        wrists: Side::BOTH.map(|side| motion.frames.iter().map(|frame| wrist(frame, side)).collect()),
        frame_interval: people.session.frame_interval(),
        progress,
    };
    let windows = windows(motion.frames.len(), WINDOW);
    let seen_in = |window: &Range<usize>| window.clone().map(|t| n_seen(&t)).sum::<usize>();
    let best = (0..windows.len()).max_by_key(|&w| (seen_in(&windows[w]), std::cmp::Reverse(w))).unwrap_or(0);
    let first = fit.window(&windows[best], size.max(0.5).ln(), true)?;
    let fitted = |(w, window): (usize, &Range<usize>)| {
        if w == best { Ok(first.clone()) } else { fit.window(window, first.state.log_size, false) }
    };
    let fitted = windows.par_iter().enumerate().map(fitted).collect::<Result<Vec<FittedWindow>, Canceled>>()?;
    let mut frames: [Vec<Unknowns>; 2] = [Vec::new(), Vec::new()];
    for (window, fitted) in windows.iter().zip(fitted) {
        let skipped = window.start - fitted.frames.start;
        for (all, own) in frames.iter_mut().zip(&fitted.state.frames) {
            all.extend_from_slice(&own[skipped..skipped + window.len()]);
        }
    }
    let size = first.state.log_size.exp();
    let reports = Side::BOTH.map(|side| fit.report(side, &frames[side as usize], size, first.share));
    publish(model, motion, &frames, size, &pixels);
    Ok(reports.into())
}

/// The body's wrist in a frame.
fn wrist(frame: &BodyPose, side: Side) -> Wrist {
    let chain: Vec<usize> = chain_to_root(side.wrist()).collect();
    let rotation = chain.iter().rev().fold(Matrix3::identity(), |world, &joint| world * frame.rotations[joint]);
    Wrist { place: frame.joints[side.wrist()], rotation }
}

/// What the fits of a person's windows share.
struct PersonHands<'a> {
    cameras: &'a [PosedCamera],
    pixels: &'a [Vec<Vec<HandPixel>>; 2],
    wrists: [Vec<Wrist>; 2],
    /// s.
    frame_interval: f64,
    progress: &'a Progress,
}

/// The fit of a window with its halo.
#[derive(Clone)]
struct FittedWindow {
    frames: Range<usize>,
    state: HandState,
    /// Standard deviation of the pixels, of the hand's image.
    share: f64,
}

impl PersonHands<'_> {
    fn window(&self, window: &Range<usize>, log_size: f64, frees_size: bool) -> Result<FittedWindow, Canceled> {
        let n_frames = self.pixels[0].len();
        let frames = window.start.saturating_sub(HALO)..(window.end + HALO).min(n_frames);
        let hand = |side: Side| Hand {
            shape: HandShape::average(side),
            wrists: self.wrists[side as usize][frames.clone()].to_vec(),
            pixels: &self.pixels[side as usize][frames.clone()],
        };
        let hands = Side::BOTH.map(hand);
        let mut state = HandState { frames: vec![vec![relaxed(); frames.len()]; 2], log_size };
        let mut problem = HandProblem {
            hands: &hands,
            cameras: self.cameras,
            share: FIRST_SHARES[0],
            frame_interval: self.frame_interval,
            log_size_of_body: frees_size.then_some(log_size),
            known: Known::new(),
        };
        for share in FIRST_SHARES {
            problem.share = share;
            state = minimize(&problem, state, &STOPPING, self.progress)?.state;
        }
        problem.share = self.measured_share(&hands, &state);
        state = minimize(&problem, state, &STOPPING, self.progress)?.state;
        Ok(FittedWindow { frames, state, share: problem.share })
    }

    /// Standard deviation of the pixels by the residuals of a fit, of the hand's image.
    fn measured_share(&self, hands: &[Hand], state: &HandState) -> f64 {
        let mut shares = Vec::new();
        let mut n_frames = 0;
        for (hand, frames) in hands.iter().zip(&state.frames) {
            for (t, pixels) in hand.pixels.iter().enumerate().filter(|(_, pixels)| !pixels.is_empty()) {
                n_frames += 1;
                let framed = FramedHand::new(&hand.shape, &hand.wrists[t], state.log_size.exp(), &frames[t]);
                shares.extend(self.distances_px(&framed, pixels).map(|(distance, size)| distance / size));
            }
        }
        let n = 2.0 * shares.len() as f64 / f64::from(n_frames.max(1));
        let freedom = variance_per_residual(n, UNKNOWNS_PER_FRAME).sqrt();
        let [low, high] = SHARE_BOUNDS;
        median(&mut shares).map_or(high, |m| (freedom * m / MEDIAN_LENGTH_IN_PLANE).clamp(low, high))
    }

    /// Distances of pixels from the projected points, and sizes of the hand's image, px.
    fn distances_px<'b>(
        &'b self,
        framed: &'b FramedHand,
        pixels: &'b [HandPixel],
    ) -> impl Iterator<Item = (f64, f64)> + 'b {
        pixels.iter().filter_map(|seen| {
            let projected = self.cameras[seen.camera].pixel_of(&framed.hand.point(seen.point))?;
            Some(((projected - seen.pixel).norm(), seen.size_px))
        })
    }

    fn report(&self, side: Side, frames: &[Unknowns], size: f64, share: f64) -> HandReport {
        let shape = HandShape::average(side);
        let pixels = &self.pixels[side as usize];
        let n_views: Vec<u8> = pixels.iter().map(|pixels| n_views(pixels)).collect();
        let mut distances = Vec::new();
        for (t, pixels) in pixels.iter().enumerate() {
            let framed = FramedHand::new(&shape, &self.wrists[side as usize][t], size, &frames[t]);
            distances.extend(self.distances_px(&framed, pixels).map(|(distance, _)| distance));
        }
        let n_frames = n_views.len().max(1) as f64;
        HandReport {
            side,
            share_in_two_views: n_views.iter().filter(|n| **n >= 2).count() as f64 / n_frames,
            mean_views: n_views.iter().map(|n| f64::from(*n)).sum::<f64>() / n_frames,
            reprojection_px: median(&mut distances),
            noise_of_size: share,
            size_m: size * shape.length(),
        }
    }
}

/// A hand at rest on the body's wrist.
fn relaxed() -> Unknowns {
    let ranges = hinge_ranges();
    Unknowns::from_fn(|column, _| column.checked_sub(FIRST_ANGLE).map_or(0.0, |h| ranges[h].rest))
}

/// Number of views that see the hand.
fn n_views(pixels: &[HandPixel]) -> u8 {
    let runs = pixels.chunk_by(|a, b| a.camera == b.camera);
    runs.filter(|run| run.len() >= MIN_POINTS).count() as u8
}

/// Turns the wrists of a motion, and gives it its hands.
fn publish(
    model: &BodyModel,
    motion: &mut BodyMotion,
    frames: &[Vec<Unknowns>; 2],
    size: f64,
    pixels: &[Vec<Vec<HandPixel>>; 2],
) {
    let body = model.shaped(&Betas::from(motion.betas));
    for (t, frame) in motion.frames.iter_mut().enumerate() {
        for side in Side::BOTH {
            frame.rotations[side.wrist()] *= exp(&turn(&frames[side as usize][t]));
        }
        let pose = Pose { rotations: frame.rotations, translation: frame.translation };
        frame.joints = posed(&body, &pose).joints;
    }
    let hand = |side: Side| {
        let shape = HandShape::average(side);
        let pose = |(t, frame): (usize, &BodyPose)| {
            let angles = angles(&frames[side as usize][t]);
            let Wrist { place, rotation } = wrist(frame, side);
            HandPose {
                rotations: finger_rotations(&shape, &angles),
                joints: posed_hand(&shape, (&place, &rotation), size, &angles).joints(),
                n_views: n_views(&pixels[side as usize][t]),
            }
        };
        HandMotion { frames: motion.frames.iter().enumerate().map(pose).collect() }
    };
    motion.hands = Some(Side::BOTH.map(hand));
}
