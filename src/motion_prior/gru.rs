//! A bidirectional GRU of one layer.
//!
//! Cho et al. 2014 (EMNLP, Eqs. 5 to 8): with the update and reset gates u and r, the candidate c and the state h,
//! `[u, r] = sigmoid(W_g [x, h])`, `c = tanh(W_c [x, r h])`, `h <- h + u (c - h)`, each with a bias. The second direction reads
//! the frames backwards; both advance together, so that a step is two batched products.

use candle_core::{Result, Tensor};
use candle_nn::VarBuilder;
use candle_nn::ops::sigmoid;

/// The layer.
#[derive(Debug, Clone)]
pub struct BiGru {
    gates: BothWays,
    candidate: BothWays,
    width: usize,
}

/// An affine map for each direction.
#[derive(Debug, Clone)]
struct BothWays {
    /// `[2, in, out]`
    weight: Tensor,
    /// `[2, 1, out]`
    bias: Tensor,
}

impl BothWays {
    fn new(n_in: usize, n_out: usize, vars: VarBuilder) -> Result<Self> {
        let weight = vars.get((2, n_out, n_in), "weight")?.transpose(1, 2)?;
        Ok(Self { weight, bias: vars.get((2, 1, n_out), "bias")? })
    }

    /// `[2, B, in]` to `[2, B, out]`.
    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        x.matmul(&self.weight)?.broadcast_add(&self.bias)
    }
}

impl BiGru {
    /// The layer for inputs of `n_in` numbers a frame, with states of `width` numbers in each direction.
    ///
    /// # Errors
    /// A variable is missing or has another shape.
    pub fn new(n_in: usize, width: usize, vars: VarBuilder) -> Result<Self> {
        let gates = BothWays::new(n_in + width, 2 * width, vars.pp("gates"))?;
        Ok(Self { gates, candidate: BothWays::new(n_in + width, width, vars.pp("candidate"))?, width })
    }

    /// The states of both directions, `[T, B, 2 width]`, over inputs `[T, B, in]`, from states of zero.
    ///
    /// # Errors
    /// The input has another shape, or no frame.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let (n_frames, n_batch, _) = x.dims3()?;
        let frames = (0..n_frames).map(|t| x.get(t)).collect::<Result<Vec<_>>>()?; // [B, in]
        let mut state = Tensor::zeros((2, n_batch, self.width), x.dtype(), x.device())?;
        let mut states = Vec::with_capacity(n_frames);
        for t in 0..n_frames {
            let both = Tensor::stack(&[&frames[t], &frames[n_frames - 1 - t]], 0)?; // [2, B, in]
            state = self.advanced(&both, &state)?;
            states.push(state.clone());
        }
        let at = |t: usize| Tensor::cat(&[states[t].get(0)?, states[n_frames - 1 - t].get(1)?], 1); // [B, 2 width]
        Tensor::stack(&(0..n_frames).map(at).collect::<Result<Vec<_>>>()?, 0)
    }

    /// The state `[2, B, width]` after the inputs `[2, B, in]`.
    fn advanced(&self, x: &Tensor, state: &Tensor) -> Result<Tensor> {
        let gates = sigmoid(&self.gates.forward(&Tensor::cat(&[x, state], 2)?)?)?; // [2, B, 2 width]
        let (update, reset) = (gates.narrow(2, 0, self.width)?, gates.narrow(2, self.width, self.width)?);
        let candidate = self.candidate.forward(&Tensor::cat(&[x, &reset.mul(state)?], 2)?)?.tanh()?;
        state + update.mul(&(candidate - state)?)?
    }
}
