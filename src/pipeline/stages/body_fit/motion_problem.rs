//! The least-squares problem of one person's motion: the cost of its terms and their Gauss-Newton system.

use super::observations::PosedCamera;
use super::terms::border_priors::ShapePrior;
use super::terms::frame::{Landmarks, LinearisedFrame, PosedFrame};
use super::terms::path_system::add_paths;
use super::terms::term::{BorderTerm, FrameTerm, WindowTerm};
use super::terms::unknowns::{FrameSystem, MotionState, Unknowns};
use super::terms::whitened_pixels::{Positions, WhitenedPixels};
use super::terms::window::{TrackedLandmark, Window};
use crate::body::BodyModel;
use crate::body::kinematics::Pose;
use crate::body::model::{Betas, ShapedBody};
use crate::optim::block_banded::{BandedStep, BlockBanded, Corner};
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

/// Frames linearised one after another; they share one corner.
const RUN: usize = 16;

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
            let at =
                |landmarks: &[usize]| landmarks.iter().map(|&landmark| frame.position(landmark)).collect::<Vec<_>>();
            let cost = self.frame_terms.iter().map(|term| term.cost(&frame)).sum::<f64>();
            (cost, (at(&self.tracked), at(self.path_landmarks())))
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

    /// The Gauss-Newton system at `state`.
    pub(super) fn linearised(&self, state: &MotionState) -> BlockBanded {
        let n_border = self.unknowns.border.len();
        let mut system = BlockBanded::zeros(state.poses.len(), self.unknowns.n_groups(), n_border);
        let body = self.model.shaped(&state.betas);
        let run_blocks = |(run, poses): (usize, &[Pose])| {
            let mut corner = Corner::zeros(n_border);
            let frame = |(i, pose)| self.frame_system(RUN * run + i, (&body, &state.betas), pose, &mut corner);
            let frames: Vec<LinearFrame> = poses.iter().enumerate().map(frame).collect();
            (frames, corner)
        };
        let runs: Vec<(Vec<_>, Corner)> = state.poses.par_chunks(RUN).enumerate().map(run_blocks).collect();

        let weight = self.time_weight;
        let mut tracked = Vec::with_capacity(state.poses.len());
        let mut paths = Vec::with_capacity(state.poses.len());
        for (frames, corner) in runs {
            system.corner.hessian += corner.hessian * weight;
            system.corner.gradient += corner.gradient * weight;
            for LinearFrame { system: frame, tracked: landmarks, paths: of_frame } in frames {
                let t = tracked.len();
                paths.push(of_frame);
                system.diagonal[t] = frame.diagonal * weight;
                system.border[t] = frame.border * weight;
                system.gradient[t] = frame.gradient * weight;
                tracked.push(landmarks);
            }
        }
        let betas = self.unknowns.border.betas();
        if !betas.is_empty() {
            self.shape_prior.add_to(state.betas.as_slice(), betas.start, &mut system.corner);
        }
        if let Some(term) = self.paths {
            add_paths(term, &self.unknowns, &paths, &mut system);
        }
        for middle in middles(state) {
            let window = Window::new(middle, &state.poses, &tracked);
            self.window_terms.iter().for_each(|term| term.add_to(&window, &mut system));
        }
        for &t in self.held {
            (0..system.diagonal[t].nrows()).for_each(|i| system.diagonal[t][(i, i)] += HOLD);
        }
        system
    }

    /// Blocks of one frame, and its tracked landmarks.
    fn frame_system(
        &self,
        index: usize,
        shape: (&ShapedBody, &Betas),
        pose: &Pose,
        corner: &mut Corner,
    ) -> LinearFrame {
        let frame = PosedFrame::new(&self.landmarks, shape, index, pose).linearised();
        let mut system = FrameSystem::zeros(&self.unknowns);
        self.frame_terms.iter().for_each(|term| term.add_to(&frame, &mut system, corner));
        system.add_floor();
        let tracked = |&landmark: &usize| tracked(&frame, landmark);
        LinearFrame {
            tracked: self.tracked.iter().map(tracked).collect(),
            paths: self.path_landmarks().iter().map(tracked).collect(),
            system,
        }
    }

    /// The landmarks of the paths with derivatives, `[frame][observed landmark]`.
    pub(super) fn linearised_paths(&self, state: &MotionState) -> Vec<Vec<TrackedLandmark>> {
        let body = self.model.shaped(&state.betas);
        let frame = |(index, pose): (usize, &Pose)| {
            let frame = PosedFrame::new(&self.landmarks, (&body, &state.betas), index, pose).linearised();
            self.path_landmarks().iter().map(|&landmark| tracked(&frame, landmark)).collect()
        };
        state.poses.par_iter().enumerate().map(frame).collect()
    }

    fn path_landmarks(&self) -> &[usize] {
        self.paths.map_or(&[], |(paths, _)| paths.landmarks.as_slice())
    }
}

/// One frame's own blocks, and its landmarks that other terms look at.
struct LinearFrame {
    system: FrameSystem,
    tracked: Vec<TrackedLandmark>,
    paths: Vec<TrackedLandmark>,
}

fn tracked(frame: &LinearisedFrame, landmark: usize) -> TrackedLandmark {
    TrackedLandmark { position: frame.posed.position(landmark), jacobian: frame.jacobian(landmark) }
}

/// The frames that have a frame on either side.
fn middles(state: &MotionState) -> Range<usize> {
    1..state.poses.len().saturating_sub(1)
}
