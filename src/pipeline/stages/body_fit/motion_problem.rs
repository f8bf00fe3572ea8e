//! The least-squares problem of one person's motion: the cost of its terms and their Gauss-Newton system.

use super::observations::PosedCamera;
use super::terms::border_priors::ShapePrior;
use super::terms::frame::{Landmarks, LinearisedFrame, PosedFrame};
use super::terms::path_system::add_paths;
use super::terms::term::{BorderTerm, FrameTerm, RUN, WindowTerm};
use super::terms::unknowns::{MotionState, Unknowns};
use super::terms::whitened_pixels::{Positions, WhitenedPixels};
use super::terms::window::{TrackedLandmark, Window};
use crate::body::BodyModel;
use crate::body::kinematics::Pose;
use crate::optim::block_banded::{BandedStep, BlockBanded, Corner, FramePanel};
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
        let over_windows = |term: &dyn WindowTerm| -> f64 {
            middles(state).map(|middle| term.cost(&Window::new(middle, &state.poses, &tracked))).sum()
        };
        let windows = self.window_terms.iter().map(|term| over_windows(term.as_ref()));
        let paths = self.paths.map_or(0.0, |(term, cameras)| term.cost(cameras, &paths));
        self.shape_prior.cost(state.betas.as_slice())
            + paths
            + self.time_weight * windows.fold(frames.iter().sum::<f64>(), |sum, cost| sum + cost)
    }

    /// Makes `system` the Gauss-Newton system at `state`.
    pub(super) fn linearise(&self, state: &MotionState, system: &mut BlockBanded) {
        system.resize(state.poses.len(), self.unknowns.n_groups(), self.unknowns.border.len());
        let body = self.model.shaped(&state.betas);
        let add_run = |(run, (frames, poses)): (usize, (&mut [FramePanel], &[Pose]))| {
            let mut corner = Corner::zeros(self.unknowns.border.len());
            let add = |(i, (frame, pose)): (usize, (&mut FramePanel, &Pose))| {
                frame.clear();
                let posed = PosedFrame::new(&self.landmarks, (&body, &state.betas), RUN * run + i, pose);
                self.add_frame(&posed.linearised(), frame, &mut corner)
            };
            let landmarks: Vec<FrameLandmarks> = frames.iter_mut().zip(poses).enumerate().map(add).collect();
            (landmarks, corner)
        };
        let mut frames = system.frames();
        let runs = frames.par_chunks_mut(RUN).zip(state.poses.par_chunks(RUN)).enumerate();
        let runs: Vec<(Vec<FrameLandmarks>, Corner)> = runs.map(add_run).collect();

        let (mut tracked, mut paths) = (Vec::with_capacity(state.poses.len()), Vec::with_capacity(state.poses.len()));
        for (landmarks, corner) in runs {
            system.corner.hessian += corner.hessian * self.time_weight;
            system.corner.gradient += corner.gradient * self.time_weight;
            for frame in landmarks {
                tracked.push(frame.tracked);
                paths.push(frame.paths);
            }
        }
        let betas = self.unknowns.border.betas();
        if !betas.is_empty() {
            self.shape_prior.add_to(state.betas.as_slice(), betas.start, &mut system.corner);
        }
        if let Some(term) = self.paths {
            add_paths(term, &self.unknowns, &paths, system);
        }
        for middle in middles(state) {
            let window = Window::new(middle, &state.poses, &tracked);
            self.window_terms.iter().for_each(|term| term.add_to(&window, system));
        }
        self.held.iter().for_each(|&t| system.frame(t).add_to_diagonal(HOLD));
    }

    /// Adds the terms of one frame; returns its landmarks that other terms look at.
    fn add_frame(&self, frame: &LinearisedFrame, system: &mut FramePanel, corner: &mut Corner) -> FrameLandmarks {
        self.frame_terms.iter().for_each(|term| term.add_to(frame, system, corner));
        system.add_to_diagonal(FLOOR);
        system.scale(self.time_weight);
        let tracked = |&landmark: &usize| TrackedLandmark {
            position: frame.posed.position(landmark),
            jacobian: frame.jacobian(landmark),
        };
        FrameLandmarks {
            tracked: self.tracked.iter().map(tracked).collect(),
            paths: self.path_landmarks().iter().map(|&landmark| observed(frame, landmark)).collect(),
        }
    }

    /// The landmarks of the paths with derivatives, `[frame][observed landmark]`.
    pub(super) fn linearised_paths(&self, state: &MotionState) -> Vec<Vec<TrackedLandmark>> {
        let body = self.model.shaped(&state.betas);
        let frame = |(index, pose): (usize, &Pose)| {
            let frame = PosedFrame::new(&self.landmarks, (&body, &state.betas), index, pose).linearised();
            self.path_landmarks().iter().map(|&landmark| observed(&frame, landmark)).collect()
        };
        state.poses.par_iter().enumerate().map(frame).collect()
    }

    fn path_landmarks(&self) -> &[usize] {
        self.paths.map_or(&[], |(paths, _)| paths.landmarks.as_slice())
    }
}

/// The landmarks of one frame that window terms and paths look at.
struct FrameLandmarks {
    tracked: Vec<TrackedLandmark>,
    paths: Vec<TrackedLandmark>,
}

fn observed(frame: &LinearisedFrame, landmark: usize) -> TrackedLandmark {
    TrackedLandmark { position: frame.posed.observed_position(landmark), jacobian: frame.observed_jacobian(landmark) }
}

/// The frames that have a frame on either side.
fn middles(state: &MotionState) -> Range<usize> {
    1..state.poses.len().saturating_sub(1)
}
