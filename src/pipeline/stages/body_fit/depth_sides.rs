//! The side in depth of limbs that one camera alone shows.
//!
//! Where the rest of the body is known, an image leaves each bone of a limb two directions: towards the camera, or away from it (Taylor
//! 2000, reconstruction of articulated objects from point correspondences). A fit keeps the side on which it starts, so that the start
//! is chosen: of the configurations of each frame, those on the cheapest path through the stretch, from and to what other cameras show.
//! Known limit: a trunk that is turned to the wrong side takes its limbs with it.

use super::completed_joints::GapCompletion;
use super::context::FitContext;
use super::gap_completion::INDEPENDENT;
use super::gaps::gaps;
use super::initial_motion::filled_rotations;
use super::monocular::limb_configurations::{
    BodyLimb, ERROR_SECS, JointCosts, MOVE_COST, body_limbs, points_at_distance,
};
use super::observations::{Observations, PixelObservation};
use super::terms::unknowns::MotionState;
use crate::body::kinematics::{PosedSkeleton, posed};
use crate::body::model::ShapedBody;
use crate::body::skeleton::PARENTS;
use crate::geometry::projection::project_normalized;
use crate::optim::viterbi::cheapest_path;
use crate::residuals::rotation_likelihood::{RotationGaussian, rotation_cost};
use nalgebra::{Matrix3, Vector3};
use std::ops::Range;

/// The motion with the limbs that the motion prior guides on their cheapest sides. Of a good motion: the ranges of joints on a rough trunk
/// choose worse than the motion prior's bridge, by a tenth in what joints are off.
pub(super) fn on_cheapest_sides(
    context: &FitContext,
    observations: &Observations,
    completion: &GapCompletion,
    mut state: MotionState,
) -> MotionState {
    let body = context.model.shaped(&state.betas);
    let weight = context.frame_interval / ERROR_SECS;
    let limit_width = context.config.limit_width_deg.to_radians();
    let sides = Sides {
        observations,
        completion,
        body: &body,
        ranges: JointCosts::new(context.model, limit_width),
        weight_of_ranges: weight,
        weight_of_guidance: weight / INDEPENDENT,
    };
    for limb in body_limbs(context.model, &body) {
        let is_known = |t: usize| limb.bones().iter().all(|bone| sides.guidance(t, *bone).is_none());
        let is_known: Vec<bool> = (0..state.poses.len()).map(is_known).collect();
        gaps(&is_known).into_iter().for_each(|stretch| sides.choose(&limb, stretch, &mut state));
    }
    state
}

/// A limb of a frame.
struct Configuration {
    /// Middle and end from the root, world, m.
    positions: [Vector3<f64>; 2],
    /// Of the two bones.
    rotations: [Matrix3<f64>; 2],
    /// Nats.
    cost: f64,
}

struct Sides<'a> {
    observations: &'a Observations,
    completion: &'a GapCompletion,
    body: &'a ShapedBody,
    ranges: JointCosts,
    weight_of_ranges: f64,
    weight_of_guidance: f64,
}

