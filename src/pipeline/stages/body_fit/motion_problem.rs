//! The least-squares problem of one person's motion: its unknowns and its cost.
//!
//! The cost is an integral over time: every frame counts `dt * 30 Hz`, so that one motion filmed at 25, 30 or 60 Hz
//! has one optimum. A detector's error drifts over some frames, hence more frames a second are not more information.

use super::BodyFitConfig;
use super::contacts::Contacts;
use super::evidence::{Evidence, PixelEvidence, PointEvidence};
use super::paces::AccelerationSizes;
use super::place_cost::{PlaceCost, pixel_cost, point_cost, sum};
use super::steady_places::steady_landmarks;
use crate::body::anthropometry::N_BETAS;
use crate::body::bone_offsets::N_BONE_KINDS;
use crate::body::detector_offsets::OffsetTable;
use crate::body::joint_ranges::{JointRange, joint_ranges_of};
use crate::body::kinematics::{Pose, PosedSkeleton, landmark_position, moving_joints, posed};
use crate::body::model::{Betas, BodyModel, ShapedBody};
use crate::body::skeleton::N_JOINTS;
use crate::geometry::rotation;
use crate::motion_prior::MotionPrior;
use crate::motion_prior::pose_gaussian::PoseGaussian;
use crate::optim::block_banded::BandedStep;
use crate::residuals::joint_angles::{JointAngleCost, JointAngleWeights, joint_angle_cost};
use crate::residuals::pose_likelihood::{PoseCost, pose_cost};
use nalgebra::Vector3;
use rayon::prelude::*;

/// The unknowns.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct MotionState {
    pub betas: Betas,
    /// One per frame.
    pub poses: Vec<Pose>,
}

/// Which evidence is fitted, and how precise it is taken to be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum DataTerm {
    /// Triangulated points, standard deviation in m per axis.
    Points { sigma: f64 },
    /// Pixels, standard deviation per axis as a share of [`super::evidence::PixelEvidence::scale_px`].
    Pixels { share: f64 },
}

/// Whether the shape moves with the pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Shape {
    Free,
    Held,
}

/// One person's motion over a run of frames.
pub(super) struct MotionProblem<'a> {
    pub model: &'a BodyModel,
    pub evidence: &'a Evidence,
    pub config: &'a BodyFitConfig,
    pub data: DataTerm,
    pub shape: Shape,
    /// Offsets of landmarks that stand in the border after the betas and the person's bones; their values, like those of
    /// the bones, are in `model`.
    pub free_offsets: Option<&'a OffsetTable>,
    /// Other people's bodies in the way.
    pub contacts: Option<Contacts<'a>>,
    /// Frames that stay as they are.
    pub held: &'a [usize],
    /// Weight of the betas' prior against one frame's evidence.
    pub shape_prior: f64,
    /// s.
    pub frame_interval: f64,
    /// The joints that turn, ascending; the root is the first.
    pub active: Vec<usize>,
    /// `moved_by[landmark]`: `(group, joint)` of the active joints that move it.
    pub moved_by: Vec<Vec<(usize, usize)>>,
    pub ranges: [JointRange; N_JOINTS],
    /// Landmarks whose places accelerate little.
    pub steady: Vec<usize>,
    /// How large accelerations are, by frame.
    pub sizes: Vec<AccelerationSizes>,
    /// What is known of the poses of those that turn.
    pub likely: Option<PoseGaussian>,
}

/// Position of the translation's three unknowns in a frame; joint `active[i]` has group `i + 1`.
pub(super) const TRANSLATION_GROUP: usize = 0;

/// Rate at which a frame counts once.
const REFERENCE_RATE_HZ: f64 = 30.0;

