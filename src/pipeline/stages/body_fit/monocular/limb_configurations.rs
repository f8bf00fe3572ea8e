//! The configurations of a limb that one frame allows: with known lengths and images of its bones, each bone points towards the
//! camera or away from it.

use super::super::initial_motion::{Limb, joint_index, limb_list, limb_rotations};
use crate::body::joint_ranges::{JointRange, joint_ranges_of};
use crate::body::kinematics::{Pose, landmark_position, posed};
use crate::body::model::{BodyModel, ShapedBody};
use crate::body::skeleton::N_JOINTS;
use crate::residuals::joint_angles::{JointAngleWeights, joint_angle_cost};
use nalgebra::{Matrix3, Vector2, Vector3};

/// Duration of an error of detector or motion prior, s: frames within it count as one independent observation. For what the motion prior
/// states, joints of 58 stretches of one camera come out 2 % farther off with a tenth and with six times this; for ranges of joints 1 to
/// 2 % with 0.3 and 3 times.
pub(in super::super) const ERROR_SECS: f64 = 0.1;

/// Cost of moving a limb's joint against its root, nats per m: jumps between configurations are rare, motion is not. A motion costs the
/// same at any speed, so that the frame rate does not matter. Half and double change nothing: joints of ten simulated captures of one
/// camera (78 to 79 mm), of 58 stretches that one of several cameras shows 0.5 %.
pub(in super::super) const MOVE_COST: f64 = 10.0;

/// A limb of the body at rest.
pub(in super::super) struct BodyLimb {
    limb: Limb,
    /// Landmarks of root, middle and end.
    pub(in super::super) landmarks: [usize; 3],
    /// Lengths of upper and lower bone between the landmarks, m.
    lengths: [f64; 2],
}

/// One configuration of a limb.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LimbConfiguration {
    /// Positions of middle and end, camera frame, m.
    pub positions: [Vector3<f64>; 2],
    /// Cost of the joint angles, nats.
    pub cost: f64,
}

/// The limbs whose landmarks the model has.
pub(in super::super) fn body_limbs(model: &BodyModel, body: &ShapedBody) -> Vec<BodyLimb> {
    let rest = posed(body, &Pose::rest());
    let of_limb = |limb: Limb| {
        let [root, middle, end] = limb.joints.map(|name| model.landmark_index(name));
        let landmarks = [root?, middle?, end?];
        let [root, middle, end] = landmarks.map(|l| landmark_position(model, body, &rest, l));
        Some(BodyLimb { limb, landmarks, lengths: [(middle - root).norm(), (end - middle).norm()] })
    };
    limb_list().into_iter().filter_map(of_limb).collect()
}

/// Ranges and weights of the joint angles.
pub(in super::super) struct JointCosts {
    ranges: [JointRange; N_JOINTS],
    weights: JointAngleWeights,
}

impl JointCosts {
    pub(in super::super) fn new(model: &BodyModel, limit_width: f64) -> Self {
        Self { ranges: joint_ranges_of(model), weights: JointAngleWeights { rest: 1.0, limit_width } }
    }

    /// Of a joint's rotation, nats.
    pub(in super::super) fn cost(&self, joint: usize, rotation: &Matrix3<f64>) -> f64 {
        joint_angle_cost(rotation, &self.ranges[joint], &self.weights).cost
    }
}

impl BodyLimb {
    /// Root, middle and end.
    pub(in super::super) fn joints(&self) -> [usize; 3] {
        self.limb.joints.map(joint_index)
    }

    /// The joints that turn the two bones.
    pub(in super::super) fn bones(&self) -> [usize; 2] {
        let [root, middle, _] = self.joints();
        [root, middle]
    }

    /// Theirs, such that the bones point along `upper` and `lower` (frame of the root's parent, any length).
    pub(in super::super) fn rotations(
        &self,
        body: &ShapedBody,
        upper: &Vector3<f64>,
        lower: &Vector3<f64>,
    ) -> [Matrix3<f64>; 2] {
        let (by_root, by_middle) = limb_rotations(body, &self.limb, upper, Some(lower));
        [by_root, by_middle.unwrap_or_else(Matrix3::identity)]
    }

    /// At most four configurations with the root at `root` (camera frame, m); none where middle or end has no point.
    pub(super) fn configurations(
        &self,
        joints: &JointCosts,
        body: &ShapedBody,
        camera_from_trunk: &Matrix3<f64>,
        root: &Vector3<f64>,
        normalized: &[Option<Vector2<f64>>],
    ) -> Vec<LimbConfiguration> {
        let [_, middle, end] = self.landmarks.map(|l| normalized[l]);
        let (Some(middle), Some(end)) = (middle, end) else { return Vec::new() };
        let mut found = Vec::with_capacity(4);
        for middle in points_at_distance(&middle, root, self.lengths[0]) {
            for end in points_at_distance(&end, &middle, self.lengths[1]) {
                let trunk_from_camera = camera_from_trunk.transpose();
                let upper = trunk_from_camera * (middle - root);
                let lower = trunk_from_camera * (end - middle);
                let [by_root, by_middle] = self.rotations(body, &upper, &lower);
                let [of_root, of_middle] = self.bones();
                let cost = joints.cost(of_root, &by_root) + joints.cost(of_middle, &by_middle);
                found.push(LimbConfiguration { positions: [middle, end], cost });
            }
        }
        found
    }
}

/// The points on a ray at distance `length` from `center`, the nearer to the camera first; the nearest point of the ray
/// where the whole ray is further away.
pub(in super::super) fn points_at_distance(
    normalized: &Vector2<f64>,
    center: &Vector3<f64>,
    length: f64,
) -> Vec<Vector3<f64>> {
    let ray = Vector3::new(normalized.x, normalized.y, 1.0);
    let (square, middle) = (ray.norm_squared(), ray.dot(center));
    let discriminant = middle * middle - square * (center.norm_squared() - length * length);
    if discriminant <= 0.0 {
        return vec![ray * (middle / square)];
    }
    let root = discriminant.sqrt();
    [middle - root, middle + root].map(|m| ray * (m / square)).to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_on_a_ray_lie_at_the_bone_length() {
        let center = Vector3::new(0.2, -0.1, 4.0);
        let normalized = Vector2::new(0.09, 0.01);
        let found = points_at_distance(&normalized, &center, 0.4);
        assert_eq!(found.len(), 2);
        for point in &found {
            assert!(
                ((point - center).norm() - 0.4).abs() < 1e-12 && (point.xy() / point.z - normalized).norm() < 1e-12
            );
        }
        assert!(found[0].z < center.z && center.z < found[1].z);
        assert_eq!(
            points_at_distance(&normalized, &center, 0.05).len(),
            1,
            "a bone that looks too long lies across the view"
        );
    }
}
