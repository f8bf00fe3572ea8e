//! How far the focal lengths of cameras are from those given, and what a session shows of it.
//!
//! The logarithms `x` of the factors are normal: each camera has an error of its own, and all share one (cameras of one make with
//! one wrong data sheet), covariance `S = own^2 I + common^2 11^T`. Which standard deviations a session's lenses have is not known
//! before: they are those under which the session is likeliest (empirical Bayes; Morris 1983, JASA 78:47). Lenses that are as
//! given then stay there, and those that are not move as far as the session shows. One camera alone may have an error of its own
//! size: one lens that was exchanged or zoomed leaves the others as they were.

use crate::optim::determinant::half_log_det;
use crate::pipeline::calibration::FocalEstimate;
use nalgebra::{DMatrix, DVector};

/// Standard deviations of the logarithms of focal factors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FocalSpread {
    /// Of each camera's own error.
    pub own: f64,
    /// Of the error that all cameras share.
    pub common: f64,
    /// The one camera whose own error is of another size.
    pub odd: Option<OddLens>,
}

/// One camera that differs from all others.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OddLens {
    /// Position among the cameras.
    pub camera: usize,
    /// Standard deviation of its own error, in place of [`FocalSpread::own`].
    pub own: f64,
}

/// A checkerboard (0.3 %), the same after refocusing (1 %), an image file's rounded length (3 %), a guessed angle of view (10 %).
const LEVELS: [f64; 4] = [0.003, 0.01, 0.03, 0.1];

/// Logarithm of the likelihood ratio from which focal lengths are taken as other than given: 3,000 to 1. Right lenses reach 0.4 on
/// realistic noise, but 4 to 7 on real detections, whose errors are not all in the model.
pub const MIN_LOG_EVIDENCE: f64 = 8.0;

/// The same where errors of 10 % are likelier than all smaller ones, 20 to 1 (strong evidence by Kass and Raftery): what is not in
/// the model looks like errors of 1 to 3 %, on real detections too, where those of 10 % gain nothing over them. Lenses that are each
/// 10 % off reach 3.5 to 7 with three cameras where people show little, and 10 to 80 else.
const MIN_LOG_EVIDENCE_OF_TENTHS: f64 = 3.0;

/// The same for 10 % of one camera alone, 150 to 1 (very strong evidence by Kass and Raftery, JASA 1995, section 3.2): it is one of as
/// many as there are cameras. With 8 two of six lenses that were 10 % off stayed; with 5 for 3 % of one camera, too, right lenses of
/// real detections moved by 1 to 3 % (5.7).
const MIN_LOG_EVIDENCE_OF_A_TENTH: f64 = 5.0;

/// How many times bundle adjustment counts what it shows of lenses: constant errors of the detector are in none of its
/// blocks. On realistic noise the mean square error of the factors is 13 times their stated variance with three cameras, twice
/// with five, 6 times over all of them.
pub const OVERCOUNT: f64 = 6.0;

impl FocalSpread {
    /// Nothing is known beside the order of magnitude.
    pub const WIDE: Self = Self::alike(LEVELS[3], LEVELS[3]);

    /// Lenses of which nothing is known share much: cameras are often of one make, and angles of view below 25 and above 100
    /// degrees are rare.
    pub const UNKNOWN: Self = Self::alike(0.3, 0.5);

    /// Focal lengths as given.
    pub const CALIBRATED: Self = Self::alike(LEVELS[0], LEVELS[0]);

    /// Own errors of all cameras of one size.
    pub const fn alike(own: f64, common: f64) -> Self {
        Self { own, common, odd: None }
    }

    /// The spreads of `n` cameras that are compared.
    fn all(n: usize) -> impl Iterator<Item = Self> {
        let alike = LEVELS.into_iter().flat_map(|own| LEVELS.into_iter().map(move |common| Self::alike(own, common)));
        let odd = (0..n).flat_map(|camera| LEVELS[2..].iter().map(move |&own| OddLens { camera, own }));
        let beside =
            |odd: OddLens| LEVELS[..2].iter().map(move |&own| Self { own, odd: Some(odd), ..Self::CALIBRATED });
        alike.chain(odd.flat_map(beside))
    }

