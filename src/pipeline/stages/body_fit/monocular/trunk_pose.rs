//! The poses of the trunk that one frame allows.
//!
//! The points of trunk and head of a body at rest are rotated and moved until they project onto the detected points, from starts
//! all around. A few poses remain, mostly two: a foreshortened shoulder line is turned to the left or to the right.

use crate::body::kinematics::{Pose, landmark_position, posed};
use crate::body::model::{BodyModel, ShapedBody};
use crate::geometry::projection::NEAR_PLANE;
use crate::geometry::{Rigid, rotation};
use crate::optim::robust::{OUTLIER_SIGMAS, geman_mcclure_rho, geman_mcclure_weight};
use nalgebra::{Matrix2x3, Matrix3, Matrix6, Vector2, Vector3, Vector6};
use std::f64::consts::TAU;

/// Standard deviation of landmarks of trunk and head about those of a rigid body, m: the spine bends, the neck turns the face.
const TRUNK: [(&str, f64); 11] = [
    ("left_hip", 0.03),
    ("right_hip", 0.03),
    ("mid_hip", 0.03),
    ("left_shoulder", 0.03),
    ("right_shoulder", 0.03),
    ("neck", 0.03),
    ("nose", 0.06),
    ("left_eye", 0.06),
    ("right_eye", 0.06),
    ("left_ear", 0.05),
    ("right_ear", 0.05),
];

/// Standard deviations of the lean, as components of the upward direction in the body's frame: to the side, backward, forward.
const LEAN: [f64; 3] = [0.2, 0.15, 0.4];

/// Number of starting directions about the upward axis, and starting leans forward, rad.
const N_YAWS: usize = 12;
const LEANS: [f64; 2] = [0.0, 0.7];

const ITERATIONS: usize = 8;

/// Poses nearer than this to a better one count as the same, rad; those that cost more than the best by the excess (nats)
/// are dropped.
const SAME_POSE: f64 = 0.3;
const MAX_EXCESS: f64 = 12.0;
const MAX_POSES: usize = 6;

/// Least number of points: three leave the pose undetermined.
const MIN_POINTS: usize = 4;

/// One pose of the trunk.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct TrunkPose {
    /// The body's frame is that of its rest pose.
    pub camera_from_body: Rigid,
    /// Half the sum of squared residuals.
    pub cost: f64,
}

/// The trunk of a body at rest.
pub(super) struct Trunk {
    /// Landmark, position at rest and its standard deviation, m.
    points: Vec<(usize, Vector3<f64>, f64)>,
    /// Middle between hips and shoulders, about which the trunk is rotated, m.
    middle: Vector3<f64>,
}

/// The image of the trunk in one frame, and priors of its pose.
pub(super) struct TrunkImage<'a> {
    /// Normalised image points by landmark.
    pub normalized: &'a [Option<Vector2<f64>>],
    /// Upward direction in the camera's frame.
    pub up: Vector3<f64>,
    /// Depth of the trunk, m, and the standard deviation of its logarithm.
    pub depth: f64,
    pub depth_sigma: f64,
}

impl Trunk {
    pub(super) fn new(model: &BodyModel, body: &ShapedBody) -> Self {
        let rest = posed(body, &Pose::rest());
        let point = |(name, sigma): &(&str, f64)| {
            let landmark = model.landmark_index(name)?;
            Some((landmark, landmark_position(model, body, &rest, landmark), *sigma))
        };
        let points = TRUNK.iter().filter_map(point).collect();
        let middle = (rest.joints[0] + rest.joints[CHEST]) / 2.0;
        Self { points, middle }
    }

    /// Position of a landmark on a posed trunk, camera frame, m.
    pub(super) fn position(&self, pose: &TrunkPose, landmark: usize) -> Option<Vector3<f64>> {
        let (_, at_rest, _) = self.points.iter().find(|(l, _, _)| *l == landmark)?;
        Some(pose.camera_from_body.transform(at_rest))
    }

    /// Depth of the middle of a posed trunk, m.
    pub(super) fn depth(&self, pose: &TrunkPose) -> f64 {
        pose.camera_from_body.transform(&self.middle).z
    }

    /// Landmarks of trunk and head.
    pub(super) fn landmarks(&self) -> impl Iterator<Item = usize> {
        self.points.iter().map(|(landmark, _, _)| *landmark)
    }

