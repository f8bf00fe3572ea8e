//! The posed hand and its derivatives.
//!
//! `p_k = w + s G (..)`: wrist `w`, size `s`, `world_from_wrist` `G`; a joint's rotation is the product of its hinges'
//! `exp(a_h theta_h)`, the outer first, and moves everything after it.

use super::geometry::{HandShape, N_HINGES, hinges};
use super::points::{HandPoint, N_HAND_POINTS, hand_points};
use super::{N_FINGER_JOINTS, finger_parent};
use crate::geometry::rotation::exp;
use nalgebra::{Matrix3, Vector3};

/// Angles of all hinges, rad.
pub type FingerAngles = [f64; N_HINGES];

/// A hand in the world.
#[derive(Debug, Clone, PartialEq)]
pub struct PosedHand {
    wrist: Vector3<f64>,
    /// `[finger][place]`, the tip in the last place, m.
    pub places: [[Vector3<f64>; 4]; 5],
    /// Axes of the hinges in the world.
    axes: [Vector3<f64>; N_HINGES],
}

/// SMPL-H's local rotations of a hand's joints.
pub fn finger_rotations(shape: &HandShape, angles: &FingerAngles) -> [Matrix3<f64>; N_FINGER_JOINTS] {
    let mut rotations = [Matrix3::identity(); N_FINGER_JOINTS];
    for ((hinge, axis), angle) in hinges().iter().zip(&shape.axes).zip(angles) {
        rotations[3 * hinge.finger + hinge.place] *= exp(&(axis * *angle));
    }
    rotations
}

/// Poses a hand of `size` times the shape's at a wrist of the given place and `world_from_wrist`.
pub fn posed_hand(
    shape: &HandShape,
    (wrist, world_from_wrist): (&Vector3<f64>, &Matrix3<f64>),
    size: f64,
    angles: &FingerAngles,
) -> PosedHand {
    let rotations = finger_rotations(shape, angles);
    let mut world_from_joint = rotations;
    let mut places = [[*wrist; 4]; 5];
    for joint in 0..N_FINGER_JOINTS {
        let (finger, place) = (joint / 3, joint % 3);
        let parent = finger_parent(joint);
        let world_from_parent = parent.map_or(*world_from_wrist, |parent| world_from_joint[parent]);
        let (from, rest) = match parent {
            Some(_) => (places[finger][place - 1], shape.places[finger][place] - shape.places[finger][place - 1]),
            None => (*wrist, shape.places[finger][0]),
        };
        places[finger][place] = from + world_from_parent * rest * size;
        world_from_joint[joint] = world_from_parent * rotations[joint];
        if place == 2 {
            let tip = shape.places[finger][3] - shape.places[finger][2];
            places[finger][3] = places[finger][2] + world_from_joint[joint] * tip * size;
        }
    }
    let mut axes = shape.axes;
    let mut outer = Matrix3::identity();
    for (h, hinge) in hinges().iter().enumerate() {
        let joint = 3 * hinge.finger + hinge.place;
        let is_first = h == 0 || hinges()[h - 1].finger != hinge.finger || hinges()[h - 1].place != hinge.place;
        if is_first {
            outer = finger_parent(joint).map_or(*world_from_wrist, |parent| world_from_joint[parent]);
        }
        axes[h] = outer * shape.axes[h];
        outer *= exp(&(shape.axes[h] * angles[h]));
    }
    PosedHand { wrist: *wrist, places, axes }
}

impl PosedHand {
    /// A point of the detector, m.
    pub fn point(&self, point: HandPoint) -> Vector3<f64> {
        match point {
            HandPoint::Wrist => self.wrist,
            HandPoint::Joint { finger, place } => self.places[finger][place],
        }
    }

    /// All points in the detector's order, m.
    pub fn points(&self) -> [Vector3<f64>; N_HAND_POINTS] {
        hand_points().map(|point| self.point(point))
    }

    /// Finger joints in SMPL-H's order, m.
    pub fn joints(&self) -> [Vector3<f64>; N_FINGER_JOINTS] {
        std::array::from_fn(|joint| self.places[joint / 3][joint % 3])
    }

    /// Derivatives of a point by the angles of the hinges that move it, m/rad: index of the hinge and derivative.
    pub fn by_angles(&self, point: HandPoint) -> impl Iterator<Item = (usize, Vector3<f64>)> + '_ {
        let moved = hinges().into_iter().enumerate().filter(move |(_, hinge)| match point {
            HandPoint::Wrist => false,
            HandPoint::Joint { finger, place } => hinge.finger == finger && hinge.place < place,
        });
        let at = self.point(point);
        moved.map(move |(h, hinge)| (h, self.axes[h].cross(&(at - self.places[hinge.finger][hinge.place]))))
    }

    /// Derivative of a point by the logarithm of the size, m.
    pub fn by_log_size(&self, point: HandPoint) -> Vector3<f64> {
        self.point(point) - self.wrist
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Side, hinge_ranges};
    use super::*;

    #[test]
    fn derivatives_of_all_points_match_differences() {
        let shape = HandShape::average(Side::Right);
        let turn = exp(&Vector3::new(0.4, -1.1, 0.3));
        let wrist = Vector3::new(0.2, 1.3, -0.4);
        let angles: FingerAngles = std::array::from_fn(|h| 0.1 * h as f64 - 0.7);
        let at = |d: &[f64]| {
            let moved = std::array::from_fn(|h| angles[h] + d[h]);
            posed_hand(&shape, (&wrist, &turn), 1.1 * d[N_HINGES].exp(), &moved)
        };
        let hand = at(&[0.0; N_HINGES + 1]);
        for point in hand_points() {
            let mut derivatives = [Vector3::zeros(); N_HINGES + 1];
            hand.by_angles(point).for_each(|(h, by)| derivatives[h] = by);
            derivatives[N_HINGES] = hand.by_log_size(point);
            for (unknown, analytic) in derivatives.iter().enumerate() {
                let stepped = |h: f64| {
                    let mut increments = [0.0; N_HINGES + 1];
                    increments[unknown] = h;
                    at(&increments).point(point)
                };
                let difference = (stepped(1e-6) - stepped(-1e-6)) / 2e-6;
                assert!((difference - analytic).norm() < 1e-8, "{point:?} by {unknown}");
            }
        }
    }

    #[test]
    fn rotations_in_smplh_order_give_the_same_joints() {
        let shape = HandShape::average(Side::Left);
        let angles = hinge_ranges().map(|range| range.rest + range.spread);
        let (wrist, turn) = (Vector3::new(1.0, 2.0, 3.0), exp(&Vector3::new(0.3, 0.2, -0.9)));
        let hand = posed_hand(&shape, (&wrist, &turn), 0.9, &angles);
        let rotations = finger_rotations(&shape, &angles);
        let mut world = rotations;
        let mut joints = [wrist; N_FINGER_JOINTS];
        for joint in 0..N_FINGER_JOINTS {
            let (from, outer, rest) = match finger_parent(joint) {
                Some(p) => (joints[p], world[p], shape.joint(joint) - shape.joint(p)),
                None => (wrist, turn, shape.joint(joint)),
            };
            joints[joint] = from + outer * rest * 0.9;
            world[joint] = outer * rotations[joint];
        }
        let worst = joints.iter().zip(hand.joints()).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
        assert!(worst < 1e-12, "{worst}");
    }
}
