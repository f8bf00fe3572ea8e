//! Body heights from a short run of frames, before the motions are fitted.

use super::config::BodyFitConfig;
use super::context::FitContext;
use super::input::BodyFitInput;
use super::observations::gather_observations;
use super::person_fit::{StartedMotion, start_motion};
use crate::body::BodyModel;
use crate::body::scale::FittedStature;
use crate::progress::{Canceled, Progress};
use crate::session::PersonTrack;
use rayon::prelude::*;

/// Fits each person's body alone, to the run of frames with most pixels and without the motion prior.
///
/// In the order of the tracks; `None` where the closed form finds no start.
pub fn fitted_statures(
    input: BodyFitInput,
    model: &BodyModel,
    progress: &Progress,
) -> Result<Vec<Option<FittedStature>>, Canceled> {
    let config = BodyFitConfig { motion_prior: false, ..BodyFitConfig::default() };
    let frame_interval = input.session.frame_interval();
    let context = FitContext { model, config: &config, first_config: &config, frame_interval, progress };
    let fit = |track: &PersonTrack| {
        progress.check()?;
        let points = input.points.iter().find(|p| p.person == track.person);
        let observations = gather_observations(input, track, points, model);
        let observations = observations.slice(observations.most_seen(0..track.detections.len(), config.bias_frames[0]));
        let n_keypoints = observations.pixels.iter().map(Vec::len).sum();
        let started = start_motion(&context, &observations)?;
        let metres = |started: StartedMotion| model.surface.stature(&started.fitted.state.betas);
        Ok(started.map(|started| FittedStature { metres: metres(started), n_keypoints }))
    };
    input.tracks.par_iter().map(fit).collect()
}
