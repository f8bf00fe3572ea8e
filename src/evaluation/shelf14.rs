//! Conversion of every skeleton to the 14 joints of the Shelf and Campus annotation, on which pose errors are defined.

use crate::body::skeleton::{JOINT_NAMES, KeypointConvention};
use nalgebra::Vector3;

/// Number of joints.
pub const N_SHELF: usize = 14;

/// Names of the joints, in order.
pub const SHELF_NAMES: [&str; N_SHELF] = [
    "R_ankle", "R_knee", "R_hip", "L_hip", "L_knee", "L_ankle", "R_wrist", "R_elbow", "R_shoulder", "L_shoulder",
    "L_elbow", "L_wrist", "bottom_head", "top_head",
];

/// Number of limb joints, which come first.
pub const N_LIMB: usize = 12;
/// Index of the right hip.
pub const RIGHT_HIP: usize = 2;
/// Index of the left hip.
pub const LEFT_HIP: usize = 3;
const RIGHT_SHOULDER: usize = 8;
const LEFT_SHOULDER: usize = 9;
/// Index of the joint between neck and head.
pub const BOTTOM_HEAD: usize = 12;
const TOP_HEAD: usize = 13;

/// A point that may be missing.
pub type Point = Option<Vector3<f64>>;
/// The 14 joints of a person, metres.
pub type Shelf14 = [Point; N_SHELF];

/// Skeleton of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Skeleton {
    /// The 14 joints, possibly followed by others.
    Shelf,
    /// A keypoint convention.
    Keypoints(KeypointConvention),
}

impl Skeleton {
    /// The skeleton with these joint names; `None` for unknown names.
    pub fn from_names(names: &[String]) -> Option<Self> {
        if names.len() >= N_SHELF && names.iter().zip(SHELF_NAMES).all(|(a, b)| a == b) {
            return Some(Self::Shelf);
        }
        let same =
            |c: &KeypointConvention| names.len() == c.names().len() && names.iter().zip(c.names()).all(|(a, b)| a == b);
        KeypointConvention::ALL.into_iter().find(same).map(Self::Keypoints)
    }
}

/// Converts a person of `skeleton` to the 14 joints; `points`: one entry per joint of it, metres; `up`: unit vector of the
/// world.
///
/// Limbs are copied. Detectors have no head joints: with S the midpoint of the shoulders and E that of the ears (one ear,
/// else the nose), bottom head is `S + (E - S) / 2` and top head lies 0.125 m ahead of it (`up` x shoulder line) and 0.145 m
/// above it: the rule of the usual Shelf evaluation. SMPL: midpoint of neck and head, and 0.16 m beyond the head.
pub fn to_shelf14(points: &[Point], skeleton: Skeleton, up: &Vector3<f64>) -> Shelf14 {
    let Skeleton::Keypoints(convention) = skeleton else {
        return std::array::from_fn(|j| points.get(j).copied().flatten());
    };
    let named = |name: &str| convention.index_of(name).and_then(|k| points.get(k).copied().flatten());
    let mut shelf: Shelf14 = [None; N_SHELF];
    for (j, name) in SHELF_NAMES.iter().enumerate().take(N_LIMB) {
        let (side, joint) = name.split_at(2);
        shelf[j] = named(&format!("{}{joint}", if side == "R_" { "right_" } else { "left_" }));
    }
    if convention == KeypointConvention::Smpl24 {
        smpl_head(&mut shelf, named(JOINT_NAMES[12]), named(JOINT_NAMES[15]));
    } else {
        detector_head(&mut shelf, [named("left_ear"), named("right_ear")], named("nose"), up);
    }
    shelf
}

fn smpl_head(shelf: &mut Shelf14, neck: Point, head: Point) {
    if let (Some(neck), Some(head)) = (neck, head) {
        let along = (head - neck) / ((head - neck).norm() + 1e-12);
        shelf[BOTTOM_HEAD] = Some(0.5 * (neck + head));
        shelf[TOP_HEAD] = Some(head + 0.16 * along);
    }
}

fn detector_head(shelf: &mut Shelf14, ears: [Point; 2], nose: Point, up: &Vector3<f64>) {
    let middle = match ears {
        [Some(left), Some(right)] => Some(0.5 * (left + right)),
        [left, right] => left.or(right).or(nose),
    };
    if let (Some(right), Some(left), Some(face)) = (shelf[RIGHT_SHOULDER], shelf[LEFT_SHOULDER], middle) {
        let shoulders = 0.5 * (right + left);
        let bottom = shoulders + 0.5 * (face - shoulders);
        let ahead = up.cross(&(right - left)).try_normalize(1e-9).unwrap_or_else(Vector3::zeros);
        shelf[BOTTOM_HEAD] = Some(bottom);
        shelf[TOP_HEAD] = Some(bottom + 0.125 * ahead + 0.145 * up);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(convention: KeypointConvention) -> Vec<String> {
        convention.names().iter().map(|n| (*n).to_owned()).collect()
    }

    #[test]
    fn converts_every_convention_to_all_joints() {
        for convention in KeypointConvention::ALL {
            let skeleton = Skeleton::from_names(&names(convention)).unwrap();
            // Conventions that differ in their hands alone have the same names.
            let same = |skeleton| matches!(skeleton, Skeleton::Keypoints(found) if found.names() == convention.names());
            assert!(same(skeleton), "{}", convention.name());
            let points: Vec<Point> =
                (0..convention.names().len()).map(|k| Some(Vector3::new(k as f64, 0.1 * k as f64, 1.0))).collect();
            assert!(to_shelf14(&points, skeleton, &Vector3::y()).iter().all(Option::is_some), "{}", convention.name());
        }
        assert_eq!(Skeleton::from_names(&["tail".to_owned()]), None);
    }

    #[test]
    fn head_lies_ahead_of_and_above_the_shoulders() {
        let coco = KeypointConvention::Coco17;
        let mut points: Vec<Point> = vec![None; 17];
        let mut set = |name: &str, p: [f64; 3]| points[coco.index_of(name).unwrap()] = Some(Vector3::from(p));
        set("left_shoulder", [0.2, 1.4, 0.0]);
        set("right_shoulder", [-0.2, 1.4, 0.0]);
        set("right_ear", [0.0, 1.6, 0.0]);
        let shelf = to_shelf14(&points, Skeleton::Keypoints(coco), &Vector3::y());
        assert!((shelf[BOTTOM_HEAD].unwrap() - Vector3::new(0.0, 1.5, 0.0)).norm() < 1e-12);
        // Left is +x and up is +y: the person faces +z.
        assert!((shelf[TOP_HEAD].unwrap() - Vector3::new(0.0, 1.645, 0.125)).norm() < 1e-12);
        assert_eq!(shelf[0], None);
    }
}
