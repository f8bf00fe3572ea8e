//! What a recording says of people's bones and the detector's offsets, whatever is known of them beforehand.

use super::super::terms::term::BorderTerm;
use super::{DetectedPixels, Eliminated, JointProblem, Member, flat};
use nalgebra::{DMatrix, DVector, Vector3};

/// What a number of [`ProportionEvidence`] is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in super::super) enum Role {
    /// A beta of a person.
    Shape,
    /// A bone of a person, m per axis.
    Bone,
    /// An offset, by number among those of all kinds, m per axis.
    Offset(usize),
}

/// The cost about a state, `cost(place + d) = d^T hessian d / 2 - right^T d`, over betas, bones and offsets: motions eliminated,
/// cameras held, without the priors of bones and offsets.
pub(in super::super) struct ProportionEvidence {
    pub hessian: DMatrix<f64>,
    pub right: DVector<f64>,
    /// Bones and offsets of the state; 0 for betas, whose prior is part of the cost.
    pub place: DVector<f64>,
    pub roles: Vec<Role>,
}

impl JointProblem<'_> {
    /// About the state of `members` and `offsets`; the cameras are held. `None` where a person's system cannot be factored.
    pub(in super::super) fn proportion_evidence(
        &self,
        members: &[Member],
        offsets: &[Vector3<f64>],
    ) -> Option<ProportionEvidence> {
        let pixels: Vec<DetectedPixels> = members.iter().map(|member| self.pixels(member)).collect();
        let people = self.eliminated((members, &pixels), offsets, self.systems(members), 0.0)?;
        let border = self.border(0);
        let (n_own, bones) = (border.person().len(), border.bones());
        let shared = n_own * people.len();
        let n = shared + border.keypoint_bias().len();
        let (mut hessian, mut right) = (DMatrix::zeros(n, n), DVector::zeros(n));
        let (mut place, mut roles) = (DVector::zeros(n), vec![Role::Shape; n]);
        for (person, (member, eliminated)) in members.iter().zip(&people).enumerate() {
            let own = person * n_own..(person + 1) * n_own;
            let columns: Vec<usize> = own.clone().chain(shared..n).collect();
            for (i, &row) in columns.iter().enumerate() {
                right[row] += eliminated.right[i];
                for (j, &column) in columns.iter().enumerate() {
                    hessian[(row, column)] += eliminated.corner[(i, j)];
                }
            }
            for (k, value) in flat(&member.bones).into_iter().enumerate() {
                let column = own.start + bones.start + k;
                (roles[column], place[column]) = (Role::Bone, value);
                hessian[(column, column)] -= self.bone_prior.precision(k);
                right[column] += self.bone_prior.precision(k) * value;
            }
        }
        for (k, value) in flat(offsets).into_iter().enumerate() {
            (roles[shared + k], place[shared + k]) = (Role::Offset(k), value);
        }
        self.context.systems.put_back(people.into_iter().map(Eliminated::into_system));
        Some(ProportionEvidence { hessian, right, place, roles })
    }
}
