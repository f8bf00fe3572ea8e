//! Depth from a single view: flat points moved along their rays to where a body of known size can have them.
//!
//! In one image every bone points towards the camera or away from it, and a trunk that appears narrow is turned to one side or
//! to the other. Per frame the few poses that the image allows are listed, of the trunk first ([`super::trunk_pose`]), then of
//! each limb on it ([`super::limb_configurations`]); the joints' ranges and time decide among them: the path of least cost
//! through all frames is taken. Taylor 2000 (reconstruction of articulated objects from point correspondences) lists the
//! configurations of a chain of known lengths; the paths through them are ours.
//!
//! Known limits: all people are assumed as large as an average adult, so that a child appears too far away; a person who lies
//! or stands on the hands is treated as a leaning person; a limb that is not detected for long is guessed.

use super::super::observations::{Observations, PointObservation};
use super::limb_configurations::{BodyLimb, ERROR_SECS, JointCosts, LimbConfiguration, MOVE_COST, body_limbs};
use super::trunk_pose::{Trunk, TrunkImage, TrunkPose};
use crate::body::BodyModel;
use crate::body::model::{Betas, ShapedBody};
use crate::geometry::projection::project_normalized;
use crate::geometry::{Rigid, rotation};
use crate::optim::robust::median;
use crate::optim::viterbi::cheapest_path;
use nalgebra::{Matrix3, Vector2, Vector3};
use rayon::prelude::*;

/// Cost of rotating the trunk, nats per rad, as [`MOVE_COST`] is of moving limbs; on ten simulated captures half and double change
/// nothing (78 to 79 mm).
const TURN_COST: f64 = 4.0;

/// Cost of differing from a known rotation, nats per rad: it decides.
const KNOWN_COST: f64 = 100.0;

/// Standard deviation of the logarithm of the trunk's depth, first about the depth of the flat points, then about its own
/// median over time.
const ROUGH_DEPTH_SIGMA: f64 = 0.1;
const FINE_DEPTH_SIGMA: f64 = 0.02;

/// Depths are medians over this time to either side, s, since people do not jump in depth.
const DEPTH_SECS: f64 = 0.5;

/// Width of the walls at the ends of the joints' ranges, degrees: twice that of the fit, since depths are still rough.
const LIMIT_WIDTH_DEG: f64 = 10.0;

/// The points of `observations`, each moved along its ray; none in frames without a detected trunk.
///
/// `up`: the upward direction in the world, from which the lean of people is measured.
pub(in super::super) fn lifted(
    model: &BodyModel,
    observations: &Observations,
    up: &Vector3<f64>,
    frame_interval: f64,
) -> Vec<Vec<PointObservation>> {
    let Some(camera) = observations.cameras.first().map(|c| c.camera_from_world) else {
        return observations.points.clone();
    };
    let body = model.shaped(&Betas::zeros());
    let lifting = Lifting::new(model, &body, observations, &camera, up, frame_interval);
    let flat = lifting.flat_depths();
    let rough = lifting.trunk_poses(&smoothed(&flat, frame_interval), ROUGH_DEPTH_SIGMA, &[]);
    let depth = |(pose, flat): (&Option<TrunkPose>, &f64)| pose.map_or(*flat, |pose| lifting.trunk.depth(&pose));
    let depths: Vec<f64> = rough.iter().zip(&flat).map(depth).collect();
    let trunk_poses = lifting.trunk_poses(&smoothed(&depths, frame_interval), FINE_DEPTH_SIGMA, &[]);
    let mut points = lifting.trunk_points(&trunk_poses);
    for limb in &lifting.limbs {
        lifting.add_limb(limb, &trunk_poses, &mut points);
    }
    points
}

/// What a camera shows of a trunk.
pub(in super::super) struct TrunkImages<'a> {
    pub observations: &'a Observations,
    /// `camera_from_world`.
    pub camera: &'a Rigid,
    /// By frame, m.
    pub depths: &'a [f64],
    /// `camera_from_body`, by frame, where it is known.
    pub known: &'a [Option<Matrix3<f64>>],
}

