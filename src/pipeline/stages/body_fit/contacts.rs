//! Where people's bodies reach into each other, capsule against capsule, and what that costs.
//!
//! A contact asks for a distance d of at least d_0 between a capsule of one person and one of another's, whose pose is held:
//! `(d_0 - d)^2 / (2 sigma^2)` where d is less. Both people are asked for half of what is missing, at once: neither goes
//! first, and the order of the people does not matter.

use super::motion_problem::TRANSLATION_GROUP;
use crate::body::capsules::{BodyCapsules, N_CAPSULES, NearestBall};
use crate::body::kinematics::{Pose, PosedSkeleton, posed};
use crate::body::model::{Betas, BodyModel};
use crate::body::skeleton::chain_to_root;
use crate::geometry::capsule::TaperedCapsule;
use nalgebra::{DMatrix, DVector, Vector3};
use std::collections::BTreeSet;

/// Another person's capsule next to one of one's own.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Contact {
    /// Index of the own capsule.
    pub own: usize,
    pub other: TaperedCapsule,
    /// The distance asked for, m; negative where the other person is to give way, too.
    pub least: f64,
}

/// One person's contacts by frame, and what is needed to judge them.
#[derive(Debug, Clone, Copy)]
pub(super) struct Contacts<'a> {
    pub capsules: &'a BodyCapsules,
    pub by_frame: &'a [Vec<Contact>],
    /// Standard deviation of a distance, m.
    pub sigma: f64,
}

/// Capsules that come nearer than this are watched, so that whoever gives way does not run into the next, m.
const WATCHED: f64 = 0.03;

/// Pelvises further apart than two people's reach cannot touch, m.
pub(super) const REACH: f64 = 2.2;

/// How two bodies touch at one time: for each of the two the contacts, and the deepest overlap, m.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Touch {
    pub contacts: [Vec<Contact>; 2],
    pub depth: f64,
    /// Joints that carry the two capsules that reach deepest.
    pub joints: [usize; 2],
}

/// A person at one time, with bounds for the capsules.
pub(super) struct CapsuleBody {
    pelvis: Vector3<f64>,
    capsules: [TaperedCapsule; N_CAPSULES],
}

impl CapsuleBody {
    pub(super) fn new(model: &BodyModel, capsules: &BodyCapsules, betas: &Betas, pose: &Pose) -> Self {
        let skeleton = posed(&model.shaped(betas), pose);
        Self { pelvis: skeleton.joints[0], capsules: capsules.posed(betas, &skeleton) }
    }

    /// What touches, or is about to.
    pub(super) fn touch(&self, other: &Self, capsules: &BodyCapsules) -> Touch {
        let mut touch = Touch::default();
        if (self.pelvis - other.pelvis).norm_squared() > REACH * REACH {
            return touch;
        }
        for (i, a) in self.capsules.iter().enumerate() {
            for (j, b) in other.capsules.iter().enumerate().filter(|(_, b)| may_touch(a, b)) {
                let distance = a.distance_to_capsule(b).distance;
                if distance > WATCHED {
                    continue;
                }
                let least = 0.5 * distance.min(0.0);
                touch.contacts[0].push(Contact { own: i, other: *b, least });
                touch.contacts[1].push(Contact { own: j, other: *a, least });
                if -distance > touch.depth {
                    touch.depth = -distance;
                    touch.joints = [i, j].map(|k| capsules.capsules[k].joint);
                }
            }
        }
        touch
    }
}

/// By the balls about both capsules.
fn may_touch(a: &TaperedCapsule, b: &TaperedCapsule) -> bool {
    let ball = |c: &TaperedCapsule| {
        let half = 0.5 * (c.ends[1] - c.ends[0]).norm();
        (c.centre(0.5), half + c.radii[0].max(c.radii[1]))
    };
    let ((at, reach), (other_at, other_reach)) = (ball(a), ball(b));
    (at - other_at).norm() < reach + other_reach + WATCHED
}

