//! Covariance of the cameras, from the spread of what the detector's channels ask of them.
//!
//! The inverse Hessian of the joint problem takes the detector's errors for the process that whitens them. Real errors are
//! slower and partly constant, so that it is too small by a factor of up to 5. What holds whatever the errors' course in time is
//! the sandwich (Huber 1967; Liang and Zeger 1986)
//!
//! `H^-1 (sum_c s_c s_c^T) H^-1`, `s_c = sum_t (J_cameras + J_motion X)_t^T W e_t`
//!
//! over channels c (a person's landmark in a view, either axis of the image): `s_c` is the channel's part in the gradient after
//! elimination of the motions, which follow the cameras by `X = -H_mm^-1 H_mc`. Residuals are smaller than the errors, and three
//! factors make up for it:
//!
//! - `C / (C - k)` for the k directions of the cameras that C independent channels determine (the first order of MacKinnon and
//!   White 1985), as many as there are over the design effect;
//! - `1 + rho p / (n - p)` for a person's n equations a frame: a motion of p unknowns a frame follows errors that are as slow as it,
//!   of which it leaves `(n - p) / n`, but not those that change from frame to frame;
//! - what landmarks of one region share ([`shared_error_variance`]): cameras and motions follow it, so that hardly any of it is left in
//!   the residuals.

use super::super::pixel_residuals::{DetectedPixels, shared_error_variance, variance_per_residual};
use super::super::session_state::SessionState;
use super::super::terms::camera_unknowns::POSE;
use super::super::terms::whitened_pixels::Positions;
use super::super::terms::whitened_pixels::scores::Movements;
use super::super::terms::window::TrackedLandmark;
use super::{JointProblem, Member, Reduced, with_bones};
use crate::geometry::free_network::CameraCovariance;
use nalgebra::{DMatrix, DVector, Matrix3xX, Vector3};
use rayon::prelude::*;

impl JointProblem<'_> {
    /// Of the poses, at the minimum; see [`Self::spread_of_cameras`].
    pub(in super::super) fn camera_covariance(&self, members: &[Member], slow: f64) -> Option<CameraCovariance> {
        let cameras = &members.first()?.observations.cameras;
        let n = self.camera_columns(cameras.len()).unknowns.len();
        let poses: Vec<usize> = (0..cameras.len()).flat_map(|camera| n * camera..n * camera + POSE).collect();
        let covariance = self.spread_of_cameras(members, slow)?.covariance(&poses);
        let cameras = cameras.iter().map(|camera| camera.camera_from_world).collect();
        CameraCovariance::new(cameras, covariance, &self.middle_of_people(members))
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

    /// At the minimum; the cameras are the only unknowns of the session. `None` where the channels do not determine them.
    ///
    /// `slow`: autocorrelation of the errors from frame to frame.
    pub(in super::super) fn spread_of_cameras(&self, members: &[Member], slow: f64) -> Option<CameraSpread> {
        let cameras = &members.first()?.observations.cameras;
        let pixels: Vec<DetectedPixels> = members.iter().map(|member| self.pixels(member)).collect();
        let session = SessionState { offsets: Vec::new(), cameras: cameras.clone() };
        let reduced = self.reduced((members, &pixels), &session, self.systems(members), 0.0)?;
        let basis = reduced.basis.as_ref()?;
        let n_free = basis.ncols();
        let (mut spread, mut n_independent) = (DMatrix::zeros(n_free, n_free), 0.0);
        let scores_of = |(person, of_member)| self.scores(&reduced, person, of_member, slow);
        let scores = members.par_iter().zip(&pixels).enumerate().map(scores_of).collect::<Option<Vec<_>>>()?;
        for PersonScores { channels, design, followed } in scores {
            n_independent += channels.len() as f64 / design;
            channels.iter().for_each(|score| spread.ger(design * followed, score, score, 1.0));
        }
        let n_left = n_independent - n_free as f64;
        if n_left <= 0.0 {
            return None;
        }
        spread *= n_independent / n_left;
        let found = CameraSpread { basis: basis.clone(), inverse_hessian: reduced.factor.inverse(), scores: spread };
        self.context.systems.put_back(reduced.into_systems());
        Some(found)
    }

    /// Scores of one person's channels by the free directions of the session.
    fn scores(
        &self,
        reduced: &Reduced,
        person: usize,
        (member, pixels): (&Member, &DetectedPixels),
        slow: f64,
    ) -> Option<PersonScores> {
        let (DetectedPixels::Correlated(over_time), Some(basis)) = (pixels, &reduced.basis) else { return None };
        let model = with_bones(self.context.model, &member.bones);
        let problem = self.problem(&model, member, pixels);
        let paths = problem.linearised_paths(&member.state);
        let landmarks = reduced.landmark_movements(person, basis, &paths);
        let positions = positions_of(&paths);
        let of_camera = self.camera_columns(member.observations.cameras.len()).unknowns;
        let movements = Movements { landmarks: &landmarks, cameras: basis, of_camera };
        let channels = over_time.scores(&member.observations.cameras, &positions, &movements);
        let n_unknowns = (3 * problem.unknowns.n_groups()) as f64;
        let of_slow = variance_per_residual(member.observations.equations_per_frame(), n_unknowns);
        let followed = 1.0 + slow * (of_slow - 1.0);
        let design = shared_error_variance(over_time.landmarks.len(), slow);
        Some(PersonScores { channels, design, followed })
    }
}

