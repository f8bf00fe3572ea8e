//! The training objective: likelihood of the true rotations, distance of the joints, velocity of the root, contacts.

use super::chart::LocalRotations;
use super::dataset::GRID_FPS;
use super::denoiser::Statement;
use super::denoiser_input::{DenoiserInput, N_INPUT};
use super::joints::Bones;
use super::observed::{DESCRIBED_JOINTS, N_DESCRIBED, ObservedMotion, joints_below};
use crate::body::skeleton::N_JOINTS;
use crate::geometry::rotation::{right_jacobian, skew, step};
use candle_core::{D, Device, Result, Tensor};
use nalgebra::Vector3;

/// A motion as it was: what the network is to state.
#[derive(Debug, Clone, PartialEq)]
pub struct TrueMotion {
    /// Local rotations; entry 0 is `world_from_pelvis`.
    pub rotations: Vec<LocalRotations>,
    /// Position of the pelvis, m.
    pub pelvis: Vec<Vector3<f64>>,
    /// Whether the left and the right foot stand.
    pub contacts: Vec<[bool; 2]>,
}

/// Frames between those whose joint positions count: neighbours are alike.
const POSITION_STRIDE: usize = 4;
/// Coordinates of the joints below the pelvis.
const N_COORDINATES: usize = 3 * (N_JOINTS - 1);
/// Errors beyond this many units do not occur in a bridge that is any use; they are cut.
const LARGEST_ERROR: f64 = 6.0;
/// Degrees of freedom of Student's t distribution in three dimensions, the likelihood of an error: some gaps hold a motion
/// that nothing announces, and under a Gaussian they alone would decide what the network learns.
const FREEDOM: f64 = 5.0;
/// Weight of a seen joint against an unseen one.
const SEEN_WEIGHT: f32 = 0.05;
/// Weight of one metre of joint error against one nat of likelihood.
const POSITION_WEIGHT: f64 = 15.0;
/// Joint errors below this are squared, m.
const POSITION_KNEE: f64 = 0.01;
/// Weights of the root's velocity and of the contacts against one joint's likelihood.
const ROOT_WEIGHT: f64 = 0.1;
const CONTACT_WEIGHT: f64 = 0.1;

/// A batch of inputs and truths as tensors; B motions of T frames.
pub struct Batch {
    /// `[B, T, N_INPUT]`.
    pub input: Tensor,
    units: Tensor,
    target: Tensor,
    weight: Tensor,
    levers: Tensor,
    joint_weight: Tensor,
    velocity: Tensor,
    contact: Tensor,
}

impl Batch {
    /// Motions of equal length with their truths.
    ///
    /// # Errors
    /// The device has no memory left.
    pub fn new(
        bones: &Bones,
        motions: &[(ObservedMotion, DenoiserInput, TrueMotion)],
        device: &Device,
    ) -> Result<Self> {
        let (n_batch, n_frames) = (motions.len(), motions.first().map_or(0, |(observed, ..)| observed.n_frames()));
        let mut rows = Rows::default();
        for (observed, input, truth) in motions {
            rows.add(bones, observed, input, truth);
        }
        let n_positions = n_batch * n_frames.div_ceil(POSITION_STRIDE);
        let tensor = |values: Vec<f32>, width: &[usize]| {
            Tensor::from_vec(values, [&[n_batch, n_frames], width].concat(), device)
        };
        Ok(Self {
            input: tensor(rows.input, &[N_INPUT])?,
            units: tensor(rows.units, &[N_DESCRIBED, 1])?,
            target: tensor(rows.target, &[N_DESCRIBED, 3])?,
            weight: tensor(rows.weight, &[N_DESCRIBED])?,
            levers: Tensor::from_vec(rows.levers, (n_positions, N_COORDINATES, 3 * N_DESCRIBED), device)?,
            joint_weight: Tensor::from_vec(rows.joint_weight, (n_positions, N_JOINTS - 1), device)?,
            velocity: tensor(rows.velocity, &[3])?,
            contact: tensor(rows.contact, &[2])?,
        })
    }

    /// The loss of what the network states.
    ///
    /// # Errors
    /// Shapes differ.
    pub fn loss(&self, stated: &Statement) -> Result<Tensor> {
        let errors = (&self.target - &stated.correction)?;
        let squares = stated.whitened(&errors)?.sqr()?.sum(D::Minus1)?;
        let tails = ((squares / FREEDOM)? + 1.0)?.log()?;
        let nats = ((tails * (0.5 * (FREEDOM + 3.0)))? - stated.log_diagonal.sum(D::Minus1)?)?;
        let likelihood = mean(&nats, &self.weight)?;
        let position = (mean(&self.joint_errors(&errors)?, &self.joint_weight)? * POSITION_WEIGHT)?;
        let velocity = (&self.velocity - &stated.velocity)?.mul(&stated.log_velocity_sigma.neg()?.exp()?)?;
        let root = ((velocity.sqr()? * 0.5)? + &stated.log_velocity_sigma)?.mean_all()?;
        let contact = cross_entropy(&stated.contact, &self.contact)?;
        ((likelihood + position)? + (root * ROOT_WEIGHT)?)? + (contact * CONTACT_WEIGHT)?
    }

