//! Keypoint bias: the offset between a detector's keypoint and the body's landmark, one a kind of keypoint and session.
//!
//! Detectors are trained on points that annotators clicked: hips come out too high and too wide, shoulders on the skin
//! (30 to 50 mm at hip and knee: Needham et al., Scientific Reports 11, 2021). The offset is fixed in the frame of the
//! bone that the keypoint belongs to, the same for all people and frames, and mirrored between left and right:
//! $l = \sum_i [w_i p_i + G_i a_i] + G_b M o$ with $M = \mathrm{diag}(-1, 1, 1)$ for a right keypoint.

use super::model::{BodyModel, Landmark, LandmarkTerm, ShapeDirections};
use super::skeleton::{JOINT_COUNTERPARTS, KeypointConvention, PARENTS, chain_to_root};
use nalgebra::{Matrix3, Vector3};

/// Standard deviation of a joint keypoint's offset, sideways in the body at rest, m.
const SIGMAS_M: [(&str, f64); 7] = [
    ("hip", 0.025),
    ("shoulder", 0.025),
    ("neck", 0.020),
    ("knee", 0.015),
    ("elbow", 0.010),
    ("wrist", 0.010),
    ("ankle", 0.010),
];

/// Standard deviation of the offset of points of face and feet, which are seen directly, m.
const SURFACE_SIGMA_M: f64 = 0.008;

/// Standard deviation of a joint keypoint's offset upwards and forwards, m. The pose compensates for such an offset (longer
/// legs, more bent knees), so that smoothness alone decides it: with a wide prior, detections without any bias gave hips
/// 22 mm (standard deviation 7 mm) down the thigh.
const UPRIGHT_SIGMA_M: f64 = 3e-3;

/// Standard deviation of the sideways offset of points on the midline, m.
const MIDDLE_SIGMA_M: f64 = 1e-3;

/// Largest plausible bias in standard deviations sideways: 50 mm at the hip, 20 mm at elbow, wrist and ankle, the largest
/// distances that Needham et al. report. A larger offset indicates a body of other proportions.
const MAX_SIGMAS: f64 = 2.0;

/// Farthest that a bias can lie inward of a joint's centre, m: the accuracy to which bodies have these centres.
const INWARD: f64 = 0.010;

/// Joints whose bias the motion shows: their limbs turn about all axes. About a hinge (knee, elbow) or with little below it (ankle,
/// wrist) an offset sideways looks like a limb that is twisted.
const SEPARABLE: [&str; 2] = ["hip", "shoulder"];

/// A kind of keypoint: left and right keypoints of one name share one offset.
#[derive(Debug, Clone, PartialEq)]
pub struct OffsetKind {
    /// Name without its side.
    pub name: String,
    /// The bone that it belongs to (of a pair: the left one), by the joint at its start.
    pub joint: usize,
    /// Whether it is a joint rather than a point of the skin.
    pub is_joint: bool,
    /// Standard deviation of the offset's prior per axis, m.
    pub prior_sigma: Vector3<f64>,
    /// Whether the motion separates its bias from the body's proportions: limbs of hips and shoulders turn about all axes.
    pub can_be_biased: bool,
}

impl OffsetKind {
    /// Whether an offset can be a detector's bias: not too long, and not inward of the joint, since annotators click between the joint's
    /// centre and the outline.
    pub fn is_plausible(&self, offset: &Vector3<f64>) -> bool {
        offset.norm() <= MAX_SIGMAS * self.prior_sigma.x && offset.x >= -INWARD
    }

    /// Whether it lies on the midline, so that its offset is not sideways.
    pub fn is_on_midline(&self) -> bool {
        self.prior_sigma.x <= MIDDLE_SIGMA_M
    }
}

/// The offset of one landmark.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LandmarkOffset {
    /// Index in [`OffsetTable::kinds`].
    pub kind: usize,
    /// The joint in whose frame the offset is fixed.
    pub joint: usize,
    /// `bone_from_offset`: the identity, or the reflection for a right keypoint.
    pub mirror: Matrix3<f64>,
}

/// The offsets of one convention's keypoints on one body.
#[derive(Debug, Clone, PartialEq)]
pub struct OffsetTable {
    /// Every kind of keypoint.
    pub kinds: Vec<OffsetKind>,
    /// By landmark of the model.
    of_landmarks: Vec<Option<LandmarkOffset>>,
}

impl OffsetTable {
    /// No offsets.
    pub fn empty(model: &BodyModel) -> Self {
        Self { kinds: Vec::new(), of_landmarks: vec![None; model.landmarks.len()] }
    }

    /// The offsets of a convention's landmarks; none for SMPL's own joints, which do not come from a detector.
    pub fn new(model: &BodyModel, convention: KeypointConvention) -> Self {
        let mut table = Self::empty(model);
        if convention == KeypointConvention::Smpl24 {
            return table;
        }
        for landmark in model.landmarks_of(convention).into_iter().flatten() {
            let shown = &model.landmarks[landmark];
            let (name, side) = match (shown.name.strip_prefix("left_"), shown.name.strip_prefix("right_")) {
                (Some(name), _) => (name, Side::Left),
                (_, Some(name)) => (name, Side::Right),
                _ => (shown.name.as_str(), Side::Middle),
            };
            let joint = bone_of(shown);
            let known = table.kinds.iter().position(|kind| kind.name == name);
            let kind = known.unwrap_or_else(|| {
                let joint = if side == Side::Right { JOINT_COUNTERPARTS[joint] } else { joint };
                let prior_sigma = prior_sigma(name, side);
                let can_be_biased = SEPARABLE.contains(&name);
                table.kinds.push(OffsetKind {
                    name: name.to_owned(),
                    joint,
                    is_joint: is_joint(shown),
                    prior_sigma,
                    can_be_biased,
                });
                table.kinds.len() - 1
            });
            let mirror = Matrix3::from_diagonal(&Vector3::new(if side == Side::Right { -1.0 } else { 1.0 }, 1.0, 1.0));
            table.of_landmarks[landmark] = Some(LandmarkOffset { kind, joint, mirror });
        }
        table
    }