impl Contacts<'_> {
    /// Every joint that can move a capsule that touches.
    pub(super) fn joints(&self) -> BTreeSet<usize> {
        let joint_of = |contact: &Contact| self.capsules.capsules[contact.own].joint;
        self.by_frame.iter().flatten().map(joint_of).flat_map(chain_to_root).collect()
    }

    pub(super) fn slice(&self, frames: std::ops::Range<usize>) -> Self {
        Self { by_frame: &self.by_frame[frames], ..*self }
    }

    /// Frames in which somebody is asked to give way.
    pub(super) fn n_touching(&self) -> usize {
        self.by_frame.iter().filter(|contacts| contacts.iter().any(|contact| contact.least < 0.0)).count()
    }

    /// What frame `t` costs.
    pub(super) fn cost(&self, t: usize, betas: &Betas, skeleton: &PosedSkeleton) -> f64 {
        if self.by_frame[t].is_empty() {
            return 0.0;
        }
        let posed = self.capsules.posed(betas, skeleton);
        let missing = |c: &Contact| (c.least - posed[c.own].distance_to_capsule(&c.other).distance).max(0.0);
        self.by_frame[t].iter().map(|c| 0.5 * (missing(c) / self.sigma).powi(2)).sum()
    }

    /// The same with its Gauss-Newton system, added to the lower blocks of `diagonal` and to `gradient`: translation and
    /// the joints `active`, three unknowns each.
    pub(super) fn add_to(
        &self,
        t: usize,
        state: (&Betas, &PosedSkeleton),
        active: &[usize],
        diagonal: &mut DMatrix<f64>,
        gradient: &mut DVector<f64>,
    ) -> f64 {
        let (betas, skeleton) = state;
        if self.by_frame[t].is_empty() {
            return 0.0;
        }
        let posed = self.capsules.posed(betas, skeleton);
        let mut cost = 0.0;
        for contact in &self.by_frame[t] {
            let found = posed[contact.own].distance_to_capsule(&contact.other);
            let missing = (contact.least - found.distance) / self.sigma;
            if missing <= 0.0 {
                continue;
            }
            cost += 0.5 * missing * missing;
            let ball = NearestBall { capsule: contact.own, share: found.shares[0], normal: found.normal };
            let by_group = self.by_group(skeleton, &posed, &ball, active);
            for (i, (row, a)) in by_group.iter().enumerate() {
                // The residual is what is missing: its derivative has the other sign.
                let mut part = gradient.fixed_rows_mut::<3>(3 * row);
                part -= a * missing;
                for (column, b) in &by_group[..=i] {
                    let mut block = diagonal.fixed_view_mut::<3, 3>(3 * row, 3 * column);
                    block += a * b.transpose();
                }
            }
        }
        cost
    }

    /// Derivatives of a distance over sigma, by group of three unknowns in ascending order.
    fn by_group(
        &self,
        skeleton: &PosedSkeleton,
        posed: &[TaperedCapsule; N_CAPSULES],
        ball: &NearestBall,
        active: &[usize],
    ) -> Vec<(usize, Vector3<f64>)> {
        let joint = self.capsules.capsules[ball.capsule].joint;
        let above: Vec<usize> = chain_to_root(joint).collect();
        let turns =
            active.iter().enumerate().filter(|(_, joint)| above.contains(joint)).map(|(i, &joint)| {
                (i + 1, self.capsules.distance_by_rotation(skeleton, posed, ball, joint) / self.sigma)
            });
        std::iter::once((TRANSLATION_GROUP, -ball.normal / self.sigma)).chain(turns).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::default_body;
    use crate::body::skeleton::N_JOINTS;
    use crate::geometry::rotation;

    /// The gradient of two people who stand in each other's way against central differences, along every unknown; the
    /// step of 1e-6 m or rad is good to 1e-7 of some 10 a metre.
    #[test]
    fn the_gradient_is_that_of_the_cost() {
        let model = default_body();
        let capsules = BodyCapsules::fitted(&model);
        let betas = Betas::from_fn(|k, _| 0.3 - 0.1 * k as f64);
        let turn =
            |j: usize| Vector3::new((j as f64 * 1.3).sin(), (j as f64 * 0.7).cos(), (j as f64 * 2.1).sin()) * 0.3;
        let pose = Pose { rotations: std::array::from_fn(|j| rotation::exp(&turn(j))), translation: Vector3::zeros() };
        let beside = Pose { translation: Vector3::new(0.25, 0.0, 0.1), ..Pose::rest() };
        let other = CapsuleBody::new(&model, &capsules, &Betas::zeros(), &beside);
        let touch = CapsuleBody::new(&model, &capsules, &betas, &pose).touch(&other, &capsules);
        assert!(touch.depth > 0.02 && touch.contacts[0].len() > 5, "{}", touch.depth);
        let by_frame = [touch.contacts[0].clone()];
        let contacts = Contacts { capsules: &capsules, by_frame: &by_frame, sigma: 0.01 };
        let active: Vec<usize> = (0..22).collect();
        let body = model.shaped(&betas);
        let cost = |pose: &Pose| contacts.cost(0, &betas, &posed(&body, pose));
        let n = 3 * (active.len() + 1);
        let (mut diagonal, mut gradient) = (DMatrix::zeros(n, n), DVector::zeros(n));
        let found = contacts.add_to(0, (&betas, &posed(&body, &pose)), &active, &mut diagonal, &mut gradient);
        assert!((found - cost(&pose)).abs() < 1e-12 * found);
        for (i, axis) in (0..=active.len()).flat_map(|i| (0..3).map(move |axis| (i, axis))) {
            let stepped = |h: f64| {
                let mut pose = pose;
                match i {
                    0 => pose.translation[axis] += h,
                    _ => pose.rotations[active[i - 1]] *= rotation::exp(&Vector3::ith(axis, h)),
                }
                cost(&pose)
            };
            let difference = (stepped(1e-6) - stepped(-1e-6)) / 2e-6;
            assert!((difference - gradient[3 * i + axis]).abs() < 1e-5 * (1.0 + gradient.amax()), "{i} {axis}");
        }
    }

    #[test]
    fn people_out_of_reach_do_not_touch() {
        let model = default_body();
        let capsules = BodyCapsules::fitted(&model);
        let at = |x: f64| {
            let pose = Pose { rotations: [nalgebra::Matrix3::identity(); N_JOINTS], translation: Vector3::x() * x };
            CapsuleBody::new(&model, &capsules, &Betas::zeros(), &pose)
        };
        assert_eq!(at(0.0).touch(&at(3.0), &capsules), Touch::default());
        assert_eq!(at(0.0).touch(&at(2.0), &capsules), Touch::default());
        // Two T-poses 1 m apart: their arms lie in each other.
        assert!(at(0.0).touch(&at(1.0), &capsules).depth > 0.03);
    }
}
