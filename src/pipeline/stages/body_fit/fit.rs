//! The fit of all persons of a session, step by step, and of their statures alone.

use super::camera_adjustment::correlated_errors;
use super::collision_resolution::resolve_collisions;
use super::config::BodyFitConfig;
use super::context::FitContext;
use super::focal_prior::RefinedFocal;
use super::gathering::gather_observations;
use super::joint_uncertainty::{MotionUncertainty, motion_uncertainty};
use super::keypoint_bias::estimated_bias;
use super::latent_fit::latent_motions;
use super::local_noise::{LocalNoise, local_noise};
use super::monocular::lifting::lifted;
use super::observations::Observations;
use super::person_fit::{StartedMotion, finish_motion, start_motion};
use super::person_motion::{PersonFit, body_motion, stage_report, valid_frames};
use super::stated_covariances::{StatedCovariances, weigh_stated_covariances};
use crate::body::BodyModel;
use crate::body::measures::BodyMeasures;
use crate::body::scale::FittedStature;
use crate::geometry::Rigid;
use crate::geometry::free_network::CameraCovariance;
use crate::optim::block_banded::SystemPool;
use crate::pipeline::calibration::TrackedPeople;
use crate::pipeline::planned_stages::LATENT_SHARE;
use crate::pipeline::time_windows::windows;
use crate::progress::{Canceled, Progress};
use crate::session::reconstruction::{KeypointBias, PenetrationReport, StageReport};
use crate::session::{BodyMotion, PersonTrack};
use nalgebra::Vector3;
use rayon::prelude::*;

/// All persons' bodies, with statistics of the fit.
#[derive(Debug, Clone)]
pub struct FittedBodies {
    /// One motion per track whose trunk was triangulated at least once, in the order of the tracks; a motion covers its
    /// track's frames without gaps.
    pub motions: Vec<BodyMotion>,
    /// Stature and mass of each.
    pub measures: Vec<BodyMeasures>,
    /// The fitted model: its landmarks lie where the session's detector has them, if that bias was applied.
    pub detector_model: BodyModel,
    /// The keypoint bias of the detector; empty where it was not estimated.
    pub detector: KeypointBias,
    /// Overlaps between bodies.
    pub penetration: PenetrationReport,
    /// `camera_from_world` of the placed cameras, where they were adjusted together with the motions.
    pub cameras: Option<Vec<Rigid>>,
    /// Theirs, m and rad; `None` where they were held or the session does not determine them.
    pub camera_covariance: Option<CameraCovariance>,
    /// Focal lengths of the placed cameras, where they were refined with the motions.
    pub focal: Option<RefinedFocal>,
    /// Iterations, costs and residuals.
    pub report: StageReport,
}

/// Fits the bodies of all persons. The same input gives the same bytes whatever the number of threads.
///
/// `up`: the upward direction in the world, unit length. Monocular fits use it, since a single view does not show how far
/// people lean.
pub fn fit_bodies(
    input: &TrackedPeople,
    up: &Vector3<f64>,
    model: &BodyModel,
    config: &BodyFitConfig,
    progress: &Progress,
) -> Result<FittedBodies, Canceled> {
    let frame_interval = input.session.frame_interval();
    let first_config = config.without_refinement();
    let (noise, averaged_noise, systems, up) = (None, None, &SystemPool::default(), *up);
    let first_config = &first_config;
    let context =
        FitContext { model, config, first_config, frame_interval, up, progress, noise, averaged_noise, systems };
    let mut steps = progress.steps(step_weights(config));
    let windows_of = |track: &PersonTrack| windows(track.detections.len(), context.window_frames()).len();
    let n_windows: usize = input.tracks.iter().map(windows_of).sum();

    let step = steps.begin_parts(n_windows, "fitting bodies to points and pixels");
    let mut started = started_people(input, &FitContext { progress: &step, ..context })?;
    let stated = weigh_stated_covariances(&context, &mut started)?;
    let local = if config.correlated_errors { local_noise(&context, &started) } else { None };

    let people: Vec<&(Observations, StartedMotion)> = started.iter().flatten().collect();
    let bias = match config.estimate_keypoint_bias {
        true => {
            steps.begin("estimating the keypoint bias of the detector");
            estimated_bias(&context, input.session.convention, &people)?
        }
        false => None,
    };
    let has_bias = bias.is_some();
    let (detector_model, detector) =
        bias.map_or_else(|| (model.clone(), KeypointBias::default()), |bias| (bias.model, bias.report));
    let context = FitContext { model: &detector_model, ..context };
    let adjusted = match config.correlated_errors {
        true => {
            steps.begin("adjusting cameras and motions together");
            correlated_errors(&context, &mut started)?
        }
        false => None,
    };
    let has_changed = has_bias || adjusted.is_some();
    let noise = adjusted.as_ref().map(|adjusted| &adjusted.noise);
    let slow = noise.map_or(0.0, |noise| noise.typical().autocorrelation);
    let last_config = config.under_correlated_errors(slow);
    let averaged_noise = adjusted.as_ref().map(|adjusted| &adjusted.averaged_noise);
    let context = FitContext { noise, averaged_noise, config: &last_config, ..context };
    let cameras = adjusted.as_ref().and_then(|adjusted| adjusted.cameras.clone());
    let cameras = match config.latent_motions {
        true => {
            steps.begin("fitting latent motions and cameras together");
            latent_motions(&context, &mut started)?.or(cameras)
        }
        false => cameras,
    };
    if let Some(local) = &local {
        local.weigh(&mut started);
    }
    let step = steps.begin_parts(n_windows, "fitting bodies to all observations");
    let last_context = FitContext { progress: &step, ..context };
    let mut people = finished_people(input, &last_context, started, has_changed)?;
    steps.begin("resolving collisions between bodies");
    let penetration = resolve_collisions(&context, &mut people, config.resolve_collisions, input.session.first_frame)?;
    let camera_covariance = adjusted.as_ref().and_then(|adjusted| adjusted.covariance.clone());
    let camera_covariance = camera_covariance.or_else(|| config.known_covariance.clone());
    let described = |person: &PersonFit| described(person, &context, model, camera_covariance.as_ref());
    let (motions, measures) = people.par_iter().map(described).unzip();
    let focal = adjusted.as_ref().and_then(|adjusted| adjusted.focal.clone());
    let mut report = stage_report(&people, input.tracks.len());
    report.metrics.extend(stated.iter().flat_map(StatedCovariances::metrics));
    report.metrics.extend(local.as_ref().map(LocalNoise::metric));
    report.metrics.extend(focal.as_ref().map(|focal| ("focal_log_evidence".to_owned(), focal.log_evidence)));
    Ok(FittedBodies {
        report,
        motions,
        measures,
        detector,
        detector_model,
        penetration,
        cameras,
        camera_covariance,
        focal,
    })
}

