//! The bidirectional gated recurrent unit, forward and backward through time.
//!
//! One direction, with the sigmoid s and the state h, zero at the start (Cho et al., EMNLP 2014, Eqs. (5)-(8), with the
//! reset gate after the product as in Chung et al. 2014 and common libraries):
//! `r = s(x W_xr + b_xr + h W_hr + b_hr)`, `u` likewise, `n = tanh(x W_xn + b_xn + r (h W_hn + b_hn))`,
//! `h' = (1 - u) n + u h`. The gates are stored in the order r, u, n.
//!
//! Sequences are `[T, B, width]`: all people and windows of one time step are contiguous and share one matrix product.

use super::layers::{Affine, Reader, affine_len, apart, beside};
use super::panels::{sigmoid, tanh};

/// The parameters of one direction.
#[derive(Debug, Clone, PartialEq)]
struct Direction {
    from_input: Affine,
    from_state: Affine,
}

/// The unit of both directions; the output is their states side by side, `[N, 2 H]`.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct BiGru {
    hidden: usize,
    directions: [Direction; 2],
}

/// Values that the backward pass of one direction needs, `[N, H]` each.
struct DirectionTape {
    reset: Vec<f32>,
    update: Vec<f32>,
    candidate: Vec<f32>,
    /// `h W_hn + b_hn`.
    recurrent: Vec<f32>,
    /// States after each step.
    states: Vec<f32>,
    /// States before each step.
    before: Vec<f32>,
}

/// Values that the backward pass needs.
pub(crate) struct BiGruTape([DirectionTape; 2]);

impl BiGru {
    /// Number of parameters.
    pub(crate) fn len(n_in: usize, hidden: usize) -> usize {
        2 * (affine_len(n_in, 3 * hidden) + affine_len(hidden, 3 * hidden))
    }

    pub(crate) fn read(reader: &mut Reader, n_in: usize, hidden: usize) -> Self {
        let mut direction = || Direction {
            from_input: Affine::read(reader, n_in, 3 * hidden),
            from_state: Affine::read(reader, hidden, 3 * hidden),
        };
        Self { hidden, directions: [direction(), direction()] }
    }

    /// `x` is `[T, B, n_in]`.
    pub(crate) fn forward(&self, x: &[f32], batch: usize) -> (Vec<f32>, BiGruTape) {
        let run = |d: usize| self.directions[d].forward(x, batch, self.hidden, d == 1);
        let (ahead, back) = rayon::join(|| run(0), || run(1));
        let states = beside(&ahead.states, &back.states, self.hidden, self.hidden);
        (states, BiGruTape([ahead, back]))
    }

    /// Gradient to the input from that to the output `[N, 2 H]`; adds the gradient to the parameters to `gradient`, if given.
    pub(crate) fn backward(
        &self,
        tape: &BiGruTape,
        x: &[f32],
        d_states: &[f32],
        batch: usize,
        gradient: Option<&mut [f32]>,
    ) -> Vec<f32> {
        let d_states = apart(d_states, self.hidden, self.hidden);
        let run = |d: usize| self.directions[d].backward(&tape.0[d], &d_states[d], batch, self.hidden, d == 1);
        let (ahead, back) = rayon::join(|| run(0), || run(1));
        let mut dx = self.directions[0].from_input.backward(&ahead.d_input);
        self.directions[1].from_input.add_backward(&back.d_input, &mut dx);
        if let Some(gradient) = gradient {
            for (direction, (sides, tape)) in self.directions.iter().zip([ahead, back].iter().zip(&tape.0)) {
                direction.from_input.add_gradient(x, &sides.d_input, gradient);
                direction.from_state.add_gradient(&tape.before, &sides.d_recurrent, gradient);
            }
        }
        dx
    }
}

/// Gradients to the two sums inside the gates, `[N, 3 H]` each.
struct GateGradients {
    d_input: Vec<f32>,
    d_recurrent: Vec<f32>,
}

/// Time steps in the order of a direction.
fn steps(n_steps: usize, reversed: bool) -> impl Iterator<Item = usize> {
    (0..n_steps).map(move |step| if reversed { n_steps - 1 - step } else { step })
}

impl Direction {
    fn forward(&self, x: &[f32], batch: usize, hidden: usize, reversed: bool) -> DirectionTape {
        let inputs = self.from_input.forward(x); // [T, B, 3 H]
        let (block, n) = (batch * hidden, inputs.len() / 3);
        let zeros = || vec![0.0; n];
        let mut tape = DirectionTape {
            reset: zeros(),
            update: zeros(),
            candidate: zeros(),
            recurrent: zeros(),
            states: zeros(),
            before: zeros(),
        };
        let mut state = vec![0.0; block];
        let mut sums = Vec::new();
        for t in steps(n / block.max(1), reversed) {
            let here = t * block..(t + 1) * block;
            self.from_state.forward_into(&state, &mut sums); // [B, 3 H]
            tape.before[here.clone()].copy_from_slice(&state);
            let step = Step {
                hidden,
                input: &inputs[3 * here.start..3 * here.end],
                sums: &sums,
                reset: &mut tape.reset[here.clone()],
                update: &mut tape.update[here.clone()],
                candidate: &mut tape.candidate[here.clone()],
                recurrent: &mut tape.recurrent[here.clone()],
                state: &mut state,
            };
            pulp::Arch::new().dispatch(step);
            tape.states[here].copy_from_slice(&state);
        }
        tape
    }

