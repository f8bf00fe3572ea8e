//! A first motion in closed form: shape from bone lengths, the trunk by rigid alignment, limbs by their directions.

use super::observations::{Observations, PointObservation};
use super::terms::unknowns::MotionState;
use crate::body::joint_ranges::joint_ranges_of;
use crate::body::kinematics::{Pose, landmark_position, posed};
use crate::body::model::{Betas, BodyModel, ShapedBody};
use crate::body::skeleton::{JOINT_NAMES, N_JOINTS};
use crate::geometry::similarity::{ScaleMode, similarity_from_points};
use crate::geometry::{Rigid, rotation};
use crate::optim::robust::median;
use nalgebra::{Matrix3, SMatrix, Vector3};

/// Points of one frame by landmark, world, m.
pub(super) type LandmarkPoints = Vec<Option<Vector3<f64>>>;

/// The first motion of one person; `None` when no frame shows the trunk well enough to determine its rotation.
pub(super) fn initial_motion(model: &BodyModel, observations: &Observations) -> Option<MotionState> {
    let points: Vec<LandmarkPoints> = observations.points.iter().map(|points| by_landmark(model, points)).collect();
    let betas = betas_from_bone_lengths(model, &points);
    let body = model.shaped(&betas);
    let trunk: Vec<Option<Rigid>> = points.iter().map(|p| trunk_placement(model, &body, p)).collect();
    let known: Vec<PartialPose> = points
        .iter()
        .zip(&trunk)
        .map(|(p, trunk)| trunk.map_or_else(PartialPose::default, |trunk| limbs(model, &body, p, &trunk)))
        .collect();
    let translations = filled_translations(&known.iter().map(|k| k.translation).collect::<Vec<_>>())?;
    let rest = joint_ranges_of(model).map(|range| rotation::exp(&range.rest));
    let mut poses = vec![Pose::rest(); points.len()];
    for (pose, translation) in poses.iter_mut().zip(translations) {
        pose.translation = translation;
    }
    for joint in 0..N_JOINTS {
        let rotations = filled_rotations(&known.iter().map(|k| k.rotations[joint]).collect::<Vec<_>>(), &rest[joint]);
        for (pose, rotation) in poses.iter_mut().zip(rotations) {
            pose.rotations[joint] = rotation;
        }
    }
    Some(MotionState { betas, poses })
}

fn by_landmark(model: &BodyModel, points: &[PointObservation]) -> LandmarkPoints {
    let mut by_landmark = vec![None; model.landmarks.len()];
    for point in points {
        by_landmark[point.landmark] = Some(point.position);
    }
    by_landmark
}

/// Pairs of landmarks whose distance determines the shape, with the standard deviation (m) of a median length: the trunk
/// bends, and detectors disagree most about hips and shoulders.
const SHAPE_BONES: [(&str, &str, f64); 12] = [
    ("left_hip", "left_knee", 0.02),
    ("right_hip", "right_knee", 0.02),
    ("left_knee", "left_ankle", 0.015),
    ("right_knee", "right_ankle", 0.015),
    ("left_shoulder", "left_elbow", 0.015),
    ("right_shoulder", "right_elbow", 0.015),
    ("left_elbow", "left_wrist", 0.015),
    ("right_elbow", "right_wrist", 0.015),
    ("left_hip", "right_hip", 0.03),
    ("left_shoulder", "right_shoulder", 0.03),
    ("left_shoulder", "left_hip", 0.03),
    ("right_shoulder", "right_hip", 0.03),
];

