//! A motion on the 30 Hz grid together with how well each joint is known.

use super::chart::{LATENT_JOINTS, LocalRotations};
use crate::body::skeleton::N_JOINTS;
use nalgebra::Vector3;

/// Joints whose rotations the denoiser describes: the pelvis in the world, then [`LATENT_JOINTS`].
pub const DESCRIBED_JOINTS: [usize; 1 + LATENT_JOINTS.len()] = described_joints();

/// Number of [`DESCRIBED_JOINTS`].
pub const N_DESCRIBED: usize = DESCRIBED_JOINTS.len();

/// Place of a joint among [`DESCRIBED_JOINTS`].
pub fn described_place(joint: usize) -> Option<usize> {
    DESCRIBED_JOINTS.iter().position(|described| *described == joint)
}

const fn described_joints() -> [usize; 1 + LATENT_JOINTS.len()] {
    let mut joints = [0; 1 + LATENT_JOINTS.len()];
    let mut i = 0;
    while i < LATENT_JOINTS.len() {
        joints[i + 1] = LATENT_JOINTS[i];
        i += 1;
    }
    joints
}

/// Rotations, path and standard deviations of a motion; y is up.
#[derive(Debug, Clone, PartialEq)]
pub struct ObservedMotion {
    /// `parent_from_joint` of every frame; entry 0 is `world_from_pelvis`. Those of unseen joints are ignored.
    pub rotations: Vec<LocalRotations>,
    /// Position of the pelvis in the world, m.
    pub pelvis: Vec<Vector3<f64>>,
    /// Standard deviation of each of [`DESCRIBED_JOINTS`] per axis, rad; infinite where the joint is unseen. The pelvis's
    /// position is unseen where its rotation is.
    pub sigma: Vec<[f64; N_DESCRIBED]>,
}

impl ObservedMotion {
    /// A motion that is known exactly.
    pub fn exact(rotations: Vec<LocalRotations>, pelvis: Vec<Vector3<f64>>) -> Self {
        let sigma = vec![[0.0; N_DESCRIBED]; rotations.len()];
        Self { rotations, pelvis, sigma }
    }

    /// Number of frames.
    pub fn n_frames(&self) -> usize {
        self.rotations.len()
    }

    /// Whether one of [`DESCRIBED_JOINTS`], by its place there, is seen.
    pub fn is_seen(&self, frame: usize, described: usize) -> bool {
        self.sigma[frame][described].is_finite()
    }

    /// Makes joints unseen; those outside [`DESCRIBED_JOINTS`] have no entry and are left out.
    pub fn hide(&mut self, joints: &[usize], frames: std::ops::Range<usize>) {
        for place in joints.iter().filter_map(|&joint| described_place(joint)) {
            self.sigma[frames.clone()].iter_mut().for_each(|sigma| sigma[place] = f64::INFINITY);
        }
    }
}

/// Joints of the thighs, and of the spine.
const HIPS: [usize; 2] = [1, 2];
pub(crate) const SPINE: [usize; 3] = [3, 6, 9];

/// Makes the spine of a frame unseen where both thighs are: the keypoints of the trunk show how it leans, but not how much of that
/// the pelvis does and how much the spine; the pelvis may tilt about the line through the hips, and hidden legs with it.
pub(crate) fn leave_spine_open(sigma: &mut [f64; N_DESCRIBED]) {
    if HIPS.into_iter().filter_map(described_place).all(|hip| sigma[hip].is_infinite()) {
        SPINE.into_iter().filter_map(described_place).for_each(|joint| sigma[joint] = f64::INFINITY);
    }
}

/// All joints of the skeleton below `joint`, without it.
pub fn joints_below(joint: usize) -> impl Iterator<Item = usize> {
    (0..N_JOINTS).filter(move |&j| j != joint && crate::body::skeleton::chain_to_root(j).any(|above| above == joint))
}
