//! The unknowns of a hand in a frame, and the hand that they pose.

use crate::body::hand::{FingerAngles, HandPoint, HandShape, N_HINGES, PosedHand, posed_hand};
use crate::geometry::rotation::{exp, right_jacobian, skew};
use nalgebra::{Matrix3, SVector, Vector3};

/// Unknowns of a hand and frame: offset of the wrist (m), rotation vector from the body's wrist, angles of the hinges (rad).
pub(super) const N_UNKNOWNS: usize = 6 + N_HINGES;

/// First of the angles.
pub(super) const FIRST_ANGLE: usize = 6;

/// Values of the unknowns.
pub(super) type Unknowns = SVector<f64, N_UNKNOWNS>;

/// Offset of the wrist from the body's.
pub(super) fn offset(unknowns: &Unknowns) -> Vector3<f64> {
    unknowns.fixed_rows::<3>(0).into_owned()
}

/// `wrist_from_hand`.
pub(super) fn turn(unknowns: &Unknowns) -> Vector3<f64> {
    unknowns.fixed_rows::<3>(3).into_owned()
}

pub(super) fn angles(unknowns: &Unknowns) -> FingerAngles {
    std::array::from_fn(|h| unknowns[FIRST_ANGLE + h])
}

/// The body's wrist in a frame: place, m, and `world_from_wrist`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Wrist {
    pub place: Vector3<f64>,
    pub rotation: Matrix3<f64>,
}

/// A hand of a frame with derivatives of its points by the unknowns.
pub(super) struct FramedHand {
    wrist: Vector3<f64>,
    world_from_hand: Matrix3<f64>,
    /// Of the rotation vector.
    right_jacobian: Matrix3<f64>,
    pub hand: PosedHand,
}

impl FramedHand {
    pub(super) fn new(shape: &HandShape, wrist: &Wrist, size: f64, unknowns: &Unknowns) -> Self {
        let place = wrist.place + offset(unknowns);
        let world_from_hand = wrist.rotation * exp(&turn(unknowns));
        let hand = posed_hand(shape, (&place, &world_from_hand), size, &angles(unknowns));
        Self { wrist: place, world_from_hand, right_jacobian: right_jacobian(&turn(unknowns)), hand }
    }

    /// Derivatives of a point by the unknowns that move it, m per m or rad: column and derivative.
    pub(super) fn by_unknowns(&self, point: HandPoint) -> Vec<(usize, Vector3<f64>)> {
        let arm = self.hand.point(point) - self.wrist;
        let by_turn = -skew(&arm) * self.world_from_hand * self.right_jacobian;
        let by_offset = Matrix3::<f64>::identity();
        let mut columns: Vec<(usize, Vector3<f64>)> = Vec::with_capacity(11);
        columns.extend((0..3).map(|axis| (axis, by_offset.column(axis).into_owned())));
        if point != HandPoint::Wrist {
            columns.extend((0..3).map(|axis| (3 + axis, by_turn.column(axis).into_owned())));
        }
        columns.extend(self.hand.by_angles(point).map(|(h, by)| (FIRST_ANGLE + h, by)));
        columns
    }
}
