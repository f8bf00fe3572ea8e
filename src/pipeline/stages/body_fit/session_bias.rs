//! Offsets of the detector's keypoints, shared by all persons and estimated together with their motions.
//!
//! The joint problem with the cameras held and independent errors. Offsets can be separated from pose and shape because limbs rotate: a point
//! that is off in the bone's frame rotates with the bone.

use super::context::FitContext;
use super::joint_problem::{Errors, JointProblem, Member, Minimum, Stopping};
use super::terms::border_priors::{BoneLengthPrior, KeypointBiasPrior};
use crate::body::detector_offsets::{OffsetKind, OffsetTable};
use crate::progress::Canceled;
use nalgebra::Vector3;

/// The source of the body's systematic residuals. Keypoint offsets and bone offsets can be separated by the centres about which
/// limbs rotate, but only weakly one by one; all together show which of the two explains the session.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Hypothesis {
    /// Neither differs from the model by more than 1 mm.
    NoBias,
    /// The detector has a bias; people's bones are as the betas say, to 5 mm.
    DetectorBias,
    /// The detector shows the body's joints, to a fifth of its prior; people's bones differ by 30 mm (joint centres of
    /// another definition, unusual proportions). Points of face and feet have offsets under either hypothesis.
    BodyProportions,
}

impl Hypothesis {
    fn bone_sigma(self) -> f64 {
        match self {
            Self::NoBias => 0.001,
            Self::DetectorBias => 0.005,
            Self::BodyProportions => 0.030,
        }
    }

    fn offset_share(self, kind: &OffsetKind) -> f64 {
        match self {
            Self::NoBias if kind.is_joint => 0.02,
            Self::BodyProportions if kind.is_joint => 0.2,
            _ => 1.0,
        }
    }
}

/// The offsets and their accuracy.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SessionBias {
    /// By kind, m.
    pub offsets: Vec<Vector3<f64>>,
    /// Standard deviations, m; that of the prior where nothing was observed.
    pub sigmas: Vec<Vector3<f64>>,
    /// Cost of all terms.
    pub cost: f64,
    /// `log |H| / 2 - log |prior| / 2` over bones, betas and offsets.
    log_volume: f64,
    pub hypothesis: Hypothesis,
}

impl SessionBias {
    /// `-log p(session | hypothesis)` by Laplace's method, up to a part that all hypotheses share (MacKay 1992, Neural
    /// Computation 4:415, Eq. 2.5): cost and log volume at the optimum.
    pub(super) fn negative_log_evidence(&self) -> f64 {
        self.cost / CORRELATED_FRAMES + self.log_volume
    }
}

/// A detector's error lasts about a third of a second, so that this many frames at 30 Hz carry as much information as one:
/// priors count that many times as much against them.
const CORRELATED_FRAMES: f64 = 5.0;

/// Hypotheses are compared by the cost, of which one unit is negligible.
const STOPPING: Stopping = Stopping { max_iterations: 7, min_decrease: 1.0, min_sigmas: 0.0 };

/// The offsets under one hypothesis, estimated together with all motions, from `start`.
pub(super) fn session_bias(
    table: &OffsetTable,
    hypothesis: Hypothesis,
    start: Vec<Vector3<f64>>,
    members: &mut [Member],
    context: &FitContext,
) -> Result<SessionBias, Canceled> {
    let correlated_frames = CORRELATED_FRAMES;
    let prior_sigmas: Vec<Vector3<f64>> =
        table.kinds.iter().map(|kind| kind.prior_sigma * hypothesis.offset_share(kind)).collect();
    let problem = JointProblem {
        context,
        table,
        errors: Errors::Independent,
        // As strong as the priors of the offsets, since offsets and shape are separated by their priors alone in what they
        // share.
        shape_prior: CORRELATED_FRAMES,
        bone_prior: BoneLengthPrior { sigma: hypothesis.bone_sigma(), correlated_frames },
        bias_prior: KeypointBiasPrior { sigmas: prior_sigmas.clone(), correlated_frames },
        cameras: None,
    };
    let Minimum { session, cost, reduced } = problem.minimised(members, start, &STOPPING)?;
    // The data count once in [`CORRELATED_FRAMES`].
    let sigmas = reduced.as_ref().map_or(prior_sigmas, |reduced| {
        let covariance = reduced.covariance() * CORRELATED_FRAMES;
        let sigma = |k: usize| Vector3::from_fn(|axis, _| covariance[(3 * k + axis, 3 * k + axis)].max(0.0).sqrt());
        (0..table.kinds.len()).map(sigma).collect()
    });
    let log_volume = reduced.map_or(0.0, |reduced| reduced.log_volume);
    Ok(SessionBias { offsets: session.offsets, sigmas, cost, log_volume, hypothesis })
}
