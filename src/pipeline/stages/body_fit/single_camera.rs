//! What a single camera alone shows of a person.
//!
//! An image does not show whether a bone points towards the camera or away from it. Ranges of joints and smoothness decide, and
//! err; the fit then has the limb mirrored in depth, as sure of itself as if it were right.

use super::observations::Observations;
use crate::body::BodyModel;
use crate::body::kinematics::{PosedSkeleton, moving_joints};
use crate::body::skeleton::{N_JOINTS, chain_to_root};
use crate::pipeline::calibration::PosedCamera;
use std::ops::Range;

/// The bones of the limbs, which may be mirrored: the joint that turns each, and the one at its end.
pub(super) const BONES: [[usize; 2]; 8] = [[1, 4], [4, 7], [2, 5], [5, 8], [16, 18], [18, 20], [17, 19], [19, 21]];

/// How often a bone that one camera alone shows is mirrored in depth. On 18 stretches of 1 to 3 seconds, in which all cameras but one lost
/// a person (realistic noise and `paper`, 4 and 6 cameras), knees, ankles, elbows and wrists were off by what 0.05, 0.07, 0.04 and 0.11
/// explain; without the guidance of the motion prior by what 0.15, 0.28, 0.19 and 0.34 do.
const MIRRORED: f64 = 0.08;

/// Time within which a limb does not change sides, s: what another camera shows then decides.
const SAME_SIDE_SECS: f64 = 0.25;

/// The cameras that show something.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Shown {
    Nowhere,
    By(usize),
    BySeveral,
}

impl Shown {
    fn and(self, other: Self) -> Self {
        match (self, other) {
            (Self::Nowhere, shown) | (shown, Self::Nowhere) => shown,
            (Self::By(a), Self::By(b)) if a == b => self,
            _ => Self::BySeveral,
        }
    }
}

/// By frame, the cameras that show a person and each of [`BONES`] within [`SAME_SIDE_SECS`]; of a session of several cameras.
pub(super) struct SingleCamera<'a> {
    frames: Vec<(Shown, [Shown; BONES.len()])>,
    cameras: &'a [PosedCamera],
}

impl<'a> SingleCamera<'a> {
    pub(super) fn new(model: &BodyModel, observations: &'a Observations, frame_interval: f64) -> Self {
        let turned: Vec<Vec<usize>> = model.landmarks.iter().map(moving_joints).collect();
        let of_frame = |t: usize| {
            let mut shown = (Shown::Nowhere, [Shown::Nowhere; BONES.len()]);
            for pixel in &observations.pixels[t] {
                let by = Shown::By(pixel.camera);
                shown.0 = shown.0.and(by);
                let bones = BONES.iter().zip(&mut shown.1);
                bones
                    .filter(|([joint, _], _)| turned[pixel.landmark].contains(joint))
                    .for_each(|(_, b)| *b = b.and(by));
            }
            shown
        };
        let n_frames = observations.pixels.len();
        let of_frames: Vec<_> = (0..n_frames).map(of_frame).collect();
        let half = (SAME_SIDE_SECS / frame_interval).round() as usize;
        let around = |t: usize| {
            let near = &of_frames[t.saturating_sub(half)..(t + half + 1).min(n_frames)];
            let bone = |k: usize| near.iter().fold(Shown::Nowhere, |shown, frame| shown.and(frame.1[k]));
            (near.iter().fold(Shown::Nowhere, |shown, frame| shown.and(frame.0)), std::array::from_fn(bone))
        };
        Self { frames: (0..n_frames).map(around).collect(), cameras: &observations.cameras }
    }

    /// Whether one camera alone shows the person.
    pub(super) fn shows_person(&self, frame: usize) -> bool {
        matches!(self.frames[frame].0, Shown::By(_))
    }

    /// Runs of frames in which one camera alone shows the person, with that camera.
    pub(super) fn stretches(&self) -> Vec<(usize, Range<usize>)> {
        let mut start = 0;
        let mut found = Vec::new();
        for run in self.frames.chunk_by(|(a, _), (b, _)| a == b) {
            let frames = start..start + run.len();
            start = frames.end;
            if let Shown::By(camera) = run[0].0 {
                found.push((camera, frames));
            }
        }
        found
    }

    /// By frame, whether fewer than two cameras show the person.
    pub(super) fn open_frames(&self) -> Vec<bool> {
        self.frames.iter().map(|(person, _)| *person != Shown::BySeveral).collect()
    }

