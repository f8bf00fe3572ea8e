//! The denoiser: a convolutional network over time that corrects a bridged motion and states how sure it is.
//!
//! Residual blocks of dilated convolutions see 36 frames to each side; without recurrence a frame's result depends on
//! nothing further away but the edges of its gap. A convolution with three taps is three matrix products whose results are shifted in time.

use super::denoiser_input::N_INPUT;
use super::observed::N_DESCRIBED;
use candle_core::{IndexOp, Result, Tensor};
use candle_nn::{Linear, Module, VarBuilder, linear, linear_no_bias};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Frames between the taps of each block's convolution.
const DILATIONS: [usize; 7] = [1, 2, 4, 8, 16, 4, 1];

/// Numbers of the output for each joint: a correction, and the lower triangle of its precision's factor.
const CORRECTION: usize = 3;
const FACTOR: usize = 6;

/// Numbers of the output: for each described joint the correction and the factor, the root's velocity with its logarithmic
/// standard deviations, and two contacts.
const N_OUTPUT: usize = N_DESCRIBED * (CORRECTION + FACTOR) + 6 + 2;

/// The logarithms of the factor's diagonal lie within this range: standard deviations within 1/20 and 20 times the unit.
const LOG_RANGE: f64 = 3.0;

/// Factor of the last layer: it begins at zero and has to reach corrections of several units.
const OUTPUT_GAIN: f64 = 5.0;

/// Width of the residual stream where nothing else is said.
pub const DEFAULT_WIDTH: usize = 48;

/// The network.
#[derive(Debug, Clone)]
pub struct Denoiser {
    embed: Linear,
    blocks: Vec<Block>,
    head: Linear,
}

/// `x + out(silu(conv(x)))`.
#[derive(Debug, Clone)]
struct Block {
    past: Linear,
    here: Linear,
    next: Linear,
    out: Linear,
    dilation: usize,
}

/// What the network states about a batch of motions `[B, T]`.
#[derive(Debug, Clone)]
pub struct Statement {
    /// Corrections of the bridged motion as right increments, in units of the input's, `[B, T, 20, 3]`.
    pub correction: Tensor,
    /// Logarithms of the diagonal of the precision's factor, `[B, T, 20, 3]`.
    pub log_diagonal: Tensor,
    /// The factor's entries (1, 0), (2, 0), (2, 1) relative to its diagonal, `[B, T, 20, 3]`.
    pub below: Tensor,
    /// Correction of the pelvis's velocity in its own frame, m/s, `[B, T, 3]`.
    pub velocity: Tensor,
    /// Logarithm of its standard deviations, `[B, T, 3]`.
    pub log_velocity_sigma: Tensor,
    /// Log odds of the left and of the right foot standing, `[B, T, 2]`.
    pub contact: Tensor,
}

impl Denoiser {
    /// The network of the given width with the variables of `vars`.
    ///
    /// # Errors
    /// A variable is missing or has another shape.
    pub fn new(width: usize, vars: VarBuilder) -> Result<Self> {
        let block = |(i, &dilation): (usize, &usize)| Block::new(width, dilation, vars.pp(format!("block{i}")));
        Ok(Self {
            embed: linear(N_INPUT, width, vars.pp("embed"))?,
            blocks: DILATIONS.iter().enumerate().map(block).collect::<Result<_>>()?,
            head: linear(width, N_OUTPUT, vars.pp("head"))?,
        })
    }

    /// What the network states about inputs `[B, T, N_INPUT]`.
    ///
    /// # Errors
    /// The input has another shape.
    pub fn forward(&self, input: &Tensor) -> Result<Statement> {
        self.forward_without(input, &mut Dropout(None))
    }

    /// The same with random numbers left out, in training.
    ///
    /// # Errors
    /// The input has another shape.
    pub(super) fn forward_without(&self, input: &Tensor, dropout: &mut Dropout) -> Result<Statement> {
        let mut stream = self.embed.forward(&dropout.of(input, INPUT_DROPOUT)?)?;
        for block in &self.blocks {
            stream = block.forward(&stream, dropout)?;
        }
        Statement::of(&(self.head.forward(&stream.silu()?)? * OUTPUT_GAIN)?)
    }
}

/// Leaves numbers out at random, and nothing without random numbers. candle's own takes them from the thread, so that no seed
/// repeats it.
pub(super) struct Dropout(pub Option<ChaCha8Rng>);

