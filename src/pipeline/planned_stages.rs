//! The stages that a job reports, with their shares of the time.

use super::config::{IntrinsicsMode, Options, Sync};
use super::corrections::Correction;

/// Passes 8 and 9, as a job reports them.
pub(super) const LAST_STAGES: [&str; 2] = ["metric_scale", "body_fit"];

/// The same after corrections.
pub(super) const CORRECTED_STAGES: [&str; 2] = ["corrected_metric_scale", "corrected_body_fit"];

/// The stages that a job reports, with their shares of the time.
pub(super) fn stage_weights(options: &Options, intrinsics: IntrinsicsMode) -> Vec<(&'static str, f64)> {
    let stages = [
        ("synchronisation", 1.5, options.sync == Sync::Estimate),
        ("focal_lengths", 0.7, intrinsics == IntrinsicsMode::RefineFocal),
        ("focal_lengths", 3.0, intrinsics == IntrinsicsMode::Estimate),
        ("cameras", 0.4, true),
        ("denoising", 0.15, options.denoise),
        ("held_out_check", 0.1, true),
        ("joint_trajectories", 0.05, true),
        ("recording_check", 0.03, true),
        (LAST_STAGES[0], 0.02, true),
        (LAST_STAGES[1], 0.28, true),
    ];
    let stages = stages.into_iter().filter(|(_, _, runs)| *runs).map(|(name, weight, _)| (name, weight));
    stages.chain(corrected_stage_weights(options)).collect()
}

/// Those of the corrections; none without any.
pub(super) fn corrected_stage_weights(options: &Options) -> Vec<(&'static str, f64)> {
    if options.corrections.is_empty() {
        return Vec::new();
    }
    let excludes = options.corrections.iter().any(Correction::excludes);
    vec![("corrections", if excludes { 0.2 } else { 0.05 }), (CORRECTED_STAGES[0], 0.02), (CORRECTED_STAGES[1], 0.28)]
}
