//! Widths and form of the network, and where its training starts.

use super::basis::{Basis, LATENT_DIM};
use super::chart::N_FEATURES;
use super::encoder_input::{EncoderInput, N_ENCODER_INPUT, N_PLAIN_INPUT, encoder_input, plain_input};
use super::fusion::N_FUSION;
use super::paths::Observed;
use super::six_d::N_COLUMNS;
use super::trunk::TrunkShape;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};

/// Widths and form of the network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VaeShape {
    /// Width of the encoder's layers.
    pub encoder_hidden: usize,
    /// Width of the decoder's layers: the decoder is what a fit evaluates, so it is the smaller one.
    pub decoder_hidden: usize,
    /// What it is made of.
    pub form: VaeForm,
}

/// What the network is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VaeForm {
    /// Recurrent trunks around a frozen linear code: what is shipped.
    Recurrent,
    /// The same without neighbours (the role of VPoser in the paper's ablation).
    PerFrame,
    /// The paper's: rotations as two columns each, in and out, recurrent trunks, nothing frozen, nothing joined by
    /// arithmetic. For comparison.
    Plain,
}

impl Default for VaeShape {
    fn default() -> Self {
        Self { encoder_hidden: 128, decoder_hidden: 96, form: VaeForm::Recurrent }
    }
}

impl VaeShape {
    /// The encoder's trunk.
    pub(crate) fn encoder(&self) -> TrunkShape {
        let [n_in, n_out] = match self.form {
            VaeForm::Plain => [N_PLAIN_INPUT, 2 * LATENT_DIM],
            VaeForm::Recurrent | VaeForm::PerFrame => [N_ENCODER_INPUT, N_FUSION + LATENT_DIM],
        };
        TrunkShape { n_in, hidden: self.encoder_hidden, n_out, recurrent: self.form != VaeForm::PerFrame }
    }

    /// The decoder's trunk.
    pub(crate) fn decoder(&self) -> TrunkShape {
        let n_out = if self.form == VaeForm::Plain { N_COLUMNS } else { N_FEATURES };
        let hidden = self.decoder_hidden;
        TrunkShape { n_in: LATENT_DIM, hidden, n_out, recurrent: self.form != VaeForm::PerFrame }
    }

    /// What the encoder is told of a take.
    pub(crate) fn input(&self, basis: &Basis, observed: &Observed) -> EncoderInput {
        if self.form == VaeForm::Plain { plain_input(basis, observed) } else { encoder_input(basis, observed) }
    }

    /// How many trained numbers the network has.
    pub fn n_parameters(&self) -> usize {
        self.encoder().len() + self.decoder().len()
    }

    /// Random parameters: normal with variance 1 / (2 H) but for the two heads, which start at zero.
    pub fn initial_parameters(&self, seed: u64) -> Vec<f32> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut parameters = vec![0.0; self.n_parameters()];
        let (encoder, decoder) = parameters.split_at_mut(self.encoder().len());
        for (values, shape) in [(encoder, self.encoder()), (decoder, self.decoder())] {
            let sd = (0.5 / shape.hidden as f64).sqrt();
            for value in &mut values[..shape.len_before_head()] {
                *value = (sd * rng.sample::<f64, _>(StandardNormal)) as f32;
            }
        }
        parameters
    }
}