    /// Distances of the joints to first order, m, for errors `[B, T, 20, 3]`.
    fn joint_errors(&self, errors: &Tensor) -> Result<Tensor> {
        let increments = errors.broadcast_mul(&self.units)?;
        let (n_batch, n_frames, ..) = increments.dims4()?;
        let picked = Tensor::arange_step(0_u32, n_frames as u32, POSITION_STRIDE as u32, errors.device())?;
        let picked_frames = increments.index_select(&picked, 1)?;
        let n_rows = n_batch * picked.dim(0)?;
        let moved = self.levers.matmul(&picked_frames.reshape((n_rows, 3 * N_DESCRIBED, 1))?)?;
        let squares = moved.reshape((n_rows, N_JOINTS - 1, 3))?.sqr()?.sum(D::Minus1)?;
        (squares + POSITION_KNEE * POSITION_KNEE)?.sqrt()
    }
}

/// The weighted mean.
fn mean(values: &Tensor, weights: &Tensor) -> Result<Tensor> {
    values.mul(weights)?.sum_all()?.div(&weights.sum_all()?)
}

/// Mean cross entropy of log odds x and labels y, `max(x, 0) - x y + log(1 + exp(-|x|))`.
fn cross_entropy(odds: &Tensor, labels: &Tensor) -> Result<Tensor> {
    let small = (odds.abs()?.neg()?.exp()? + 1.0)?.log()?;
    ((odds.relu()? - odds.mul(labels)?)? + small)?.mean_all()
}

#[derive(Default)]
struct Rows {
    input: Vec<f32>,
    units: Vec<f32>,
    target: Vec<f32>,
    weight: Vec<f32>,
    levers: Vec<f32>,
    joint_weight: Vec<f32>,
    velocity: Vec<f32>,
    contact: Vec<f32>,
}

impl Rows {
    fn add(&mut self, bones: &Bones, observed: &ObservedMotion, input: &DenoiserInput, truth: &TrueMotion) {
        self.input.extend(&input.values);
        self.units.extend(&input.units);
        for t in 0..observed.n_frames() {
            let off =
                DESCRIBED_JOINTS.map(|joint| step(&input.bridged.rotations[t][joint], &truth.rotations[t][joint]));
            for (described, off) in off.iter().enumerate() {
                let unit = f64::from(input.units[t * N_DESCRIBED + described]);
                self.target.extend(off.iter().map(|x| (x / unit).clamp(-LARGEST_ERROR, LARGEST_ERROR) as f32));
                self.weight.push(if observed.is_seen(t, described) { SEEN_WEIGHT } else { 1.0 });
            }
            if t.is_multiple_of(POSITION_STRIDE) {
                self.levers.extend(levers(bones, &truth.rotations[t], &off));
                let mut weights = [SEEN_WEIGHT; N_JOINTS];
                for unseen in (0..N_DESCRIBED).filter(|&d| !observed.is_seen(t, d)) {
                    joints_below(DESCRIBED_JOINTS[unseen]).for_each(|joint| weights[joint] = 1.0);
                }
                self.joint_weight.extend(&weights[1..]);
            }
            let next = (t + 1).min(observed.n_frames() - 1);
            let step = |pelvis: &[Vector3<f64>]| (pelvis[next] - pelvis[t]) * GRID_FPS;
            let off = input.bridged.rotations[t][0].transpose() * (step(&truth.pelvis) - step(&input.bridged.pelvis));
            self.velocity.extend(off.iter().map(|x| *x as f32));
            self.contact.extend(truth.contacts[t].map(|stands| f32::from(u8::from(stands))));
        }
    }
}

/// Derivative of the joints by the described joints' corrections, `[69, 60]` row by row: a right increment d of joint a moves
/// the joints below it by `-[p - p_a]x G_a d`, and `exp(u + e) = exp(u) exp(J_r(u) e)` at the true correction u.
pub(super) fn levers(bones: &Bones, rotations: &LocalRotations, corrections: &[Vector3<f64>; N_DESCRIBED]) -> Vec<f32> {
    let posed = bones.posed(rotations);
    let mut rows = vec![0.0; N_COORDINATES * 3 * N_DESCRIBED];
    for (described, &joint) in DESCRIBED_JOINTS.iter().enumerate() {
        // `posed` leaves the pelvis at rest, which changes no distance.
        let turned = posed.rotations[joint] * right_jacobian(&corrections[described]);
        for below in joints_below(joint) {
            let block = -skew(&(posed.joints[below] - posed.joints[joint])) * turned;
            for row in 0..3 {
                for column in 0..3 {
                    rows[(3 * (below - 1) + row) * 3 * N_DESCRIBED + 3 * described + column] =
                        block[(row, column)] as f32;
                }
            }
        }
    }
    rows
}
