//! The least-squares fit of the capsules to a body's skin at rest and in natural poses, and of their change per beta.
//!
//! Every sampled vertex is assigned to its nearest capsule, in the frame of the capsule's joint; per capsule
//! `min sum w d(v_i)^2` over two ends and two radii by damped Gauss-Newton, with new assignments after each step; most steps look
//! among the capsules that were nearly nearest before. With fixed assignments, the change per beta at rest is linear:
//! `min sum (D_i x + n_i . S_i)^2`, where `D_i` are the derivatives of the distance to the eight numbers.
//!
//! A vertex may be assigned to a capsule only if its skin weights include a joint near the capsule's: a hand that hangs at a
//! hip is not assigned to the hip.

use super::body_capsules::{BodyCapsule, BodyCapsules, CapsuleEnd, MIN_RADIUS, N_CAPSULES};
use super::start::{RoughCapsule, rough_capsules};
use crate::body::anthropometry::N_BETAS;
use crate::body::joint_ranges::natural_pose;
use crate::body::kinematics::{Pose, PosedSkeleton, posed};
use crate::body::model::{Betas, BodyModel};
use crate::body::skeleton::PARENTS;
use crate::body::skinning::skinned;
use crate::body::surface::JointWeight;
use crate::geometry::capsule::{PointDistance, TaperedCapsule};
use nalgebra::{SMatrix, SVector, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Approximate number of vertices used.
const N_SAMPLES: usize = 2_500;
/// Gauss-Newton steps; the residual changes by less than 1 % after them.
const N_STEPS: usize = 12;
/// After every how many steps all capsules are looked at again.
const SEARCH_STEPS: usize = 4;
/// How much farther a capsule may be than the nearest and still become it before that, m: ends move less between two searches.
const NEARLY: f64 = 0.03;
/// Damping, small against some hundred vertices a capsule: it holds ends inside the body that few vertices determine.
const DAMPING: f64 = 0.3;
/// Natural poses beside the rest pose; without them the capsules at the shoulders fit the T-pose only.
const N_POSES: usize = 8;
/// Spread of the natural poses, as a share of the joints' standard deviations.
const POSE_SPREAD: f64 = 0.5;
/// Weight of the rest pose relative to a natural pose: as much as all of them together.
const REST_WEIGHT: f64 = 8.0;

/// Both ends in the joint's frame, both radii.
type Numbers = SVector<f64, 8>;
type NumbersByBetas = SMatrix<f64, 8, N_BETAS>;
type Normal = SMatrix<f64, 8, 8>;

impl BodyCapsules {
    /// Fits the capsules to a model's surface at rest and in some natural poses; takes a tenth of a second.
    pub fn fitted(model: &BodyModel) -> Self {
        fitted(model)
    }
}

fn fitted(model: &BodyModel) -> BodyCapsules {
    let rough = rough_capsules(model);
    let joints = rough.map(|r| r.joint);
    let samples = samples(model, &joints);
    let mut views = views(model, &samples);
    let mut numbers = rough.map(|r| start_numbers(model, &r));
    for step in 0..N_STEPS {
        if step.is_multiple_of(SEARCH_STEPS) {
            views.par_iter_mut().for_each(|view| view.search(&samples, &joints, &numbers));
        }
        let damping = DAMPING * views.iter().map(|view| view.weight).sum::<f64>();
        let mut systems = [(Normal::identity() * damping, Numbers::zeros()); N_CAPSULES];
        let owned: Vec<Vec<Owned>> = views.par_iter().map(|view| view.owned(&samples, &joints, &numbers)).collect();
        for (view, owned) in views.iter().zip(owned) {
            for owned in owned {
                let (normal, moment) = &mut systems[owned.capsule];
                *normal += owned.by_numbers * owned.by_numbers.transpose() * view.weight;
                *moment -= owned.by_numbers * (owned.distance * view.weight);
            }
        }
        for (numbers, (normal, moment)) in numbers.iter_mut().zip(&systems) {
            *numbers += solved(normal, moment);
            numbers.fixed_rows_mut::<2>(6).apply(|radius| *radius = radius.max(MIN_RADIUS));
        }
    }
    views[0].search(&samples, &joints, &numbers);
    let rest = views[0].owned(&samples, &joints, &numbers);
    let by_betas = numbers_by_betas(model, &rough, rest);
    BodyCapsules { capsules: std::array::from_fn(|k| body_capsule(joints[k], &numbers[k], &by_betas[k])) }
}

/// Some of the capsules, a bit each.
#[derive(Clone, Copy)]
struct Candidates(u32);

impl Candidates {
    fn of(chosen: impl Fn(usize) -> bool) -> Self {
        Self((0..N_CAPSULES).filter(|&k| chosen(k)).fold(0, |bits, k| bits | 1 << k))
    }

    fn has(self, capsule: usize) -> bool {
        self.0 >> capsule & 1 == 1
    }

    fn iter(self) -> impl Iterator<Item = usize> {
        (0..N_CAPSULES).filter(move |&k| self.has(k))
    }
}

/// A sampled vertex and the capsules it may be assigned to.
struct Sample {
    vertex: usize,
    candidates: Candidates,
}

fn samples(model: &BodyModel, joints: &[usize; N_CAPSULES]) -> Vec<Sample> {
    let skin = &model.surface.skin;
    let step = (skin.len() / N_SAMPLES).max(1);
    let candidates = |vertex: usize| Candidates::of(|k| is_near(&skin[vertex], joints[k]));
    (0..skin.len()).step_by(step).map(|vertex| Sample { vertex, candidates: candidates(vertex) }).collect()
}

/// Whether the skin weights include the joint or one at most two bones away.
fn is_near(skin: &[JointWeight], joint: usize) -> bool {
    let up = |joint: usize| [Some(joint), PARENTS[joint], PARENTS[joint].and_then(|parent| PARENTS[parent])];
    let [own, parent, grandparent] = up(joint);
    let is_close = |other: usize| {
        let above = up(other);
        above.contains(&own) || above[..2].contains(&parent) || Some(other) == grandparent
    };
    skin.iter().any(|share| is_close(share.joint))
}

/// The samples in one pose.
struct View {
    skeleton: PosedSkeleton,
    /// Positions of the samples, world, m.
    places: Vec<Vector3<f64>>,
    /// Capsules that were nearly nearest to each at the last search.
    near: Vec<Candidates>,
    weight: f64,
}

/// The rest pose, then the natural poses.
fn views(model: &BodyModel, samples: &[Sample]) -> Vec<View> {
    let view = |pose: &Pose, weight: f64| {
        let skin = skinned(model, &Betas::zeros(), pose);
        let skeleton = posed(&model.shaped(&Betas::zeros()), pose);
        let places = samples.iter().map(|sample| skin[sample.vertex]).collect();
        View { skeleton, places, near: samples.iter().map(|sample| sample.candidates).collect(), weight }
    };
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let poses = (0..N_POSES).map(|_| view(&natural_pose(&mut rng, POSE_SPREAD), 1.0));
    std::iter::once(view(&Pose::rest(), REST_WEIGHT)).chain(poses).collect()
}

/// A vertex and its nearest capsule.
struct Owned {
    vertex: usize,
    capsule: usize,
    distance: f64,
    /// Unit vector from the capsule to the vertex in the joint's frame.
    normal: Vector3<f64>,
    /// Derivative of the distance to the capsule's numbers.
    by_numbers: Numbers,
}

impl View {
    /// Finds the capsules that are nearly nearest to each sample.
    fn search(&mut self, samples: &[Sample], joints: &[usize; N_CAPSULES], numbers: &[Numbers; N_CAPSULES]) {
        let capsules = numbers.each_ref().map(tapered_capsule);
        let mut distances = [f64::INFINITY; N_CAPSULES];
        for ((sample, place), near) in samples.iter().zip(&self.places).zip(&mut self.near) {
            let candidates = sample.candidates;
            for k in candidates.iter() {
                distances[k] = capsules[k].distance_to(&in_joint(&self.skeleton, joints[k], place)).distance;
            }
            let least = candidates.iter().map(|k| distances[k]).fold(f64::INFINITY, f64::min);
            *near = Candidates::of(|k| candidates.has(k) && distances[k] <= least + NEARLY);
        }
    }

    /// Each sample with the nearest of its near capsules.
    fn owned(&self, samples: &[Sample], joints: &[usize; N_CAPSULES], numbers: &[Numbers; N_CAPSULES]) -> Vec<Owned> {
        let capsules = numbers.each_ref().map(tapered_capsule);
        let distance =
            |k: usize, place: &Vector3<f64>| (k, capsules[k].distance_to(&in_joint(&self.skeleton, joints[k], place)));
        let owned = |((sample, place), near): ((&Sample, &Vector3<f64>), &Candidates)| {
            let distances = near.iter().map(|k| distance(k, place));
            let nearest = distances.reduce(|a, b| if b.1.distance < a.1.distance { b } else { a })?;
            let (capsule, PointDistance { distance, share, normal }) = nearest;
            Some(Owned { vertex: sample.vertex, capsule, distance, normal, by_numbers: by_numbers(share, &normal) })
        };
        samples.iter().zip(&self.places).zip(&self.near).filter_map(owned).collect()
    }
}

/// A place in the frame of a joint.
fn in_joint(skeleton: &PosedSkeleton, joint: usize, place: &Vector3<f64>) -> Vector3<f64> {
    skeleton.rotations[joint].tr_mul(&(place - skeleton.joints[joint]))
}

fn start_numbers(model: &BodyModel, rough: &RoughCapsule) -> Numbers {
    let [first, second] = rough.ends.map(|end| end - model.rest_joints[rough.joint]);
    Numbers::from_iterator(first.iter().chain(second.iter()).copied().chain([rough.radius; 2]))
}

fn tapered_capsule(numbers: &Numbers) -> TaperedCapsule {
    let end = |start: usize| numbers.fixed_rows::<3>(start).into_owned();
    TaperedCapsule { ends: [end(0), end(3)], radii: [numbers[6], numbers[7]] }
}

/// `-(1 - s) n`, `-s n`, `-(1 - s)`, `-s`.
fn by_numbers(share: f64, normal: &Vector3<f64>) -> Numbers {
    let (first, second) = (normal * (share - 1.0), normal * -share);
    Numbers::from_iterator(first.iter().chain(second.iter()).copied().chain([share - 1.0, -share]))
}

/// Change of the numbers per beta, fitted to the skin at rest; starts from the change of the joints, with fixed radii.
fn numbers_by_betas(
    model: &BodyModel,
    rough: &[RoughCapsule; N_CAPSULES],
    owned: Vec<Owned>,
) -> [NumbersByBetas; N_CAPSULES] {
    let mut by_betas = rough.map(|r| {
        let [first, second] = r.directions.map(|d| d - model.shape_directions[r.joint]);
        let mut start = NumbersByBetas::zeros();
        start.fixed_rows_mut::<3>(0).copy_from(&first);
        start.fixed_rows_mut::<3>(3).copy_from(&second);
        start
    });
    let mut systems = [(Normal::identity() * DAMPING, NumbersByBetas::zeros()); N_CAPSULES];
    for Owned { vertex, capsule, normal, by_numbers, .. } in owned {
        let (system, moment) = &mut systems[capsule];
        let in_joint = model.surface.shape_directions[vertex] - model.shape_directions[rough[capsule].joint];
        let missing = normal.transpose() * in_joint + by_numbers.transpose() * by_betas[capsule];
        *system += by_numbers * by_numbers.transpose();
        *moment -= by_numbers * missing;
    }
    for (by_betas, (normal, moment)) in by_betas.iter_mut().zip(&systems) {
        *by_betas += solved(normal, moment);
    }
    by_betas
}

fn solved<const N: usize>(normal: &Normal, moment: &SMatrix<f64, 8, N>) -> SMatrix<f64, 8, N> {
    normal.cholesky().expect("a sum of squares and a positive multiple of the identity").solve(moment)
}

fn body_capsule(joint: usize, numbers: &Numbers, by_betas: &NumbersByBetas) -> BodyCapsule {
    let end = |k: usize| CapsuleEnd {
        offset: numbers.fixed_rows::<3>(3 * k).into_owned(),
        offset_directions: by_betas.fixed_rows::<3>(3 * k).into_owned(),
        radius: numbers[6 + k],
        radius_directions: by_betas.row(6 + k).transpose(),
    };
    BodyCapsule { joint, ends: [end(0), end(1)] }
}
