//! How persons' landmarks follow the session's unknowns, and how they spread about that.

use super::super::pixel_residuals::DetectedPixels;
use super::super::terms::landmark_jacobian::{LandmarkJacobian, LinearLandmarks};
use super::super::terms::whitened_pixels::Positions;
use super::reduced::draws;
use super::{JointProblem, Member, Reduced, with_bones};
use nalgebra::{DMatrix, Matrix3xX};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Draws of a person's errors: the gradient of a marginal step sums thousands of independent directions, and errs by some hundredths of a
/// standard deviation of the cameras. The exact spread (Takahashi's recursion) costs ten times as much.
pub(super) const N_SAMPLES: usize = 16;

/// By frame and observed landmark.
pub(super) type ByLandmark = Vec<Vec<Matrix3xX<f64>>>;

/// One person's landmarks, and how they follow the free directions of the session.
pub(super) struct Following {
    /// In the world. `[frame][observed landmark]`, as the others.
    pub positions: Positions,
    /// Per unit of each free direction. [3, free directions]
    pub movements: ByLandmark,
    /// Errors of the positions while the session, betas and bones stay, drawn from what the motion's system leaves open. [3, samples]
    pub of_motion: ByLandmark,
    /// The same with those of betas and bones: only the session stays.
    pub of_person: ByLandmark,
}

impl Following {
    /// The landmarks' movements while the session moves, in the columns of `session` by its free directions. [3, columns]
    pub(super) fn along(&self, session: &DMatrix<f64>) -> ByLandmark {
        let of_frame = |frame: &Vec<Matrix3xX<f64>>| frame.iter().map(|moved| moved * session).collect();
        self.movements.par_iter().map(of_frame).collect()
    }

    /// Draws of the errors of everything: those of the person with those of the session, in columns. [3, samples]
    pub(super) fn drawn(&self, session: &DMatrix<f64>) -> ByLandmark {
        let mut drawn = self.along(session);
        for (all, of_person) in drawn.iter_mut().flatten().zip(self.of_person.iter().flatten()) {
            *all += of_person;
        }
        drawn
    }
}

impl JointProblem<'_> {
    /// All persons' landmarks as they follow the free directions of the session, and [`N_SAMPLES`] of their errors.
    pub(super) fn following(
        &self,
        reduced: &Reduced,
        (members, pixels): (&[Member], &[DetectedPixels]),
    ) -> Option<Vec<Following>> {
        let basis = reduced.basis.as_ref()?;
        let of_person = |(person, (member, pixels)): (usize, (&Member, &DetectedPixels))| {
            let model = with_bones(self.context.model, &member.bones);
            let paths = self.problem(&model, member, pixels).linearised_paths(&member.state);
            let [movements, of_motion, of_person] = reduced.landmark_movements(person, basis, &paths)?;
            let positions = paths.into_iter().map(|frame| frame.positions).collect();
            Some(Following { positions, movements, of_motion, of_person })
        };
        members.par_iter().zip(pixels).enumerate().map(of_person).collect()
    }
}

impl Reduced {
    /// Movement of a person's landmarks per unit of each free direction of the session, which the person follows, and samples of
    /// their errors: of the motion, and of motion, betas and bones. `None` where those are not determined.
    fn landmark_movements(
        &self,
        person: usize,
        basis: &DMatrix<f64>,
        paths: &[LinearLandmarks],
    ) -> Option<[ByLandmark; 3]> {
        let rng = |stream| {
            let mut rng = ChaCha8Rng::seed_from_u64(person as u64);
            rng.set_stream(stream);
            rng
        };
        let (n_free, n_own) = (basis.ncols(), self.own_parts[person].0.nrows());
        // First the columns of the free directions, then those of the samples.
        let mut own = DMatrix::zeros(n_own, n_free + N_SAMPLES);
        own.columns_mut(0, n_free).copy_from(&-(&self.own_parts[person].0 * basis));
        own.columns_mut(n_free, N_SAMPLES).copy_from(&self.own_samples(person, &mut rng(1))?);
        let mut border = DMatrix::zeros(n_own + basis.nrows(), n_free + N_SAMPLES);
        border.rows_mut(0, n_own).copy_from(&own);
        border.view_mut((n_own, 0), basis.shape()).copy_from(basis);
        let frames = self.people[person].responses_and_samples(&border, N_SAMPLES, &mut rng(0));
        let movement = |t: usize, jacobian: LandmarkJacobian| {
            let mut by_frame = Matrix3xX::zeros(n_free + 2 * N_SAMPLES);
            for (first, block) in jacobian.by_frame {
                by_frame += block * frames[t].fixed_rows::<3>(*first);
            }
            let of_motion = by_frame.columns(n_free + N_SAMPLES, N_SAMPLES).into_owned();
            let followed = jacobian.by_border.dense(n_own) * &own + by_frame.columns(0, n_free + N_SAMPLES);
            let of_person = followed.columns(n_free, N_SAMPLES) + &of_motion;
            [followed.columns(0, n_free).into_owned(), of_motion, of_person]
        };
        let of_frame = |(t, landmarks): (usize, &LinearLandmarks)| {
            transposed((0..landmarks.len()).map(|l| movement(t, landmarks.jacobian(l))), landmarks.len())
        };
        let of_frames: Vec<[Vec<Matrix3xX<f64>>; 3]> = paths.par_iter().enumerate().map(of_frame).collect();
        Some(transposed(of_frames.into_iter(), paths.len()))
    }

    /// Draws of a person's betas and bones from what the person's system leaves open while the session stays. [own, samples]
    fn own_samples(&self, person: usize, rng: &mut ChaCha8Rng) -> Option<DMatrix<f64>> {
        let n_own = self.own_parts[person].0.nrows();
        let factor = self.people[person].corner.view((0, 0), (n_own, n_own)).into_owned().cholesky()?;
        draws(&factor, N_SAMPLES, rng)
    }
}

/// Triples as three lists.
fn transposed<T>(triples: impl Iterator<Item = [T; 3]>, n: usize) -> [Vec<T>; 3] {
    let mut lists = [0; 3].map(|_| Vec::with_capacity(n));
    for triple in triples {
        lists.iter_mut().zip(triple).for_each(|(list, one)| list.push(one));
    }
    lists
}