/// Betas that minimise `sum ((median length - length(beta)) / sigma)^2 + |beta|^2`: three Gauss-Newton steps, since rest
/// lengths are nearly linear in the betas.
fn betas_from_bone_lengths(model: &BodyModel, points: &[LandmarkPoints]) -> Betas {
    let mut measured: Vec<(usize, usize, f64, f64)> = Vec::new();
    for (a, b, sigma) in SHAPE_BONES {
        let (Some(a), Some(b)) = (model.landmark_index(a), model.landmark_index(b)) else { continue };
        let mut lengths: Vec<f64> = points.iter().filter_map(|p| Some((p[a]? - p[b]?).norm())).collect();
        if let Some(length) = median(&mut lengths) {
            measured.push((a, b, length, sigma));
        }
    }
    let rest_length = |betas: &Betas, a: usize, b: usize| {
        let body = model.shaped(betas);
        let skeleton = posed(&body, &Pose::rest());
        (landmark_position(model, &body, &skeleton, a) - landmark_position(model, &body, &skeleton, b)).norm()
    };
    let mut betas = Betas::zeros();
    for _ in 0..3 {
        let mut hessian = SMatrix::<f64, 10, 10>::identity();
        let mut gradient = betas;
        for &(a, b, length, sigma) in &measured {
            let slope = Betas::from_fn(|k, _| {
                let step = Betas::ith(k, 1e-3);
                (rest_length(&(betas + step), a, b) - rest_length(&(betas - step), a, b)) / (2e-3 * sigma)
            });
            hessian += slope * slope.transpose();
            gradient += slope * ((rest_length(&betas, a, b) - length) / sigma);
        }
        if let Some(factor) = hessian.cholesky() {
            betas -= factor.solve(&gradient);
        }
    }
    betas
}

/// Landmarks that move little against the pelvis.
const TRUNK: [&str; 9] =
    ["left_hip", "right_hip", "mid_hip", "left_shoulder", "right_shoulder", "neck", "pelvis", "spine2", "spine3"];

/// `world_from_rest` of the trunk by least squares; `None` with fewer than three points well off one line.
pub(super) fn trunk_placement(model: &BodyModel, body: &ShapedBody, points: &LandmarkPoints) -> Option<Rigid> {
    let rest = posed(body, &Pose::rest());
    let pairs = TRUNK.iter().filter_map(|name| model.landmark_index(name)).filter_map(|l| {
        let point = points[l]?;
        Some((landmark_position(model, body, &rest, l), point))
    });
    let (in_rest, in_world): (Vec<_>, Vec<_>) = pairs.unzip();
    if width_across(&in_rest) < MIN_TRUNK_WIDTH {
        return None;
    }
    let world_from_rest = similarity_from_points(&in_rest, &in_world, ScaleMode::Unit).ok()?;
    Some(Rigid { rotation: world_from_rest.rotation, translation: world_from_rest.translation })
}

/// Least spread (m, root mean square); with less, noise determines the rotation about the long direction.
const MIN_TRUNK_WIDTH: f64 = 0.05;

/// Root mean square distance of points from their centre along their second longest direction, m.
fn width_across(points: &[Vector3<f64>]) -> f64 {
    let n = points.len().max(1) as f64;
    let center = points.iter().sum::<Vector3<f64>>() / n;
    let scatter: Matrix3<f64> = points.iter().map(|p| (p - center) * (p - center).transpose()).sum();
    let mut variances: [f64; 3] = (scatter / n).symmetric_eigenvalues().into();
    variances.sort_by(f64::total_cmp);
    variances[1].max(0.0).sqrt()
}

/// The closed-form part of one frame's pose.
#[derive(Clone)]
struct PartialPose {
    translation: Option<Vector3<f64>>,
    rotations: [Option<Matrix3<f64>>; N_JOINTS],
}

impl Default for PartialPose {
    fn default() -> Self {
        Self { translation: None, rotations: [None; N_JOINTS] }
    }
}