    /// The offset of a landmark, by index in the model.
    pub fn of_landmark(&self, landmark: usize) -> Option<&LandmarkOffset> {
        self.of_landmarks.get(landmark)?.as_ref()
    }

    /// The model with its landmarks moved to the detector's keypoints; `offsets` by kind, m.
    pub fn applied(&self, model: &BodyModel, offsets: &[Vector3<f64>]) -> BodyModel {
        let mut moved = model.clone();
        for (landmark, own) in moved.landmarks.iter_mut().zip(&self.of_landmarks) {
            if let Some(LandmarkOffset { kind, joint, mirror }) = *own {
                let (offset, offset_directions) = (mirror * offsets[kind], ShapeDirections::zeros());
                landmark.terms.push(LandmarkTerm { joint, weight: 0.0, offset, offset_directions });
            }
        }
        moved
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Side {
    Left,
    Right,
    Middle,
}

fn prior_sigma(name: &str, side: Side) -> Vector3<f64> {
    let of_joint = SIGMAS_M.iter().find(|(part, _)| name.ends_with(part)).map(|(_, sigma)| *sigma);
    let (sigma, upright) = of_joint.map_or((SURFACE_SIGMA_M, SURFACE_SIGMA_M), |sigma| (sigma, UPRIGHT_SIGMA_M));
    let lateral = if side == Side::Middle { MIDDLE_SIGMA_M } else { sigma };
    Vector3::new(lateral, upright, upright)
}

fn is_joint(landmark: &Landmark) -> bool {
    landmark.terms.iter().all(|term| term.offset == Vector3::zeros())
}

/// The joint at the start of the bone that a landmark belongs to: of a joint the parent, of a midpoint the common ancestor
/// of both parents, of a point of the skin the joint with the largest weight.
fn bone_of(landmark: &Landmark) -> usize {
    if is_joint(landmark) {
        let parents = landmark.terms.iter().map(|term| PARENTS[term.joint].unwrap_or(term.joint));
        return parents.reduce(common_ancestor).unwrap_or(0);
    }
    let heaviest = landmark.terms.iter().max_by(|a, b| a.weight.total_cmp(&b.weight));
    heaviest.map_or(0, |term| term.joint)
}

fn common_ancestor(a: usize, b: usize) -> usize {
    chain_to_root(a).find(|joint| chain_to_root(b).any(|other| other == *joint)).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::super::default_body::default_body;
    use super::super::kinematics::{Pose, landmark_position, posed};
    use super::super::model::Betas;
    use super::super::skeleton::JOINT_NAMES;
    use super::*;

    fn place(model: &BodyModel, name: &str) -> Vector3<f64> {
        let body = model.shaped(&Betas::zeros());
        landmark_position(model, &body, &posed(&body, &Pose::rest()), model.landmark_index(name).unwrap())
    }

    #[test]
    fn an_offset_moves_both_sides_outward() {
        let model = default_body();
        let table = OffsetTable::new(&model, KeypointConvention::Body25);
        let mut offsets = vec![Vector3::zeros(); table.kinds.len()];
        let hip = table.kinds.iter().position(|kind| kind.name == "hip").unwrap();
        offsets[hip] = Vector3::new(0.04, 0.01, 0.0);
        let moved = table.applied(&model, &offsets);
        for (name, side) in [("left_hip", 1.0), ("right_hip", -1.0)] {
            let shift = place(&moved, name) - place(&model, name);
            assert!((shift - Vector3::new(0.04 * side, 0.01, 0.0)).norm() < 1e-12);
        }
        assert_eq!(place(&moved, "left_knee"), place(&model, "left_knee"));
    }

    /// A veto over all axes at once kept hips from being corrected whose offset upwards was 6 mm.
    #[test]
    fn a_bias_is_outward_and_no_longer_than_reported() {
        let table = OffsetTable::new(&default_body(), KeypointConvention::Body25);
        let hip = table.kinds.iter().find(|kind| kind.name == "hip").unwrap();
        assert!(hip.can_be_biased && hip.is_plausible(&Vector3::new(0.04, 0.01, 0.0)));
        assert!(!hip.is_plausible(&Vector3::new(0.06, 0.0, 0.0)));
        assert!(!hip.is_plausible(&Vector3::new(-0.04, 0.0, 0.0)));
        assert!(table.kinds.iter().all(|kind| kind.is_joint || !kind.can_be_biased));
    }

    #[test]
    fn keypoints_belong_to_the_bone_above_them() {
        let model = default_body();
        let table = OffsetTable::new(&model, KeypointConvention::Body25);
        let bone = |name: &str| JOINT_NAMES[table.kinds.iter().find(|kind| kind.name == name).unwrap().joint];
        let found = ["hip", "knee", "ankle", "shoulder", "elbow", "wrist", "neck", "mid_hip", "nose", "heel"].map(bone);
        let expected = [
            "pelvis", "left_hip", "left_knee", "left_collar", "left_shoulder", "left_elbow", "spine3", "pelvis",
            "head", "left_ankle",
        ];
        assert_eq!(found, expected);
        assert!(OffsetTable::new(&model, KeypointConvention::Smpl24).kinds.is_empty());
    }
}