/// How far the cameras may be from where they are, in the free directions of the session.
pub(in super::super) struct CameraSpread {
    /// Of the cameras' unknowns by the free directions.
    basis: DMatrix<f64>,
    inverse_hessian: DMatrix<f64>,
    /// Covariance of the gradient.
    scores: DMatrix<f64>,
}

impl CameraSpread {
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
    /// Variance of a sum of the errors over that of as many independent ones.
    design: f64,
    /// Variance of the errors over that of the residuals that the motion leaves of them.
    followed: f64,
}

/// World positions of the landmarks.
pub(super) fn positions_of(paths: &[Vec<TrackedLandmark>]) -> Positions {
    paths.iter().map(|frame| frame.iter().map(|landmark| landmark.position).collect()).collect()
}

impl Reduced {
    /// Movement of a person's landmarks per unit of each free direction of the session, which the person follows.
    /// `[frame][observed landmark]`
    pub(super) fn landmark_movements(
        &self,
        person: usize,
        basis: &DMatrix<f64>,
        paths: &[Vec<TrackedLandmark>],
    ) -> Vec<Vec<Matrix3xX<f64>>> {
        let (own, frames) = self.responses(person, basis);
        let movement = |t: usize, landmark: &TrackedLandmark| {
            let mut movement: Matrix3xX<f64> = landmark.jacobian.by_border.dense(own.nrows()) * &own;
            for (first, block) in &landmark.jacobian.by_frame {
                movement += block * frames[t].fixed_rows::<3>(*first);
            }
            movement
        };
        let of_frame =
            |(t, landmarks): (usize, &Vec<TrackedLandmark>)| landmarks.iter().map(|l| movement(t, l)).collect();
        paths.par_iter().enumerate().map(of_frame).collect()
    }

    /// Movement of a person's own border and frames per unit of each free direction of the session.
    pub(super) fn responses(&self, person: usize, basis: &DMatrix<f64>) -> (DMatrix<f64>, Vec<DMatrix<f64>>) {
        let own = -(&self.own_parts[person].0 * basis);
        let mut border = DMatrix::zeros(own.nrows() + basis.nrows(), basis.ncols());
        border.rows_mut(0, own.nrows()).copy_from(&own);
        border.rows_mut(own.nrows(), basis.nrows()).copy_from(basis);
        let frames = self.people[person].responses(&border);
        (own, frames)
    }
}