    fn backward(
        &self,
        tape: &DirectionTape,
        d_states: &[f32],
        batch: usize,
        hidden: usize,
        reversed: bool,
    ) -> GateGradients {
        let (block, n) = (batch * hidden, d_states.len());
        let mut sides = GateGradients { d_input: vec![0.0; 3 * n], d_recurrent: vec![0.0; 3 * n] };
        let mut d_state = vec![0.0; block];
        for t in steps(n / block.max(1), !reversed) {
            let here = t * block..(t + 1) * block;
            d_state.iter_mut().zip(&d_states[here.clone()]).for_each(|(sum, own)| *sum += own);
            let step = BackwardStep {
                hidden,
                reset: &tape.reset[here.clone()],
                update: &tape.update[here.clone()],
                candidate: &tape.candidate[here.clone()],
                recurrent: &tape.recurrent[here.clone()],
                before: &tape.before[here.clone()],
                d_state: &mut d_state,
                d_input: &mut sides.d_input[3 * here.start..3 * here.end],
                d_recurrent: &mut sides.d_recurrent[3 * here.start..3 * here.end],
            };
            pulp::Arch::new().dispatch(step);
            self.from_state.add_backward(&sides.d_recurrent[3 * here.start..3 * here.end], &mut d_state);
        }
        sides
    }
}

/// One time step of the forward pass; `[B, 3 H]` and `[B, H]`.
struct Step<'a> {
    hidden: usize,
    input: &'a [f32],
    sums: &'a [f32],
    reset: &'a mut [f32],
    update: &'a mut [f32],
    candidate: &'a mut [f32],
    recurrent: &'a mut [f32],
    state: &'a mut [f32],
}

impl pulp::NullaryFnOnce for Step<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        step_forward(self);
    }
}

#[inline(always)]
fn step_forward(step: Step) {
    let hidden = step.hidden;
    for (row, state) in step.state.chunks_exact_mut(hidden).enumerate() {
        let (x, h) = (&step.input[3 * row * hidden..][..3 * hidden], &step.sums[3 * row * hidden..][..3 * hidden]);
        let own = row * hidden..(row + 1) * hidden;
        let (reset, update) = (&mut step.reset[own.clone()], &mut step.update[own.clone()]);
        let (candidate, recurrent) = (&mut step.candidate[own.clone()], &mut step.recurrent[own]);
        let ((xr, rest_x), (hr, rest_h)) = (x.split_at(hidden), h.split_at(hidden));
        let ((xu, xn), (hu, hn)) = (rest_x.split_at(hidden), rest_h.split_at(hidden));
        for i in 0..hidden {
            reset[i] = sigmoid(xr[i] + hr[i]);
            update[i] = sigmoid(xu[i] + hu[i]);
            candidate[i] = tanh(xn[i] + reset[i] * hn[i]);
            recurrent[i] = hn[i];
            state[i] = candidate[i] + update[i] * (state[i] - candidate[i]);
        }
    }
}

/// One time step of the backward pass.
struct BackwardStep<'a> {
    hidden: usize,
    reset: &'a [f32],
    update: &'a [f32],
    candidate: &'a [f32],
    recurrent: &'a [f32],
    before: &'a [f32],
    d_state: &'a mut [f32],
    d_input: &'a mut [f32],
    d_recurrent: &'a mut [f32],
}

impl pulp::NullaryFnOnce for BackwardStep<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        step_backward(self);
    }
}

#[inline(always)]
fn step_backward(step: BackwardStep) {
    let hidden = step.hidden;
    for (row, d_state) in step.d_state.chunks_exact_mut(hidden).enumerate() {
        let own = row * hidden..(row + 1) * hidden;
        let (reset, update) = (&step.reset[own.clone()], &step.update[own.clone()]);
        let (candidate, recurrent) = (&step.candidate[own.clone()], &step.recurrent[own.clone()]);
        let before = &step.before[own];
        let (xr, rest_x) = step.d_input[3 * row * hidden..][..3 * hidden].split_at_mut(hidden);
        let (hr, rest_h) = step.d_recurrent[3 * row * hidden..][..3 * hidden].split_at_mut(hidden);
        let ((xu, xn), (hu, hn)) = (rest_x.split_at_mut(hidden), rest_h.split_at_mut(hidden));
        for i in 0..hidden {
            let d = d_state[i];
            let (r, u, n) = (reset[i], update[i], candidate[i]);
            let d_candidate = d * (1.0 - u) * (1.0 - n * n);
            let d_update = d * (before[i] - n) * u * (1.0 - u);
            let d_reset = d_candidate * recurrent[i] * r * (1.0 - r);
            (xr[i], xu[i], xn[i]) = (d_reset, d_update, d_candidate);
            (hr[i], hu[i], hn[i]) = (d_reset, d_update, d_candidate * r);
            d_state[i] = d * u;
        }
    }
}
