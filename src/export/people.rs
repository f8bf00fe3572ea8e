//! `people.json`: shape and motion of every person in SMPL's convention.

use super::files::{micro, micro_entries};
use crate::body::measures::BodyMeasures;
use crate::body::skeleton::N_JOINTS;
use crate::geometry::rotation;
use crate::session::formats::rounded;
use crate::session::people::{BodyPose, HandMotion, HandPose, JointSigmas};
use crate::session::reconstruction::{BodyModelId, Report};
use crate::session::{BodyMotion, FrameIndex, Reconstruction, Session};
use serde::{Deserialize, Serialize};

/// The file.
#[derive(Serialize)]
pub(super) struct People<'a> {
    units: &'static str,
    fps: f64,
    body_model: &'a BodyModelId,
    people: Vec<Person>,
}

#[derive(Serialize)]
struct Person {
    id: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    name: Option<String>,
    betas: [f64; 10],
    #[serde(flatten)]
    measures: Option<Measures>,
    frames: Vec<i64>,
    global_orient: Vec<[f64; 3]>,
    body_pose: Vec<Vec<f64>>,
    transl: Vec<[f64; 3]>,
    valid: Vec<bool>,
    /// By frame and joint, three axes together.
    #[serde(skip_serializing_if = "Option::is_none")]
    joint_sigma_mm: Option<Vec<[f64; N_JOINTS]>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    hands: Option<Hands>,
}

/// Fingers of both hands, where they were fitted.
#[derive(Serialize, Deserialize)]
pub(super) struct Hands {
    pub(super) left: Hand,
    pub(super) right: Hand,
}

/// Fingers of a hand by frame, joints in SMPL-H's order.
#[derive(Serialize, Deserialize)]
pub(super) struct Hand {
    /// Axis-angle of the 15 joints, rad.
    pub(super) pose: Vec<Vec<f64>>,
    /// World, m.
    pub(super) joints: Vec<Vec<[f64; 3]>>,
    /// Number of views that saw the hand.
    pub(super) n_views: Vec<u8>,
}

/// Stature and mass, and standard deviations of the shape where the session shows them.
#[derive(Serialize)]
struct Measures {
    stature_m: f64,
    mass_kg: f64,
    #[serde(flatten)]
    sigmas: Option<Sigmas>,
}

#[derive(Serialize)]
struct Sigmas {
    betas_sigma: [f64; 10],
    stature_sigma_m: f64,
    mass_sigma_kg: f64,
}

/// In mm, hundredths of a kg and of a standard deviation.
fn rounded_measures(measures: &BodyMeasures) -> Measures {
    let sigmas = measures.sigmas.as_ref().map(|sigmas| Sigmas {
        betas_sigma: sigmas.betas.map(|sigma| rounded(sigma, 2)),
        stature_sigma_m: rounded(sigmas.stature_m, 3),
        mass_sigma_kg: rounded(sigmas.mass_kg, 2),
    });
    Measures { stature_m: rounded(measures.stature_m, 3), mass_kg: rounded(measures.mass_kg, 2), sigmas }
}

/// The content of `people.json`.
pub(super) fn people<'a>(session: &Session, reconstruction: &'a Reconstruction) -> People<'a> {
    People {
        units: "m",
        fps: session.fps,
        body_model: &reconstruction.body_model,
        people: reconstruction.motions.iter().map(|motion| person(session, motion, &reconstruction.report)).collect(),
    }
}

/// Frame numbers of a motion, consecutive.
pub(super) fn frame_numbers(session: &Session, motion: &BodyMotion) -> Vec<i64> {
    (0..motion.frames.len()).map(|i| session.frame_number(FrameIndex(motion.first.0 + i))).collect()
}

/// The 24 local rotations of a frame as axis-angle, radians: SMPL's `poses`, 72 wide.
pub(super) fn axis_angles(pose: &BodyPose) -> Vec<f64> {
    pose.rotations.iter().flat_map(|r| <[f64; 3]>::from(rotation::log(r))).collect()
}

/// The 15 local rotations of a hand as axis-angle, radians: 45 numbers.
pub(super) fn finger_axis_angles(pose: &HandPose) -> Vec<f64> {
    pose.rotations.iter().flat_map(|r| <[f64; 3]>::from(rotation::log(r))).collect()
}

/// Standard deviations in mm, to a hundredth.
pub(super) fn millimetres(sigmas: &JointSigmas) -> [f64; N_JOINTS] {
    sigmas.map(|sigma| rounded(1e3 * sigma, 2))
}

fn hand(motion: &HandMotion) -> Hand {
    let frames = || motion.frames.iter();
    Hand {
        pose: frames().map(|pose| finger_axis_angles(pose).into_iter().map(micro).collect()).collect(),
        joints: frames().map(|pose| pose.joints.iter().map(micro_entries).collect()).collect(),
        n_views: frames().map(|pose| pose.n_views).collect(),
    }
}

fn person(session: &Session, motion: &BodyMotion, report: &Report) -> Person {
    let own = report.people.iter().find(|person| person.id == motion.person.0);
    let measures = own.and_then(|person| person.body.as_ref());
    // [frames, 72]
    let poses: Vec<Vec<f64>> =
        motion.frames.iter().map(|pose| axis_angles(pose).into_iter().map(micro).collect()).collect();
    Person {
        id: motion.person.0,
        name: own.and_then(|person| person.name.clone()),
        betas: motion.betas.map(micro),
        measures: measures.map(rounded_measures),
        frames: frame_numbers(session, motion),
        global_orient: poses.iter().map(|pose| [pose[0], pose[1], pose[2]]).collect(),
        body_pose: poses.iter().map(|pose| pose[3..].to_vec()).collect(),
        transl: motion.frames.iter().map(|pose| micro_entries(&pose.translation)).collect(),
        valid: motion.frames.iter().map(|pose| pose.valid).collect(),
        hands: motion.hands.as_ref().map(|[left, right]| Hands { left: hand(left), right: hand(right) }),
        joint_sigma_mm: motion.joint_sigmas.as_ref().map(|sigmas| sigmas.iter().map(millimetres).collect()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::measures::MeasureSigmas;
    use serde_json::json;

    #[test]
    fn measures_state_their_sigmas_where_known() {
        let sigmas = MeasureSigmas { stature_m: 0.0525, mass_kg: 12.3456, betas: [0.123; 10] };
        let known = BodyMeasures { stature_m: 1.788_49, mass_kg: 98.7654, sigmas: Some(sigmas) };
        let written = serde_json::to_value(rounded_measures(&known)).unwrap();
        assert_eq!((&written["stature_m"], &written["mass_kg"]), (&json!(1.788), &json!(98.77)));
        assert_eq!((&written["mass_sigma_kg"], &written["betas_sigma"][9]), (&json!(12.35), &json!(0.12)));
        let unknown = serde_json::to_value(rounded_measures(&BodyMeasures { sigmas: None, ..known })).unwrap();
        assert_eq!(unknown, json!({ "stature_m": 1.788, "mass_kg": 98.77 }));
    }
}