/// `camera_from_body` of the trunk on the path of least cost, by frame; `None` where the image shows too little.
pub(in super::super) fn trunk_rotations(
    model: &BodyModel,
    body: &ShapedBody,
    images: &TrunkImages,
    up: &Vector3<f64>,
    frame_interval: f64,
) -> Vec<Option<Matrix3<f64>>> {
    let lifting = Lifting::new(model, body, images.observations, images.camera, up, frame_interval);
    let poses = lifting.trunk_poses(images.depths, FINE_DEPTH_SIGMA, images.known);
    poses.into_iter().map(|pose| Some(pose?.camera_from_body.rotation)).collect()
}

/// Body, camera and normalised points, which all steps read.
struct Lifting<'a> {
    body: &'a ShapedBody,
    trunk: Trunk,
    limbs: Vec<BodyLimb>,
    joints: JointCosts,
    /// Normalised image points by frame and landmark.
    normalized: Vec<Vec<Option<Vector2<f64>>>>,
    camera: &'a Rigid,
    /// Upward direction in the camera's frame.
    up: Vector3<f64>,
    observations: &'a Observations,
    /// Weight of one frame's observations, less than 1 since detectors' errors last over several frames.
    frame_weight: f64,
}

impl<'a> Lifting<'a> {
    fn new(
        model: &BodyModel,
        body: &'a ShapedBody,
        observations: &'a Observations,
        camera: &'a Rigid,
        up: &Vector3<f64>,
        frame_interval: f64,
    ) -> Self {
        let by_landmark = |points: &Vec<PointObservation>| {
            let mut normalized = vec![None; model.landmarks.len()];
            for point in points {
                normalized[point.landmark] = project_normalized(camera, &point.position).map(|p| p.normalized);
            }
            normalized
        };
        Self {
            trunk: Trunk::new(model, body),
            limbs: body_limbs(model, body),
            joints: JointCosts::new(model, LIMIT_WIDTH_DEG.to_radians()),
            normalized: observations.points.iter().map(by_landmark).collect(),
            camera,
            up: camera.rotation * up,
            observations,
            frame_weight: frame_interval / ERROR_SECS,
            body,
        }
    }

    /// Median depth of the flat points of every frame, m; that of the previous frame where there are none.
    fn flat_depths(&self) -> Vec<f64> {
        let of_frame = |points: &Vec<PointObservation>| {
            median(&mut points.iter().map(|p| self.camera.transform(&p.position).z).collect::<Vec<_>>())
        };
        let known: Vec<Option<f64>> = self.observations.points.iter().map(of_frame).collect();
        let mut last = known.iter().flatten().next().copied().unwrap_or(4.0);
        known
            .into_iter()
            .map(|depth| {
                last = depth.unwrap_or(last);
                last
            })
            .collect()
    }

    /// The pose of the trunk in every frame, given its depth: of the poses that the image allows those on the path of least
    /// cost, the sum of their own cost, that of the limbs on them, that of rotating, and of differing from `known` ones.
    fn trunk_poses(&self, depths: &[f64], depth_sigma: f64, known: &[Option<Matrix3<f64>>]) -> Vec<Option<TrunkPose>> {
        let off_known = |t: usize, pose: &TrunkPose| {
            let known = known.get(t).copied().flatten();
            known.map_or(0.0, |known| KNOWN_COST * rotation::angle_between(&pose.camera_from_body.rotation, &known))
        };
        let of_frame = |(t, depth): (usize, &f64)| {
            let image = TrunkImage { normalized: &self.normalized[t], up: self.up, depth: *depth, depth_sigma };
            let poses = self.trunk.poses(&image);
            let own = |pose: &TrunkPose| self.frame_weight * (pose.cost + self.limb_cost(t, pose)) + off_known(t, pose);
            let costs = poses.iter().map(own).collect();
            (poses, costs)
        };
        let (poses, own): (Vec<Vec<TrunkPose>>, Vec<Vec<f64>>) = depths.par_iter().enumerate().map(of_frame).unzip();
        let turn = |t: usize, r: usize, u: usize, s: usize| {
            let (one, other) = (&poses[t][r].camera_from_body, &poses[u][s].camera_from_body);
            TURN_COST * rotation::angle_between(&one.rotation, &other.rotation)
        };
        cheapest_path(&own, turn).into_iter().zip(&poses).map(|(chosen, poses)| chosen.map(|c| poses[c])).collect()
    }

