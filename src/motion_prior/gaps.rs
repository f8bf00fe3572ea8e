//! Gaps and noise for training: what cameras do not see, and errors as fits have them.

use super::observed::{DESCRIBED_JOINTS, N_DESCRIBED, ObservedMotion};
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

/// Joints that no keypoint shows: COCO's 17 have neither feet nor hands, others have feet.
const WITHOUT_KEYPOINTS: [&[usize]; 3] = [&[], &[20, 21], &[7, 8, 10, 11, 20, 21]];

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
    motion.hide(WITHOUT_KEYPOINTS[rng.random_range(0..3)], 0..n_frames);
    for _ in 0..rng.random_range(1..=3) {
        let length = rng.random_range(GAP_FRAMES[0].ln()..GAP_FRAMES[1].ln()).exp() as usize;
        let length = length.min(3 * n_frames / 4);
        let start = rng.random_range(0..=n_frames - length);
        let joints = hidden_joints(rng);
        motion.hide(&joints, start..start + length);
    }
}

/// Range of the noise of a joint, rad; a fit of six cameras has half a degree to some degrees, one of two cameras more.
const NOISE: [f64; 2] = [0.005, 0.12];
/// Correlation of the noise from frame to frame: detectors err alike over half a second to two (autocorrelation on real
/// detections 0.53 after 0.4 s, 0.38 after 1 s). Slow errors look like departures, and a network that has not seen them takes them for motion.
const NOISE_CORRELATION: f64 = 0.97;
/// Share of the motions that are nearly exact.
const CLEAN_SHARE: f64 = 0.3;

/// Adds noise that is correlated in time to every joint. The standard deviation that
/// the motion states is off by up to a third, as a fit's is.
pub(crate) fn add_noise(motion: &mut ObservedMotion, rng: &mut ChaCha8Rng) {
    let is_clean = rng.random_bool(CLEAN_SHARE);
    for described in 0..N_DESCRIBED {
        let sd = if is_clean { NOISE[0] } else { rng.random_range(NOISE[0].ln()..NOISE[1].ln()).exp() };
        let stated = sd * rng.random_range(0.75..1.33);
        let mut error = Vector3::from_fn(|_, _| sd * rng.sample::<f64, _>(StandardNormal));
        for frame in 0..motion.n_frames() {
            let fresh = Vector3::from_fn(|_, _| sd * rng.sample::<f64, _>(StandardNormal));
            error = error * NOISE_CORRELATION + fresh * (1.0 - NOISE_CORRELATION * NOISE_CORRELATION).sqrt();
            motion.rotations[frame][DESCRIBED_JOINTS[described]] *= exp(&error);
            motion.sigma[frame][described] = stated;
        }
    }
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
            add_noise(&mut motion, &mut rng);
            assert!(motion.sigma.iter().flatten().all(|sigma| (0.003..0.23).contains(sigma)));
            hide_randomly(&mut motion, &mut rng);
            assert_eq!(motion.rotations.len(), n);
        }
    }
}
