//! The variational autoencoder of motions, the paper's latent motion prior (section 3.2).
//!
//! Encoder and decoder are alike: a skip connection from frame to frame, and a bidirectional GRU that adds what follows from
//! the whole motion. The code has 32 numbers a frame, so that the network is trained on short stretches and decodes motions
//! of any length. Unlike in the paper, the skip connections are the frozen linear code ([`super::basis`]), and the GRUs begin
//! at zero.

use super::basis::LATENT_DIM;
use super::chart::N_FEATURES;
use super::gru::BiGru;
use candle_core::{Result, Tensor};
use candle_nn::{Linear, Module, VarBuilder, linear};

/// Width of a GRU's state in each direction where nothing else is said.
pub const DEFAULT_WIDTH: usize = 64;

/// Logarithm of the codes' variance before training: standard deviations of 0.1, which leave a joint where it is to some mm.
const FIRST_LOG_VARIANCE: f64 = -4.6;

/// Part of the names of the variables that are not trained.
pub(super) const FROZEN: &str = "skip.";

/// Encoder and decoder.
#[derive(Debug, Clone)]
pub struct Vae {
    encoder: Half,
    decoder: Half,
}

/// `[skip(x), 0] + head(gru(x))`.
#[derive(Debug, Clone)]
struct Half {
    skip: Linear,
    gru: BiGru,
    head: Linear,
}

/// The posterior `q(z | X)`: independent normal distributions.
#[derive(Debug, Clone)]
pub struct Posterior {
    /// `[T, B, 32]`
    pub mean: Tensor,
    /// `[T, B, 32]`
    pub log_variance: Tensor,
}

impl Half {
    fn new([n_in, n_skip, n_out]: [usize; 3], width: usize, vars: VarBuilder) -> Result<Self> {
        Ok(Self {
            skip: linear(n_in, n_skip, vars.pp("skip"))?,
            gru: BiGru::new(n_in, width, vars.pp("gru"))?,
            head: linear(2 * width, n_out, vars.pp("head"))?,
        })
    }

    /// What the whole motion `[T, B, in]` adds, `[T, B, out]`.
    fn residual(&self, x: &Tensor) -> Result<Tensor> {
        self.head.forward(&self.gru.forward(x)?)
    }
}

impl Vae {
    /// The network of the given width with the variables of `vars`.
    ///
    /// # Errors
    /// A variable is missing or has another shape.
    pub fn new(width: usize, vars: VarBuilder) -> Result<Self> {
        Ok(Self {
            encoder: Half::new([N_FEATURES, LATENT_DIM, 2 * LATENT_DIM], width, vars.pp("encoder"))?,
            decoder: Half::new([LATENT_DIM, N_FEATURES, N_FEATURES], width, vars.pp("decoder"))?,
        })
    }

    /// Codes of frames without regard to the motion, `[N, 32]` from features `[N, 57]`.
    ///
    /// # Errors
    /// The input has another shape.
    pub fn encoded_frames(&self, features: &Tensor) -> Result<Tensor> {
        self.encoder.skip.forward(features)
    }

    /// What the motion adds to mean and logarithmic variance of its codes, `[T, B, 64]` from features `[T, B, 57]`.
    ///
    /// # Errors
    /// The input has another shape.
    pub fn encoder_residual(&self, features: &Tensor) -> Result<Tensor> {
        self.encoder.residual(features)
    }

    /// Features of frames without regard to the motion, `[N, 57]` from codes `[N, 32]`.
    ///
    /// # Errors
    /// The input has another shape.
    pub fn decoded_frames(&self, codes: &Tensor) -> Result<Tensor> {
        self.decoder.skip.forward(codes)
    }

    /// What the motion adds to its features, `[T, B, 57]` from codes `[T, B, 32]`.
    ///
    /// # Errors
    /// The input has another shape.
    pub fn decoder_residual(&self, codes: &Tensor) -> Result<Tensor> {
        self.decoder.residual(codes)
    }

    /// The posterior of motions `[T, B, 57]`.
    ///
    /// # Errors
    /// The input has another shape.
    pub fn posterior(&self, features: &Tensor) -> Result<Posterior> {
        let residual = self.encoder_residual(features)?;
        Ok(Posterior {
            mean: (self.encoded_frames(features)? + residual.narrow(2, 0, LATENT_DIM)?)?,
            log_variance: (residual.narrow(2, LATENT_DIM, LATENT_DIM)? + FIRST_LOG_VARIANCE)?,
        })
    }

    /// Features `[T, B, 57]` of codes `[T, B, 32]`.
    ///
    /// # Errors
    /// The input has another shape.
    pub fn decoded(&self, codes: &Tensor) -> Result<Tensor> {
        self.decoded_frames(codes)? + self.decoder_residual(codes)?
    }
}
