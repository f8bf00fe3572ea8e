//! Where two persons' bodies overlap, capsule against capsule.

use crate::body::capsules::{BodyCapsules, N_CAPSULES};
use crate::body::kinematics::{Pose, posed};
use crate::body::model::{Betas, BodyModel};
use crate::geometry::capsule::TaperedCapsule;
use nalgebra::Vector3;

/// A capsule of one person that overlaps, or nearly, with one of another person.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct CapsuleOverlap {
    /// Index of the person's own capsule.
    pub own: usize,
    pub other: TaperedCapsule,
    /// Required distance, m: half of the present one where that is negative, since the other person moves away as well.
    pub least: f64,
}

/// Distance below which capsules are watched, so that a person moved out of one overlap does not enter another, m.
const WATCHED: f64 = 0.03;

/// Pelvises further apart than the reach of two persons exclude an overlap, m.
pub(super) const REACH: f64 = 2.2;

/// Overlaps of two bodies in one frame.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct BodyOverlap {
    /// For each of the two persons, its own capsules against the other's.
    pub capsules: [Vec<CapsuleOverlap>; 2],
    /// Deepest overlap, m.
    pub depth: f64,
    /// Joints that carry the two capsules with the deepest overlap.
    pub joints: [usize; 2],
}

/// A person's capsules in one frame.
pub(super) struct CapsuleBody {
    pelvis: Vector3<f64>,
    capsules: [TaperedCapsule; N_CAPSULES],
}

impl CapsuleBody {
    pub(super) fn new(model: &BodyModel, capsules: &BodyCapsules, betas: &Betas, pose: &Pose) -> Self {
        let skeleton = posed(&model.shaped(betas), pose);
        Self { pelvis: skeleton.joints[0], capsules: capsules.posed(betas, &skeleton) }
    }

    /// All pairs of capsules nearer than [`WATCHED`].
    pub(super) fn overlap(&self, other: &Self, capsules: &BodyCapsules) -> BodyOverlap {
        let mut found = BodyOverlap::default();
        if (self.pelvis - other.pelvis).norm_squared() > REACH * REACH {
            return found;
        }
        for (i, a) in self.capsules.iter().enumerate() {
            for (j, b) in other.capsules.iter().enumerate().filter(|(_, b)| are_balls_near(a, b)) {
                let distance = a.distance_to_capsule(b).distance;
                if distance > WATCHED {
                    continue;
                }
                let least = 0.5 * distance.min(0.0);
                found.capsules[0].push(CapsuleOverlap { own: i, other: *b, least });
                found.capsules[1].push(CapsuleOverlap { own: j, other: *a, least });
                if -distance > found.depth {
                    found.depth = -distance;
                    found.joints = [i, j].map(|k| capsules.capsules[k].joint);
                }
            }
        }
        found
    }
}

/// Whether the balls around two capsules are near enough for the capsules to be.
fn are_balls_near(a: &TaperedCapsule, b: &TaperedCapsule) -> bool {
    let ball = |c: &TaperedCapsule| {
        let half = 0.5 * (c.ends[1] - c.ends[0]).norm();
        (c.centre(0.5), half + c.radii[0].max(c.radii[1]))
    };
    let ((at, reach), (other_at, other_reach)) = (ball(a), ball(b));
    (at - other_at).norm() < reach + other_reach + WATCHED
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::default_body;

    #[test]
    fn only_bodies_within_reach_overlap() {
        let model = default_body();
        let capsules = BodyCapsules::fitted(&model);
        let at = |x: f64| {
            let pose = Pose { translation: Vector3::x() * x, ..Pose::rest() };
            CapsuleBody::new(&model, &capsules, &Betas::zeros(), &pose)
        };
        assert_eq!(at(0.0).overlap(&at(3.0), &capsules), BodyOverlap::default());
        assert_eq!(at(0.0).overlap(&at(2.0), &capsules), BodyOverlap::default());
        // The arms of two T-poses 1 m apart.
        assert!(at(0.0).overlap(&at(1.0), &capsules).depth > 0.03);
    }
}
