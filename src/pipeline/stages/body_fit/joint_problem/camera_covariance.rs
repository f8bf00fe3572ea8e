//! Covariance of the cameras, from the spread of what the detector's channels ask of them.
//!
//! The inverse Hessian of the joint problem takes the detector's errors for the process that whitens them. Real errors are
//! slower and partly constant, so that it is too small by a factor of up to 5. What holds whatever the errors' course in time is
//! the sandwich (Huber 1967; Liang and Zeger 1986)
//!
//! `H^-1 (sum_c s_c s_c^T) H^-1`, `s_c = sum_t (J_cameras + J_motion X)_t^T W e_t`
//!
//! over channels c (a person's landmark in a view, either axis of the image): `s_c` is the channel's part in the gradient after
//! elimination of the motions, which follow the cameras by `X = -H_mm^-1 H_mc`. `H` has second derivatives of the robust cost where the
//! normal equations have its weights, which are a fifth larger: with those, orientations of the presets' noise were 1.1 to 1.2 times
//! as far off as stated. Residuals are smaller than the errors, and two factors make up for it:
//!
//! - one over what the unknowns leave of errors as the channels have them
//!   ([`unabsorbed`](super::super::terms::whitened_pixels::WhitenedPixels::unabsorbed)), 0.6 to 0.8 with the usual cameras. Motions follow
//!   slow errors; but cameras, too, show what is slow of errors that change from frame to frame;
//! - what landmarks of one region share ([`shared_error_variance`]): cameras and motions follow it, so that hardly any of it is left in
//!   the residuals.
//!
//! Given poses and focal lengths err as well, by their standard deviations: the gradient of their prior, precision P counted c times, has the
//! variance `c^2 P`. That of focal lengths counts for the poses alone: what the session shows of these lengths stands apart from their prior. Cameras of 10 captures (`extrinsics: refine`) are 1.19 and 1.10 times their stated deviations off. So does the step to the
//! cameras whatever the motions ([`marginal_step`](super::marginal_step)), along its own direction.

use super::super::pixel_residuals::{DetectedPixels, shared_error_variance};
use super::super::session_state::SessionState;
use super::super::terms::whitened_pixels::scores::Movements;
use super::following::{Following, N_SAMPLES};
use super::{JointProblem, Member, Reduced, cameras_of};
use crate::optim::robust::Curvature;
use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Correlation of slow errors of two landmarks of a region: the mean of a region on real detections (docs/method.md 15; 0.38 for the hips,
/// 0.49 for nose and eyes). The cameras' errors are 0.8 times as stated on realistic noise, 0.85 to 1.0 on the presets' and 1.1 to 1.3
/// on Shelf, whose published cameras err as well.
const SHARED: f64 = 0.2;

/// Least share of the errors that is taken to be left in a person's residuals: less would be of keypoints that scarcely determine the
/// person.
const MIN_UNABSORBED: f64 = 0.1;

/// Standard deviation, from recording to recording, of the share of the motions' spread that counts: half of it, so that from none to twice
/// the share is within two of them. It counts where the step over the motions is long: of the ten pairs of Shelf's cameras that is 0.3 to 16
/// standard deviations of the normal equations long, of six more than 4. Without it orientations of these pairs were 3.0 times as far off as stated, with it 1.9 times; a share of 0.7 would fit
/// them best. Of simulated pairs it is at most 1 long.
const SHARE_SIGMA: f64 = 0.2;

impl JointProblem<'_> {
    /// At the minimum, whose betas without bones members get; the cameras are the only unknowns of the session. `None` where the channels do not determine them.
    ///
    /// `slow`: autocorrelation of the errors from frame to frame.
    pub(in super::super) fn spread_of_cameras(&self, members: &mut [Member], slow: f64) -> Option<CameraSpread> {
        let pixels: Vec<DetectedPixels> = members.iter().map(|member| self.pixels(member)).collect();
        let session = SessionState { offsets: Vec::new(), cameras: cameras_of(members) };
        let reduced = self.reduced((members, &pixels), &session, self.systems(members), 0.0)?;
        let following = self.following(&reduced, (members, &pixels));
        let found = following.and_then(|following| {
            let gradient = self.spread_gradient(&reduced, (members, &pixels), &following)?;
            Some(self.spread(&reduced, (members, &pixels), &following, slow)?.with_uncertain_share(&gradient))
        });
        self.close(reduced, members);
        found
    }

    /// [`Self::spread_of_cameras`] of a system that is reduced already.
    pub(super) fn spread(
        &self,
        reduced: &Reduced,
        (members, pixels): (&[Member], &[DetectedPixels]),
        following: &[Following],
        slow: f64,
    ) -> Option<CameraSpread> {
        let basis = reduced.basis.as_ref()?;
        let n_free = basis.ncols();
        let (mut spread, mut n_channels) = (DMatrix::zeros(n_free, n_free), 0);
        let mut curvature = Curvature::default();
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let [directions, draws] =
            [reduced.session_draws(N_SAMPLES, &mut rng)?, reduced.session_draws(N_SAMPLES, &mut rng)?];
        let scores_of = |((member, pixels), following)| {
            self.scores(basis, [&directions, &draws], (member, pixels), following, slow)
        };
        let scores = members.par_iter().zip(pixels).zip(following).map(scores_of).collect::<Option<Vec<_>>>()?;
        for PersonScores { channels, curvature: of_person, design, unabsorbed } in scores {
            n_channels += channels.len();
            curvature = curvature.and(of_person);
            channels.iter().for_each(|score| spread.ger(design / unabsorbed, score, score, 1.0));
        }
        if n_channels <= n_free {
            return None;
        }
        let n_cameras = members.first()?.observations.cameras.len();
        let of_priors = self.cameras.map(|priors| basis.tr_mul(&(priors.precision(n_cameras) * basis)));
        let curvature_per_weight = curvature.per_weight();
        let inverse_hessian = reduced.inverse_hessian(curvature_per_weight, of_priors.as_ref())?;
        let found = CameraSpread { basis: basis.clone(), inverse_hessian, curvature_per_weight, scores: spread };
        let of_poses = self.cameras.and_then(|priors| Some((priors.precisions_of_poses(n_cameras)?, priors.overcount)));
        Some(match of_poses {
            Some((of_poses, overcount)) => found.with_uncertain_prior(&of_poses, overcount),
            None => found,
        })
    }

    /// Scores of one person's channels by the free directions of the session.
    fn scores(
        &self,
        basis: &DMatrix<f64>,
        [directions, draws]: [&DMatrix<f64>; 2],
        (member, pixels): (&Member, &DetectedPixels),
        following: &Following,
        slow: f64,
    ) -> Option<PersonScores> {
        let DetectedPixels::Correlated(over_time) = pixels else { return None };
        let movements = self.movements(basis, member, following);
        let (cameras, positions) = (&member.observations.cameras, &following.positions);
        let curvature = over_time.curvature(cameras, positions);
        let channels = over_time.scores(cameras, positions, &movements);
        let of_landmarks = [following.along(directions), following.drawn(draws)];
        let of_cameras = [basis * directions, basis * draws];
        let [directions, draws] =
            [0, 1].map(|k| Movements { landmarks: &of_landmarks[k], cameras: &of_cameras[k], ..movements });
        let unabsorbed = over_time.unabsorbed((cameras, positions), &directions, &draws).max(MIN_UNABSORBED);
        let design = shared_error_variance(over_time.landmarks.len(), SHARED * slow);
        tracing::debug!(unabsorbed, design, "a person's errors in the residuals");
        Some(PersonScores { channels, curvature, design, unabsorbed })
    }

    /// By the free directions of the session.
    pub(super) fn movements<'b>(
        &self,
        basis: &'b DMatrix<f64>,
        member: &Member,
        following: &'b Following,
    ) -> Movements<'b> {
        let of_camera = self.camera_columns(member.observations.cameras.len()).unknowns;
        Movements { landmarks: &following.movements, cameras: basis, of_camera }
    }
}

