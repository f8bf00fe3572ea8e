//! A person's motion as latent codes: encoded from a fitted motion, decoded to the joints of the body.

use super::super::gap_completion::mocap_rotations;
use super::super::terms::unknowns::MotionState;
use crate::body::kinematics::{Pose, PosedSkeleton, landmark_by_rotation, moving_joints};
use crate::body::mocap_skeleton::retargeted;
use crate::body::model::{Betas, BodyModel, ShapedBody};
use crate::geometry::rotation::{exp, right_jacobian};
use crate::motion_prior::LatentPrior;
use crate::motion_prior::basis::LATENT_DIM;
use crate::motion_prior::chart::{Features, LATENT_JOINTS, LocalRotations, N_FEATURES};
use crate::motion_prior::latent_prior::Code;
use nalgebra::{DVector, Matrix3, SMatrix, Vector3};

/// Unknowns of a frame in groups of three: translation, rotation of the pelvis, and the code, which one number without effect
/// fills up.
pub(super) const N_GROUPS: usize = 2 + LATENT_DIM.div_ceil(3);
/// Number of a frame's unknowns.
pub(super) const N_UNKNOWNS: usize = 3 * N_GROUPS;
/// First of the root's rotation, and of the code.
pub(super) const ROOT: usize = 3;
pub(super) const CODE: usize = 6;

/// Values of the unknowns of one person's motion.
#[derive(Debug, Clone)]
pub(super) struct LatentMotion {
    /// `z`, `[T][32]`.
    pub codes: Vec<Code>,
    /// What they decode to, rad. [T][57]
    pub features: Vec<Features>,
    /// Betas, and the poses with the decoded rotations; collars and hands keep those of the first fit.
    pub state: MotionState,
}

/// Derivatives of a landmark's position in one frame.
pub(super) struct LandmarkByFrame {
    /// By the frame's unknowns, those of the code through the skip connection alone.
    pub by_unknowns: SMatrix<f64, 3, N_UNKNOWNS>,
    /// By the features of the joints that move it: place of the joint, and the derivative by its three features.
    pub by_features: Vec<(usize, Matrix3<f64>)>,
}

/// The decoder on one body, at one frame rate.
pub(super) struct MotionDecoder<'a> {
    prior: &'a LatentPrior,
    model: &'a BodyModel,
    fps: f64,
    by_code: SMatrix<f64, N_FEATURES, LATENT_DIM>,
    /// By landmark, the joints that move it.
    moving: Vec<Vec<usize>>,
}

impl<'a> MotionDecoder<'a> {
    pub(super) fn new(prior: &'a LatentPrior, model: &'a BodyModel, frame_interval: f64) -> Self {
        let moving = model.landmarks.iter().map(moving_joints).collect();
        Self { prior, model, fps: 1.0 / frame_interval, by_code: prior.features_by_code(), moving }
    }

    /// The motion of the encoder's mean.
    pub(super) fn encoded(&self, state: &MotionState) -> LatentMotion {
        let on_mocap =
            |pose: &Pose| mocap_rotations(&pose.rotations, &self.model.mocap_from_body, &Matrix3::identity());
        let rotations: Vec<LocalRotations> = state.poses.iter().map(on_mocap).collect();
        self.decoded(self.prior.encoded(&rotations, self.fps), state.clone())
    }

    /// The motion of codes, with roots, betas and other joints of `state`.
    pub(super) fn decoded(&self, codes: Vec<Code>, mut state: MotionState) -> LatentMotion {
        let features = self.prior.decoded(&codes, self.fps);
        let turns = &self.model.mocap_from_body;
        for (pose, features) in state.poses.iter_mut().zip(&features) {
            let mut on_mocap = pose.rotations;
            self.prior.chart().write(features, &mut on_mocap);
            for joint in LATENT_JOINTS {
                pose.rotations[joint] = retargeted(&on_mocap[joint], joint, turns);
            }
        }
        LatentMotion { codes, features, state }
    }

    /// The motion after steps of its frames and betas.
    pub(super) fn moved(&self, motion: &LatentMotion, frames: &[DVector<f64>], betas: Option<Betas>) -> LatentMotion {
        let mut state = motion.state.clone();
        state.betas += betas.unwrap_or_else(Betas::zeros);
        for (pose, step) in state.poses.iter_mut().zip(frames) {
            pose.translation += step.fixed_rows::<3>(0);
            pose.rotations[0] *= exp(&step.fixed_rows::<3>(ROOT).into_owned());
        }
        let code = |(code, step): (&Code, &DVector<f64>)| std::array::from_fn(|k| code[k] + step[CODE + k]);
        self.decoded(motion.codes.iter().zip(frames).map(code).collect(), state)
    }

    /// Derivatives of a landmark. The decoded rotation is `Q_p^T M exp(u) Q`, so that a step of the features is the right
    /// increment `Q^T J_r(u) du` of the body's joint.
    pub(super) fn landmark(
        &self,
        body: &ShapedBody,
        skeleton: &PosedSkeleton,
        features: &Features,
        landmark: usize,
    ) -> LandmarkByFrame {
        let mut by_unknowns = SMatrix::<f64, 3, N_UNKNOWNS>::zeros();
        by_unknowns.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
        let mut by_features = Vec::new();
        for &joint in &self.moving[landmark] {
            let by_rotation = landmark_by_rotation(self.model, body, skeleton, landmark, joint);
            if joint == 0 {
                by_unknowns.fixed_view_mut::<3, 3>(0, ROOT).copy_from(&by_rotation);
            }
            let Some(place) = LATENT_JOINTS.iter().position(|&latent| latent == joint) else { continue };
            let u = Vector3::from_column_slice(&features[3 * place..3 * place + 3]);
            let by_u = by_rotation * self.model.mocap_from_body[joint].transpose() * right_jacobian(&u);
            let mut by_code = by_unknowns.fixed_view_mut::<3, LATENT_DIM>(0, CODE);
            by_code += by_u * self.by_code.fixed_view::<3, LATENT_DIM>(3 * place, 0);
            by_features.push((place, by_u));
        }
        LandmarkByFrame { by_unknowns, by_features }
    }

    /// The gradient by the codes, given that by the features.
    pub(super) fn pulled_back(&self, motion: &LatentMotion, by_features: &[Features]) -> Vec<Code> {
        self.prior.pulled_back(&motion.codes, by_features, self.fps)
    }
}
