//! Where two persons' bodies overlap, capsule against capsule.

use crate::body::capsules::{BodyCapsules, N_CAPSULES};
use crate::body::kinematics::{Pose, posed};
use crate::body::model::{Betas, ShapedBody};
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
    /// Around each capsule: centre and radius.
    balls: [(Vector3<f64>, f64); N_CAPSULES],
}

impl CapsuleBody {
    /// `body`: the model with the shape `betas`.
    pub(super) fn new(capsules: &BodyCapsules, (body, betas): (&ShapedBody, &Betas), pose: &Pose) -> Self {
        let skeleton = posed(body, pose);
        let capsules = capsules.posed(betas, &skeleton);
        Self { pelvis: skeleton.joints[0], balls: capsules.each_ref().map(ball_around), capsules }
    }

    /// All pairs of capsules nearer than [`WATCHED`].
    pub(super) fn overlap(&self, other: &Self, capsules: &BodyCapsules) -> BodyOverlap {
        let mut found = BodyOverlap::default();
        if (self.pelvis - other.pelvis).norm_squared() > REACH * REACH {
            return found;
        }
        for (i, (a, ball)) in self.capsules.iter().zip(&self.balls).enumerate() {
            let others = other.capsules.iter().zip(&other.balls).enumerate();
            for (j, (b, _)) in others.filter(|(_, (_, other))| are_near(ball, other)) {
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

/// The ball around a capsule.
fn ball_around(capsule: &TaperedCapsule) -> (Vector3<f64>, f64) {
    let half = 0.5 * (capsule.ends[1] - capsule.ends[0]).norm();
    (capsule.centre(0.5), half + capsule.radii[0].max(capsule.radii[1]))
}

/// Whether two balls are near enough for the capsules in them to be.
fn are_near((at, reach): &(Vector3<f64>, f64), (other_at, other_reach): &(Vector3<f64>, f64)) -> bool {
    (at - other_at).norm_squared() < (reach + other_reach + WATCHED).powi(2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::default_body;

    #[test]
    fn only_bodies_within_reach_overlap() {
        let model = default_body();
        let capsules = BodyCapsules::of(&model);
        let at = |x: f64| {
            let pose = Pose { translation: Vector3::x() * x, ..Pose::rest() };
            CapsuleBody::new(&capsules, (&model.shaped(&Betas::zeros()), &Betas::zeros()), &pose)
        };
        assert_eq!(at(0.0).overlap(&at(3.0), &capsules), BodyOverlap::default());
        assert_eq!(at(0.0).overlap(&at(2.0), &capsules), BodyOverlap::default());
        // The arms of two T-poses 1 m apart.
        assert!(at(0.0).overlap(&at(1.0), &capsules).depth > 0.03);
    }
}