impl<'a> MotionProblem<'a> {
    /// The problem over all frames of `evidence`.
    ///
    /// Only joints that move a landmark with evidence turn; the others (the hands always) stay where they started.
    pub(super) fn new(
        model: &'a BodyModel,
        evidence: &'a Evidence,
        config: &'a BodyFitConfig,
        data: DataTerm,
        shape: Shape,
        frame_interval: f64,
    ) -> Self {
        let moving: Vec<Vec<usize>> = model.landmarks.iter().map(moving_joints).collect();
        let mut turns = [false; N_JOINTS];
        turns[0] = true;
        let of_points = evidence.points.iter().flatten().map(|p| p.landmark);
        for landmark in of_points.chain(evidence.pixels.iter().flatten().map(|p| p.landmark)) {
            moving[landmark].iter().for_each(|&j| turns[j] = true);
        }
        let active: Vec<usize> = (0..FIRST_HAND).filter(|&j| turns[j]).collect();
        let moved_by = moved_by(model, &active);
        let (free_offsets, contacts, shape_prior, ranges) = (None, None, config.shape_prior, joint_ranges_of(model));
        let steady = steady_landmarks(model, config);
        let sizes = vec![AccelerationSizes::typical(config, &ranges); evidence.points.len()];
        Self {
            model,
            evidence,
            config,
            data,
            shape,
            free_offsets,
            contacts,
            held: &[],
            shape_prior,
            frame_interval,
            steady,
            sizes,
            likely: likely_poses(model, config, &active),
            active,
            moved_by,
            ranges,
        }
    }

    /// The same with the person's bones and the offsets of landmarks as further unknowns and a stronger prior of the
    /// shape, for what offsets and skeleton share is told apart by their priors alone.
    pub(super) fn with_free_offsets(self, table: &'a OffsetTable, shape_prior: f64) -> Self {
        Self { free_offsets: Some(table), shape_prior, ..self }
    }

    /// The same with other people's bodies in the way: whatever carries a capsule that touches turns, too, as the wrists
    /// do, which no keypoint tells of.
    pub(super) fn with_contacts(self, contacts: Contacts<'a>) -> Self {
        let touching = contacts.joints();
        let active: Vec<usize> = (0..FIRST_HAND).filter(|j| self.active.contains(j) || touching.contains(j)).collect();
        let likely = likely_poses(self.model, self.config, &active);
        Self { contacts: Some(contacts), moved_by: moved_by(self.model, &active), active, likely, ..self }
    }

    /// The same with some frames held.
    pub(super) fn holding(self, held: &'a [usize]) -> Self {
        Self { held, ..self }
    }

    /// Unknowns of the border: the betas, the person's bones, the offsets.
    pub(super) fn n_border(&self) -> usize {
        self.first_offset() + self.free_offsets.map_or(0, |table| 3 * table.kinds.len())
    }

    /// Column of the border where the offsets begin.
    pub(super) fn first_offset(&self) -> usize {
        self.n_betas() + if self.free_offsets.is_some() { 3 * N_BONE_KINDS } else { 0 }
    }

    /// Betas among the unknowns.
    pub(super) fn n_betas(&self) -> usize {
        if self.shape == Shape::Free { N_BETAS } else { 0 }
    }

    pub(super) fn time_weight(&self) -> f64 {
        self.frame_interval * REFERENCE_RATE_HZ
    }

    /// The state after a step of the solver: betas added, right increments of the rotations. Bones and offsets
    /// are no part of it.
    pub(super) fn moved(&self, state: &MotionState, step: &BandedStep) -> MotionState {
        let mut moved = state.clone();
        if self.shape == Shape::Free {
            moved.betas += step.border.fixed_rows::<N_BETAS>(0);
        }
        for (pose, step) in moved.poses.iter_mut().zip(&step.frames) {
            let group = |g: usize| step.fixed_rows::<3>(3 * g).into_owned();
            pose.translation += group(TRANSLATION_GROUP);
            for (i, &joint) in self.active.iter().enumerate() {
                pose.rotations[joint] *= rotation::exp(&group(i + 1));
            }
        }
        moved
    }

    /// The cost but for other people's bodies.
    pub(super) fn cost_alone(&self, state: &MotionState) -> f64 {
        self.cost_with(state, None)
    }

    /// The whole cost.
    pub(super) fn cost(&self, state: &MotionState) -> f64 {
        self.cost_with(state, self.contacts)
    }

