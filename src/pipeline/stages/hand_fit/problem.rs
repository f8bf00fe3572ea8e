//! Both hands of a person over a window of frames, as one least-squares problem: the hands share their size.

use super::observations::HandPixel;
use super::state::{FramedHand, N_UNKNOWNS, Unknowns, Wrist};
use super::terms::{FrameSystem, Known, add_pixels, smoothness};
use crate::body::hand::HandShape;
use crate::optim::block_banded::{BlockBanded, Eliminated};
use crate::optim::levenberg_marquardt::{LeastSquares, Trial};
use crate::pipeline::calibration::PosedCamera;
use nalgebra::{DVector, Matrix3, Vector3};

/// One hand of a window.
#[derive(Clone)]
pub(super) struct Hand<'a> {
    pub shape: HandShape,
    pub wrists: Vec<Wrist>,
    pub pixels: &'a [Vec<HandPixel>],
}

/// The problem.
pub(super) struct HandProblem<'a> {
    pub hands: &'a [Hand<'a>],
    pub cameras: &'a [PosedCamera],
    /// Standard deviation of a pixel, of the hand's image.
    pub share: f64,
    /// s.
    pub frame_interval: f64,
    /// Logarithm of the size that the body has; `None`: the size is held.
    pub log_size_of_body: Option<f64>,
    pub known: Known,
}

/// Values of the unknowns.
#[derive(Debug, Clone)]
pub(super) struct HandState {
    /// `frames[hand][frame]`.
    pub frames: Vec<Vec<Unknowns>>,
    pub log_size: f64,
}

/// Standard deviation of the logarithm of the hands' size about what stature and forearms say (ANSUR II).
const LOG_SIZE_SIGMA: f64 = 0.06;

/// Groups of three unknowns of a frame.
const N_GROUPS: usize = N_UNKNOWNS / 3;

impl HandProblem<'_> {
    fn frame(&self, hand: usize, t: usize, state: &HandState, with_derivatives: bool) -> FrameSystem {
        let (own, unknowns) = (&self.hands[hand], &state.frames[hand][t]);
        let framed = FramedHand::new(&own.shape, &own.wrists[t], state.log_size.exp(), unknowns);
        let mut system = FrameSystem::zeros();
        add_pixels(&mut system, &framed, &own.pixels[t], self.cameras, self.share, with_derivatives);
        self.known.add(&mut system, unknowns);
        system
    }

    /// Cost of the second differences of a hand.
    fn roughness(&self, frames: &[Unknowns]) -> f64 {
        let precision = smoothness(self.frame_interval);
        let cost = |[a, b, c]: &[Unknowns; 3]| {
            let second = a - b * 2.0 + c;
            0.5 * second.component_mul(&second).dot(&precision)
        };
        frames.array_windows().map(cost).sum()
    }

    /// The system of a hand; its border is the size where that is free.
    fn system(&self, hand: usize, state: &HandState) -> BlockBanded {
        let frames = &state.frames[hand];
        let n_border = usize::from(self.log_size_of_body.is_some());
        let mut system = BlockBanded::zeros(frames.len(), N_GROUPS, n_border);
        for t in 0..frames.len() {
            let own = self.frame(hand, t, state, true);
            let mut panel = system.frame(t);
            panel.add_own(0, 0, &own.hessian);
            panel.add_gradient(0, &own.gradient);
            if n_border > 0 {
                panel.add_border(0, 0, &own.by_size);
                system.corner.gradient[0] += own.size[0];
                system.corner.hessian[(0, 0)] += own.size[1];
            }
        }
        self.add_smoothness(frames, &mut system);
        system
    }

    fn add_smoothness(&self, frames: &[Unknowns], system: &mut BlockBanded) {
        const FACTORS: [f64; 3] = [1.0, -2.0, 1.0];
        let precision = smoothness(self.frame_interval);
        for (first, window) in frames.array_windows().enumerate() {
            let [a, b, c]: &[Unknowns; 3] = window;
            let weighted = (a - b * 2.0 + c).component_mul(&precision);
            for (i, factor) in FACTORS.iter().enumerate() {
                system.frame(first + i).add_gradient(0, &(weighted * *factor));
                for (j, other) in FACTORS.iter().enumerate().take(i + 1) {
                    for group in 0..N_GROUPS {
                        let diagonal = Vector3::from_fn(|k, _| factor * other * precision[3 * group + k]);
                        let block = Matrix3::from_diagonal(&diagonal);
                        system.add_block([first + i, first + j], [group, group], &block);
                    }
                }
            }
        }
    }

    fn size_prior(&self, log_size: f64) -> [f64; 3] {
        let precision = LOG_SIZE_SIGMA.powi(-2);
        let off = self.log_size_of_body.map_or(0.0, |known| log_size - known);
        [0.5 * precision * off * off, precision * off, precision]
    }
}

impl LeastSquares for HandProblem<'_> {
    type State = HandState;

    fn cost(&self, state: &HandState) -> f64 {
        let of_hand = |hand: usize| {
            let frames = &state.frames[hand];
            let own: f64 = (0..frames.len()).map(|t| self.frame(hand, t, state, false).cost).sum();
            own + self.roughness(frames)
        };
        (0..self.hands.len()).map(of_hand).sum::<f64>() + self.size_prior(state.log_size)[0]
    }

    fn step(&self, state: &HandState, damping: f64) -> Option<Trial<HandState>> {
        let systems = (0..self.hands.len()).map(|hand| self.system(hand, state).eliminated(damping));
        let systems: Vec<Eliminated> = systems.collect::<Option<_>>()?;
        let border = match self.log_size_of_body {
            None => DVector::zeros(0),
            Some(_) => {
                let [_, gradient, precision] = self.size_prior(state.log_size);
                let hessian: f64 = precision + systems.iter().map(|system| system.corner[(0, 0)]).sum::<f64>();
                let right: f64 = systems.iter().map(|system| system.right[0]).sum::<f64>() - gradient;
                DVector::from_element(1, right / hessian)
            }
        };
        let mut moved = state.clone();
        for (frames, system) in moved.frames.iter_mut().zip(&systems) {
            let step = system.step(border.clone(), 1.0)?;
            frames.iter_mut().zip(&step.frames).for_each(|(frame, step)| *frame += step);
        }
        moved.log_size += border.iter().sum::<f64>();
        let cost = self.cost(&moved);
        Some(Trial { state: moved, cost })
    }
}