    /// Least cost of the limbs on a trunk.
    fn limb_cost(&self, t: usize, trunk: &TrunkPose) -> f64 {
        let of_limb = |limb: &BodyLimb| {
            self.configurations(t, limb, trunk).iter().map(|b| b.cost).reduce(f64::min).unwrap_or(0.0)
        };
        self.limbs.iter().map(of_limb).sum()
    }

    fn root(&self, t: usize, limb: &BodyLimb, trunk: &TrunkPose) -> Option<Vector3<f64>> {
        let position = self.trunk.position(trunk, limb.landmarks[0])?;
        Some(self.normalized[t][limb.landmarks[0]].map_or(position, |b| Vector3::new(b.x, b.y, 1.0) * position.z))
    }

    fn configurations(&self, t: usize, limb: &BodyLimb, trunk: &TrunkPose) -> Vec<LimbConfiguration> {
        let Some(root) = self.root(t, limb, trunk) else { return Vec::new() };
        limb.configurations(&self.joints, self.body, &trunk.camera_from_body.rotation, &root, &self.normalized[t])
    }

    /// The points of trunk and head on their rays, at the depths of the posed trunk.
    fn trunk_points(&self, trunk_poses: &[Option<TrunkPose>]) -> Vec<Vec<PointObservation>> {
        let world_from_camera = self.camera.inverse();
        let point = |t: usize, pose: &TrunkPose, landmark: usize| {
            let (normalized, on_trunk) = (self.normalized[t][landmark]?, self.trunk.position(pose, landmark)?);
            let position = world_from_camera.transform(&(Vector3::new(normalized.x, normalized.y, 1.0) * on_trunk.z));
            Some(PointObservation { landmark, position })
        };
        let of_frame = |(t, pose): (usize, &Option<TrunkPose>)| {
            pose.map_or_else(Vec::new, |pose| self.trunk.landmarks().filter_map(|l| point(t, &pose, l)).collect())
        };
        trunk_poses.iter().enumerate().map(of_frame).collect()
    }

    /// Adds middle and end of a limb, of the configurations on the path of least cost.
    fn add_limb(&self, limb: &BodyLimb, trunk_poses: &[Option<TrunkPose>], points: &mut [Vec<PointObservation>]) {
        let root = |(t, pose): (usize, &Option<TrunkPose>)| pose.and_then(|pose| self.root(t, limb, &pose));
        let roots: Vec<Vector3<f64>> =
            trunk_poses.iter().enumerate().map(|at| root(at).unwrap_or_else(Vector3::zeros)).collect();
        let found: Vec<Vec<LimbConfiguration>> = (trunk_poses.iter().enumerate())
            .map(|(t, pose)| pose.map_or_else(Vec::new, |pose| self.configurations(t, limb, &pose)))
            .collect();
        let own: Vec<Vec<f64>> =
            found.iter().map(|found| found.iter().map(|c| self.frame_weight * c.cost).collect()).collect();
        let shift = |t: usize, r: usize, u: usize, s: usize| {
            let moved =
                |i: usize| ((found[u][s].positions[i] - roots[u]) - (found[t][r].positions[i] - roots[t])).norm();
            MOVE_COST * (moved(0) + moved(1))
        };
        let world_from_camera = self.camera.inverse();
        for (t, chosen) in cheapest_path(&own, shift).into_iter().enumerate() {
            let Some(limb_pose) = chosen.map(|c| found[t][c]) else { continue };
            for (landmark, position) in limb.landmarks[1..].iter().zip(limb_pose.positions) {
                points[t]
                    .push(PointObservation { landmark: *landmark, position: world_from_camera.transform(&position) });
            }
        }
    }
}