impl Sides<'_> {
    /// What the motion prior states about a joint that one camera alone shows.
    fn guidance(&self, t: usize, joint: usize) -> Option<&RotationGaussian> {
        self.completion.guided[t].iter().find(|(guided, _)| *guided == joint).map(|(_, gaussian)| gaussian)
    }

    /// Sets a limb in a stretch of frames; in those whose image does not show it, to what lies between.
    fn choose(&self, limb: &BodyLimb, stretch: Range<usize>, state: &mut MotionState) {
        let with_ends = stretch.start.saturating_sub(1)..(stretch.end + 1).min(state.poses.len());
        let of_frame = |t: usize| {
            let skeleton = posed(self.body, &state.poses[t]);
            match stretch.contains(&t) {
                true => self.configurations(limb, t, &skeleton),
                false => vec![fitted(limb, &skeleton, &state.poses[t].rotations)],
            }
        };
        let found: Vec<Vec<Configuration>> = with_ends.clone().map(of_frame).collect();
        let costs: Vec<Vec<f64>> = found.iter().map(|found| found.iter().map(|c| c.cost).collect()).collect();
        let movement = |t: usize, r: usize, u: usize, s: usize| {
            let moved = |i: usize| (found[u][s].positions[i] - found[t][r].positions[i]).norm();
            MOVE_COST * (moved(0) + moved(1))
        };
        let path = cheapest_path(&costs, movement);
        if path.iter().all(Option::is_none) {
            return;
        }
        for (i, bone) in limb.bones().into_iter().enumerate() {
            let rotation =
                |(found, chosen): (&Vec<Configuration>, &Option<usize>)| Some(found[(*chosen)?].rotations[i]);
            let known: Vec<Option<Matrix3<f64>>> = found.iter().zip(&path).map(rotation).collect();
            for (t, rotation) in with_ends.clone().zip(filled_rotations(&known, &Matrix3::identity())) {
                state.poses[t].rotations[bone] = rotation;
            }
        }
    }

    /// At most four; none where no image shows a bone that is open.
    fn configurations(&self, limb: &BodyLimb, t: usize, skeleton: &PosedSkeleton) -> Vec<Configuration> {
        let joints = limb.joints();
        let [root, fitted_middle, fitted_end] = joints.map(|joint| skeleton.joints[joint]);
        let rest = joints.map(|joint| self.body.rest_joints[joint]);
        let bones = limb.bones();
        let guidance = bones.map(|bone| self.guidance(t, bone));
        let pixel = |landmark: usize| self.observations.pixels[t].iter().find(|pixel| pixel.landmark == landmark);
        let middles = match (guidance[0], pixel(limb.landmarks[1])) {
            (None, _) => vec![fitted_middle],
            (Some(_), Some(pixel)) => self.seen_at_distance(t, pixel, &root, (rest[1] - rest[0]).norm()),
            (Some(_), None) => Vec::new(),
        };
        let ends = |middle: &Vector3<f64>| match (guidance[1], pixel(limb.landmarks[2])) {
            (None, _) => vec![fitted_end],
            (Some(_), Some(pixel)) => self.seen_at_distance(t, pixel, middle, (rest[2] - rest[1]).norm()),
            (Some(_), None) => vec![middle + (fitted_end - fitted_middle)],
        };
        let parent = PARENTS[joints[0]].map_or_else(Matrix3::identity, |parent| skeleton.rotations[parent]);
        let configuration = |middle: &Vector3<f64>, end: &Vector3<f64>| {
            let (upper, lower) = (parent.tr_mul(&(middle - root)), parent.tr_mul(&(end - middle)));
            let rotations = limb.rotations(self.body, &upper, &lower);
            let cost = |i: usize| {
                let stated = |gaussian| self.weight_of_guidance * rotation_cost(&rotations[i], gaussian);
                self.weight_of_ranges * self.ranges.cost(bones[i], &rotations[i]) + guidance[i].map_or(0.0, stated)
            };
            Configuration { positions: [middle - root, end - root], rotations, cost: cost(0) + cost(1) }
        };
        let mut found = Vec::with_capacity(4);
        for middle in middles {
            found.extend(ends(&middle).iter().map(|end| configuration(&middle, end)));
        }
        found
    }

    /// The points at a distance from `center` where the camera of a pixel sees the landmark: on its smooth path, since the depth of bones
    /// across the view varies much with their image.
    fn seen_at_distance(
        &self,
        t: usize,
        pixel: &PixelObservation,
        center: &Vector3<f64>,
        length: f64,
    ) -> Vec<Vector3<f64>> {
        let camera = &self.observations.cameras[pixel.camera];
        let path = self.observations.points[t].iter().find(|point| point.landmark == pixel.landmark);
        let normalized = path
            .and_then(|point| project_normalized(&camera.camera_from_world, &point.position))
            .map_or_else(|| camera.intrinsics.normalized_from_pixel(&pixel.pixel), |projected| projected.normalized);
        let world_from_camera = camera.camera_from_world.inverse();
        let found = points_at_distance(&normalized, &camera.camera_from_world.transform(center), length);
        found.iter().map(|point| world_from_camera.transform(point)).collect()
    }
}

