//! Which joints the detector places elsewhere than the body has them, by evidence.
//!
//! A body whose joints lie elsewhere looks nearly the same as a detector that places them elsewhere: what separates them are the
//! centres about which limbs rotate. All hypotheses are compared at one state, that of a fit with bones and offsets free, from
//! the same quadratic cost (MacKay 1992, Neural Computation 4:415, Eq. 2.5): separate fits end in different local minima, whose
//! costs differ by more than the hypotheses do.

use super::joint_problem::{ProportionEvidence, Role};
use crate::body::detector_offsets::OffsetTable;
use crate::optim::determinant::half_log_det;
use nalgebra::{DVector, Vector3};

/// Standard deviation of a person's bones against those of the betas, m per axis: joint centres of another definition, unusual
/// proportions.
pub(super) const PROPORTION_SIGMA: f64 = 0.030;

/// Axis of a bias: upwards and forwards the pose makes up for an offset (longer legs, more bent knees), so that smoothness alone
/// would decide on it.
const SIDEWAYS: usize = 0;

/// Standard deviation of the offset of a joint without a bias along an axis, as a share of its prior's with one.
const UNBIASED_SHARE: f64 = 0.2;

/// A joint has a bias where that is this much likelier, as a logarithm: 20 to 1, strong evidence after Kass and Raftery (JASA 1995,
/// section 3.2). On realistic noise hips that are 40 mm too wide reach 0.3 to 18 (7 of 10 are above), without a bias -1.6 to 2.5;
/// shoulders without one reach 5.7 where many detections are missing.
const MIN_LOG_EVIDENCE: f64 = 3.0;

/// The offsets and their accuracy.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SessionBias {
    /// By kind, m.
    pub offsets: Vec<Vector3<f64>>,
    /// Standard deviations, m; that of the prior where nothing was observed.
    pub sigmas: Vec<Vector3<f64>>,
    /// Kinds of joints with a bias.
    pub biased: Vec<usize>,
    /// `-log p(session | biased)`, up to a constant.
    negative_log_evidence: f64,
}

/// The offsets with a bias of those joints for which the evidence is strong, added one by one.
pub(super) fn likeliest_bias(evidence: &ProportionEvidence, table: &OffsetTable) -> Option<SessionBias> {
    let mut found = under(evidence, table, &[])?;
    loop {
        let open = (0..table.kinds.len()).filter(|k| table.kinds[*k].can_be_biased && !found.biased.contains(k));
        let with = |k: usize| under(evidence, table, &[found.biased.as_slice(), &[k]].concat());
        let is_plausible =
            |bias: &SessionBias| bias.biased.iter().all(|&k| table.kinds[k].is_plausible(&bias.offsets[k]));
        let best = open
            .filter_map(with)
            .filter(is_plausible)
            .min_by(|a, b| a.negative_log_evidence.total_cmp(&b.negative_log_evidence));
        match best {
            Some(bias) if bias.negative_log_evidence < found.negative_log_evidence - MIN_LOG_EVIDENCE => found = bias,
            _ => return Some(found),
        }
    }
}

/// The offsets if the joints `biased` have a bias: the minimum of the cost with the priors that say so.
fn under(evidence: &ProportionEvidence, table: &OffsetTable, biased: &[usize]) -> Option<SessionBias> {
    let is_open = |k: usize, axis: usize| !table.kinds[k].is_joint || (axis == SIDEWAYS && biased.contains(&k));
    let share = |k: usize, axis: usize| if is_open(k, axis) { 1.0 } else { UNBIASED_SHARE };
    let precision = |role: &Role| match *role {
        Role::Shape => 0.0,
        Role::Bone => PROPORTION_SIGMA.powi(-2),
        Role::Offset(number) => {
            let (k, axis) = (number / 3, number % 3);
            (share(k, axis) * table.kinds[k].prior_sigma[axis]).powi(-2)
        }
    };
    let ProportionEvidence { hessian, right, place, roles } = evidence;
    let precision = DVector::from_iterator(roles.len(), roles.iter().map(precision));
    let mut with_prior = hessian.clone();
    with_prior.set_diagonal(&(hessian.diagonal() + &precision));
    let factor = with_prior.cholesky()?;
    let step = factor.solve(&(right - precision.component_mul(place)));
    let place = place + &step;
    let cost =
        0.5 * step.dot(&(hessian * &step)) - right.dot(&step) + 0.5 * place.dot(&precision.component_mul(&place));
    let log_prior: f64 = precision.iter().filter(|p| **p > 0.0).map(|p| 0.5 * p.ln()).sum();
    let variances = factor.inverse().diagonal();
    let first = roles.len() - 3 * table.kinds.len();
    let by_kind = |numbers: DVector<f64>| {
        (0..table.kinds.len()).map(|k| numbers.fixed_rows::<3>(first + 3 * k).into_owned()).collect()
    };
    Some(SessionBias {
        offsets: by_kind(place),
        sigmas: by_kind(variances.map(|variance| variance.max(0.0).sqrt())),
        biased: biased.to_vec(),
        negative_log_evidence: cost + half_log_det(&factor) - log_prior,
    })
}
