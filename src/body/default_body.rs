//! The default adult body: where the joints and the detectors' points lie, in terms of measured lengths.
//!
//! Joints are put at their anatomical places, but for the pelvis joint, which lies some 85 mm above the hip line as in
//! SMPL's convention. Written for the left side and mirrored. Sources of the factors:
//! - ANSUR II heights and lengths ([`super::anthropometry`]);
//! - de Leva 1996 (J. Biomech. 29:1223): the shoulder's centre lies 10.4 % of the upper arm below the acromion, the
//!   elbow's 4.3 % above the radiale; his forearm (elbow to wrist centre) ends 9 mm short of the stylion;
//! - Harrington et al. 2007 (J. Biomech. 40:595): a hip's distance from the midline is 0.33 times the pelvic width
//!   between the front iliac spines (0.875 of the bicristal breadth) + 7.3 mm;
//! - the plumb line of upright posture (Kendall): ear, shoulder, hip and knee in one frontal plane, the ankle taken
//!   with them;
//! - ball of the foot at 0.74 of the foot's length, the ankle's axis at 0.25 of it from the heel (ANSUR II ball of
//!   foot length; de Leva);
//! - eye height 111 mm below the crown, pupils 63 mm apart (ANSUR II); the other points of face and foot are own
//!   estimates, good to 10 mm.
//!
//! Known limits: arms hang at identity collars (the shoulder joints of a true T-pose lie 30 to 40 mm higher). No
//! detector bias is built in: reported as 30 to 50 mm at hip and knee (Needham et al. 2021), its direction differs by
//! detector; the fit takes it up in the betas.

use super::anthropometry::{Length, Measure, Measure::*, Population, VariedLength};
use super::model::{BodyModel, Landmark, LandmarkTerm, NECK_JOINT, ShapeDirections};
use super::skeleton::{JOINT_NAMES, KeypointConvention, N_JOINTS};
use nalgebra::Vector3;
use std::collections::BTreeSet;

/// A place in the rest pose: x to the left, y up from the floor, z to the front.
type Place = [Length; 3];

/// The place's mean and its change per beta.
struct VariedPlace {
    mean: Vector3<f64>,
    directions: ShapeDirections,
}

fn length(constant: f64, terms: &[(f64, Measure)]) -> Length {
    Length { constant, terms: terms.to_vec() }
}

fn fixed(constant: f64) -> Length {
    length(constant, &[])
}

/// A point on the trunk, a share of the way from the pelvis joint (0) to the neck joint (1), `z` in front.
fn spine(share: f64, z: f64) -> Place {
    let y = length(0.0, &[(1.0 - share, TrochanterHeight), (0.05 * (1.0 - share), Stature), (share, CervicaleHeight)]);
    [fixed(0.0), y, fixed(z)]
}

/// A point on the arm, `factors` of upper arm, forearm and hand length out from the shoulder joint.
fn arm(upper_arm: f64, forearm: f64, hand: f64, constant: f64) -> Place {
    let x = length(
        -0.027 + constant,
        &[(0.5, BiacromialBreadth), (upper_arm, UpperArm), (forearm, Forearm), (hand, HandLength)],
    );
    [x, length(0.0, &[(1.0, AcromialHeight), (-0.104, UpperArm)]), fixed(0.0)]
}

/// A point on the leg's vertical axis at height `y`, `x` to the left of the hip.
fn leg(y: Length, x: f64, z: Length) -> Place {
    [length(0.0073 + x, &[(0.33 * 0.875, BicristalBreadth)]), y, z]
}

/// A point on the head, `below` the crown.
fn head(x: f64, below: &[(f64, Measure)], up: f64, z: f64) -> Place {
    let y: Vec<_> = [(1.0, Stature)].iter().chain(below).copied().collect();
    [fixed(x), length(up, &y), fixed(z)]
}

