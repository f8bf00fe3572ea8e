//! The true points of a person's face and hands.

use super::FingerMotion;
use crate::body::hand::{HandShape, N_FACE_POINTS, N_HAND_POINTS, Side, face_keypoints, posed_hand};
use crate::body::kinematics::PosedSkeleton;
use crate::body::skeleton::KeypointConvention;
use crate::simulation::config::SimulationConfig;
use crate::simulation::random::{Purpose, normal, stream};
use crate::simulation::skeleton::{SimulatedPerson, joint};
use nalgebra::Vector3;
use std::f64::consts::FRAC_PI_2;

/// Points of a face and both hands, left first.
pub const N_DETAILS: usize = N_FACE_POINTS + 2 * N_HAND_POINTS;

/// Whether a convention has points of hands.
pub fn has_details(convention: KeypointConvention) -> bool {
    face_keypoints(convention).is_some()
}

/// Standard deviation of the logarithm of a hand's size at given stature (ANSUR II: 4 % with men and women apart).
const SIZE_SD: f64 = 0.04;
/// The same of a finger's length at given size of the hand.
const FINGER_SD: f64 = 0.04;
/// Standard deviation of a knuckle's place per axis, m. Chosen.
const KNUCKLE_SD: f64 = 0.002;

/// A person's face and hands.
pub(in crate::simulation) struct Details {
    face: [Vector3<f64>; N_FACE_POINTS],
    /// Left and right.
    hands: [(HandShape, FingerMotion); 2],
    scale: f64,
    fps: f64,
}

impl Details {
    /// `None` where the convention has no such points.
    pub(in crate::simulation) fn new(
        config: &SimulationConfig,
        index: usize,
        person: &SimulatedPerson,
    ) -> Option<Self> {
        if !has_details(config.convention) {
            return None;
        }
        let hands =
            Side::BOTH.map(|side| (individual_hand(config, index, side), FingerMotion::new(config, index, side)));
        Some(Self { face: face(), hands, scale: person.skeleton.scale, fps: config.fps })
    }

    /// Face, left and right hand in the world, m.
    pub(in crate::simulation) fn points(&self, frame: usize, posed: &PosedSkeleton) -> Vec<Vector3<f64>> {
        let head = joint("head");
        let on_head = |p: &Vector3<f64>| posed.joints[head] + posed.rotations[head] * p * self.scale;
        let mut points: Vec<Vector3<f64>> = self.face.iter().map(on_head).collect();
        for (side, (shape, motion)) in Side::BOTH.into_iter().zip(&self.hands) {
            let wrist = (&posed.joints[side.wrist()], &posed.rotations[side.wrist()]);
            points.extend(posed_hand(shape, wrist, self.scale, &motion.at(frame as f64 / self.fps)).points());
        }
        points
    }
}

/// The hand of an adult whose fingers, knuckles and size are the person's own, both sides alike.
fn individual_hand(config: &SimulationConfig, person: usize, side: Side) -> HandShape {
    let rng = &mut stream(config.seed, Purpose::Hand, 0, person);
    let mut shape = HandShape::average(side);
    let size = normal(rng, SIZE_SD).exp();
    for finger in &mut shape.places {
        let length = normal(rng, FINGER_SD).exp();
        let shift = Vector3::from_fn(|_, _| normal(rng, KNUCKLE_SD));
        let mirrored = Vector3::new(if side == Side::Right { -shift.x } else { shift.x }, shift.y, shift.z);
        let knuckle = finger[0];
        finger.iter_mut().for_each(|place| *place = (knuckle + mirrored + (*place - knuckle) * length) * size);
    }
    shape
}

/// The 68 points of the face in the head's frame (x left, y up, z forward), from the person's right to the left, m; about the
/// points of the simulator's own head ([`crate::simulation::landmarks`]).
fn face() -> [Vector3<f64>; N_FACE_POINTS] {
    let mut points = Vec::with_capacity(N_FACE_POINTS);
    let share = |i: usize, n: usize| i as f64 / (n - 1) as f64;
    // Outline: from ear to ear by the chin.
    for i in 0..17 {
        let (sin, cos) = ((2.0 * share(i, 17) - 1.0) * FRAC_PI_2).sin_cos();
        points.push([0.072 * sin, 0.060 - 0.100 * cos, 0.020 + 0.065 * cos]);
    }
    // Brows.
    let brow = |t: f64| [-0.060 + 0.045 * t, 0.098 + 0.006 * (4.0 * t * (1.0 - t)), 0.085 + 0.020 * t];
    let left = |[x, y, z]: [f64; 3]| [-x, y, z];
    points.extend((0..5).map(|i| brow(share(i, 5))));
    points.extend((0..5).map(|i| left(brow(1.0 - share(i, 5)))));
    // Nose: bridge and nostrils.
    points.extend((0..4).map(|i| [0.0, 0.085 - 0.040 * share(i, 4), 0.102 + 0.014 * share(i, 4)]));
    points.extend((0..5).map(|i| [-0.015 + 0.030 * share(i, 5), 0.033, 0.104]));
    // Eyes: the outer corner of the right one first, the inner one of the left one.
    let eye = [[0.0, 0.0], [0.33, 0.005], [0.67, 0.005], [1.0, 0.0], [0.67, -0.005], [0.33, -0.005]];
    let at_eye = |[t, up]: [f64; 2]| [-0.048 + 0.030 * t, 0.080 + up, 0.085 + 0.015 * t];
    points.extend(eye.map(at_eye));
    points.extend(eye.map(|[t, up]| left(at_eye([1.0 - t, up]))));
    // Lips: outer and inner outline, from the right corner over the upper lip.
    for (n, high) in [(12, 0.010), (8, 0.003)] {
        points.extend((0..n).map(|i| {
            let (sin, cos) = (i as f64 / n as f64 * 4.0 * FRAC_PI_2).sin_cos();
            [-0.024 * cos, 0.005 + high * sin, 0.098 + 0.006 * sin.abs()]
        }));
    }
    std::array::from_fn(|i| Vector3::from(points[i]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::hand::FACE_POINTS;

    #[test]
    fn corners_of_the_face_lie_on_their_sides() {
        let face = face();
        for (place, name) in FACE_POINTS {
            let point = face[place];
            assert_eq!(point.x > 0.0, name.starts_with("left"), "{name}: {point}");
            let high = if name.ends_with("mouth") { 0.005 } else { 0.080 };
            assert!((point.y - high).abs() < 1e-9, "{name}: {point}");
        }
    }
}
