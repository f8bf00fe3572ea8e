//! Self-penetration of a pose: overlaps of the default body's 21 capsules.

use super::chart::LocalRotations;
use crate::body::capsules::{BodyCapsules, N_CAPSULES};
use crate::body::kinematics::{Pose, posed};
use crate::body::model::{BodyModel, ShapedBody};
use crate::body::skeleton::chain_to_root;
use crate::body::{Betas, default_body};
use crate::geometry::capsule::TaperedCapsule;
use nalgebra::{Matrix3, Vector3};

/// Capsules of joints at most this many bones apart share skin and overlap when the joints between them bend.
const NEIGHBOUR_BONES: usize = 2;

/// The default body and the pairs of its capsules that count as penetration when they overlap.
pub(crate) struct SelfContact {
    body: ShapedBody,
    capsules: BodyCapsules,
    pairs: Vec<[usize; 2]>,
}

impl SelfContact {
    /// The default body with the pairs that are not neighbours and do not overlap at rest. Fitting the capsules takes half a
    /// second.
    pub(crate) fn of_default_body() -> Self {
        let model: BodyModel = default_body();
        let capsules = BodyCapsules::fitted(&model);
        let joints = capsules.capsules.each_ref().map(|capsule| capsule.joint);
        let mut contact = Self { body: model.shaped(&Betas::zeros()), capsules, pairs: Vec::new() };
        let rest = contact.posed(&Pose::rest().rotations);
        let all = (0..N_CAPSULES).flat_map(|a| (0..a).map(move |b| [a, b]));
        let is_free = |[a, b]: &[usize; 2]| {
            bones_between(joints[*a], joints[*b]) > NEIGHBOUR_BONES
                && rest[*a].distance_to_capsule(&rest[*b]).distance > 0.0
        };
        contact.pairs = all.filter(is_free).collect();
        contact
    }

    /// Depth of the deepest overlap, m; 0 without overlap. The pelvis's rotation has no effect.
    pub(crate) fn depth(&self, local: &LocalRotations) -> f64 {
        let posed = self.posed(local);
        let depths = self.pairs.iter().map(|[a, b]| -posed[*a].distance_to_capsule(&posed[*b]).distance);
        depths.fold(0.0, f64::max)
    }

    fn posed(&self, local: &LocalRotations) -> [TaperedCapsule; N_CAPSULES] {
        let mut rotations = *local;
        rotations[0] = Matrix3::identity();
        let skeleton = posed(&self.body, &Pose { rotations, translation: Vector3::zeros() });
        self.capsules.posed(&Betas::zeros(), &skeleton)
    }
}

/// Number of bones between two joints along the skeleton.
fn bones_between(a: usize, b: usize) -> usize {
    let above: Vec<usize> = chain_to_root(a).collect();
    let meets = |joint: usize| above.iter().position(|other| *other == joint);
    let lengths = chain_to_root(b).enumerate().filter_map(|(up, joint)| meets(joint).map(|down| up + down));
    lengths.min().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::rotation;

    #[test]
    fn bones_are_counted_along_the_skeleton() {
        assert_eq!([(4, 4), (4, 1), (1, 2), (4, 5), (20, 15)].map(|(a, b)| bones_between(a, b)), [0, 1, 2, 4, 6]);
    }

    /// A forearm folded across the chest so far that the hand lies inside it, against a T-pose and hanging arms.
    #[test]
    fn an_arm_inside_the_chest_penetrates_hanging_arms_do_not() {
        let contact = SelfContact::of_default_body();
        let mut pose = Pose::rest().rotations;
        assert_eq!(contact.depth(&pose), 0.0);
        pose[16] = rotation::exp(&Vector3::new(0.0, 0.0, -1.2));
        pose[17] = rotation::exp(&Vector3::new(0.0, 0.0, 1.2));
        assert!(contact.depth(&pose) < 0.01, "{}", contact.depth(&pose));
        pose[18] = rotation::exp(&Vector3::new(0.0, 0.0, -1.6));
        assert!(contact.depth(&pose) > 0.05, "{}", contact.depth(&pose));
    }
}