/// Rest place of a midline joint or a left one, by SMPL's name without the side.
fn joint_place(name: &str) -> Place {
    match name {
        "pelvis" => spine(0.0, 0.0),
        "spine1" => spine(0.22, -0.015),
        "spine2" => spine(0.48, -0.015),
        "spine3" => spine(0.60, -0.020),
        "neck" => spine(1.0, -0.020),
        // The occipital condyles, about which the head nods, lie some 30 mm below the ear canal.
        "head" => head(0.0, &[(-1.0, TragionToTop)], -0.030, 0.0),
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

/// The joint that carries a surface point and the point's rest place, for the midline and the left side.
fn surface_place(name: &str) -> Option<(&'static str, Place)> {
    let eye = |x: f64, z: f64| head(x, &[], -0.111, z);
    Some(match name {
        "head_top" => ("head", head(0.0, &[], 0.0, 0.0)),
        "nose" => ("head", head(0.0, &[], -0.149, 0.120)),
        "eye" => ("head", eye(0.0315, 0.085)),
        "eye_inner" => ("head", eye(0.017, 0.088)),
        "eye_outer" => ("head", eye(0.046, 0.078)),
        "ear" => ("head", head(0.070, &[(-1.0, TragionToTop)], 0.0, 0.0)),
        "mouth" => ("head", head(0.025, &[], -0.180, 0.100)),
        "big_toe" => ("foot", leg(fixed(0.015), -0.010, length(-0.005, &[(0.75, FootLength)]))),
        "small_toe" => ("foot", leg(fixed(0.012), 0.050, length(-0.005, &[(0.62, FootLength)]))),
        "heel" => ("ankle", leg(fixed(0.020), 0.0, length(0.005, &[(-0.25, FootLength)]))),
        // Knuckles about the palm; the palm faces the floor, so the thumb points to the front.
        "index" => ("hand", on_hand(0.005, 0.025)),
        "pinky" => ("hand", on_hand(-0.010, -0.030)),
        "thumb" => ("hand", on_hand(-0.025, 0.045)),
        _ => return None,
    })
}

fn on_hand(x: f64, z: f64) -> Place {
    let [px, py, _] = joint_place("hand");
    [Length { constant: px.constant + x, ..px }, py, fixed(z)]
}

/// Side and plain name: `left_knee` is (1, knee), `nose` is (1, nose), `right_knee` is (-1, knee).
fn side_and_part(name: &str) -> (f64, &str) {
    match (name.strip_prefix("left_"), name.strip_prefix("right_")) {
        (Some(part), _) => (1.0, part),
        (_, Some(part)) => (-1.0, part),
        _ => (1.0, name),
    }
}

fn varied(place: &Place, side: f64, population: &Population) -> VariedPlace {
    let [x, y, z]: [VariedLength; 3] = std::array::from_fn(|axis| place[axis].in_population(population));
    let directions =
        ShapeDirections::from_rows(&[x.per_beta.transpose() * side, y.per_beta.transpose(), z.per_beta.transpose()]);
    VariedPlace { mean: Vector3::new(side * x.mean, y.mean, z.mean), directions }
}

fn joint_index(name: &str) -> usize {
    JOINT_NAMES.iter().position(|n| *n == name).expect("the tables above name joints of the skeleton only")
}

fn joint_term(name: &str, weight: f64) -> LandmarkTerm {
    LandmarkTerm {
        joint: joint_index(name),
        weight,
        offset: Vector3::zeros(),
        offset_directions: ShapeDirections::zeros(),
    }
}

/// The default body, `wandless-adult-1`: rest height 1.692 m at beta 0, floor at y = 0.
///
/// The betas are those of [`Population::ansur2`]: beta 0 is stature (92 mm), beta 1 weight at fixed stature.
pub fn default_body() -> BodyModel {
    let population = Population::ansur2();
    let joint = |name: &str| {
        let (side, part) = side_and_part(name);
        varied(&joint_place(part), side, &population)
    };
    let joints: [VariedPlace; N_JOINTS] = std::array::from_fn(|j| joint(JOINT_NAMES[j]));
    let terms = |name: &str| -> Option<Vec<LandmarkTerm>> {
        let (side, part) = side_and_part(name);
        let between = |a: &str, b: &str| vec![joint_term(a, 0.5), joint_term(b, 0.5)];
        match name {
            // The detectors' neck is the middle of the shoulders, their mid hip that of the hips (formats differ from
            // SMPL's joints here, also where the words agree).
            "neck" => return Some(between("left_shoulder", "right_shoulder")),
            "mid_hip" => return Some(between("left_hip", "right_hip")),
            NECK_JOINT => return Some(vec![joint_term("neck", 1.0)]),
            _ => {}
        }
        let Some((carrier, place)) = surface_place(part) else {
            return JOINT_NAMES.contains(&name).then(|| vec![joint_term(name, 1.0)]);
        };
        let carrier = match carrier {
            "head" => "head".to_owned(),
            part if side > 0.0 => format!("left_{part}"),
            part => format!("right_{part}"),
        };
        let (point, bone) = (varied(&place, side, &population), &joints[joint_index(&carrier)]);
        let offset = point.mean - bone.mean;
        let offset_directions = point.directions - bone.directions;
        Some(vec![LandmarkTerm { offset, offset_directions, ..joint_term(&carrier, 1.0) }])
    };
    let mut names: BTreeSet<&str> = KeypointConvention::ALL.iter().flat_map(|c| c.names().iter().copied()).collect();
    names.insert(NECK_JOINT);
    let landmark = |name: &&str| terms(name).map(|terms| Landmark { name: (*name).to_owned(), terms });
    BodyModel {
        name: "wandless-adult-1".to_owned(),
        landmarks: names.iter().filter_map(landmark).collect(),
        rest_joints: std::array::from_fn(|j| joints[j].mean),
        shape_directions: std::array::from_fn(|j| joints[j].directions),
    }
}

#[cfg(test)]
mod tests {
    use super::super::model::Betas;
    use super::*;

    fn joint(model: &BodyModel, name: &str, betas: &Betas) -> Vector3<f64> {
        model.shaped(betas).rest_joints[joint_index(name)]
    }

    /// de Leva 1996 gives 0.162, 0.154, 0.243 (men) and 0.249 of the stature; the femoral epicondyle of ANSUR II lies
    /// higher than his knee, hence 5 %.
    #[test]
    fn mean_bones_agree_with_published_segment_lengths() {
        let model = default_body();
        let of_stature = |a: &str, b: &str| {
            (joint(&model, a, &Betas::zeros()) - joint(&model, b, &Betas::zeros())).norm() / 1.692344
        };
        for (a, b, share) in [
            ("left_shoulder", "left_elbow", 0.162),
            ("left_elbow", "left_wrist", 0.154),
            ("left_hip", "left_knee", 0.243),
            ("left_knee", "left_ankle", 0.249),
        ] {
            assert!((of_stature(a, b) / share - 1.0).abs() < 0.05, "{a}: {}", of_stature(a, b));
        }
    }

    #[test]
    fn the_body_is_mirror_symmetric_for_every_shape() {
        let model = default_body();
        let betas = Betas::from_fn(|i, _| 0.4 * i as f64 - 1.5);
        for (j, name) in JOINT_NAMES.iter().enumerate() {
            if let Some(part) = name.strip_prefix("left_") {
                let (l, r) = (model.shaped(&betas).rest_joints[j], joint(&model, &format!("right_{part}"), &betas));
                assert!((l - Vector3::new(-r.x, r.y, r.z)).norm() < 1e-12);
            }
        }
    }

    #[test]
    fn stature_is_beta_zero_alone_and_every_convention_finds_its_landmarks() {
        let model = default_body();
        let crown = model.landmark_index("head_top").unwrap();
        let height = |betas: &Betas| {
            let body = model.shaped(betas);
            body.rest_joints[15].y + body.landmark_offsets[crown][0].y
        };
        for k in 0..10 {
            let change = height(&Betas::from_fn(|i, _| f64::from(i == k))) - height(&Betas::zeros());
            assert!((change - if k == 0 { 0.09214 } else { 0.0 }).abs() < 1e-9, "beta {k}");
        }
        for convention in KeypointConvention::ALL {
            assert!(model.landmarks_of(convention).iter().all(Option::is_some), "{}", convention.name());
        }
        let weights = |l: &Landmark| l.terms.iter().map(|t| t.weight).sum::<f64>();
        assert!(model.landmarks.iter().all(|l| (weights(l) - 1.0).abs() < 1e-12));
    }
}
