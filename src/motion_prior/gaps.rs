//! Gaps and noise for training: what cameras do not see, and errors as fits have them.

use super::chart::LocalRotations;
use super::joints::{Bones, orientations};
use super::observed::{DESCRIBED_JOINTS, N_DESCRIBED, ObservedMotion, described_place, leave_spine_open};
use crate::body::skeleton::{N_JOINTS, PARENTS};
use crate::geometry::rotation::exp;
use nalgebra::Vector3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// Joints that are hidden together.
pub const LIMBS: [(&str, &[usize]); 4] = [
    ("left leg", &[1, 4, 7, 10]),
    ("right leg", &[2, 5, 8, 11]),
    ("left arm", &[16, 18, 20]),
    ("right arm", &[17, 19, 21]),
];
/// Both legs.
pub const LEGS: &[usize] = &[1, 2, 4, 5, 7, 8, 10, 11];
const ARMS: &[usize] = &[16, 17, 18, 19, 20, 21];
const FOREARMS: [&[usize]; 2] = [&[18, 20], &[19, 21]];
const SHANKS: [&[usize]; 2] = [&[4, 7, 10], &[5, 8, 11]];
const SIDES: [&[usize]; 2] = [&[1, 4, 7, 10, 16, 18, 20], &[2, 5, 8, 11, 17, 19, 21]];
const UPPER_HALF: &[usize] = &[6, 9, 12, 15, 16, 17, 18, 19, 20, 21];

/// Lengths of gaps, frames at 30 Hz; short and long ones are equally likely on a logarithmic scale.
const GAP_FRAMES: [f64; 2] = [5.0, 120.0];

/// Joints that no keypoint shows: COCO's 17, the commonest, have neither feet nor hands, others have feet.
const WITHOUT_KEYPOINTS: [&[usize]; 4] = [&[], &[20, 21], COCO, COCO];
const COCO: &[usize] = &[7, 8, 10, 11, 20, 21];

/// Joints that one obstacle hides: whole limbs mostly, since the solve needs them most.
fn hidden_joints(rng: &mut ChaCha8Rng) -> Vec<usize> {
    let side = rng.random_range(0..2);
    match rng.random_range(0..20) {
        0..6 => LIMBS[2 + side].1.to_vec(),
        6..10 => LIMBS[side].1.to_vec(),
        10..13 => LEGS.to_vec(),
        13 => ARMS.to_vec(),
        14 => FOREARMS[side].to_vec(),
        15 => SHANKS[side].to_vec(),
        16 => SIDES[side].to_vec(),
        17 => UPPER_HALF.to_vec(),
        18 => DESCRIBED_JOINTS.to_vec(),
        _ => DESCRIBED_JOINTS.into_iter().filter(|_| rng.random_bool(0.3)).collect(),
    }
}

/// Hides joints of a motion in one to three gaps, and those without keypoints throughout.
pub(crate) fn hide_randomly(motion: &mut ObservedMotion, rng: &mut ChaCha8Rng) {
    let n_frames = motion.n_frames();
    motion.hide(WITHOUT_KEYPOINTS[rng.random_range(0..WITHOUT_KEYPOINTS.len())], 0..n_frames);
    for _ in 0..rng.random_range(1..=3) {
        let length = rng.random_range(GAP_FRAMES[0].ln()..GAP_FRAMES[1].ln()).exp() as usize;
        let length = length.min(3 * n_frames / 4);
        let start = rng.random_range(0..=n_frames - length);
        let joints = hidden_joints(rng);
        motion.hide(&joints, start..start + length);
    }
    motion.sigma.iter_mut().for_each(leave_spine_open);
}

/// Standard deviations of the noise of an orientation about axes across the bone and about the bone itself, rad; by joint. In fits of
/// six cameras trunks err by 2 to 4 degrees across and 1.2 to 3.9 about themselves, limbs by 1 to 2.2 and 2.4 to 8.6; fewer
/// cameras see less.
const TRUNK: [usize; 6] = [0, 3, 6, 9, 12, 15];
const TRUNK_NOISE: [[f64; 2]; 2] = [[0.01, 0.12], [0.01, 0.08]];
const LIMB_NOISE: [[f64; 2]; 2] = [[0.006, 0.06], [0.02, 0.18]];
/// Standard deviation of the pelvis's position, m.
const POSITION_NOISE: f64 = 0.006;
/// Correlation of the noise from frame to frame: errors of the same fits have 0.87 after 3 frames, 0.65 after 10, 0.25 after 30.
/// Slow errors look like departures, and a network that has not seen them takes them for motion.
const NOISE_CORRELATION: f64 = 0.955;
/// Share of the motions that are nearly exact, and their part of the noise.
const CLEAN_SHARE: f64 = 0.3;
const CLEAN_PART: f64 = 0.1;

/// Noise that is correlated in time.
struct SlowNoise {
    sd: Vector3<f64>,
    error: Vector3<f64>,
}

impl SlowNoise {
    fn new(sd: Vector3<f64>, rng: &mut ChaCha8Rng) -> Self {
        Self { sd, error: Vector3::from_fn(|axis, _| sd[axis] * rng.sample::<f64, _>(StandardNormal)) }
    }

    fn next(&mut self, rng: &mut ChaCha8Rng) -> Vector3<f64> {
        let fresh = Vector3::from_fn(|axis, _| self.sd[axis] * rng.sample::<f64, _>(StandardNormal));
        self.error = self.error * NOISE_CORRELATION + fresh * (1.0 - NOISE_CORRELATION * NOISE_CORRELATION).sqrt();
        self.error
    }
}