    /// The poses that explain a frame, best first; none where too little of the trunk is detected.
    pub(super) fn poses(&self, image: &TrunkImage) -> Vec<TrunkPose> {
        let seen: Vec<Vector2<f64>> = self.points.iter().filter_map(|(l, _, _)| image.normalized[*l]).collect();
        if seen.len() < MIN_POINTS {
            return Vec::new();
        }
        let center = seen.iter().sum::<Vector2<f64>>() / seen.len() as f64;
        let mut found: Vec<TrunkPose> = starts(image.up).map(|turn| self.refined(image, &center, turn)).collect();
        found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        let mut poses: Vec<TrunkPose> = Vec::new();
        for pose in found {
            let angle = |other: &TrunkPose| {
                rotation::angle_between(&pose.camera_from_body.rotation, &other.camera_from_body.rotation)
            };
            let is_new = poses.iter().all(|other| angle(other) > SAME_POSE);
            let is_likely = poses.first().is_none_or(|best| pose.cost < best.cost + MAX_EXCESS);
            if is_new && is_likely && pose.cost.is_finite() && poses.len() < MAX_POSES {
                poses.push(pose);
            }
        }
        poses
    }

    /// Damped Gauss-Newton from a first rotation.
    fn refined(&self, image: &TrunkImage, center: &Vector2<f64>, turn: Matrix3<f64>) -> TrunkPose {
        let mut turn = turn;
        let mut place = Vector3::new(center.x, center.y, 1.0) * image.depth;
        let mut damping = 1e-3;
        let (mut cost, mut system) = self.system(image, &turn, &place);
        for _ in 0..ITERATIONS {
            let (mut hessian, gradient) = system;
            for i in 0..6 {
                hessian[(i, i)] *= 1.0 + damping;
            }
            let Some(factor) = hessian.cholesky() else { break };
            let step: Vector6<f64> = -factor.solve(&gradient);
            let moved_turn = turn * rotation::exp(&step.fixed_rows::<3>(0).into_owned());
            let moved_place = place + step.fixed_rows::<3>(3);
            let (moved_cost, moved_system) = self.system(image, &moved_turn, &moved_place);
            if moved_cost < cost {
                (turn, place, system, cost, damping) =
                    (moved_turn, moved_place, moved_system, moved_cost, damping * 0.1);
            } else {
                damping = damping * 30.0 + 1e-3;
            }
        }
        let camera_from_body = Rigid { rotation: turn, translation: place - turn * self.middle };
        TrunkPose { camera_from_body, cost }
    }

    /// Cost, Gauss-Newton matrix and gradient by the rotation (right increment) and the position of the middle.
    fn system(
        &self,
        image: &TrunkImage,
        turn: &Matrix3<f64>,
        place: &Vector3<f64>,
    ) -> (f64, (Matrix6<f64>, Vector6<f64>)) {
        let (mut cost, mut hessian, mut gradient) = (0.0, Matrix6::zeros(), Vector6::zeros());
        for (landmark, at_rest, sigma) in &self.points {
            let Some(normalized) = image.normalized[*landmark] else { continue };
            let lever = at_rest - self.middle;
            let x = turn * lever + place;
            let z = x.z.max(NEAR_PLANE);
            let scale = image.depth / sigma;
            let residual = (x.xy() / z - normalized) * scale;
            let square = residual.norm_squared();
            let soft = OUTLIER_SIGMAS * OUTLIER_SIGMAS;
            cost += 0.5 * geman_mcclure_rho(square, soft);
            let weight = geman_mcclure_weight(square, soft);
            let by_place = Matrix2x3::new(1.0, 0.0, -x.x / z, 0.0, 1.0, -x.y / z) * (scale / z);
            let by_turn = by_place * (-turn * rotation::skew(&lever));
            let mut jacobian = nalgebra::Matrix2x6::zeros();
            jacobian.fixed_view_mut::<2, 3>(0, 0).copy_from(&by_turn);
            jacobian.fixed_view_mut::<2, 3>(0, 3).copy_from(&by_place);
            hessian += jacobian.tr_mul(&jacobian) * weight;
            gradient += jacobian.tr_mul(&residual) * weight;
        }
        let depth = (place.z / image.depth).max(1e-3).ln() / image.depth_sigma;
        let by_depth = 1.0 / (place.z.max(NEAR_PLANE) * image.depth_sigma);
        cost += 0.5 * depth * depth;
        hessian[(5, 5)] += by_depth * by_depth;
        gradient[5] += by_depth * depth;
        // Upward in the body's frame: (0, 1, 0) for a person who stands straight.
        let up = turn.transpose() * image.up;
        let by_turn = rotation::skew(&up);
        let [side, back, front] = LEAN;
        for (axis, sigma) in [(0, side), (2, if up.z > 0.0 { back } else { front })] {
            let residual = up[axis] / sigma;
            let row = by_turn.row(axis) / sigma;
            cost += 0.5 * residual * residual;
            let mut block = hessian.fixed_view_mut::<3, 3>(0, 0);
            block += row.transpose() * row;
            let mut part = gradient.fixed_rows_mut::<3>(0);
            part += row.transpose() * residual;
        }
        if up.y < 0.0 {
            cost += UPSIDE_DOWN;
        }
        (cost, (hessian, gradient))
    }
}

