//! The points of hands and face that are rigid with a joint of the body, as landmarks of the body fit.

use super::geometry::HandShape;
use super::points::{FACE_POINTS, HandPoint, face_keypoints, hand_keypoints, hand_points};
use super::{FINGERS, Side};
use crate::body::model::{Betas, BodyModel, Landmark, LandmarkTerm};
use crate::body::shape::ShapeDirections;
use crate::body::skeleton::{KeypointConvention, PARENTS};
use nalgebra::{RowSVector, Vector3};

/// Name of the landmark of a point that moves with the wrist: the wrist itself as hand detectors see it, and the first joint
/// of each finger.
fn name(side: Side, point: HandPoint) -> Option<String> {
    match point {
        HandPoint::Wrist => Some(format!("{}_hand_root", side.name())),
        HandPoint::Joint { finger, place: 0 } => Some(format!("{}_{}1", side.name(), FINGERS[finger])),
        HandPoint::Joint { .. } => None,
    }
}

/// Size of a person's hands over those of the average adult: as the body's own hand joint lies farther from the wrist or less.
pub fn relative_hand_size(model: &BodyModel, side: Side, betas: &Betas) -> f64 {
    1.0 + (size_by_betas(model, side) * betas).x
}

/// Derivative of [`relative_hand_size`] by the betas.
fn size_by_betas(model: &BodyModel, side: Side) -> RowSVector<f64, 10> {
    let wrist = side.wrist();
    let Some(hand) = PARENTS.iter().position(|parent| *parent == Some(wrist)) else { return RowSVector::zeros() };
    let bone = model.rest_joints[hand] - model.rest_joints[wrist];
    let change = model.shape_directions[hand] - model.shape_directions[wrist];
    bone.transpose() * change / bone.norm_squared().max(f64::MIN_POSITIVE)
}

/// The model with the landmarks of both hands' rigid points; its own come first, and stay what they are.
pub fn with_hand_landmarks(model: &BodyModel) -> BodyModel {
    let mut own = model.clone();
    for side in Side::BOTH {
        let shape = HandShape::average(side);
        let by_betas = size_by_betas(model, side);
        for point in hand_points() {
            let Some(name) = name(side, point) else { continue };
            let offset = match point {
                HandPoint::Wrist => Vector3::zeros(),
                HandPoint::Joint { finger, place } => shape.places[finger][place],
            };
            let offset_directions: ShapeDirections = offset * by_betas;
            let term = LandmarkTerm { joint: side.wrist(), weight: 1.0, offset, offset_directions };
            own.landmarks.push(Landmark { name, terms: vec![term] });
        }
    }
    own
}

/// Keypoints of hands and face of a convention with the landmarks of the model that they show; none where the model has no
/// landmarks of hands.
pub fn rigid_points(model: &BodyModel, convention: KeypointConvention) -> Vec<(usize, usize)> {
    let of_hands = Side::BOTH.into_iter().flat_map(|side| {
        let keypoints = hand_keypoints(convention, side).into_iter().flatten();
        keypoints.zip(hand_points()).filter_map(move |(keypoint, point)| Some((keypoint, name(side, point)?)))
    });
    let known = |(keypoint, name): (usize, String)| Some((keypoint, model.landmark_index(&name)?));
    let mut points: Vec<(usize, usize)> = of_hands.filter_map(known).collect();
    if !points.is_empty() {
        let face = face_keypoints(convention).unwrap_or_default();
        let of_face = |(place, name): &(usize, &str)| Some((face.clone().nth(*place)?, model.landmark_index(name)?));
        points.extend(FACE_POINTS.iter().filter_map(of_face));
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::default_body;
    use crate::body::kinematics::{Pose, landmark_position, posed};
    use crate::geometry::rotation::exp;

    #[test]
    fn knuckles_turn_with_the_wrist_and_the_body_stays() {
        let model = default_body();
        let with_hands = with_hand_landmarks(&model);
        assert_eq!(with_hands.landmarks[..model.landmarks.len()], model.landmarks);
        let convention = KeypointConvention::CocoWholebody133;
        assert!(rigid_points(&model, convention).is_empty());
        assert_eq!(rigid_points(&with_hands, convention).len(), 18);
        for (other, n) in [(KeypointConvention::Body25Hands, 12), (KeypointConvention::Halpe136, 18)] {
            assert_eq!(rigid_points(&with_hands, other).len(), n);
        }
        let corner = with_hands.landmark_index("left_mouth").unwrap();
        assert!(rigid_points(&with_hands, KeypointConvention::Halpe136).contains(&(26 + 54, corner)));
        assert!(rigid_points(&with_hands, KeypointConvention::Halpe26).is_empty());
        let mut pose = Pose::rest();
        pose.rotations[20] = exp(&Vector3::new(0.7, 0.0, 0.0));
        let betas = Betas::from_fn(|i, _| 0.2 * i as f64 - 0.5);
        let body = with_hands.shaped(&betas);
        let skeleton = posed(&body, &pose);
        let place =
            |name: &str| landmark_position(&with_hands, &body, &skeleton, with_hands.landmark_index(name).unwrap());
        let size = relative_hand_size(&model, Side::Left, &betas);
        let expected = skeleton.rotations[20] * HandShape::average(Side::Left).places[0][0] * size;
        assert!((place("left_index1") - place("left_hand_root") - expected).norm() < 1e-12);
        assert_eq!(place("left_hand_root"), skeleton.joints[20]);
    }
}
