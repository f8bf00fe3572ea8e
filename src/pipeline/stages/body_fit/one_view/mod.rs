//! Depth from one view: flat points moved along their rays to where a body of known size can have them.
//!
//! In one image every bone points towards the camera or away from it, and a trunk seen narrow is turned to one side or to
//! the other. Per frame the few ways that the image allows are listed, trunk first ([`trunk`]), then each limb on it
//! ([`limbs`]); which of them is true is left to the joints' ranges and to time, that is to the path of least cost
//! through all frames. Taylor 2000 (reconstruction of articulated objects from point correspondences) lists the ways of a
//! chain of known lengths; the paths through them are ours.
//!
//! Known limits: people are as large as an average adult, so that a child is seen too far off; who lies or stands on their
//! hands is taken for somebody who leans; a limb that stays unseen for long is guessed.

mod limbs;
mod trunk;

use super::evidence::{Evidence, PointEvidence};
use crate::body::BodyModel;
use crate::body::model::{Betas, ShapedBody};
use crate::geometry::projection::project_normalized;
use crate::geometry::{Rigid, rotation};
use crate::optim::robust::median;
use crate::optim::viterbi::cheapest_path;
use limbs::{Bend, BodyLimb, Joints, body_limbs};
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;
use trunk::{Sight, Trunk, Way};

/// A detector's error lasts this long, s: so much time is one independent look at a frame's ways.
const LOOK_SECS: f64 = 0.1;

/// Cost of turning the trunk, nats per rad, and of moving a limb's joint against its root, nats per m: changes of mind are
/// rare, motion is not. Whatever its speed a motion costs the same, so that the frame rate does not matter; on ten
/// simulated captures half and double of either change nothing (78 to 79 mm).
const TURN_COST: f64 = 4.0;
const MOVE_COST: f64 = 10.0;

/// Standard deviation of the logarithm of the trunk's depth, first as the longest limbs tell it, then about its own
/// median over time.
const ROUGH_DEPTH_SIGMA: f64 = 0.1;
const FINE_DEPTH_SIGMA: f64 = 0.02;

/// People do not come nearer by jerks: depths are medians over this long to either side, s.
const DEPTH_SECS: f64 = 0.5;

/// Width of the walls at the ends of the joints' ranges, degrees: twice the fit's, for depths are rough yet.
const LIMIT_WIDTH_DEG: f64 = 10.0;

/// The points of `evidence`, each moved along its ray; frames in which the trunk was not seen have none.
///
/// `up`: the upright in the world; people lean about it.
pub(super) fn lifted(
    model: &BodyModel,
    evidence: &Evidence,
    up: &Vector3<f64>,
    frame_interval: f64,
) -> Vec<Vec<PointEvidence>> {
    let Some(camera) = evidence.cameras.first().map(|c| c.camera_from_world) else { return evidence.points.clone() };
    let lifting = Lifting::new(model, evidence, &camera, up, frame_interval);
    let of_limbs = lifting.flat_depths();
    let rough = lifting.stances(&smoothed(&of_limbs, frame_interval), ROUGH_DEPTH_SIGMA);
    let depth = |(stance, of_limbs): (&Option<Way>, &f64)| stance.map_or(*of_limbs, |way| lifting.trunk.depth(&way));
    let depths: Vec<f64> = rough.iter().zip(&of_limbs).map(depth).collect();
    let stances = lifting.stances(&smoothed(&depths, frame_interval), FINE_DEPTH_SIGMA);
    let mut points = lifting.trunk_points(&stances);
    for limb in &lifting.limbs {
        lifting.add_limb(limb, &stances, &mut points);
    }
    points
}

/// What every step reads.
struct Lifting<'a> {
    body: ShapedBody,
    trunk: Trunk,
    limbs: Vec<BodyLimb>,
    joints: Joints,
    /// By frame and landmark.
    normalized: Vec<Vec<Option<Vector2<f64>>>>,
    camera: &'a Rigid,
    /// In the camera's frame.
    up: Vector3<f64>,
    evidence: &'a Evidence,
    /// What one frame's evidence counts: detectors' errors last.
    frame_weight: f64,
}