/// Adds noise that is correlated in time to the orientation of every described joint, independently of its parent's: keypoints
/// show where bones point, and a pelvis that is fitted too far to the left leaves the legs where they are. The standard
/// deviation that the motion states is off by up to a third, as a fit's is.
pub(crate) fn add_noise(motion: &mut ObservedMotion, bones: &Bones, rng: &mut ChaCha8Rng) {
    let part = if rng.random_bool(CLEAN_SHARE) { CLEAN_PART } else { 1.0 };
    let mut position = SlowNoise::new(Vector3::repeat(POSITION_NOISE * part), rng);
    let mut noises: Vec<SlowNoise> = Vec::with_capacity(N_DESCRIBED);
    for (described, &joint) in DESCRIBED_JOINTS.iter().enumerate() {
        let ranges = if TRUNK.contains(&joint) { TRUNK_NOISE } else { LIMB_NOISE };
        let [across, about] = ranges.map(|range| part * rng.random_range(range[0].ln()..range[1].ln()).exp());
        let axis = bones.axis(joint);
        noises.push(SlowNoise::new(Vector3::repeat(across) + axis.abs() * (about - across), rng));
        let stated = across * rng.random_range(0.75..1.33);
        motion.sigma.iter_mut().for_each(|sigma| sigma[described] = stated);
    }
    for frame in 0..motion.n_frames() {
        let mut errors = [Vector3::zeros(); N_JOINTS];
        for (noise, joint) in noises.iter_mut().zip(DESCRIBED_JOINTS) {
            errors[joint] = noise.next(rng);
        }
        motion.rotations[frame] = disturbed(&motion.rotations[frame], &errors);
        motion.pelvis[frame] += position.next(rng);
    }
}

/// A pose whose described joints' orientations are in error; the others keep their rotation relative to their parents.
fn disturbed(pose: &LocalRotations, errors: &[Vector3<f64>; N_JOINTS]) -> LocalRotations {
    let right = orientations(pose);
    let mut wrong = right;
    for joint in 0..N_JOINTS {
        wrong[joint] = match PARENTS[joint] {
            Some(parent) if described_place(joint).is_none() => wrong[parent] * pose[joint],
            _ => right[joint] * exp(&errors[joint]),
        };
    }
    std::array::from_fn(|joint| PARENTS[joint].map_or(wrong[joint], |parent| wrong[parent].transpose() * wrong[joint]))
}

/// What the network is to state: the true orientation of each described joint relative to its parent's as observed, or to the
/// true one where the parent is unseen. A hidden limb points where it pointed also where the trunk is in error.
pub(crate) fn aims(truth: &[LocalRotations], observed: &ObservedMotion) -> Vec<LocalRotations> {
    let of_frame = |(frame, truth): (usize, &LocalRotations)| {
        let right = orientations(truth);
        let mut known = orientations(&observed.rotations[frame]);
        for joint in 0..N_JOINTS {
            match described_place(joint) {
                Some(described) if !observed.is_seen(frame, described) => known[joint] = right[joint],
                None => known[joint] = PARENTS[joint].map_or(known[joint], |parent| known[parent] * truth[joint]),
                Some(_) => {}
            }
        }
        std::array::from_fn(|joint| match PARENTS[joint] {
            Some(parent) if described_place(joint).is_some() => known[parent].transpose() * right[joint],
            _ => truth[joint],
        })
    };
    truth.iter().enumerate().map(of_frame).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;
    use rand::SeedableRng;

    #[test]
    fn motions_of_any_length_get_gaps_and_stated_noise() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for n in [1, 2, 30, 200] {
            let still = ObservedMotion::exact(vec![[Matrix3::identity(); 24]; n], vec![Vector3::zeros(); n]);
            let mut motion = still.clone();
            add_noise(&mut motion, &Bones::of_default_body(), &mut rng);
            assert!(motion.sigma.iter().flatten().all(|sigma| (0.0004..0.17).contains(sigma)));
            hide_randomly(&mut motion, &mut rng);
            assert_eq!(motion.rotations.len(), n);
        }
    }

    /// Errors of the trunk do not move limbs, and what is to be stated of a hidden limb makes up for them.
    #[test]
    fn hidden_limbs_are_aimed_where_they_pointed() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let bent: LocalRotations = std::array::from_fn(|joint| match described_place(joint) {
            Some(_) => exp(&Vector3::new(0.02 * joint as f64, -0.3, 0.2)),
            None => Matrix3::identity(),
        });
        let mut motion = ObservedMotion::exact(vec![bent; 40], vec![Vector3::zeros(); 40]);
        add_noise(&mut motion, &Bones::of_default_body(), &mut rng);
        motion.hide(LIMBS[0].1, 10..30);
        let right = orientations(&bent);
        for (frame, aim) in aims(&[bent; 40], &motion).iter().enumerate() {
            let seen = orientations(&motion.rotations[frame]);
            let knee = if motion.is_seen(frame, 4) { seen[1] } else { right[1] };
            assert!(
                (seen[0] * aim[1] - right[1]).norm() < 1e-12 && (knee * aim[4] - right[4]).norm() < 1e-12,
                "{frame}"
            );
            assert!((seen[0] - right[0]).norm() > 1e-4 && aim[13] == Matrix3::identity());
        }
    }
}
