//! The step from the cameras at the least cost to the likeliest ones whatever the motions, and how sure they are.
//!
//! At the minimum over cameras c and motions m, the motions have adapted to the detector's errors, and cameras under which they adapt
//! more easily cost less. Where all cameras look from one side, errors go into depth, and depth moves the less for an error the wider the
//! angles between the views are: these come out too wide, and people too near (the nuisance parameters of Neyman and Scott 1948).
//! Integrated over the motions (Laplace; Tierney and Kadane 1986) the cost is
//!
//! `C(c, m(c)) + log |H_mm(c)| / 2`,
//!
//! and its minimum lies a Newton step of `-S^-1 g` away, with `S` the reduced Hessian of the cameras and
//!
//! `g = d/dc log |H_mm| / 2 = trace(H_mm^-1 dH_mm/dc) / 2`:
//!
//! the derivative of the variance that the motions' spread `H_mm^-1`, as it is, has in the innovations. What shapes bodies is not
//! integrated over: it is little against the motions.
//!
//! With focal lengths among the unknowns one step is not enough: see [`over_motions`](super::over_motions).
//!
//! Of the term [`SHARE`] counts. On 24 captures of cameras along a wall or on an arc of 30 to 80 degrees (realistic noise) people
//! had been 0.4 to 4.8 % of their distance too near, orientations 0.4 and 0.65 degrees off at 1.7 and 1.8 times the stated
//! deviation; now they are 0.22 and 0.52 off at 1.0 and 1.3 times. Cameras all around move by less than a tenth of their
//! errors.

use super::super::pixel_residuals::DetectedPixels;
use super::super::session_state::SessionState;
use super::super::terms::camera_unknowns::POSE;
use super::super::terms::whitened_pixels::spread::Spread;
use super::camera_covariance::CameraSpread;
use super::following::Following;
use super::{JointProblem, Member, Minimum, Reduced, Stopping, replace_all};
use crate::geometry::Rigid;
use crate::geometry::free_network::CameraCovariance;
use crate::progress::Canceled;
use nalgebra::{DVector, Matrix3, Matrix3xX, Vector3};
use rayon::prelude::*;

/// Share of the term that counts. All of it would if motions were drawn from the smoothness prior: they are smoother than that, and
/// errors alone leave a part of it. Measured over three kinds of noise (white; slow; slow with outliers, holes and ghosts) the bias is
/// 0.43, 0.33 and 0.43 of the whole step.
pub(super) const SHARE: f64 = 0.4;

/// Rise of the cost over the expected one beyond which a step is not taken, and a rise that never stops it: half of a squared
/// standard deviation, as the minimisation's last step.
const MAX_RISE: f64 = 3.0;
const ROUNDING: f64 = 0.5;

/// Parts of the step that are tried, the first one first.
const PARTS: [f64; 3] = [1.0, 0.5, 0.25];

