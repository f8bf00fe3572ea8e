//! The side to which a trunk is turned that one camera alone shows.
//!
//! A shoulder line that the image shows foreshortened is turned to the left or to the right. A fit keeps the side on which it starts, and
//! the limbs follow. Where the cheapest path through the poses that the images allow ([`super::monocular`]), from and to what other
//! cameras show, has the trunk on another side, it is turned there.

use super::context::FitContext;
use super::initial_motion::trunk_placement;
use super::monocular::lifting::{TrunkImages, trunk_rotations};
use super::observations::Observations;
use super::single_camera::SingleCamera;
use super::terms::unknowns::MotionState;
use crate::body::kinematics::{Pose, landmark_position, posed};
use crate::body::model::ShapedBody;
use crate::geometry::{Rigid, rotation};
use nalgebra::{Matrix3, Vector3};
use std::ops::Range;

/// Trunks nearer than this are on the same side, rad: spines bend and twist, and the poses of an image are those of a rigid trunk.
const SAME_SIDE: f64 = 0.6;

/// A trunk that leans farther than this in any frame is left as it is, rad: the poses of an image are those of people who stand. Without
/// this bound, one of 29 motions, of a person who bends down, comes out 20 to 120 % farther off.
const MAX_LEAN: f64 = 0.8;

/// The motion with the trunk on its cheapest side where one camera alone shows the person.
pub(super) fn with_trunk_on_its_side(
    context: &FitContext,
    observations: &Observations,
    alone: &SingleCamera,
    mut state: MotionState,
) -> MotionState {
    let stretches = alone.stretches();
    if stretches.is_empty() {
        return state;
    }
    let body = context.model.shaped(&state.betas);
    for (camera, stretch) in stretches {
        turn(context, observations, &body, camera, stretch, &mut state);
    }
    state
}

fn turn(
    context: &FitContext,
    observations: &Observations,
    body: &ShapedBody,
    camera: usize,
    stretch: Range<usize>,
    state: &mut MotionState,
) {
    let with_ends = stretch.start.saturating_sub(1)..(stretch.end + 1).min(state.poses.len());
    let placed = |pose: &Pose| -> Option<Rigid> {
        let skeleton = posed(body, pose);
        let points =
            (0..context.model.landmarks.len()).map(|l| Some(landmark_position(context.model, body, &skeleton, l)));
        trunk_placement(context.model, body, &points.collect())
    };
    let fitted: Option<Vec<Rigid>> = state.poses[with_ends.clone()].iter().map(placed).collect();
    let leans = |trunk: &Rigid| trunk.rotation.column(1).dot(&context.up) < MAX_LEAN.cos();
    let Some(fitted) = fitted.filter(|fitted| !fitted.iter().any(leans)) else { return };
    let camera = &observations.cameras[camera].camera_from_world;
    let middle = body.rest_joints[0];
    let depths: Vec<f64> = fitted.iter().map(|trunk| camera.transform(&trunk.transform(&middle)).z).collect();
    let known = |(t, trunk): (usize, &Rigid)| (!stretch.contains(&t)).then(|| camera.rotation * trunk.rotation);
    let known: Vec<Option<Matrix3<f64>>> = with_ends.clone().zip(&fitted).map(known).collect();
    let observations = observations.slice(with_ends.clone());
    let images = TrunkImages { observations: &observations, camera, depths: &depths, known: &known };
    let found = trunk_rotations(context.model, body, &images, &context.up, context.frame_interval);
    for ((t, trunk), found) in with_ends.zip(&fitted).zip(found) {
        let Some(found) = found.filter(|_| stretch.contains(&t)) else { continue };
        let found = camera.rotation.tr_mul(&found);
        if rotation::angle_between(&found, &trunk.rotation) > SAME_SIDE {
            let turn = found * trunk.rotation.transpose();
            turn_about(&mut state.poses[t], body, &turn, &trunk.transform(&middle));
        }
    }
}

/// Turns a whole body about a point in the world.
fn turn_about(pose: &mut Pose, body: &ShapedBody, turn: &Matrix3<f64>, center: &Vector3<f64>) {
    let pelvis = body.rest_joints[0];
    let moved = center + turn * (pelvis + pose.translation - center);
    pose.rotations[0] = turn * pose.rotations[0];
    pose.translation = moved - pelvis;
}

#[cfg(test)]
mod tests {
    use super::super::observations::{PixelObservation, PointObservation};
    use super::super::test_fixtures::{Surroundings, camera_in_front, seen};
    use super::*;
    use crate::body::model::Betas;
    use crate::body::skeleton::KeypointConvention;

    const N_FRAMES: usize = 40;

    /// A person who turns to one side and back.
    fn turned(t: usize, sense: f64) -> Pose {
        let mut pose = Pose::rest();
        let yaw = 1.3 * (std::f64::consts::PI * t as f64 / (N_FRAMES - 1) as f64).sin();
        pose.rotations[0] = rotation::exp(&(Vector3::y() * yaw * sense));
        pose
    }

    /// From frame 5 to 35 one of two cameras shows the person, and the fit has the turn to the other side.
    #[test]
    fn trunks_that_a_fit_turns_to_the_wrong_side_return() {
        let surroundings = Surroundings::new();
        let frame_interval = 0.1;
        let (context, model) = (FitContext { frame_interval, ..surroundings.context() }, &surroundings.model);
        let body = model.shaped(&Betas::zeros());
        let landmarks: Vec<usize> = model.landmarks_of(KeypointConvention::Coco17).into_iter().flatten().collect();
        let is_alone = |t: usize| (5..35).contains(&t);
        let pixels = |t: usize| -> Vec<PixelObservation> {
            let of_camera = |camera: usize| landmarks.iter().map(move |landmark| seen(*landmark, camera));
            (0..if is_alone(t) { 1 } else { 2 }).flat_map(of_camera).collect()
        };
        let points = |t: usize| -> Vec<PointObservation> {
            let skeleton = posed(&body, &turned(t, 1.0));
            let at = |&landmark: &usize| PointObservation {
                landmark,
                position: landmark_position(model, &body, &skeleton, landmark),
            };
            landmarks.iter().map(at).collect()
        };
        let observations = Observations {
            cameras: vec![camera_in_front(0.0); 2],
            points: (0..N_FRAMES).map(points).collect(),
            pixels: (0..N_FRAMES).map(pixels).collect(),
        };
        let alone = SingleCamera::new(model, &observations, frame_interval);
        assert_eq!(alone.stretches(), [(0, 8..32)]);
        let sense = |t: usize| if (8..32).contains(&t) { -1.0 } else { 1.0 };
        let poses = (0..N_FRAMES).map(|t| turned(t, sense(t))).collect();
        let found =
            with_trunk_on_its_side(&context, &observations, &alone, MotionState { betas: Betas::zeros(), poses });
        for t in 0..N_FRAMES {
            let angle = rotation::angle_between(&found.poses[t].rotations[0], &turned(t, 1.0).rotations[0]);
            assert!(angle < 0.5 * SAME_SIDE, "frame {t}: {angle} rad");
            assert!(found.poses[t].translation.norm() < 0.2, "frame {t}: it turns about itself");
        }
    }
}
