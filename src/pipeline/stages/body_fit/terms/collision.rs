//! Collision: overlap of the body's capsules with those of other persons, whose poses are held.
//!
//! `(d_0 - d)^2 / (2 sigma^2)` where the distance d between two capsules is less than the required d_0. Both persons are
//! required to resolve half of an overlap at the same time, so that the order of the persons does not matter.

use super::super::capsule_overlaps::CapsuleOverlap;
use super::frame::{LinearisedFrame, PosedFrame};
use super::term::FrameTerm;
use super::unknowns::Unknowns;
use crate::body::capsules::{BodyCapsules, N_CAPSULES, NearestBall};
use crate::body::kinematics::PosedSkeleton;
use crate::body::skeleton::chain_to_root;
use crate::geometry::capsule::TaperedCapsule;
use crate::optim::block_banded::{Corner, FramePanel};
use crate::residuals::interpenetration::missing_distance;
use nalgebra::Vector3;
use std::collections::BTreeSet;
use std::ops::Range;

/// One person's overlaps by frame, and what their cost depends on.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Collisions<'a> {
    pub capsules: &'a BodyCapsules,
    pub by_frame: &'a [Vec<CapsuleOverlap>],
    /// Standard deviation of a distance, m.
    pub sigma: f64,
}

impl Collisions<'_> {
    /// Every joint that moves a capsule with a possible overlap.
    pub(crate) fn joints(&self) -> BTreeSet<usize> {
        let joint = |overlap: &CapsuleOverlap| self.capsules.capsules[overlap.own].joint;
        self.by_frame.iter().flatten().map(joint).flat_map(chain_to_root).collect()
    }

    pub(crate) fn slice(&self, frames: Range<usize>) -> Self {
        Self { by_frame: &self.by_frame[frames], ..*self }
    }

    /// Number of frames with an overlap.
    pub(crate) fn n_frames_with_overlap(&self) -> usize {
        self.by_frame.iter().filter(|overlaps| overlaps.iter().any(|overlap| overlap.least < 0.0)).count()
    }
}

/// The cost of overlaps.
pub(crate) struct CollisionTerm<'a> {
    collisions: Collisions<'a>,
    /// Group and joint of the free rotations.
    rotations: Vec<(usize, usize)>,
    /// Group of the translation.
    translation: usize,
}

impl<'a> CollisionTerm<'a> {
    pub(crate) fn new(collisions: Collisions<'a>, unknowns: &Unknowns) -> Self {
        Self { collisions, rotations: unknowns.rotations().collect(), translation: unknowns.translation() }
    }

    /// Derivatives of a distance over sigma, by group of three unknowns in ascending order.
    fn by_group(
        &self,
        skeleton: &PosedSkeleton,
        posed: &[TaperedCapsule; N_CAPSULES],
        ball: &NearestBall,
    ) -> Vec<(usize, Vector3<f64>)> {
        let Collisions { capsules, sigma, .. } = self.collisions;
        let above: Vec<usize> = chain_to_root(capsules.capsules[ball.capsule].joint).collect();
        let rotations = self.rotations.iter().filter(|(_, joint)| above.contains(joint));
        let by_rotation = rotations
            .map(|&(group, joint)| (group, capsules.distance_by_rotation(skeleton, posed, ball, joint) / sigma));
        by_rotation.chain([(self.translation, -ball.normal / sigma)]).collect()
    }
}

impl FrameTerm for CollisionTerm<'_> {
    fn cost(&self, frame: &PosedFrame) -> f64 {
        let Collisions { capsules, by_frame, sigma } = self.collisions;
        let overlaps = &by_frame[frame.index];
        if overlaps.is_empty() {
            return 0.0;
        }
        let posed = capsules.posed(frame.betas, &frame.skeleton);
        let missing = |overlap: &CapsuleOverlap| {
            missing_distance(overlap.least, posed[overlap.own].distance_to_capsule(&overlap.other).distance, sigma)
        };
        overlaps.iter().map(|overlap| 0.5 * missing(overlap).powi(2)).sum()
    }

    fn add_to(&self, frame: &LinearisedFrame, system: &mut FramePanel, _: &mut Corner) {
        let Collisions { capsules, by_frame, sigma } = self.collisions;
        let (skeleton, overlaps) = (&frame.posed.skeleton, &by_frame[frame.posed.index]);
        if overlaps.is_empty() {
            return;
        }
        let posed = capsules.posed(frame.posed.betas, skeleton);
        for overlap in overlaps {
            let found = posed[overlap.own].distance_to_capsule(&overlap.other);
            let missing = missing_distance(overlap.least, found.distance, sigma);
            if missing <= 0.0 {
                continue;
            }
            let ball = NearestBall { capsule: overlap.own, share: found.shares[0], normal: found.normal };
            let by_group = self.by_group(skeleton, &posed, &ball);
            for (i, (row, a)) in by_group.iter().enumerate() {
                // The residual falls with the distance.
                system.add_gradient(3 * row, &(a * -missing));
                for (column, b) in &by_group[..=i] {
                    system.add_own(3 * row, 3 * column, &(a * b.transpose()));
                }
            }
        }
    }
}