/// Joint between the shoulder blades.
const CHEST: usize = 9;

/// Cost of an upside-down trunk, nats.
const UPSIDE_DOWN: f64 = 20.0;

/// Starting rotations about the upward axis, straight and leaning forward.
fn starts(up: Vector3<f64>) -> impl Iterator<Item = Matrix3<f64>> {
    let side = rotation::any_perpendicular(&up).normalize();
    let other = up.cross(&side);
    (0..N_YAWS).flat_map(move |i| {
        let (sin, cos) = (TAU * i as f64 / N_YAWS as f64).sin_cos();
        let front = side * cos + other * sin;
        let upright = Matrix3::from_columns(&[up.cross(&front), up, front]);
        LEANS.map(|lean| upright * rotation::exp(&(Vector3::x() * lean)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::default_body;
    use crate::body::model::Betas;

    /// Rotation and image of an upright body at 4 m that faces `yaw` rad from the camera.
    fn image_of(model: &BodyModel, trunk: &Trunk, yaw: f64) -> (Matrix3<f64>, Vec<Option<Vector2<f64>>>) {
        let front = Vector3::new(yaw.sin(), 0.0, -yaw.cos());
        let up = -Vector3::y();
        let turn = Matrix3::from_columns(&[up.cross(&front), up, front]);
        let mut normalized = vec![None; model.landmarks.len()];
        for (landmark, at_rest, _) in &trunk.points {
            let x = turn * (at_rest - trunk.middle) + Vector3::new(0.3, 0.1, 4.0);
            normalized[*landmark] = Some(x.xy() / x.z);
        }
        (turn, normalized)
    }

    #[test]
    fn the_true_pose_is_the_best_for_all_directions() {
        let model = default_body();
        let trunk = Trunk::new(&model, &model.shaped(&Betas::zeros()));
        for i in 0..16 {
            let (turn, normalized) = image_of(&model, &trunk, TAU * f64::from(i) / 16.0);
            let image = TrunkImage { normalized: &normalized, up: -Vector3::y(), depth: 4.1, depth_sigma: 0.1 };
            let poses = trunk.poses(&image);
            let angle = rotation::angle_between(&poses[0].camera_from_body.rotation, &turn);
            assert!(angle < 0.05, "{i}: {angle} rad off");
        }
    }

    #[test]
    fn poses_without_a_face_are_two_and_without_a_trunk_none() {
        let model = default_body();
        let trunk = Trunk::new(&model, &model.shaped(&Betas::zeros()));
        let (turn, mut normalized) = image_of(&model, &trunk, 1.0);
        for name in ["nose", "left_eye", "right_eye", "left_ear", "right_ear"] {
            normalized[model.landmark_index(name).unwrap()] = None;
        }
        let image = |normalized| TrunkImage { normalized, up: -Vector3::y(), depth: 4.0, depth_sigma: 0.1 };
        let poses = trunk.poses(&image(&normalized));
        let off = |pose: &TrunkPose| rotation::angle_between(&pose.camera_from_body.rotation, &turn);
        assert!(poses.len() >= 2 && poses.iter().any(|p| off(p) < 0.1) && poses.iter().any(|p| off(p) > 1.0));
        assert!(trunk.poses(&image(&vec![None; model.landmarks.len()])).is_empty());
    }
}