impl<'a> Lifting<'a> {
    fn new(
        model: &BodyModel,
        evidence: &'a Evidence,
        camera: &'a Rigid,
        up: &Vector3<f64>,
        frame_interval: f64,
    ) -> Self {
        let body = model.shaped(&Betas::zeros());
        let by_landmark = |points: &Vec<PointEvidence>| {
            let mut normalized = vec![None; model.landmarks.len()];
            for point in points {
                normalized[point.landmark] = project_normalized(camera, &point.position).map(|p| p.normalized);
            }
            normalized
        };
        Self {
            trunk: Trunk::new(model, &body),
            limbs: body_limbs(model, &body),
            joints: Joints::new(model, LIMIT_WIDTH_DEG.to_radians()),
            normalized: evidence.points.iter().map(by_landmark).collect(),
            camera,
            up: camera.rotation * up,
            evidence,
            frame_weight: frame_interval / LOOK_SECS,
            body,
        }
    }

    /// Depth of the flat points of every frame, m; where there are none that of the frame before.
    fn flat_depths(&self) -> Vec<f64> {
        let of_frame = |points: &Vec<PointEvidence>| {
            median(&mut points.iter().map(|p| self.camera.transform(&p.position).z).collect::<Vec<_>>())
        };
        let known: Vec<Option<f64>> = self.evidence.points.iter().map(of_frame).collect();
        let mut last = known.iter().flatten().next().copied().unwrap_or(4.0);
        known
            .into_iter()
            .map(|depth| {
                last = depth.unwrap_or(last);
                last
            })
            .collect()
    }

    /// How the trunk stands in every frame, given its depth: of the ways that the image allows those on the path of least
    /// cost, which is their own, what the limbs must do on them, and turning.
    fn stances(&self, depths: &[f64], depth_sigma: f64) -> Vec<Option<Way>> {
        let of_frame = |(t, depth): (usize, &f64)| {
            let sight = Sight { normalized: &self.normalized[t], up: self.up, depth: *depth, depth_sigma };
            let ways = self.trunk.ways(&sight);
            let own = |way: &Way| self.frame_weight * (way.cost + self.limb_cost(t, way));
            let costs = ways.iter().map(own).collect();
            (ways, costs)
        };
        let (ways, own): (Vec<Vec<Way>>, Vec<Vec<f64>>) = depths.par_iter().enumerate().map(of_frame).unzip();
        let turn = |t: usize, r: usize, u: usize, s: usize| {
            let (one, other) = (&ways[t][r].camera_from_body, &ways[u][s].camera_from_body);
            TURN_COST * rotation::angle_between(&one.rotation, &other.rotation)
        };
        cheapest_path(&own, turn).into_iter().zip(&ways).map(|(chosen, ways)| chosen.map(|c| ways[c])).collect()
    }

    /// What the limbs' easiest bends cost on a trunk.
    fn limb_cost(&self, t: usize, way: &Way) -> f64 {
        let of_limb = |limb: &BodyLimb| self.bends(t, limb, way).iter().map(|b| b.cost).reduce(f64::min).unwrap_or(0.0);
        self.limbs.iter().map(of_limb).sum()
    }

    fn root(&self, t: usize, limb: &BodyLimb, way: &Way) -> Option<Vector3<f64>> {
        let place = self.trunk.place(way, limb.landmarks[0])?;
        Some(self.normalized[t][limb.landmarks[0]].map_or(place, |b| Vector3::new(b.x, b.y, 1.0) * place.z))
    }

    fn bends(&self, t: usize, limb: &BodyLimb, way: &Way) -> Vec<Bend> {
        let Some(root) = self.root(t, limb, way) else { return Vec::new() };
        limb.bends(&self.joints, &self.body, &way.camera_from_body.rotation, &root, &self.normalized[t])
    }

