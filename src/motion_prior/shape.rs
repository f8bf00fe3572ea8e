//! Widths and form of the network, and its initial parameters.

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
    /// Width of the decoder's layers; smaller, since a fit evaluates the decoder.
    pub decoder_hidden: usize,
    /// Form of the network.
    pub form: VaeForm,
}

/// Form of the network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VaeForm {
    /// Recurrent trunks around a frozen linear code: the shipped form.
    Recurrent,
    /// The same without recurrence (the role of VPoser in the paper's ablation).
    PerFrame,
    /// The paper's form, for comparison: input and output are two columns of each rotation; recurrent trunks, no frozen code,
    /// no fusion.
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

    /// The encoder's input of a take.
    pub(crate) fn input(&self, basis: &Basis, observed: &Observed) -> EncoderInput {
        if self.form == VaeForm::Plain { plain_input(basis, observed) } else { encoder_input(basis, observed) }
    }

    /// How many trained numbers the network has.
    pub fn n_parameters(&self) -> usize {
        self.encoder().len() + self.decoder().len()
    }

    /// Random initial parameters: normal with variance 1 / (2 H), except the two heads, which are zero.
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