    /// Variance of each camera's own error, the diagonal `D` of `S = D + common^2 11^T`.
    fn own_variances(&self, n: usize) -> DVector<f64> {
        let own = |camera| self.odd.filter(|odd| odd.camera == camera).map_or(self.own, |odd| odd.own);
        DVector::from_fn(n, |camera, _| own(camera).powi(2))
    }

    /// `S^-1 = D^-1 - common^2 D^-1 11^T D^-1 / (1 + common^2 1^T D^-1 1)`.
    pub fn precision(&self, n: usize) -> DMatrix<f64> {
        let own = self.own_variances(n).map(f64::recip);
        let common = self.common.powi(2);
        DMatrix::from_diagonal(&own) - &own * own.transpose() * (common / (1.0 + common * own.sum()))
    }

    /// `log |S| / 2`.
    fn half_log_det(&self, n: usize) -> f64 {
        let own = self.own_variances(n);
        0.5 * (own.map(f64::ln).sum() + (1.0 + self.common.powi(2) * own.map(f64::recip).sum()).ln())
    }

    /// The likeliest of lenses of which nothing is known: how much they differ from each other is open, but by 3 % at least; how
    /// long they are is always [`Self::UNKNOWN`]. Where a session shows little, lenses that are exactly alike would be likeliest,
    /// and on simulated rigs of lenses that differ by 3 % one error in four was then above three standard deviations.
    pub fn likeliest_of_unknown(found: &FoundFactors) -> (Self, f64) {
        let calibrated = found.log_evidence(Self::CALIBRATED);
        let spreads =
            [LEVELS[2], LEVELS[3], Self::UNKNOWN.own].map(|own| Self::alike(own, Self::UNKNOWN.common)).into_iter();
        spreads
            .map(|spread| (spread, found.log_evidence(spread) - calibrated))
            .fold((Self::UNKNOWN, f64::NEG_INFINITY), |best, next| if next.1 > best.1 { next } else { best })
    }

    /// From which lenses are taken to spread so.
    fn min_log_evidence(self) -> f64 {
        let is_tenths = |sigma: f64| sigma >= LEVELS[3];
        match self.odd {
            Some(odd) if is_tenths(odd.own) => MIN_LOG_EVIDENCE_OF_A_TENTH,
            None if is_tenths(self.own.max(self.common)) => MIN_LOG_EVIDENCE_OF_TENTHS,
            _ => MIN_LOG_EVIDENCE,
        }
    }

    /// The likeliest where it is clearly likelier than [`Self::CALIBRATED`], which else it is, and the largest logarithm of a
    /// likelihood over that of the latter.
    pub fn likeliest(found: &FoundFactors) -> (Self, f64) {
        let evidence = |spread: Self| found.log_evidence(spread);
        let calibrated = evidence(Self::CALIBRATED);
        let (spread, log_evidence) = Self::all(found.linear.len())
            .map(|spread| (spread, evidence(spread) - calibrated))
            .fold((Self::CALIBRATED, 0.0), |best, next| if next.1 > best.1 { next } else { best });
        let needed = spread.min_log_evidence();
        (if log_evidence < needed { Self::CALIBRATED } else { spread }, log_evidence)
    }
}

/// What a session shows of the logarithms: their likelihood `exp(-x^T A x / 2 + b^T x)` up to a factor.
#[derive(Debug, Clone)]
pub struct FoundFactors {
    information: DMatrix<f64>,
    linear: DVector<f64>,
}

