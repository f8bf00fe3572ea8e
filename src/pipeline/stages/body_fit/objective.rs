//! The objective of one person's motion: which terms it is the sum of.

use super::completed_joints::GapCompletion;
use super::config::BodyFitConfig;
use super::context::FitContext;
use super::motion_problem::MotionProblem;
use super::observations::Observations;
use super::terms::border_priors::ShapePrior;
use super::terms::completion::Completion;
use super::terms::data::{DataSource, DataTerm};
use super::terms::foot_contact::{FootContact, ankles};
use super::terms::frame::Landmarks;
use super::terms::joint_limits::JointLimits;
use super::terms::pose_prior::PosePrior;
use super::terms::smoothness::Smoothness;
use super::terms::term::{FrameTerm, WindowTerm};
use super::terms::unknowns::{Border, CameraColumns, MotionState, Shape, Unknowns};
use super::terms::window::RobustAcceleration;
use crate::body::BodyModel;
use crate::body::detector_offsets::OffsetTable;
use crate::body::joint_ranges::joint_ranges_of;
use crate::body::kinematics::moving_joints;

/// What is fitted to what, and which of the terms apply.
#[derive(Clone, Copy)]
pub(super) struct Objective<'a> {
    pub model: &'a BodyModel,
    pub observations: &'a Observations,
    pub config: &'a BodyFitConfig,
    /// s.
    pub frame_interval: f64,
    pub data: DataSource<'a>,
    pub shape: Shape,
    /// Weights of the prior of the betas against the data: of each, and of girths.
    pub shape_prior: [f64; 2],
    /// Whether the person's bone offsets are unknowns; their values, and those of keypoint offsets, are in `model`.
    pub has_bones: bool,
    /// Keypoint offsets as unknowns.
    pub bias: Option<&'a OffsetTable>,
    /// The cameras, where they are unknowns.
    pub cameras: CameraColumns,
    /// The motion whose speeds scale the sigmas of accelerations; without one they are those of typical speeds.
    pub speeds: Option<&'a MotionState>,
    /// By frame, whether fewer than two cameras show the person, where the pelvis is free to accelerate for longer; empty: nowhere.
    pub is_open: &'a [bool],
    /// Joints that the motion prior completes, where it does.
    pub completion: Option<&'a GapCompletion>,
    /// Joints that are free although no observation shows them, such as the wrist of an overlapping hand.
    pub extra_joints: &'a [usize],
    /// Frames that stay as they are.
    pub held: &'a [usize],
}

/// Rate at which a frame counts once, Hz.
///
/// The cost is an integral over time: every frame counts `dt * 30 Hz`, so that one motion filmed at 25, 30 or 60 Hz has one
/// optimum. A detector's error drifts over some frames, hence more frames a second are not more information.
const REFERENCE_RATE_HZ: f64 = 30.0;

impl<'a> Objective<'a> {
    /// Data, joint limits, smoothness and the shape prior, with the motion prior if `config` has it.
    pub(super) fn new(
        context: &FitContext<'a>,
        config: &'a BodyFitConfig,
        observations: &'a Observations,
        data: DataSource<'a>,
        shape: Shape,
    ) -> Self {
        let FitContext { model, frame_interval, .. } = *context;
        Self {
            model,
            observations,
            config,
            frame_interval,
            data,
            shape,
            shape_prior: config.shape_priors(),
            has_bones: false,
            bias: None,
            cameras: CameraColumns::default(),
            speeds: None,
            is_open: &[],
            completion: None,
            extra_joints: &[],
            held: &[],
        }
    }