    /// Whether one camera alone shows the bone that a joint turns.
    pub(super) fn shows_bone(&self, frame: usize, joint: usize) -> bool {
        let bone = BONES.iter().position(|[turned, _]| *turned == joint);
        bone.is_some_and(|bone| matches!(self.frames[frame].1[bone], Shown::By(_)))
    }

    /// Variances of the joints' positions, three axes together, m^2: what bones that may be mirrored add. A mirrored bone moves its end,
    /// and all beyond it, by twice its extent along the ray.
    pub(super) fn mirrored_variances(&self, frame: usize, skeleton: &PosedSkeleton) -> [f64; N_JOINTS] {
        let of_bone = |([joint, end], shown): (&[usize; 2], &Shown)| {
            let Shown::By(camera) = shown else { return 0.0 };
            let camera_from_world = &self.cameras[*camera].camera_from_world;
            let [joint, end] = [joint, end].map(|&joint| camera_from_world.transform(&skeleton.joints[joint]));
            MIRRORED * (2.0 * (end - joint).dot(&end.normalize())).powi(2)
        };
        let of_bones: Vec<f64> = BONES.iter().zip(&self.frames[frame].1).map(of_bone).collect();
        let before = |joint: usize| {
            let on_the_way = |[_, end]: &[usize; 2]| chain_to_root(joint).any(|ancestor| ancestor == *end);
            BONES.iter().zip(&of_bones).filter(|(bone, _)| on_the_way(bone)).map(|(_, variance)| variance).sum()
        };
        std::array::from_fn(before)
    }
}

#[cfg(test)]
mod tests {
    use super::super::observations::PixelObservation;
    use super::super::test_fixtures::seen;
    use super::*;
    use crate::body::default_body;
    use crate::body::kinematics::{Pose, posed};
    use crate::body::model::Betas;
    use crate::geometry::{Intrinsics, Rigid, rotation};
    use nalgebra::{Matrix3, Vector3};

    /// Forty frames at 20 a second; the second camera shows the left arm in the first twenty, and nothing after.
    #[test]
    fn bones_along_the_ray_may_be_mirrored_beside_one_camera() {
        let model = default_body();
        let pixel = |name: &str, camera: usize| seen(model.landmark_index(name).unwrap(), camera);
        let arm = ["left_elbow", "left_wrist"];
        let frame = |t: usize| -> Vec<PixelObservation> {
            let of_second = arm.iter().filter(|_| t < 20).map(|name| pixel(name, 1));
            arm.iter().chain(&["left_knee"]).map(|name| pixel(name, 0)).chain(of_second).collect()
        };
        let camera = |translation| PosedCamera {
            intrinsics: Intrinsics::PLAIN,
            camera_from_world: Rigid { rotation: Matrix3::identity(), translation },
        };
        let observations = Observations {
            cameras: vec![camera(Vector3::new(0.0, 0.0, 4.0)), camera(Vector3::new(1.0, 0.0, 4.0))],
            points: vec![Vec::new(); 40],
            pixels: (0..40).map(frame).collect(),
        };
        let alone = SingleCamera::new(&model, &observations, 0.05);
        assert!([0, 24].iter().all(|&t| !alone.shows_person(t)) && [25, 39].iter().all(|&t| alone.shows_person(t)));
        assert_eq!([24, 25].map(|t| alone.shows_bone(t, 16)), [false, true]);
        assert!(alone.shows_bone(0, 1) && !alone.shows_bone(0, 4), "a knee is seen, nothing below it");
        assert_eq!(alone.open_frames(), (0..40).map(|t| t >= 25).collect::<Vec<_>>());

        // At rest arms lie across the view, and legs as well.
        let mut pose = Pose::rest();
        let body = model.shaped(&Betas::zeros());
        let at = |t: usize, pose: &Pose| alone.mirrored_variances(t, &posed(&body, pose));
        let across = at(39, &pose);
        pose.rotations[16] = rotation::exp(&(Vector3::y() * -1.5));
        let [seen, along] = [at(10, &pose), at(39, &pose)];
        assert_eq!((seen[18], seen[20], along[19]), (0.0, 0.0, 0.0));
        assert!(across[18] < 0.001 && along[18] > 0.02 && along[20] > 1.8 * along[18], "{across:?} {along:?}");
        assert_eq!(along[22], along[20], "a hand is beyond the wrist");
    }
}
