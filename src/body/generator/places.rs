//! Rest positions of the joints and the detectors' points as functions of measured lengths.
//!
//! Joints have their anatomical positions, except at the ends of the trunk, where SMPL's layout differs: the pelvis joint
//! lies some 85 mm above the hip line, neck and head some 60 and 155 mm above the shoulder line (anatomy: the base of the
//! cervical spine at 100 mm, the condyles at 180 mm). Given for the left side and mirrored. Sources of the factors:
//! - ANSUR II heights and lengths ([`crate::body::anthropometry`]);
//! - de Leva 1996 (J. Biomech. 29:1223): the shoulder's centre lies 10.4 % of the upper arm below the acromion, the
//!   elbow's 4.3 % above the radiale; his forearm (elbow to wrist centre) ends 9 mm short of the stylion;
//! - Harrington et al. 2007 (J. Biomech. 40:595): a hip's distance from the midline is 0.33 times the pelvic width
//!   between the front iliac spines (0.875 of the bicristal breadth) + 7.3 mm;
//! - the plumb line of upright posture (Kendall): ear, shoulder, hip and knee in one frontal plane, the ankle assumed
//!   in it too;
//! - ball of the foot at 0.74 of the foot's length, the ankle's axis at 0.25 of it from the heel (ANSUR II ball of
//!   foot length; de Leva);
//! - eye height 111 mm below the crown, pupils 63 mm apart (ANSUR II); the other points of face and foot are our own
//!   estimates, to 10 mm.
//!
//! Known limits: arms hang at identity collars (the shoulder joints of a true T-pose lie 30 to 40 mm higher). Detector bias
//! is not included: it is reported as 30 to 50 mm at hip and knee (Needham et al. 2021), its direction differs by detector,
//! and the betas absorb it in the fit.

use crate::body::anthropometry::{Length, Measure, Measure::*, Population, VariedLength};
use crate::body::model::ShapeDirections;
use nalgebra::Vector3;

/// A rest position: x to the left, y up from the floor, z to the front.
pub(super) type Place = [Length; 3];

/// Mean of a rest position and its change per beta.
pub(super) struct VariedPlace {
    /// Position at beta 0, m.
    pub mean: Vector3<f64>,
    /// Change per beta, m.
    pub directions: ShapeDirections,
}

pub(super) fn length(constant: f64, terms: &[(f64, Measure)]) -> Length {
    Length { constant, terms: terms.to_vec() }
}

pub(super) fn fixed(constant: f64) -> Length {
    length(constant, &[])
}

/// A point on the trunk: a share of the way from the pelvis joint (0) to the neck joint (1), `z` metres in front.
pub(super) fn spine(share: f64, z: f64) -> Place {
    let y = length(0.0, &[(1.0 - share, TrochanterHeight), (0.05 * (1.0 - share), Stature), (share, CervicaleHeight)]);
    [fixed(0.0), y, fixed(z)]
}

/// A point on the arm: shares of upper arm, forearm and hand length, and `constant` metres, out from the shoulder joint.
pub(super) fn arm(upper_arm: f64, forearm: f64, hand: f64, constant: f64) -> Place {
    let x = length(
        -0.027 + constant,
        &[(0.5, BiacromialBreadth), (upper_arm, UpperArm), (forearm, Forearm), (hand, HandLength)],
    );
    [x, length(0.0, &[(1.0, AcromialHeight), (-0.104, UpperArm)]), fixed(0.0)]
}

/// A point on the leg's vertical axis at height `y`, `x` metres to the left of the hip.
pub(super) fn leg(y: Length, x: f64, z: Length) -> Place {
    [length(0.0073 + x, &[(0.33 * 0.875, BicristalBreadth)]), y, z]
}

/// A point on the head: measures `below` and `up` metres added to the crown's height.
pub(super) fn head(x: f64, below: &[(f64, Measure)], up: f64, z: f64) -> Place {
    let y: Vec<_> = [(1.0, Stature)].iter().chain(below).copied().collect();
    [fixed(x), length(up, &y), fixed(z)]
}

/// Distance of the head joint below the ear canals, m; the condyles, about which a head nods, are at 30 mm.
const HEAD_BELOW_EAR: f64 = 0.055;