/// Shares that are left out of the input and of the numbers within a block: without, the network learns its subjects.
const INPUT_DROPOUT: f64 = 0.2;
const BLOCK_DROPOUT: f64 = 0.3;

impl Dropout {
    /// What is left, larger by as much as keeps the mean.
    fn of(&mut self, x: &Tensor, share: f64) -> Result<Tensor> {
        let Some(rng) = &mut self.0 else { return Ok(x.clone()) };
        let (threshold, kept) = ((share * f64::from(u32::MAX)) as u32, (1.0 / (1.0 - share)) as f32);
        let factor = |_| if rng.random::<u32>() < threshold { 0.0 } else { kept };
        let factors: Vec<f32> = (0..x.elem_count()).map(factor).collect();
        x.mul(&Tensor::from_vec(factors, x.dims(), x.device())?)
    }
}

impl Block {
    fn new(width: usize, dilation: usize, vars: VarBuilder) -> Result<Self> {
        Ok(Self {
            past: linear_no_bias(width, width, vars.pp("past"))?,
            here: linear(width, width, vars.pp("here"))?,
            next: linear_no_bias(width, width, vars.pp("next"))?,
            out: linear(width, width, vars.pp("out"))?,
            dilation,
        })
    }

    fn forward(&self, x: &Tensor, dropout: &mut Dropout) -> Result<Tensor> {
        let later = shifted(&self.past.forward(x)?, self.dilation, true)?;
        let earlier = shifted(&self.next.forward(x)?, self.dilation, false)?;
        let taps = ((self.here.forward(x)? + later)? + earlier)?;
        x + self.out.forward(&dropout.of(&taps.silu()?, BLOCK_DROPOUT)?)?
    }
}

/// `[B, T, C]` moved by `frames` to later or earlier times; zeros move in.
fn shifted(x: &Tensor, frames: usize, later: bool) -> Result<Tensor> {
    let n = x.dim(1)?;
    let kept = n.saturating_sub(frames);
    if kept == 0 {
        return x.zeros_like();
    }
    match later {
        true => x.narrow(1, 0, kept)?.pad_with_zeros(1, frames, 0),
        false => x.narrow(1, n - kept, kept)?.pad_with_zeros(1, 0, frames),
    }
}

impl Statement {
    fn of(output: &Tensor) -> Result<Self> {
        let (n_batch, n_frames, _) = output.dims3()?;
        let joints = output.narrow(2, 0, N_DESCRIBED * (CORRECTION + FACTOR))?.contiguous()?;
        let joints = joints.reshape((n_batch, n_frames, N_DESCRIBED, CORRECTION + FACTOR))?;
        let rest = output.narrow(2, N_DESCRIBED * (CORRECTION + FACTOR), 8)?;
        Ok(Self {
            correction: joints.narrow(3, 0, 3)?,
            log_diagonal: bounded(&joints.narrow(3, 3, 3)?)?,
            below: joints.narrow(3, 6, 3)?,
            velocity: rest.narrow(2, 0, 3)?,
            log_velocity_sigma: bounded(&rest.narrow(2, 3, 3)?)?,
            contact: rest.narrow(2, 6, 2)?,
        })
    }

    /// Errors in units of their stated deviations: `L e` with the factor L of the precision, for errors `[B, T, 20, 3]` in
    /// the input's units.
    ///
    /// # Errors
    /// The errors have another shape.
    pub fn whitened(&self, errors: &Tensor) -> Result<Tensor> {
        let diagonal = self.log_diagonal.exp()?;
        let [x, y, z] = [errors.i((.., .., .., 0..1))?, errors.i((.., .., .., 1..2))?, errors.i((.., .., .., 2..3))?];
        let below = |k: usize| self.below.i((.., .., .., k..k + 1));
        let second = (&y + below(0)?.mul(&x)?)?;
        let third = ((&z + below(1)?.mul(&x)?)? + below(2)?.mul(&y)?)?;
        Tensor::cat(&[&x, &second, &third], 3)?.mul(&diagonal)
    }
}

/// Smoothly bounded to [`LOG_RANGE`].
fn bounded(x: &Tensor) -> Result<Tensor> {
    (x * (1.0 / LOG_RANGE))?.tanh()? * LOG_RANGE
}