impl FoundFactors {
    /// From the minimum of a problem with a prior of this `precision`, and what its unknowns scatter by; `None` for a matrix that is
    /// not positive definite.
    ///
    /// With `H` the Hessian, `A = H - P` without the prior, and `S = H C H` the covariance of the gradient, the minimum without the
    /// prior is `A^-1 H x`, of covariance `A^-1 S A^-1`.
    pub fn new(
        mean: &DVector<f64>,
        inverse_hessian: &DMatrix<f64>,
        covariance: &DMatrix<f64>,
        precision: &DMatrix<f64>,
    ) -> Option<Self> {
        let hessian = inverse_hessian.clone().cholesky()?.inverse();
        let mut shown = (&hessian - precision).symmetric_eigen();
        shown.eigenvalues.iter_mut().for_each(|value| *value = value.max(0.0));
        let shown = shown.recompose();
        let weighted = &shown * (&hessian * covariance * &hessian).cholesky()?.inverse();
        Some(Self { information: &weighted * &shown, linear: weighted * (hessian * mean) })
    }

    /// From a bundle adjustment with independent priors of standard deviation `prior_sigma`, begun at factors of logarithm
    /// `origin(view)`; `None` for a covariance that is none.
    pub fn of_adjustment(estimate: &FocalEstimate, origin: impl Fn(usize) -> f64, prior_sigma: f64) -> Option<Self> {
        let n = estimate.views.len();
        let covariance = DMatrix::from_fn(n, n, |i, j| estimate.covariance[i][j]);
        let prior = FocalSpread::alike(prior_sigma, 0.0);
        let increments = DVector::from_column_slice(&estimate.log_factors);
        let found = Self::new(&increments, &covariance, &(&covariance * OVERCOUNT), &prior.precision(n))?;
        Some(found.shifted(&DVector::from_iterator(n, estimate.views.iter().map(|&view| origin(view)))))
    }

    /// How many times a problem with a prior of this `precision` counts what the session shows: the information that it has of it over
    /// this, `tr(H^-1 A) / tr(H^-1 A S^-1 A)`, in the directions that the session shows rather than the prior.
    pub fn overcount(&self, inverse_hessian: &DMatrix<f64>, precision: &DMatrix<f64>) -> f64 {
        let n_shown = self.linear.len() as f64 - (inverse_hessian * precision).trace();
        (n_shown / (inverse_hessian * &self.information).trace()).max(1.0)
    }

    /// Of `x + origin`, if these were of `x`.
    pub fn shifted(mut self, origin: &DVector<f64>) -> Self {
        self.linear += &self.information * origin;
        self
    }

    /// Mean and covariance under a prior.
    pub fn under(&self, spread: FocalSpread) -> Option<(DVector<f64>, DMatrix<f64>)> {
        let posterior = (&self.information + spread.precision(self.linear.len())).cholesky()?;
        Some((posterior.solve(&self.linear), posterior.inverse()))
    }

    /// Logarithm of the session's likelihood under lenses whose factors have these logarithms, each but for the errors of a
    /// calibration, over that under lenses as given.
    pub fn log_evidence_of(&self, log_factors: &DVector<f64>) -> f64 {
        let at_factors = self.linear.dot(log_factors) - 0.5 * log_factors.dot(&(&self.information * log_factors));
        let around = self.clone().shifted(&-log_factors).log_evidence(FocalSpread::CALIBRATED);
        at_factors + around - self.log_evidence(FocalSpread::CALIBRATED)
    }