/// Shares of the steps of [`fit_bodies`] in its time without latent motions, as measured on recordings of 300 and 1,500 frames.
fn step_weights(config: &BodyFitConfig) -> impl Iterator<Item = f64> {
    let steps = [
        (0.1, true), // to points and pixels
        (0.04, config.estimate_keypoint_bias),
        (0.43, config.correlated_errors),
        (LATENT_SHARE, config.latent_motions),
        (0.23, true), // to all observations
        (0.2, true),  // collisions and uncertainties
    ];
    steps.into_iter().filter_map(|(weight, runs)| runs.then_some(weight))
}

/// Observations and first fit of each person, by track.
fn started_people(
    input: &TrackedPeople,
    context: &FitContext,
) -> Result<Vec<Option<(Observations, StartedMotion)>>, Canceled> {
    let start_person = |track: &PersonTrack| {
        context.progress.check()?;
        let mut observations = gather_observations(input, track, context.model);
        if input.session.views.len() == 1 {
            observations.points = lifted(context.model, &observations, &context.up, context.frame_interval);
        }
        Ok(start_motion(context, &observations)?.map(|started| (observations, started)))
    };
    input.tracks.par_iter().map(start_person).collect()
}

/// The last fit of each person with a first one, in the order of the tracks.
fn finished_people(
    input: &TrackedPeople,
    context: &FitContext,
    started: Vec<Option<(Observations, StartedMotion)>>,
    has_changed: bool,
) -> Result<Vec<PersonFit>, Canceled> {
    let gap_limit = (context.config.gap_limit_secs / context.frame_interval).round() as usize;
    let finish_person = |(track, started): (&PersonTrack, Option<(Observations, StartedMotion)>)| {
        context.progress.check()?;
        let Some((observations, started)) = started else { return Ok(None) };
        let fitted = match context.config.latent_motions {
            true => started.fitted,
            false => finish_motion(context, &observations, started, has_changed)?,
        };
        let valid = valid_frames(&observations, gap_limit);
        Ok(Some(PersonFit { person: track.person, first: track.first.0, observations, fitted, valid }))
    };
    let people: Vec<_> = input.tracks.par_iter().zip(started).map(finish_person).collect::<Result<_, Canceled>>()?;
    Ok(people.into_iter().flatten().collect())
}

/// Motion and measures of a person with their standard deviations, on the `model` without the detector's bias.
fn described(
    person: &PersonFit,
    context: &FitContext,
    model: &BodyModel,
    cameras: Option<&CameraCovariance>,
) -> (BodyMotion, BodyMeasures) {
    let uncertainty = motion_uncertainty(context, person, cameras);
    let (sigmas, betas) = uncertainty.map(|MotionUncertainty { joint_sigmas, betas }| (joint_sigmas, betas)).unzip();
    let scale = context.config.sigma_log_scale;
    let measures = BodyMeasures::new(&model.surface, &person.fitted.state.betas, betas.as_ref(), scale);
    (body_motion(model, person, sigmas), measures)
}

/// Fits each person's body alone, to the run of frames with most pixels and without the motion prior.
///
/// In the order of the tracks; `None` where the closed form finds no start.
pub fn fitted_statures(
    input: &TrackedPeople,
    model: &BodyModel,
    progress: &Progress,
) -> Result<Vec<Option<FittedStature>>, Canceled> {
    let config = BodyFitConfig { motion_prior: false, ..BodyFitConfig::default() };
    let frame_interval = input.session.frame_interval();
    // Without the motion prior the way up is of no account.
    let up = Vector3::y();
    let (config, noise, averaged_noise, systems) = (&config, None, None, &SystemPool::default());
    let first_config = config;
    let context =
        FitContext { model, config, first_config, frame_interval, up, progress, noise, averaged_noise, systems };
    let fit = |track: &PersonTrack| {
        progress.check()?;
        let observations = gather_observations(input, track, model);
        let observations = observations.slice(observations.most_seen(0..track.detections.len(), config.bias_frames[0]));
        let n_keypoints = observations.pixels.iter().map(Vec::len).sum();
        let started = start_motion(&context, &observations)?;
        let metres = |started: StartedMotion| model.surface.stature(&started.fitted.state.betas);
        Ok(started.map(|started| FittedStature { metres: metres(started), n_keypoints }))
    };
    input.tracks.par_iter().map(fit).collect()
}