    fn cost_with(&self, state: &MotionState, contacts: Option<Contacts>) -> f64 {
        let body = self.model.shaped(&state.betas);
        let frame_cost = |(t, pose): (usize, &Pose)| {
            let skeleton = posed(&body, pose);
            let data: f64 = self.place_costs(t, &body, &skeleton).iter().map(|p| p.cost).sum();
            let angles: f64 = self.active[1..].iter().map(|&j| self.angle_cost(pose, j).cost).sum();
            let likely = self.pose_cost(pose).map_or(0.0, |poses| poses.cost);
            let contacts = contacts.map_or(0.0, |contacts| contacts.cost(t, &state.betas, &skeleton));
            (data + angles + likely + contacts, self.steady_positions(&body, &skeleton))
        };
        let (frames, places): (Vec<f64>, Vec<Vec<Vector3<f64>>>) =
            state.poses.par_iter().enumerate().map(frame_cost).unzip();
        let smooth: f64 = (1..state.poses.len().saturating_sub(1)).map(|t| self.smoothness_cost(state, t)).sum();
        let steady: f64 =
            places.windows(3).enumerate().map(|(i, around)| self.place_acceleration_cost(i + 1, around)).sum();
        0.5 * self.shape_prior * state.betas.norm_squared()
            + self.time_weight() * (frames.iter().sum::<f64>() + smooth + steady)
    }

    /// Walls at the ends of a joint's range, and the pull to rest where the likely poses do not tell of it.
    pub(super) fn angle_cost(&self, pose: &Pose, joint: usize) -> JointAngleCost {
        let is_told = self.likely.as_ref().is_some_and(|likely| likely.joints.contains(&joint));
        let rest = if is_told { 0.0 } else { self.config.rest_weight };
        let weights = JointAngleWeights { rest, limit_width: self.config.limit_width_deg.to_radians() };
        joint_angle_cost(&pose.rotations[joint], &self.ranges[joint], &weights)
    }

    /// What the pose as a whole costs.
    pub(super) fn pose_cost(&self, pose: &Pose) -> Option<PoseCost> {
        self.likely.as_ref().map(|likely| pose_cost(&pose.rotations, likely, &self.config.pose_weights))
    }

    /// Cost over the position of every landmark with evidence at frame `t`.
    pub(super) fn place_costs(&self, t: usize, body: &ShapedBody, skeleton: &PosedSkeleton) -> Vec<PlaceCost> {
        let position_of = |landmark: usize| landmark_position(self.model, body, skeleton, landmark);
        let robust_scale = self.config.robust_scale;
        match self.data {
            DataTerm::Points { sigma } => {
                let of_point = |p: &PointEvidence| point_cost(p, &position_of(p.landmark), sigma, robust_scale);
                self.evidence.points[t].iter().map(of_point).collect()
            }
            DataTerm::Pixels { share } => {
                let of_landmark = |seen: &[PixelEvidence]| {
                    let position = position_of(seen[0].landmark);
                    sum(seen.iter().map(|pixel| {
                        let camera = &self.evidence.cameras[pixel.camera];
                        pixel_cost(pixel, camera, &position, share * pixel.scale_px, robust_scale)
                    }))
                };
                self.evidence.pixels[t].chunk_by(|a, b| a.landmark == b.landmark).filter_map(of_landmark).collect()
            }
        }
    }
}

/// The motion prior's poses over the joints that turn, as the body takes them.
fn likely_poses(model: &BodyModel, config: &BodyFitConfig, active: &[usize]) -> Option<PoseGaussian> {
    let captured = || PoseGaussian::over(MotionPrior::embedded().basis(), active);
    config.motion_prior.then(|| captured().retargeted_to(&model.mocap_from_body))
}

/// For every landmark the active joints that move it, with their groups.
fn moved_by(model: &BodyModel, active: &[usize]) -> Vec<Vec<(usize, usize)>> {
    let group_of = |joint: usize| active.iter().position(|a| *a == joint).map(|g| (g + 1, joint));
    model.landmarks.iter().map(|landmark| moving_joints(landmark).into_iter().filter_map(group_of).collect()).collect()
}

/// First of the two hand joints, which have no keypoints of their own to turn by.
const FIRST_HAND: usize = 22;