/// Running median, see [`DEPTH_SECS`].
fn smoothed(depths: &[f64], frame_interval: f64) -> Vec<f64> {
    let half = (DEPTH_SECS / frame_interval).round() as usize;
    let around = |t: usize| {
        let window = t.saturating_sub(half)..(t + half + 1).min(depths.len());
        median(&mut depths[window].to_vec()).unwrap_or(depths[t])
    };
    (0..depths.len()).map(around).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::default_body;
    use crate::body::joint_ranges::natural_pose;
    use crate::body::kinematics::{landmark_position, posed};
    use crate::body::skeleton::KeypointConvention;
    use crate::geometry::Intrinsics;
    use crate::pipeline::calibration::PosedCamera;
    use rand::SeedableRng;

    /// A camera at eye level whose image stands upright in a world with y up, looking along -z.
    fn camera() -> PosedCamera {
        let rotation = rotation::exp(&(Vector3::x() * std::f64::consts::PI));
        PosedCamera {
            intrinsics: Intrinsics::PLAIN,
            camera_from_world: Rigid { rotation, translation: Vector3::new(0.0, 1.4, 4.0) },
        }
    }

    /// People who turn by a quarter in a second, each in a natural pose; their points flat, a tenth too far away.
    ///
    /// The bound is a third of a limb: a bone on the wrong side would be off by twice its depth.
    #[test]
    fn lifts_flat_points_to_the_depth_of_the_body() {
        let (model, camera, dt) = (default_body(), camera(), 1.0 / 30.0);
        let body = model.shaped(&Betas::zeros());
        let landmarks: Vec<usize> = model.landmarks_of(KeypointConvention::Coco17).into_iter().flatten().collect();
        for seed in 0..6 {
            let mut pose = natural_pose(&mut rand_chacha::ChaCha8Rng::seed_from_u64(seed), 0.5);
            let place = |yaw: f64, pose: &mut crate::body::kinematics::Pose| {
                pose.rotations[0] = rotation::exp(&(Vector3::y() * yaw));
                let skeleton = posed(&body, pose);
                landmarks.iter().map(|l| landmark_position(&model, &body, &skeleton, *l)).collect::<Vec<_>>()
            };
            let truth: Vec<Vec<Vector3<f64>>> =
                (0..30).map(|t| place(seed as f64 + 0.05 * f64::from(t), &mut pose)).collect();
            let flat = |(landmark, x): (&usize, &Vector3<f64>)| {
                let x = camera.camera_from_world.transform(x);
                let position = camera.camera_from_world.inverse().transform(&(x * (4.4 / x.z)));
                PointObservation { landmark: *landmark, position }
            };
            let points = truth.iter().map(|places| landmarks.iter().zip(places).map(flat).collect()).collect();
            let observations = Observations { cameras: vec![camera], points, pixels: vec![Vec::new(); 30] };
            let lifted = lifted(&model, &observations, &Vector3::y(), dt);
            let mut errors = Vec::new();
            for (found, truth) in lifted.iter().zip(&truth) {
                let place = |l: usize| found.iter().find(|p| p.landmark == l).unwrap().position;
                let off: Vec<_> = landmarks.iter().zip(truth).map(|(l, x)| place(*l) - x).collect();
                let mean = off.iter().sum::<Vector3<f64>>() / off.len() as f64;
                errors.extend(off.iter().map(|o| (o - mean).norm()));
            }
            let error = errors.iter().sum::<f64>() / errors.len() as f64;
            assert!(error < 0.12, "{seed}: {error} m");
        }
    }
}