/// A limb as the motion has it.
fn fitted(limb: &BodyLimb, skeleton: &PosedSkeleton, rotations: &[Matrix3<f64>]) -> Configuration {
    let [root, middle, end] = limb.joints().map(|joint| skeleton.joints[joint]);
    Configuration {
        positions: [middle - root, end - root],
        rotations: limb.bones().map(|bone| rotations[bone]),
        cost: 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::super::observations::PointObservation;
    use super::super::test_fixtures::{Surroundings, camera_in_front, seen};
    use super::*;
    use crate::body::kinematics::{Pose, landmark_position};
    use crate::body::model::Betas;
    use crate::geometry::rotation;

    const N_FRAMES: usize = 40;

    /// A left arm that swings from the side to straight ahead and back, its elbow bent, seen from the front.
    fn swing(t: usize) -> Pose {
        let mut pose = Pose::rest();
        let share = (std::f64::consts::PI * t as f64 / (N_FRAMES - 1) as f64).sin();
        pose.rotations[16] = rotation::exp(&(Vector3::y() * -1.4 * share));
        pose.rotations[18] = rotation::exp(&(Vector3::y() * -0.6));
        pose
    }

    /// In the middle of the take the camera alone shows the arm, and the fit has it mirrored in depth.
    #[test]
    fn arms_that_a_fit_has_mirrored_return_to_their_side() {
        let surroundings = Surroundings::new();
        let (context, model) = (surroundings.context(), &surroundings.model);
        let (body, camera) = (model.shaped(&Betas::zeros()), camera_in_front(0.0));
        let landmarks = ["left_elbow", "left_wrist"].map(|name| model.landmark_index(name).unwrap());
        let stretch = 5..35;
        let observed = |t: usize| -> (Vec<PixelObservation>, Vec<PointObservation>) {
            let skeleton = posed(&body, &swing(t));
            let of_landmark = |landmark: usize| {
                let position = landmark_position(model, &body, &skeleton, landmark);
                let x = camera.camera_from_world.transform(&position);
                // The path of a single ray, its depth off.
                let position = camera.camera_from_world.inverse().transform(&(x * 1.1));
                (seen(landmark, 0), PointObservation { landmark, position })
            };
            landmarks.map(of_landmark).into_iter().unzip()
        };
        let (pixels, points) = (0..N_FRAMES).map(observed).unzip();
        let observations = Observations { cameras: vec![camera], points, pixels };
        // Mirrored in the plane that faces the camera: turns about the upward axis change their sense.
        let mirrored = |t: usize| {
            let mut pose = swing(t);
            [16, 18].iter().for_each(|bone| pose.rotations[*bone] = pose.rotations[*bone].transpose());
            if stretch.contains(&t) { pose } else { swing(t) }
        };
        let state = MotionState { betas: Betas::zeros(), poses: (0..N_FRAMES).map(mirrored).collect() };
        let vague = RotationGaussian { mean: Matrix3::identity(), precision: Matrix3::zeros() };
        let guided = |t: usize| if stretch.contains(&t) { vec![(16, vague), (18, vague)] } else { vec![] };
        let completion = GapCompletion { hidden: vec![vec![]; N_FRAMES], guided: (0..N_FRAMES).map(guided).collect() };
        let error = |state: &MotionState| {
            let off = |t: usize| {
                let wrists = [&state.poses[t], &swing(t)].map(|pose| posed(&body, pose).joints[20]);
                (wrists[0] - wrists[1]).norm()
            };
            stretch.clone().map(off).sum::<f64>() / stretch.len() as f64
        };
        let before = error(&state);
        let after = error(&on_cheapest_sides(&context, &observations, &completion, state));
        assert!(before > 0.5 && after < 0.06, "{before} m before, {after} m after");
    }
}
