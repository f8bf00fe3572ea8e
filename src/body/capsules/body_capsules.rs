//! The capsules of a body model: posed, and the derivatives of distances from them.

use crate::body::anthropometry::BetaRow;
use crate::body::kinematics::PosedSkeleton;
use crate::body::shape::{Betas, ShapeDirections};
use crate::body::skeleton::chain_to_root;
use crate::geometry::capsule::TaperedCapsule;
use crate::geometry::rotation::skew;
use nalgebra::{Matrix3, Vector3};

/// Number of capsules.
pub const N_CAPSULES: usize = 21;

/// One end of a capsule.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CapsuleEnd {
    /// `a`: centre in the joint's frame at beta 0, m.
    pub offset: Vector3<f64>,
    /// `A`: its change per beta, m.
    pub offset_directions: ShapeDirections,
    /// `r_0`: radius at beta 0, m.
    pub radius: f64,
    /// `r_beta`: its change per beta, m.
    pub radius_directions: BetaRow,
}

/// A capsule fixed to one joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BodyCapsule {
    /// The joint in whose frame its ends are fixed.
    pub joint: usize,
    /// Both ends.
    pub ends: [CapsuleEnd; 2],
}

/// The capsules of a body model, fitted to its surface.
#[derive(Debug, Clone, PartialEq)]
pub struct BodyCapsules {
    /// All capsules, in the same order for every model.
    pub capsules: [BodyCapsule; N_CAPSULES],
}

/// The ball of a capsule that determines a distance to a point or to another body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NearestBall {
    /// Index of the capsule.
    pub capsule: usize,
    /// Position of its centre between the ends, 0 to 1.
    pub share: f64,
    /// Unit vector from the centre towards the other point, world.
    pub normal: Vector3<f64>,
}

impl BodyCapsules {
    /// The capsules of a shape in a pose, in the world.
    pub fn posed(&self, betas: &Betas, skeleton: &PosedSkeleton) -> [TaperedCapsule; N_CAPSULES] {
        let posed = |capsule: &BodyCapsule| {
            let (joint, rotation) = (skeleton.joints[capsule.joint], skeleton.rotations[capsule.joint]);
            let centre = |end: &CapsuleEnd| joint + rotation * (end.offset + end.offset_directions * betas);
            let radius = |end: &CapsuleEnd| (end.radius + end.radius_directions.dot(betas)).max(MIN_RADIUS);
            TaperedCapsule { ends: capsule.ends.each_ref().map(centre), radii: capsule.ends.each_ref().map(radius) }
        };
        self.capsules.each_ref().map(posed)
    }

    /// Derivative of a distance to the local right increment `R_a <- R_a exp(d)` of joint `a` of this body (per rad).
    ///
    /// The ball's centre c rotates with every joint above it: `dc = -[c - p_a]x G_a d`, hence `n^T [c - p_a]x G_a`. The
    /// derivative to the body's translation is `-n`.
    pub fn distance_by_rotation(
        &self,
        skeleton: &PosedSkeleton,
        posed: &[TaperedCapsule; N_CAPSULES],
        ball: &NearestBall,
        joint: usize,
    ) -> Vector3<f64> {
        if !chain_to_root(self.capsules[ball.capsule].joint).any(|above| above == joint) {
            return Vector3::zeros();
        }
        let lever = posed[ball.capsule].centre(ball.share) - skeleton.joints[joint];
        let by_centre: Matrix3<f64> = -skew(&lever) * skeleton.rotations[joint];
        -by_centre.tr_mul(&ball.normal)
    }
}

/// Smallest radius of a capsule at any shape, m.
pub(super) const MIN_RADIUS: f64 = 5e-3;