    /// Logarithm of the session's likelihood under a prior, up to a constant: `b^T (A + S^-1)^-1 b / 2 - log |A + S^-1| / 2 -
    /// log |S| / 2`.
    fn log_evidence(&self, spread: FocalSpread) -> f64 {
        let n = self.linear.len();
        (&self.information + spread.precision(n)).cholesky().map_or(f64::NEG_INFINITY, |posterior| {
            0.5 * self.linear.dot(&posterior.solve(&self.linear)) - half_log_det(&posterior) - spread.half_log_det(n)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As if each factor had been measured to 1 %, independent of the others.
    fn found(log_factors: &[f64]) -> FoundFactors {
        let n = log_factors.len();
        let information = DMatrix::identity(n, n) / 0.01f64.powi(2);
        FoundFactors { linear: &information * DVector::from_column_slice(log_factors), information }
    }

    #[test]
    fn precision_and_determinant_are_those_of_the_covariance() {
        let spread = FocalSpread { odd: Some(OddLens { camera: 1, own: 0.2 }), ..FocalSpread::alike(0.03, 0.1) };
        let own = [0.0009, 0.04, 0.0009, 0.0009];
        let covariance = DMatrix::from_fn(4, 4, |i, j| 0.01 + if i == j { own[i] } else { 0.0 });
        assert!((spread.precision(4) * &covariance - DMatrix::identity(4, 4)).amax() < 1e-9);
        assert!((half_log_det(&covariance.cholesky().unwrap()) - spread.half_log_det(4)).abs() < 1e-9);
    }

    #[test]
    fn overcount_is_the_ratio_of_scatter_and_hessian() {
        let inverse_hessian = DMatrix::from_diagonal(&DVector::from_column_slice(&[1e-4, 4e-4]));
        let shown = |prior: &DMatrix<f64>| {
            let information = inverse_hessian.clone().cholesky().unwrap().inverse() - prior;
            let covariance = &inverse_hessian * information * &inverse_hessian * 7.0;
            let found = FoundFactors::new(&DVector::zeros(2), &inverse_hessian, &covariance, prior).unwrap();
            found.overcount(&inverse_hessian, prior)
        };
        assert!((shown(&DMatrix::zeros(2, 2)) - 7.0).abs() < 1e-9);
        // What a prior determines is not what the session shows.
        let prior = DMatrix::from_diagonal(&DVector::from_column_slice(&[5e3, 500.0]));
        assert!((shown(&prior) - 7.0).abs() < 1e-9);
    }

    /// Errors of the size of their standard deviations are no reason to move.
    #[test]
    fn lenses_as_given_stay() {
        let (spread, log_evidence) = FocalSpread::likeliest(&found(&[0.01, -0.008, 0.005, -0.011]));
        assert_eq!((spread, log_evidence), (FocalSpread::CALIBRATED, 0.0));
        let (mean, _) = found(&[0.01, -0.008, 0.005, -0.011]).under(spread).unwrap();
        assert!(mean.amax() < 0.002, "{mean}");
    }

    /// On three cameras with right lenses a likelihood ratio of 1.1 made cameras 1.7 times worse.
    #[test]
    fn weak_evidence_does_not_move_lenses() {
        let (spread, log_evidence) = FocalSpread::likeliest(&found(&[0.016, -0.017, 0.012]));
        assert!(log_evidence > 0.0 && log_evidence < MIN_LOG_EVIDENCE, "{log_evidence}");
        assert_eq!(spread, FocalSpread::CALIBRATED);
    }

    /// Right lenses of real detections moved, and cameras by 30 mm: 3 % of one lens needed less than errors of all lenses.
    #[test]
    fn a_small_error_of_one_lens_needs_as_much_as_those_of_all() {
        let information = DMatrix::identity(5, 5) / 0.0085f64.powi(2);
        let off = DVector::from_vec(vec![0.004, -0.009, -0.038, -0.006, 0.002]);
        let shown = FoundFactors { linear: &information * off, information };
        let (spread, log_evidence) = FocalSpread::likeliest(&shown);
        assert!((5.0..8.0).contains(&log_evidence), "{log_evidence}");
        assert_eq!(spread, FocalSpread::CALIBRATED);
    }

    /// Three lenses that were each 10 % off, shown to 5 %, stayed as given by the bar that small errors need.
    #[test]
    fn lenses_that_are_far_off_move_by_less_evidence() {
        let information = DMatrix::identity(3, 3) / 0.045f64.powi(2);
        let shown = FoundFactors { linear: &information * DVector::from_vec(vec![0.11, -0.1, 0.12]), information };
        let (spread, log_evidence) = FocalSpread::likeliest(&shown);
        assert!((3.0..8.0).contains(&log_evidence), "{log_evidence}");
        assert_eq!(spread.own, 0.1);
    }

    #[test]
    fn wrong_lenses_move_as_far_as_is_shown() {
        let off = [0.1, -0.08, 0.05, -0.11];
        let (spread, log_evidence) = FocalSpread::likeliest(&found(&off));
        assert!(spread.own == 0.1 && log_evidence > 50.0, "{spread:?}, {log_evidence}");
        let (mean, covariance) = found(&off).under(spread).unwrap();
        // Of 10 % and a measurement to 1 % a hundredth is lost.
        assert!((mean - DVector::from_column_slice(&off)).amax() < 0.002);
        assert!((covariance[(0, 0)].sqrt() - 0.00995).abs() < 1e-4);
    }

    /// With one spread for all, three right lenses moved by 1 to 3 % beside one that was 10 % off.
    #[test]
    fn one_wrong_lens_leaves_the_others() {
        let (spread, log_evidence) = FocalSpread::likeliest(&found(&[0.008, -0.006, 0.105, -0.01]));
        assert_eq!(spread.odd, Some(OddLens { camera: 2, own: 0.1 }));
        assert!(log_evidence > 20.0, "{log_evidence}");
        let (mean, _) = found(&[0.008, -0.006, 0.105, -0.01]).under(spread).unwrap();
        assert!(mean[2] > 0.1 && [0, 1, 3].iter().all(|&k| mean[k].abs() < 0.003), "{mean}");
    }

    #[test]
    fn an_error_that_all_lenses_share_is_one_error() {
        let (spread, _) = FocalSpread::likeliest(&found(&[0.098, 0.103, 0.101, 0.097]));
        assert_eq!(spread, FocalSpread::alike(0.003, 0.1));
    }

    /// Lenses of 1.5 guessed lengths, of which the session shows the mean well and the differences hardly.
    #[test]
    fn unknown_lenses_may_differ_where_little_is_shown() {
        let n = 3;
        let information = DMatrix::from_element(n, n, 1e4 / 3.0) + DMatrix::identity(n, n) * 100.0;
        let shown = FoundFactors { linear: &information * DVector::from_element(n, 0.4), information };
        let (spread, _) = FocalSpread::likeliest_of_unknown(&shown);
        assert_eq!(spread, FocalSpread::alike(0.03, 0.5));
        let (mean, covariance) = shown.under(spread).unwrap();
        assert!((mean[0] - 0.4).abs() < 0.01 && covariance[(0, 0)].sqrt() > 0.02, "{mean}");
    }

    /// Measured to 1 %, lenses that are 5 % off as stated are likelier than those given by `(0.05 / 0.01)^2 / 2` each, a little less
    /// for their own 0.3 %.
    #[test]
    fn named_factors_are_compared_with_the_given_lenses() {
        let off = DVector::from_column_slice(&[0.05, -0.05, 0.0]);
        let shown = found(off.as_slice());
        assert!((shown.log_evidence_of(&off) - 25.0).abs() < 5.0, "{}", shown.log_evidence_of(&off));
        assert!(shown.log_evidence_of(&-&off) < -50.0);
        assert!(shown.log_evidence_of(&DVector::zeros(3)).abs() < 1e-9);
        assert!(found(&[0.0; 3]).log_evidence_of(&off) < -15.0);
    }

    /// What a session shows does not depend on the prior under which it was solved, nor on where the unknowns began.
    #[test]
    fn the_prior_of_the_solution_does_not_count_twice() {
        let shown = found(&[0.02, -0.04, 0.01]);
        for spread in [FocalSpread::WIDE, FocalSpread::alike(0.01, 0.03)] {
            let (mean, inverse_hessian) = shown.under(spread).unwrap();
            for overcount in [1.0, 5.0] {
                let scatter = &inverse_hessian * &shown.information * &inverse_hessian * overcount;
                let again = FoundFactors::new(&mean, &inverse_hessian, &scatter, &spread.precision(3)).unwrap();
                assert!((again.information * overcount / 1e4 - DMatrix::identity(3, 3)).amax() < 1e-6);
                assert!((again.linear * overcount - &shown.linear).amax() < 1e-6 * shown.linear.amax());
            }
        }
        let origin = DVector::from_column_slice(&[0.1, 0.1, 0.0]);
        let moved = found(&[-0.08, -0.14, 0.01]).shifted(&origin);
        assert!((moved.linear - shown.linear).amax() < 1e-9);
    }
}
