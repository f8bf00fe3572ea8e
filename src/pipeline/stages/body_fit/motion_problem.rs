//! The least-squares problem of one person's motion: the cost of its terms and their Gauss-Newton system.

use super::terms::border_priors::ShapePrior;
use super::terms::frame::{Landmarks, LinearisedFrame, PosedFrame};
use super::terms::landmark_jacobian::LinearLandmarks;
use super::terms::path_system::LinearPaths;
use super::terms::term::{BorderTerm, FrameTerm, WindowTerm};
use super::terms::unknowns::{MotionState, Unknowns};
use super::terms::whitened_pixels::{Positions, WhitenedPixels};
use super::terms::window::Window;
use crate::body::BodyModel;
use crate::body::kinematics::Pose;
use crate::body::model::ShapedBody;
use crate::geometry::rotation;
use crate::optim::block_banded::{BandedStep, BlockBanded, Corner, Fill, FramePanel, N_RESTS};
use crate::pipeline::calibration::PosedCamera;
use crate::residuals::acceleration::LinearRotationStep;
use nalgebra::Matrix3;
use rayon::prelude::*;
use std::ops::Range;

/// A sum of terms over a motion's unknowns; [`super::objective::Objective::problem`] lists them.
pub(super) struct MotionProblem<'a> {
    pub model: &'a BodyModel,
    pub landmarks: Landmarks<'a>,
    pub unknowns: Unknowns<'a>,
    pub frame_terms: Vec<Box<dyn FrameTerm + 'a>>,
    pub window_terms: Vec<Box<dyn WindowTerm + 'a>>,
    /// Detected pixels with errors that are correlated in time, where these are modelled, and the cameras.
    pub paths: Option<(&'a WhitenedPixels, &'a [PosedCamera])>,
    pub shape_prior: ShapePrior,
    /// Landmarks whose paths the window terms look at.
    pub tracked: Vec<usize>,
    /// Frames that stay as they are.
    pub held: &'a [usize],
    /// Factor of the cost of a frame or a window.
    pub time_weight: f64,
}

/// Added to every frame's diagonal (squared residual per rad^2 or m^2), so that a frame without observations does not make
/// the system singular: 1e6 times weaker than one keypoint.
const FLOOR: f64 = 1e-4;

/// Added to the diagonal of a held frame, which makes its step a millionth of a free one.
const HOLD: f64 = 1e15;

impl MotionProblem<'_> {
    /// The state after a step of the solver.
    pub(super) fn moved(&self, state: &MotionState, step: &BandedStep) -> MotionState {
        self.unknowns.moved(state, step)
    }

    /// The sum of all terms: half of squared standardised residuals, robust.
    pub(super) fn cost(&self, state: &MotionState) -> f64 {
        let body = self.model.shaped(&state.betas);
        let frame_cost = |(index, pose): (usize, &Pose)| {
            let frame = PosedFrame::new(&self.landmarks, (&body, &state.betas), index, pose);
            let tracked = self.tracked.iter().map(|&landmark| frame.position(landmark)).collect();
            let paths = self.path_landmarks().iter().map(|&landmark| frame.observed_position(landmark)).collect();
            let cost = self.frame_terms.iter().map(|term| term.cost(&frame)).sum::<f64>();
            (cost, (tracked, paths))
        };
        let (frames, (tracked, paths)): (Vec<f64>, (Positions, Positions)) =
            state.poses.par_iter().enumerate().map(frame_cost).unzip();
        let turns = self.turns(state, rotation::step);
        let over_windows = |term: &dyn WindowTerm| -> f64 {
            middles(state).map(|middle| term.cost(&Window::new(middle, &state.poses, &tracked, &turns))).sum()
        };
        let windows = self.window_terms.iter().map(|term| over_windows(term.as_ref()));
        let paths = self.paths.map_or(0.0, |(term, cameras)| term.cost(cameras, &paths));
        self.shape_prior.cost(state.betas.as_slice())
            + paths
            + self.time_weight * windows.fold(frames.iter().sum::<f64>(), |sum, cost| sum + cost)
    }

    /// Makes `system` the Gauss-Newton system at `state`, and eliminates its frames with this damping; `None` where it is not
    /// positive definite.
    pub(super) fn eliminate(&self, state: &MotionState, damping: f64, system: &mut BlockBanded) -> Option<()> {
        system.resize(state.poses.len(), self.unknowns.n_groups(), self.unknowns.border.len());
        self.with_filling(state, |filling| {
            let mut corners = filling.corners();
            let eliminated = system.fill_and_eliminate(damping, filling, &mut corners);
            system.corner = filling.corner(&corners);
            eliminated
        })
    }

    /// Calls `work` with what fills a system at `state`.
    pub(super) fn with_filling<T>(&self, state: &MotionState, work: impl FnOnce(&Filling) -> T) -> T {
        let body = self.model.shaped(&state.betas);
        let linear = self.linearised(state, &body);
        let paths = self.paths.map(|term| LinearPaths::new(term, &self.unknowns.border, &linear.paths));
        work(&Filling { problem: self, state, linear: &linear, paths })
    }

    /// Makes `panel` that of the terms of one frame.
    fn add_frame(&self, frame: &LinearisedFrame, panel: &mut FramePanel, corner: &mut Corner) {
        panel.clear();
        self.frame_terms.iter().for_each(|term| term.add_to(frame, panel, corner));
        panel.add_to_diagonal(FLOOR);
        panel.scale_own(self.time_weight);
        if self.held.contains(&frame.posed.index) {
            panel.add_to_diagonal(HOLD);
        }
    }

    /// All frames with derivatives of the landmarks that other terms look at.
    fn linearised<'b>(&'b self, state: &'b MotionState, body: &'b ShapedBody) -> LinearisedMotion<'b> {
        let linearised = |(index, pose): (usize, &'b Pose)| {
            let frame = PosedFrame::new(&self.landmarks, (body, &state.betas), index, pose).linearised();
            let mut tracked = LinearLandmarks::with_room(self.tracked.len());
            let mut paths = LinearLandmarks::with_room(self.path_landmarks().len());
            self.tracked.iter().for_each(|landmark| frame.add_landmark(*landmark, &mut tracked));
            self.path_landmarks().iter().for_each(|landmark| frame.add_observed(*landmark, &mut paths));
            (frame, (tracked, paths))
        };
        let (frames, (tracked, paths)) = state.poses.par_iter().enumerate().map(linearised).unzip();
        LinearisedMotion { frames, tracked, paths, turns: self.turns(state, LinearRotationStep::new) }
    }

    /// Steps of the free rotations from each frame to the next, by group.
    fn turns<T: Send>(
        &self,
        state: &MotionState,
        step: impl Fn(&Matrix3<f64>, &Matrix3<f64>) -> T + Sync,
    ) -> Vec<Vec<T>> {
        let from = |frames: &[Pose]| {
            let (earlier, later) = (&frames[0], &frames[1]);
            let turn = |&joint: &usize| step(&earlier.rotations[joint], &later.rotations[joint]);
            self.unknowns.joints.iter().map(turn).collect()
        };
        state.poses.par_windows(2).map(from).collect()
    }

    /// By frame the landmarks of the paths with derivatives.
    pub(super) fn linearised_paths(&self, state: &MotionState) -> Vec<LinearLandmarks> {
        self.linearised(state, &self.model.shaped(&state.betas)).paths
    }

    fn path_landmarks(&self) -> &[usize] {
        self.paths.map_or(&[], |(paths, _)| paths.landmarks.as_slice())
    }
}

