//! Training of the denoiser on recorded motions with gaps and noise.

use super::chart::LocalRotations;
use super::dataset::{Dataset, Take};
use super::denoiser::{DEFAULT_WIDTH, Denoiser, Dropout};
use super::denoiser_input::{DenoiserInput, denoiser_input};
use super::descent::{
    LONGEST_MOTION, Split, Trainee, TrainingConfig, TrainingError, initialise, named, on_cpu, provenance, trained,
};
use super::evaluation::{GapErrors, gap_errors, has_gaps, share_inside};
use super::gaps::{add_noise, aims, hide_randomly};
use super::joints::Bones;
use super::objective::{Batch, TrueMotion};
use super::observed::ObservedMotion;
use super::prior::MotionPrior;
use super::stretches::{MAX_MOTIONS, Stretches};
use super::weights::{NetworkKind, Weights, WeightsError};
use crate::progress::Progress;
use candle_core::{DType, Device, Tensor};
use candle_nn::{VarBuilder, VarMap};
use rayon::prelude::*;

/// The configuration where nothing else is said; a step is some 2,000 frames.
pub(super) const DEFAULTS: TrainingConfig =
    TrainingConfig { model: NetworkKind::Denoiser, seed: 1, steps: 4000, width: DEFAULT_WIDTH };

/// Lengths of the motions of a step and their numbers: 2,048 frames or a little less.
const MOTIONS: [(usize, usize); 3] = [(96, 21), (144, 14), (LONGEST_MOTION, 10)];
/// One of this number of gaps of the held-out subjects is validated on.
const VALIDATION_GAPS: usize = 12;
/// The same for the calibration of the temperature.
const CALIBRATION_GAPS: usize = 3;

/// The denoiser in training.
struct Training<'a> {
    denoiser: Denoiser,
    stretches: Stretches<'a>,
    rest: LocalRotations,
    held_out: &'a [&'a Take],
    bones: Bones,
    device: &'a Device,
}

/// Trains a denoiser and calibrates its temperature; see [`super::training::train`].
pub(super) fn train_denoiser(
    data: &Dataset,
    config: &TrainingConfig,
    device: &Device,
    progress: &Progress,
    keep: &mut dyn FnMut(&Weights),
) -> Result<Weights, TrainingError> {
    let Split { training, mut held_out, code } = Split::of(data)?;
    // Errors of takes without gaps would be 0 mm from the first validation on.
    held_out.retain(|take| has_gaps(take));
    let mut variables = VarMap::new();
    let denoiser = Denoiser::new(config.width, VarBuilder::from_varmap(&variables, DType::F32, device))?;
    initialise(&mut variables, config.seed, device)?;
    let network = on_cpu(&named(&variables)?)?;
    let start = Weights { provenance: provenance(data, config), basis: code.basis, network };
    let trainee = Training {
        denoiser,
        stretches: Stretches { takes: &training, seed: config.seed },
        rest: MotionPrior::new(start.clone())?.mean_pose(),
        held_out: &held_out,
        bones: Bones::of_default_body(),
        device,
    };
    let amount = (config.steps, !held_out.is_empty());
    let mut best = trained(&trainee, &variables, "no such name", start, amount, progress, keep)?;
    if held_out.is_empty() {
        best.provenance.held_out_error_mm = 0.0;
        return Ok(best);
    }
    let errors = gap_errors(&MotionPrior::new(best.clone())?, &held_out, CALIBRATION_GAPS);
    best.provenance.held_out_error_mm = mean_mm(&errors);
    best.provenance.temperature = temperature(&errors);
    Ok(best)
}

