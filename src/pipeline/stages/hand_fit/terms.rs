//! The terms of the fit of a hand: pixels, what is known of a hand, smoothness.

use super::observations::HandPixel;
use super::state::{FIRST_ANGLE, FramedHand, N_UNKNOWNS, Unknowns};
use crate::body::hand::{HingeRange, hinge_ranges, hinges};
use crate::pipeline::calibration::PosedCamera;
use crate::residuals::reprojection::pixel_cost;
use nalgebra::{SMatrix, SVector};

/// Cost, gradient and Gauss-Newton Hessian of a frame over its unknowns and the logarithm of the size.
#[derive(Clone)]
pub(super) struct FrameSystem {
    pub cost: f64,
    pub gradient: Unknowns,
    pub hessian: SMatrix<f64, N_UNKNOWNS, N_UNKNOWNS>,
    /// Row of the size.
    pub by_size: SMatrix<f64, 1, N_UNKNOWNS>,
    /// Gradient and Hessian of the size.
    pub size: [f64; 2],
}

impl FrameSystem {
    pub(super) fn zeros() -> Self {
        Self {
            cost: 0.0,
            gradient: SVector::zeros(),
            hessian: SMatrix::zeros(),
            by_size: SMatrix::zeros(),
            size: [0.0; 2],
        }
    }
}

/// Scale of Geman-McClure's cost, standard deviations: as for the body.
const ROBUST_SCALE: f64 = 4.0;

/// Share of a frame's pixels that counts: errors last for some frames, so that frames share them.
const PIXEL_WEIGHT: f64 = 0.5;

/// Adds the pixels of a frame; their standard deviation is `share` of the hand's image.
pub(super) fn add_pixels(
    system: &mut FrameSystem,
    framed: &FramedHand,
    pixels: &[HandPixel],
    cameras: &[PosedCamera],
    share: f64,
    with_derivatives: bool,
) {
    for seen in pixels {
        let PosedCamera { intrinsics, camera_from_world } = &cameras[seen.camera];
        let position = framed.hand.point(seen.point);
        let sigma = share * seen.size_px;
        let at = pixel_cost(intrinsics, camera_from_world, &position, &seen.pixel, sigma, ROBUST_SCALE);
        system.cost += PIXEL_WEIGHT * at.cost;
        if !with_derivatives {
            continue;
        }
        let (gradient, hessian) = (at.gradient * PIXEL_WEIGHT, at.hessian * PIXEL_WEIGHT);
        let columns = framed.by_unknowns(seen.point);
        let by_size = framed.hand.by_log_size(seen.point);
        system.size[0] += by_size.dot(&gradient);
        system.size[1] += by_size.dot(&(hessian * by_size));
        for (a, by_a) in &columns {
            let weighted = hessian * by_a;
            system.gradient[*a] += by_a.dot(&gradient);
            system.by_size[*a] += by_size.dot(&weighted);
            for (b, by_b) in &columns {
                system.hessian[(*a, *b)] += by_b.dot(&weighted);
            }
        }
    }
}

/// Standard deviation of the wrist that hand detectors see about the body's, m per axis.
const OFFSET_SIGMA: f64 = 0.015;
/// Standard deviation of the hand's rotation about the body's wrist, rad: that has been fitted to the knuckles.
const TURN_SIGMA: f64 = 0.25;
/// Weight of the pull towards a relaxed hand: a frame's pull is then a hundredth of one point's.
const REST_WEIGHT: f64 = 0.05;
/// Width of the walls at the ends of the ranges, rad: 5 degrees.
const WALL: f64 = 0.087;
/// The last joint of a finger bends by this share of the middle one, since they share a tendon (Rijpkema and Girard, SIGGRAPH
/// 1991), to within this many radians.
const LAST_OF_MIDDLE: f64 = 2.0 / 3.0;
const LAST_SIGMA: f64 = 0.25;
/// Frames of the same pose count once: the knowledge about a pose is the same in all of them.
const POSE_WEIGHT: f64 = 0.1;

/// What is known of a hand: squares of linear functions of the unknowns.
pub(super) struct Known {
    ranges: [HingeRange; N_UNKNOWNS - FIRST_ANGLE],
    /// Last and middle hinge of each finger.
    pairs: Vec<[usize; 2]>,
}

impl Known {
    pub(super) fn new() -> Self {
        let is_last = |(h, hinge): (usize, &crate::body::hand::Hinge)| {
            (hinge.place == 2 && hinge.finger < 4).then_some([FIRST_ANGLE + h, FIRST_ANGLE + h - 1])
        };
        Self { ranges: hinge_ranges(), pairs: hinges().iter().enumerate().filter_map(is_last).collect() }
    }

    /// Adds the knowledge to a frame.
    pub(super) fn add(&self, system: &mut FrameSystem, unknowns: &Unknowns) {
        let mut square = |column: usize, value: f64, sigma: f64, weight: f64| {
            let precision = weight / (sigma * sigma);
            system.cost += 0.5 * precision * value * value;
            system.gradient[column] += precision * value;
            system.hessian[(column, column)] += precision;
        };
        for axis in 0..3 {
            square(axis, unknowns[axis], OFFSET_SIGMA, POSE_WEIGHT);
            square(3 + axis, unknowns[3 + axis], TURN_SIGMA, POSE_WEIGHT);
        }
        for (h, range) in self.ranges.iter().enumerate() {
            let (column, angle) = (FIRST_ANGLE + h, unknowns[FIRST_ANGLE + h]);
            square(column, angle - range.rest, range.spread, REST_WEIGHT);
            let beyond = (angle - range.max).max(0.0) + (angle - range.min).min(0.0);
            if beyond != 0.0 {
                square(column, beyond, WALL, 1.0);
            }
        }
        for &[last, middle] in &self.pairs {
            let precision = POSE_WEIGHT / (LAST_SIGMA * LAST_SIGMA);
            let residual = unknowns[last] - LAST_OF_MIDDLE * unknowns[middle];
            system.cost += 0.5 * precision * residual * residual;
            for (a, by_a) in [(last, 1.0), (middle, -LAST_OF_MIDDLE)] {
                system.gradient[a] += precision * by_a * residual;
                for (b, by_b) in [(last, 1.0), (middle, -LAST_OF_MIDDLE)] {
                    system.hessian[(a, b)] += precision * by_a * by_b;
                }
            }
        }
    }
}

/// Standard deviations of second differences over time: of the offset, m/s^2, of rotation and angles, rad/s^2. Fingers of
/// gestures and grasps turn by 60 degrees within half a second; wrists have been smoothed with the body.
const OFFSET_ACCELERATION: f64 = 1.0;
const TURN_ACCELERATION: f64 = 8.0;
const ANGLE_ACCELERATION: f64 = 20.0;

/// Precision of the second difference `x_{t-1} - 2 x_t + x_{t+1}` of each unknown, `frame_interval` in s.
pub(super) fn smoothness(frame_interval: f64) -> Unknowns {
    let precision = |sigma: f64| (sigma * frame_interval * frame_interval).powi(-2);
    Unknowns::from_fn(|column, _| {
        precision(match column {
            0..3 => OFFSET_ACCELERATION,
            3..6 => TURN_ACCELERATION,
            _ => ANGLE_ACCELERATION,
        })
    })
}