/// How far the cameras may be from where they are, in the free directions of the session.
#[derive(Clone)]
pub(in super::super) struct CameraSpread {
    /// Of the cameras' unknowns by the free directions.
    basis: DMatrix<f64>,
    inverse_hessian: DMatrix<f64>,
    /// The Hessian of what is seen over the normal equations.
    pub(in super::super) curvature_per_weight: f64,
    /// Covariance of the gradient.
    scores: DMatrix<f64>,
}

impl CameraSpread {
    /// The same where the share of the motions' spread that counts is uncertain by [`SHARE_SIGMA`].
    ///
    /// `gradient`: of all of it ([`JointProblem::spread_gradient`]), by the free directions.
    pub(super) fn with_uncertain_share(mut self, gradient: &DVector<f64>) -> Self {
        self.scores.ger(SHARE_SIGMA * SHARE_SIGMA, gradient, gradient, 1.0);
        self
    }

    /// The same with the errors of what is given of the cameras' unknowns. `precision`: of the prior, counted `overcount` times.
    pub(super) fn with_uncertain_prior(mut self, precision: &DMatrix<f64>, overcount: f64) -> Self {
        self.scores += self.basis.tr_mul(&(precision * &self.basis)) * overcount;
        self
    }

    /// Of some of the cameras' unknowns.
    pub(in super::super) fn covariance(&self, unknowns: &[usize]) -> DMatrix<f64> {
        let inverse = self.basis.select_rows(unknowns) * &self.inverse_hessian;
        &inverse * &self.scores * inverse.transpose()
    }

    /// The same if the detector's errors were as the joint problem takes them.
    pub(in super::super) fn inverse_hessian(&self, unknowns: &[usize]) -> DMatrix<f64> {
        let by_free = self.basis.select_rows(unknowns);
        &by_free * &self.inverse_hessian * by_free.transpose()
    }
}

/// What one person's channels ask of the cameras.
struct PersonScores {
    channels: Vec<DVector<f64>>,
    curvature: Curvature,
    /// Variance of a sum of the errors over that of as many independent ones.
    design: f64,
    /// Share of the errors' variance, as the session's directions show it, that the unknowns leave in the residuals.
    unabsorbed: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cameras that see people from opposite sides were 3 times as far off as stated: how far motions follow errors, which moves
    /// such cameras by many standard deviations, was taken for known.
    #[test]
    fn an_uncertain_share_spreads_cameras_along_its_step() {
        let vector = |values: [f64; 3]| DVector::from_column_slice(&values);
        let spread = CameraSpread {
            basis: DMatrix::identity(3, 3),
            inverse_hessian: DMatrix::from_diagonal(&vector([4.0, 1.0, 0.5])),
            curvature_per_weight: 1.0,
            scores: DMatrix::from_diagonal(&vector([0.25, 1.0, 2.0])),
        };
        let before = spread.covariance(&[0, 1, 2]);
        let after = spread.with_uncertain_share(&vector([1.0, -2.0, 0.0])).covariance(&[0, 1, 2]);
        let step = vector([4.0, -2.0, 0.0]) * SHARE_SIGMA;
        assert!((after - before - &step * step.transpose()).norm() < 1e-12);
    }
}