/// Rest position of a joint on the midline or the left side, by SMPL's name without the side.
pub(super) fn joint_place(name: &str) -> Place {
    match name {
        "pelvis" => spine(0.0, 0.0),
        "spine1" => spine(0.22, -0.015),
        "spine2" => spine(0.48, -0.015),
        "spine3" => spine(0.60, -0.020),
        // 60 mm above the shoulder line, a third of the way from the acromions up to the lowest cervical vertebra.
        "neck" => [fixed(0.0), length(0.0, &[(0.64, AcromialHeight), (0.36, CervicaleHeight)]), fixed(-0.020)],
        "head" => head(0.0, &[(-1.0, TragionToTop)], -HEAD_BELOW_EAR, 0.0),
        // Between the inner end of the clavicle (25 mm) and SMPL's collar joint (some 75 mm).
        "collar" => [length(0.0, &[(0.13, BiacromialBreadth)]), length(-0.004, &[(1.0, AcromialHeight)]), fixed(0.0)],
        "shoulder" => arm(0.0, 0.0, 0.0, 0.0),
        "elbow" => arm(1.0 - 0.104 - 0.043, 0.0, 0.0, 0.0),
        "wrist" => arm(1.0 - 0.104, 1.0, 0.0, -0.009),
        "hand" => arm(1.0 - 0.104, 1.0, 0.45, -0.009),
        "hip" => leg(length(0.0, &[(1.0, TrochanterHeight)]), 0.0, fixed(0.0)),
        "knee" => leg(length(0.0, &[(1.0, KneeHeight)]), 0.0, fixed(0.0)),
        "ankle" => leg(length(0.0, &[(1.0, MalleolusHeight)]), 0.0, fixed(0.0)),
        _ => leg(fixed(0.020), 0.010, length(0.0, &[(0.49, FootLength)])), // foot: the ball
    }
}

/// Rest position of a point on the skin, on the midline or the left side.
pub(super) fn surface_place(name: &str) -> Option<Place> {
    let eye = |x: f64, z: f64| head(x, &[], -0.111, z);
    Some(match name {
        "head_top" => head(0.0, &[], 0.0, 0.0),
        "nose" => head(0.0, &[], -0.149, 0.120),
        "eye" => eye(0.0315, 0.085),
        "eye_inner" => eye(0.017, 0.088),
        "eye_outer" => eye(0.046, 0.078),
        "ear" => head(0.070, &[(-1.0, TragionToTop)], 0.0, 0.0),
        "mouth" => head(0.025, &[], -0.180, 0.100),
        "big_toe" => leg(fixed(0.015), -0.010, length(-0.005, &[(0.75, FootLength)])),
        "small_toe" => leg(fixed(0.012), 0.050, length(-0.005, &[(0.62, FootLength)])),
        "heel" => leg(fixed(0.020), 0.0, length(0.005, &[(-0.25, FootLength)])),
        // Knuckles relative to the palm; the palm faces the floor, so the thumb points to the front.
        "index" => on_hand(0.005, 0.025),
        "pinky" => on_hand(-0.010, -0.030),
        "thumb" => on_hand(-0.025, 0.045),
        _ => return None,
    })
}

fn on_hand(x: f64, z: f64) -> Place {
    let [px, py, _] = joint_place("hand");
    [Length { constant: px.constant + x, ..px }, py, fixed(z)]
}

/// Side and plain name: `left_knee` is (1, knee), `nose` is (1, nose), `right_knee` is (-1, knee).
pub(super) fn side_and_part(name: &str) -> (f64, &str) {
    match (name.strip_prefix("left_"), name.strip_prefix("right_")) {
        (Some(part), _) => (1.0, part),
        (_, Some(part)) => (-1.0, part),
        _ => (1.0, name),
    }
}

pub(super) fn varied(place: &Place, side: f64, population: &Population) -> VariedPlace {
    let [x, y, z]: [VariedLength; 3] = std::array::from_fn(|axis| place[axis].in_population(population));
    let directions =
        ShapeDirections::from_rows(&[x.per_beta.transpose() * side, y.per_beta.transpose(), z.per_beta.transpose()]);
    VariedPlace { mean: Vector3::new(side * x.mean, y.mean, z.mean), directions }
}
