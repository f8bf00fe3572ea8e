//! How tall people are, from a short run of frames: asked for before their motions are fitted.

use super::evidence::gather_evidence;
use super::habits::most_seen;
use super::solve::{Stages, StartedMotion, start_motion};
use super::{BodyFitConfig, BodyFitInput};
use crate::body::BodyModel;
use crate::body::scale::FittedStature;
use crate::progress::{Canceled, Progress};
use crate::session::PersonTrack;
use rayon::prelude::*;

/// Fits everybody's body to the frames that tell most of them, each person alone and by what was seen alone.
///
/// In the order of the tracks; `None` where closed form finds no start.
///
/// # Errors
/// [`Canceled`] once the caller has asked the work to stop.
pub fn fitted_statures(
    input: BodyFitInput,
    model: &BodyModel,
    progress: &Progress,
) -> Result<Vec<Option<FittedStature>>, Canceled> {
    let config = BodyFitConfig { motion_prior: false, ..BodyFitConfig::default() };
    let frame_interval = input.session.frame_interval();
    let stages = Stages { model, config: &config, as_seen: &config, frame_interval, progress };
    let fit = |track: &PersonTrack| {
        progress.check()?;
        let points = input.points.iter().find(|p| p.person == track.person);
        let evidence = gather_evidence(input, track, points, model);
        let evidence = evidence.slice(most_seen(&evidence, 0..track.detections.len(), config.offset_frames[0]));
        let n_keypoints = evidence.pixels.iter().map(Vec::len).sum();
        let started = start_motion(&stages, &evidence)?;
        let metres = |started: StartedMotion| model.surface.stature(&started.fitted.state.betas);
        Ok(started.map(|started| FittedStature { metres: metres(started), n_keypoints }))
    };
    input.tracks.par_iter().map(fit).collect()
}