impl Training<'_> {
    /// The motions of a step.
    fn motions(&self, step: usize) -> Vec<(ObservedMotion, DenoiserInput, TrueMotion)> {
        let (n_frames, n_motions) = MOTIONS[step % MOTIONS.len()];
        let motion = |place: usize| {
            let mut rng = self.stretches.stream(step, place);
            let truth = self.stretches.draw(n_frames, &mut rng);
            let mut observed = ObservedMotion::exact(truth.rotations.clone(), truth.pelvis.clone());
            add_noise(&mut observed, &self.bones, &mut rng);
            hide_randomly(&mut observed, &mut rng);
            let input = denoiser_input(&observed, &self.rest);
            let aimed = TrueMotion { rotations: aims(&truth.rotations, &observed), ..truth };
            (observed, input, aimed)
        };
        (0..n_motions).into_par_iter().map(motion).collect()
    }
}

impl Trainee for Training<'_> {
    const LEARNING_RATE: f64 = 2e-3;
    const ERROR_OF: &'static str = "hidden joints";

    fn loss(&self, step: usize) -> candle_core::Result<Tensor> {
        let batch = Batch::new(&self.bones, &self.motions(step), self.device)?;
        // The last stream of a step: motions take the first ones.
        let mut dropout = Dropout(Some(self.stretches.stream(step, MAX_MOTIONS - 1)));
        batch.loss(&self.denoiser.forward_without(&batch.input, &mut dropout)?)
    }

    fn held_out_mm(&self, candidate: &Weights) -> Result<f64, WeightsError> {
        let prior = MotionPrior::new(candidate.clone())?;
        Ok(mean_mm(&gap_errors(&prior, self.held_out, VALIDATION_GAPS)))
    }
}

/// Mean over the kinds of gaps that occur, mm.
fn mean_mm(errors: &[GapErrors]) -> f64 {
    let found: Vec<f64> = errors.iter().filter(|kind| kind.n_gaps > 0).map(|kind| kind.denoiser_mm).collect();
    found.iter().sum::<f64>() / found.len().max(1) as f64
}

/// The smallest factor of the covariances with which 95 % of all errors lie inside their 95 % ellipsoids.
fn temperature(errors: &[GapErrors]) -> f64 {
    let ellipsoids: Vec<_> = errors.iter().flat_map(|kind| kind.ellipsoids.iter().copied()).collect();
    let (mut low, mut high) = (0.05_f64, 50.0_f64);
    for _ in 0..30 {
        let middle = (low * high).sqrt();
        if share_inside(&ellipsoids, middle) < 0.95 { low = middle } else { high = middle }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::super::weights::NetworkKind;
    use super::*;
    use crate::geometry::rotation::exp;
    use nalgebra::Vector3;

    /// A subject that moves all joints.
    fn take(n_frames: usize) -> Take {
        let of_frame = |t: usize| {
            let angle = |joint: usize| (0.05 * (joint + 2) as f64 * t as f64).sin();
            std::array::from_fn(|joint| exp(&Vector3::new(0.2 * angle(joint), -0.1 * angle(joint + 3), 0.1)))
        };
        Take {
            subject: "a".to_owned(),
            name: "b".to_owned(),
            rotations: (0..n_frames).map(of_frame).collect(),
            pelvis: vec![Vector3::new(0.0, 0.9, 0.0); n_frames],
            contacts: vec![[true; 2]; n_frames],
        }
    }

    /// The first of two takes is held out. Its error was 0 mm, below which no later weights came, and its temperature 50.
    #[test]
    fn held_out_takes_too_short_for_gaps_had_no_error() {
        let config = TrainingConfig { model: NetworkKind::Denoiser, seed: 1, steps: 0, width: 16 };
        let weights = |n_held_out: usize| {
            let data = Dataset { takes: vec![take(n_held_out), take(300)], sha256: String::new() };
            train_denoiser(&data, &config, &Device::Cpu, &Progress::silent(), &mut |_| {}).unwrap()
        };
        let [none, shortest] = [44, 45].map(|n_held_out| weights(n_held_out).provenance);
        assert_eq!((none.held_out_error_mm, none.temperature), (0.0, 1.0));
        assert!(shortest.held_out_error_mm > 0.0 && shortest.temperature < 50.0, "{shortest:?}");
    }
}