    /// The points of trunk and head on their rays, as deep as the trunk has them.
    fn trunk_points(&self, stances: &[Option<Way>]) -> Vec<Vec<PointEvidence>> {
        let world_from_camera = self.camera.inverse();
        let point = |t: usize, way: &Way, landmark: usize| {
            let (normalized, place) = (self.normalized[t][landmark]?, self.trunk.place(way, landmark)?);
            let position = world_from_camera.transform(&(Vector3::new(normalized.x, normalized.y, 1.0) * place.z));
            Some(PointEvidence { landmark, position })
        };
        let of_frame = |(t, way): (usize, &Option<Way>)| {
            way.map_or_else(Vec::new, |way| self.trunk.landmarks().filter_map(|l| point(t, &way, l)).collect())
        };
        stances.iter().enumerate().map(of_frame).collect()
    }

    /// Adds middle and end of a limb: of the ways to bend those on the path of least cost.
    fn add_limb(&self, limb: &BodyLimb, stances: &[Option<Way>], points: &mut [Vec<PointEvidence>]) {
        let root = |(t, way): (usize, &Option<Way>)| way.and_then(|way| self.root(t, limb, &way));
        let roots: Vec<Vector3<f64>> =
            stances.iter().enumerate().map(|at| root(at).unwrap_or_else(Vector3::zeros)).collect();
        let bends: Vec<Vec<Bend>> = (stances.iter().enumerate())
            .map(|(t, way)| way.map_or_else(Vec::new, |way| self.bends(t, limb, &way)))
            .collect();
        let own: Vec<Vec<f64>> =
            bends.iter().map(|bends| bends.iter().map(|b| self.frame_weight * b.cost).collect()).collect();
        let shift = |t: usize, r: usize, u: usize, s: usize| {
            let moved = |i: usize| ((bends[u][s].places[i] - roots[u]) - (bends[t][r].places[i] - roots[t])).norm();
            MOVE_COST * (moved(0) + moved(1))
        };
        let world_from_camera = self.camera.inverse();
        for (t, chosen) in cheapest_path(&own, shift).into_iter().enumerate() {
            let Some(bend) = chosen.map(|c| bends[t][c]) else { continue };
            for (landmark, place) in limb.landmarks[1..].iter().zip(bend.places) {
                points[t].push(PointEvidence { landmark: *landmark, position: world_from_camera.transform(&place) });
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
    use super::super::evidence::PlacedCamera;
    use super::*;
    use crate::body::default_body;
    use crate::body::joint_ranges::natural_pose;
    use crate::body::kinematics::{landmark_position, posed};
    use crate::body::skeleton::KeypointConvention;
    use crate::geometry::Intrinsics;
    use rand::SeedableRng;

    /// A camera at eye level whose image stands upright in a world with y up, looking along -z.
    fn camera() -> PlacedCamera {
        let rotation = rotation::exp(&(Vector3::x() * std::f64::consts::PI));
        PlacedCamera {
            intrinsics: Intrinsics::PLAIN,
            camera_from_world: Rigid { rotation, translation: Vector3::new(0.0, 1.4, 4.0) },
        }
    }

    /// People who turn about by a quarter in a second, each in a natural pose; their points flat, a tenth too far off.
    ///
    /// The bound is a third of a limb: bones whose image is a guess short would be off by twice their depth.
    #[test]
    fn flat_points_are_given_the_depth_of_the_body_that_casts_them() {
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
                PointEvidence { landmark: *landmark, position }
            };
            let points = truth.iter().map(|places| landmarks.iter().zip(places).map(flat).collect()).collect();
            let evidence = Evidence { cameras: vec![camera], points, pixels: vec![Vec::new(); 30] };
            let lifted = lifted(&model, &evidence, &Vector3::y(), dt);
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
