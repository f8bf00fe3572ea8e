//! The stages that a job reports, and the time that they take.

use super::config::{IntrinsicsMode, MotionPriorMode, Options, Sync};
use super::corrections::Correction;
use crate::matching::view_pairs::max_pairs;
use crate::session::Session;

/// Passes 8 and 9, as a job reports them.
pub(super) const LAST_STAGES: [&str; 2] = ["metric_scale", "body_fit"];

/// The same after corrections.
pub(super) const CORRECTED_STAGES: [&str; 2] = ["corrected_metric_scale", "corrected_body_fit"];

/// Time that latent motions take, over that of all other steps of the body fit.
pub(super) const LATENT_SHARE: f64 = 2.0;

/// Cores that the times are of.
const MEASURED_CORES: f64 = 2.0;

/// What the time of a stage depends on.
struct Workload {
    n_pairs: f64,
    n_detections: f64,
}

impl Workload {
    fn of(session: &Session) -> Self {
        let n_detections: usize = session.views.iter().flat_map(|view| &view.frames).map(Vec::len).sum();
        Self { n_pairs: max_pairs(session.views.len()) as f64, n_detections: n_detections as f64 }
    }

    /// Of a stage that takes `fixed` seconds, these for each pair of cameras, and these for a thousand detections, as measured on
    /// [`MEASURED_CORES`] with recordings of 300 and 1,500 frames, 3 to 8 cameras and 1 to 4 people. A slow core takes twice as long.
    fn secs(&self, fixed: f64, per_pair: f64, per_thousand: f64) -> f64 {
        fixed + per_pair * self.n_pairs + 1e-3 * per_thousand * self.n_detections
    }

    fn body_fit_secs(&self, options: &Options) -> f64 {
        let is_latent = options.motion_prior == MotionPriorMode::Latent;
        self.secs(0.25, 0.0, 0.18) * if is_latent { 1.0 + LATENT_SHARE } else { 1.0 }
    }
}

/// The stages of a solve of `session`, with their expected seconds.
pub(super) fn stage_secs(options: &Options, session: &Session) -> Vec<(&'static str, f64)> {
    let intrinsics = options.intrinsics_of(session);
    let work = Workload::of(session);
    let stages = [
        ("synchronisation", work.secs(0.0, 0.25, 0.0), options.sync == Sync::Estimate),
        ("focal_lengths", work.secs(0.0, 0.05, 0.04), intrinsics == IntrinsicsMode::RefineFocal),
        ("focal_lengths", work.secs(0.0, 0.26, 0.0), intrinsics == IntrinsicsMode::Estimate),
        ("cameras", work.secs(0.0, 0.028, 0.025), true),
        ("denoising", work.secs(0.05, 0.0, 0.018), options.denoise),
        ("held_out_check", 0.06, true),
        ("joint_trajectories", work.secs(0.005, 0.0, 0.003), true),
        ("recording_check", work.secs(0.1, 0.005, 0.01), true),
        (LAST_STAGES[0], 0.01, true),
        (LAST_STAGES[1], work.body_fit_secs(options), true),
    ];
    let stages = stages.into_iter().filter(|(_, _, runs)| *runs).map(|(name, secs, _)| (name, secs));
    stages.chain(corrected_stage_secs(options, session)).collect()
}

/// Expected seconds of a solve of `session` with default options.
pub(super) fn expected_secs(session: &Session, n_cores: usize) -> f64 {
    let on_measured: f64 = stage_secs(&Options::default(), session).iter().map(|(_, secs)| secs).sum();
    on_measured * MEASURED_CORES / n_cores.max(1) as f64
}

/// Those of the corrections; none without any.
pub(super) fn corrected_stage_secs(options: &Options, session: &Session) -> Vec<(&'static str, f64)> {
    if options.corrections.is_empty() {
        return Vec::new();
    }
    let work = Workload::of(session);
    let excludes = options.corrections.iter().any(Correction::excludes);
    let corrections = work.secs(0.05, 0.0, if excludes { 0.02 } else { 0.01 });
    vec![("corrections", corrections), (CORRECTED_STAGES[0], 0.01), (CORRECTED_STAGES[1], work.body_fit_secs(options))]
}