/// A limb of two bones: root, middle and end joint, and the direction of the end when the middle joint bends.
pub(super) struct Limb {
    pub joints: [&'static str; 3],
    bends_to: Vector3<f64>,
}

pub(super) fn limb_list() -> [Limb; 4] {
    let leg = |joints| Limb { joints, bends_to: -Vector3::z() };
    let arm = |joints| Limb { joints, bends_to: Vector3::z() };
    [
        leg(["left_hip", "left_knee", "left_ankle"]),
        leg(["right_hip", "right_knee", "right_ankle"]),
        arm(["left_shoulder", "left_elbow", "left_wrist"]),
        arm(["right_shoulder", "right_elbow", "right_wrist"]),
    ]
}

/// Sine of the bend above which a limb's two bones determine the rotation of the upper one about itself.
const MIN_BEND: f64 = 0.35;

/// Root and limb rotations of one frame, spine and collars taken straight.
fn limbs(model: &BodyModel, body: &ShapedBody, points: &LandmarkPoints, world_from_trunk: &Rigid) -> PartialPose {
    let mut pose = PartialPose::default();
    let pelvis = body.rest_joints[0];
    pose.rotations[0] = Some(world_from_trunk.rotation);
    pose.translation = Some(world_from_trunk.transform(&pelvis) - pelvis);
    let trunk_from_world = world_from_trunk.rotation.transpose();
    for limb in limb_list() {
        let point = |name: &str| model.landmark_index(name).and_then(|l| points[l]);
        let Some(middle_point) = point(limb.joints[1]) else { continue };
        let root = body.rest_joints[joint_index(limb.joints[0])];
        let root_point = point(limb.joints[0]).unwrap_or_else(|| world_from_trunk.transform(&root));
        let upper = trunk_from_world * (middle_point - root_point);
        let lower = point(limb.joints[2]).map(|end_point| trunk_from_world * (end_point - middle_point));
        let (by_root, by_middle) = limb_rotations(body, &limb, &upper, lower.as_ref());
        pose.rotations[joint_index(limb.joints[0])] = Some(by_root);
        pose.rotations[joint_index(limb.joints[1])] = by_middle;
    }
    pose
}

/// Rotations of a limb's first two joints that point its bones along `upper` and `lower` (the trunk's frame, any
/// length); no rotation of the second where `lower` is missing.
pub(super) fn limb_rotations(
    body: &ShapedBody,
    limb: &Limb,
    upper: &Vector3<f64>,
    lower: Option<&Vector3<f64>>,
) -> (Matrix3<f64>, Option<Matrix3<f64>>) {
    let [root, middle, end] = limb.joints.map(|name| body.rest_joints[joint_index(name)]);
    let (upper_rest, lower_rest) = (middle - root, end - middle);
    let mut turn = rotation::rotation_between(&upper_rest, upper);
    let lower_turn = lower.map(|lower| {
        turn *= turn_about_bone(&upper_rest, &limb.bends_to, &(turn.transpose() * lower));
        rotation::rotation_between(&lower_rest, &(turn.transpose() * lower))
    });
    (turn, lower_turn)
}

pub(super) fn joint_index(name: &str) -> usize {
    JOINT_NAMES.iter().position(|n| *n == name).expect("limbs are listed by names of joints")
}

/// Rotation about the upper bone that turns the bend of the lower one towards `bends_to`; the identity where a straight limb
/// leaves it undetermined.
fn turn_about_bone(upper: &Vector3<f64>, bends_to: &Vector3<f64>, lower: &Vector3<f64>) -> Matrix3<f64> {
    let (Some(axis), Some(lower)) = (upper.try_normalize(1e-9), lower.try_normalize(1e-9)) else {
        return Matrix3::identity();
    };
    let across = |v: &Vector3<f64>| v - axis * axis.dot(v);
    let (target, current) = (across(bends_to), across(&lower));
    if current.norm() < MIN_BEND {
        return Matrix3::identity();
    }
    rotation::exp(&(axis * axis.dot(&target.cross(&current)).atan2(target.dot(&current))))
}

/// The known frames on either side of `t`, and the share of the way from the first to the second at `t`; where only one side
/// is known it counts as both.
fn neighbours(known: &[usize], t: usize) -> Option<(usize, usize, f64)> {
    let after = known.partition_point(|&k| k < t);
    let next = known.get(after).or(known.last())?;
    let before = after.checked_sub(1).map_or(next, |i| &known[i]);
    let share = if next > before { (t as f64 - *before as f64) / (next - before) as f64 } else { 0.0 };
    Some((*before, *next, share.clamp(0.0, 1.0)))
}

fn filled_translations(known: &[Option<Vector3<f64>>]) -> Option<Vec<Vector3<f64>>> {
    let frames: Vec<usize> = (0..known.len()).filter(|&t| known[t].is_some()).collect();
    let between = |t: usize| {
        let (a, b, share) = neighbours(&frames, t)?;
        Some(known[a]? * (1.0 - share) + known[b]? * share)
    };
    (0..known.len()).map(between).collect()
}

/// With those between known frames; `rest` without any.
pub(super) fn filled_rotations(known: &[Option<Matrix3<f64>>], rest: &Matrix3<f64>) -> Vec<Matrix3<f64>> {
    let frames: Vec<usize> = (0..known.len()).filter(|&t| known[t].is_some()).collect();
    let between = |t: usize| {
        let (a, b, share) = neighbours(&frames, t)?;
        Some(rotation::towards(&known[a]?, &known[b]?, share))
    };
    (0..known.len()).map(|t| between(t).unwrap_or(*rest)).collect()
}