    /// Unknowns shared by all frames.
    pub(super) fn border(&self) -> Border<'a> {
        Border { shape: self.shape, has_bones: self.has_bones, bias: self.bias, cameras: self.cameras }
    }

    /// The joints that rotate, and the border.
    pub(super) fn unknowns(&self) -> Unknowns<'a> {
        self.unknowns_of(self.observed_joints())
    }

    /// The `observed` joints and the extra ones, and the border.
    fn unknowns_of(&self, observed: impl Iterator<Item = usize>) -> Unknowns<'a> {
        Unknowns::new(observed.chain(self.extra_joints.iter().copied()), self.border())
    }

    /// Factor of a frame's cost.
    pub(super) fn time_weight(&self) -> f64 {
        self.frame_interval * REFERENCE_RATE_HZ
    }

    /// The problem over all frames of the observations: the terms in the order of their summation.
    pub(super) fn problem(&self) -> MotionProblem<'a> {
        let Self { model, observations, config, frame_interval, .. } = *self;
        let observed = Unknowns::new(self.observed_joints(), self.border());
        let unknowns = self.unknowns_of(observed.joints.iter().copied());
        let ranges = joint_ranges_of(model);
        let (n_frames, time_weight) = (observations.points.len(), self.time_weight());
        let robust = RobustAcceleration { knee: config.acceleration_knee, time_weight };

        let completed = self.completion.map_or_else(Vec::new, GapCompletion::completed_joints);
        let prior = config.motion_prior.then(|| PosePrior::new(model, config, &unknowns, &completed));
        let with_prior = prior.as_ref().map_or(&[] as &[usize], PosePrior::joints);
        let robust_scale = config.robust_scale;
        let mut frame_terms: Vec<Box<dyn FrameTerm + 'a>> = Vec::new();
        let mut paths = None;
        match self.data {
            DataSource::Paths(pixels) => paths = Some((pixels, observations.cameras.as_slice())),
            source => frame_terms.push(Box::new(DataTerm { observations, source, robust_scale })),
        }
        frame_terms.push(Box::new(JointLimits::new(config, &ranges, &unknowns, with_prior)));
        frame_terms.extend(prior.map(|prior| Box::new(prior) as Box<dyn FrameTerm>));
        frame_terms
            .extend(self.completion.map(|gaps| Box::new(Completion::new(gaps, &unknowns)) as Box<dyn FrameTerm>));

        let mut smoothness = Smoothness::new(config, &ranges, &unknowns, robust, n_frames, frame_interval);
        let speeds = self.speeds.filter(|_| config.motion_prior);
        if let Some(speeds) = speeds {
            smoothness = smoothness.speed_scaled(speeds, &observed.joints, &ranges);
        }
        let smoothness = smoothness.loosened(self.is_open);
        let mut window_terms: Vec<Box<dyn WindowTerm + 'a>> = vec![Box::new(smoothness)];
        let tracked = if config.motion_prior { ankles(model) } else { Vec::new() };
        if config.motion_prior {
            let mut contact = FootContact::new(config, &tracked, robust, n_frames, frame_interval);
            if let Some(speeds) = speeds {
                contact = contact.speed_scaled(speeds, model, &tracked);
            }
            window_terms.push(Box::new(contact));
        }
        MotionProblem {
            model,
            landmarks: Landmarks::new(model, &unknowns, self.completion),
            unknowns,
            frame_terms,
            window_terms,
            paths,
            shape_prior: ShapePrior::new(self.shape_prior, model),
            tracked,
            held: self.held,
            time_weight,
        }
    }

    /// The joints that move an observed landmark.
    fn observed_joints(&self) -> impl Iterator<Item = usize> {
        let points = self.observations.points.iter().flatten().map(|point| point.landmark);
        let pixels = self.observations.pixels.iter().flatten().map(|pixel| pixel.landmark);
        let mut is_observed = vec![false; self.model.landmarks.len()];
        points.chain(pixels).for_each(|landmark| is_observed[landmark] = true);
        let observed = self.model.landmarks.iter().zip(is_observed).filter(|(_, is_observed)| *is_observed);
        observed.flat_map(|(landmark, _)| moving_joints(landmark))
    }
}