/// A motion with derivatives of the landmarks and the steps from frame to frame that window terms and paths look at.
struct LinearisedMotion<'a> {
    frames: Vec<LinearisedFrame<'a>>,
    tracked: Vec<LinearLandmarks>,
    paths: Vec<LinearLandmarks>,
    turns: Vec<Vec<LinearRotationStep>>,
}

/// Fills a system run by run.
pub(super) struct Filling<'a> {
    problem: &'a MotionProblem<'a>,
    state: &'a MotionState,
    linear: &'a LinearisedMotion<'a>,
    paths: Option<LinearPaths<'a>>,
}

/// What terms ask of the border alone.
pub(super) struct Corners {
    /// Frame terms, per unit of time weight.
    of_frames: Corner,
    /// All others.
    of_others: Corner,
}

impl Fill for Filling<'_> {
    type Rest = Corners;

    fn within(&self, frames: Range<usize>, panels: &mut [FramePanel], corners: &mut Corners) {
        let first = frames.start;
        for t in frames {
            let panel = &mut panels[t - first];
            self.problem.add_frame(&self.linear.frames[t], panel, &mut corners.of_frames);
            if let Some(paths) = &self.paths {
                paths.add_frame(t, panel, &mut corners.of_others);
            }
            if t >= first + 2 {
                self.add_window(t, &mut panels[t - 2 - first..=t - first], corners);
            }
        }
    }

    fn across(&self, first: usize, panels: &mut [FramePanel], corners: &mut Corners) {
        for (i, window) in (0..panels.len() - 2).map(|i| (i, i..i + 3)) {
            self.add_window(first + i, &mut panels[window], corners);
        }
    }
}

impl Filling<'_> {
    /// Adds the window terms of three frames.
    fn add_window(&self, last: usize, panels: &mut [FramePanel], corners: &mut Corners) {
        let LinearisedMotion { tracked, turns, .. } = self.linear;
        let window = Window::new(last - 1, &self.state.poses, tracked, turns);
        self.problem.window_terms.iter().for_each(|term| term.add_to(&window, panels, &mut corners.of_others));
    }

    /// Zeros for what terms ask of the border alone.
    pub(super) fn corners(&self) -> [Corners; N_RESTS] {
        let zeros = || Corner::zeros(self.problem.unknowns.border.len());
        std::array::from_fn(|_| Corners { of_frames: zeros(), of_others: zeros() })
    }

    /// The border's own part, once all frames are added.
    pub(super) fn corner(&self, corners: &[Corners]) -> Corner {
        let MotionProblem { unknowns, time_weight, shape_prior, .. } = self.problem;
        let mut corner = Corner::zeros(unknowns.border.len());
        for Corners { of_frames, of_others } in corners {
            corner.hessian += &of_frames.hessian * *time_weight + &of_others.hessian;
            corner.gradient += &of_frames.gradient * *time_weight + &of_others.gradient;
        }
        if let Some(paths) = &self.paths {
            paths.add_cameras(&mut corner);
        }
        let betas = unknowns.border.betas();
        if !betas.is_empty() {
            shape_prior.add_to(self.state.betas.as_slice(), betas.start, &mut corner);
        }
        corner
    }
}

/// The frames that have a frame on either side.
fn middles(state: &MotionState) -> Range<usize> {
    1..state.poses.len().saturating_sub(1)
}