impl JointProblem<'_> {
    /// [`Self::minimised`], then from the minimum of the cost to that of the cost over the cameras alone. Returns the covariance of the
    /// cameras' poses; `None` where the channels do not determine them.
    ///
    /// `slow`: autocorrelation of the errors from frame to frame.
    pub(in super::super) fn minimised_and_marginalised(
        &self,
        members: &mut [Member],
        stopping: &Stopping,
        slow: f64,
    ) -> Result<Option<CameraCovariance>, Canceled> {
        let (Minimum { session, .. }, reduced) = self.minimised_and_reduced(members, Vec::new(), stopping)?;
        let pixels: Vec<DetectedPixels> = members.iter().map(|member| self.pixels(member)).collect();
        // The normal equations of where the last step began, if that was short.
        let reduced = reduced.or_else(|| self.reduced((members, &pixels), &session, self.systems(members), 0.0));
        let Some(reduced) = reduced else { return Ok(None) };
        let following = self.following(&reduced, (members, &pixels));
        let spread = following.and_then(|following| {
            let gradient = self.spread_gradient(&reduced, (members, &pixels), &following)?;
            let spread = self.spread(&reduced, (members, &pixels), &following, slow);
            self.step_to_likeliest(&reduced, (members, &pixels), &gradient, &session);
            Some(spread?.with_uncertain_share(&gradient))
        });
        self.close(reduced, members);
        Ok(spread.and_then(|spread| self.covariance(members, &spread)))
    }

    /// The step along `gradient`, `g`, or the first part of it that the cost allows.
    fn step_to_likeliest(
        &self,
        reduced: &Reduced,
        (members, pixels): (&mut [Member], &[DetectedPixels]),
        gradient: &DVector<f64>,
        session: &SessionState,
    ) {
        let cost = self.costs(members, pixels, session).total();
        for part in PARTS {
            let to_likeliest = -part * SHARE * reduced.factor.solve(gradient);
            let expected_rise = -0.5 * part * SHARE * gradient.dot(&to_likeliest);
            let Some(step) = reduced.followed(to_likeliest) else { break };
            let (after, before) = self.stepped((members, pixels), session, &step);
            let rise = after.costs.total() - cost;
            tracing::debug!(part, rise, expected_rise, "step to the cameras whatever the motions");
            // Where the cost rises by far more than its curvature lets expect, the step leads out of where that holds.
            if rise <= MAX_RISE * expected_rise + ROUNDING {
                break;
            }
            replace_all(members, before, &session.cameras);
        }
    }

    /// Gives members their betas without bones, and the memory of the normal equations back.
    pub(super) fn close(&self, reduced: Reduced, members: &mut [Member]) {
        for (member, person) in members.iter_mut().zip(&reduced.people) {
            member.betas_alone = self.betas_alone(member, person);
        }
        self.context.systems.put_back(reduced.into_systems());
    }

    /// Covariance of the cameras' poses, which spread so.
    pub(in super::super) fn covariance(&self, members: &[Member], spread: &CameraSpread) -> Option<CameraCovariance> {
        let cameras = &members.first()?.observations.cameras;
        let n = self.camera_columns(cameras.len()).unknowns.len();
        let poses: Vec<usize> = (0..cameras.len()).flat_map(|camera| n * camera..n * camera + POSE).collect();
        let of_focal =
            self.cameras.and_then(|priors| Some((priors.precision_of_focal(cameras.len())?, priors.overcount)));
        let covariance = match of_focal {
            Some((precision, overcount)) => {
                spread.clone().with_uncertain_prior(&precision, overcount).covariance(&poses)
            }
            None => spread.covariance(&poses),
        };
        let cameras: Vec<Rigid> = cameras.iter().map(|camera| camera.camera_from_world).collect();
        CameraCovariance::new(cameras, covariance, &self.middle_of_people(members))
    }

    /// `g`, by the free directions of the session.
    pub(super) fn spread_gradient(
        &self,
        reduced: &Reduced,
        (members, pixels): (&[Member], &[DetectedPixels]),
        following: &[Following],
    ) -> Option<DVector<f64>> {
        let basis = reduced.basis.as_ref()?;
        let of_person = |((member, pixels), following): ((&Member, &DetectedPixels), &Following)| {
            let DetectedPixels::Correlated(over_time) = pixels else { return None };
            let movements = self.movements(basis, member, following);
            let cameras = &member.observations.cameras;
            Some(over_time.spread_gradient(cameras, &following.positions, &following.spreads(), &movements))
        };
        let of_people: Option<Vec<DVector<f64>>> =
            members.par_iter().zip(pixels).zip(following).map(of_person).collect();
        Some(of_people?.iter().fold(DVector::zeros(basis.ncols()), |sum, gradient| sum + gradient))
    }

    /// Mean position of all members' pelvises.
    fn middle_of_people(&self, members: &[Member]) -> Vector3<f64> {
        let (mut sum, mut n) = (Vector3::zeros(), 0);
        for Member { state, .. } in members {
            let pelvis_at_rest = self.context.model.shaped(&state.betas).rest_joints[0];
            sum += state.poses.iter().map(|pose| pelvis_at_rest + pose.translation).sum::<Vector3<f64>>();
            n += state.poses.len();
        }
        sum / n.max(1) as f64
    }
}

impl Following {
    /// How the landmarks spread under the errors of the motion. `[frame][observed landmark]`
    fn spreads(&self) -> Vec<Vec<Spread>> {
        let of_landmark = |t: usize, k: usize| {
            [0, 1, 2].map(|lag| {
                let own = &self.of_motion[t][k];
                let product = |later: &Vec<Matrix3xX<f64>>| &later[k] * own.transpose() / own.ncols() as f64;
                self.of_motion.get(t + lag).map_or_else(Matrix3::zeros, product)
            })
        };
        let of_frame = |t: usize| (0..self.of_motion[t].len()).map(|k| of_landmark(t, k)).collect();
        (0..self.of_motion.len()).into_par_iter().map(of_frame).collect()
    }
}
