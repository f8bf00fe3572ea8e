//! Individual bodies: default bodies with moved joints inside the same skin, and a detector with a keypoint bias.

use super::config::{Bodies, SimulationConfig};
use super::random::{Purpose, normal, stream};
use crate::body::BodyModel;
use crate::body::detector_offsets::{OffsetKind, OffsetTable};
use crate::body::skeleton::N_JOINTS;
use nalgebra::Vector3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::ops::RangeInclusive;

/// Standard deviation per axis of a rest joint's distance from the default body's, m.
const JOINT_SD: f64 = 0.010;

/// Distance of a detector's hips from the joints, m (Needham et al., Scientific Reports 11, 2021).
const HIP_OFFSET: RangeInclusive<f64> = 0.030..=0.050;
/// Distance of its other joint keypoints, m.
const JOINT_OFFSET: RangeInclusive<f64> = 0.010..=0.020;
/// Distance of its points of face and feet, which are seen directly, m.
const SKIN_OFFSET: RangeInclusive<f64> = 0.005..=0.010;

/// Differences of a person's rest joints from the default body's at the same betas, m; zero unless bodies are
/// [`Bodies::Individual`].
pub(super) fn joint_shifts(config: &SimulationConfig, person: usize) -> [Vector3<f64>; N_JOINTS] {
    let rng = &mut stream(config.seed, Purpose::Joints, 0, person);
    match config.bodies {
        Bodies::Own | Bodies::Default => [Vector3::zeros(); N_JOINTS],
        Bodies::Individual => std::array::from_fn(|_| Vector3::from_fn(|_, _| normal(rng, JOINT_SD))),
    }
}

/// A body with its landmarks moved to the session's keypoints. For [`Bodies::Individual`] every kind of keypoint has one
/// offset, fixed in the bone's frame, mirrored, the same for all people; otherwise the body is unchanged.
pub(super) fn as_detected(body: BodyModel, config: &SimulationConfig) -> BodyModel {
    if config.bodies != Bodies::Individual {
        return body;
    }
    let rng = &mut stream(config.seed, Purpose::KeypointBias, 0, 0);
    let table = OffsetTable::new(&body, config.convention);
    let offsets: Vec<Vector3<f64>> = table.kinds.iter().map(|kind| offset(kind, rng)).collect();
    table.applied(&body, &offsets)
}

/// A random keypoint bias: hips are too high and too wide, points on the midline stay on it.
fn offset(kind: &OffsetKind, rng: &mut ChaCha8Rng) -> Vector3<f64> {
    let is_hip = kind.name.ends_with("hip");
    let size = rng.random_range(match kind.is_joint {
        true if is_hip => HIP_OFFSET,
        true => JOINT_OFFSET,
        false => SKIN_OFFSET,
    });
    let mut direction = Vector3::from_fn(|_, _| normal(rng, 1.0));
    if is_hip {
        direction = Vector3::new(direction.x.abs(), direction.y.abs(), direction.z);
    }
    if kind.is_on_midline() {
        direction.x = 0.0;
    }
    direction.normalize() * size
}

#[cfg(test)]
mod tests {
    use super::super::{Preset, simulate};
    use super::*;
    use crate::body::default_body;
    use crate::body::kinematics::{Pose, landmark_position, posed};
    use crate::body::model::Betas;
    use crate::body::skeleton::KeypointConvention;

    fn config(bodies: Bodies) -> SimulationConfig {
        let preset = SimulationConfig::preset(Preset::Paper);
        SimulationConfig { bodies, frames: 3, convention: KeypointConvention::Halpe26, ..preset }
    }

    #[test]
    fn joints_differ_by_ten_millimetres_per_axis() {
        let config = config(Bodies::Individual);
        let shifts: Vec<f64> = (0..50).flat_map(|p| joint_shifts(&config, p)).flat_map(|s| [s.x, s.y, s.z]).collect();
        let sd = (shifts.iter().map(|s| s * s).sum::<f64>() / shifts.len() as f64).sqrt();
        assert!((sd - JOINT_SD).abs() < 5e-4, "{sd}"); // 3,600 numbers: 1.2 % is one standard error
        assert_eq!(joint_shifts(&SimulationConfig { bodies: Bodies::Default, ..config }, 0)[5], Vector3::zeros());
    }

    #[test]
    fn detected_hips_are_too_wide_and_symmetric() {
        let body = default_body();
        let seen = as_detected(body.clone(), &config(Bodies::Individual));
        let shift = |name: &str| {
            let place = |model: &BodyModel| {
                let shaped = model.shaped(&Betas::zeros());
                landmark_position(model, &shaped, &posed(&shaped, &Pose::rest()), model.landmark_index(name).unwrap())
            };
            place(&seen) - place(&body)
        };
        let (left, right) = (shift("left_hip"), shift("right_hip"));
        assert!(left.x > 0.0 && (left - Vector3::new(-right.x, right.y, right.z)).norm() < 1e-12);
        for (name, range) in [("left_hip", HIP_OFFSET), ("right_knee", JOINT_OFFSET), ("left_heel", SKIN_OFFSET)] {
            assert!(range.contains(&shift(name).norm()), "{name}: {}", shift(name).norm());
        }
        assert_eq!(shift("nose").x, 0.0);
    }

    #[test]
    fn the_simulated_skeleton_is_that_of_the_body() {
        let simulated = simulate(&config(Bodies::Individual)).unwrap();
        let person = &simulated.truth.people[1];
        let (model, betas) = (person.model().unwrap(), person.betas.unwrap());
        let rest = model.shaped(&betas).rest_joints;
        let pose = &person.poses[2];
        let pose = Pose { rotations: pose.rotations, translation: pose.pelvis - rest[0] };
        let joints = posed(&model.shaped(&betas), &pose).joints;
        let worst = joints.iter().zip(&simulated.truth.joints[2][1]).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
        assert!(worst < 1e-12, "{worst}");
    }
}
