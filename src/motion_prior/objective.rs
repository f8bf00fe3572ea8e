//! The training loss, with gradients to the features.
//!
//! All in millimetres on the default skeleton without the root; `rho(x, s) = sqrt(|x|^2 + s^2) - s` (Charbonnier): the
//! error of the 23 joints, of their velocities and accelerations per frame; and of 19 rotations, as the displacement of a
//! point on a short lever, since a rotation about a bone's own axis, or of a last bone, moves no joint.

use super::chart::{Chart, Features, LATENT_JOINTS, LocalRotations, N_FEATURES};
use super::joints::{Bones, JointPositions, frame};
use crate::body::joint_ranges::{JointRange, joint_ranges};
use crate::body::skeleton::N_JOINTS;
use crate::geometry::rotation;
use nalgebra::Vector3;

/// Scale of position errors, m: smaller ones count quadratically; 5 mm is the error of the frozen code.
const POSITION_SCALE: f64 = 0.005;
/// Scale of errors of differences between frames, m.
const DIFFERENCE_SCALE: f64 = 0.002;
/// Weight of velocity relative to position, per frame and mm.
const VELOCITY_WEIGHT: f64 = 2.0;
/// Weight of acceleration relative to position, per frame and mm.
const ACCELERATION_WEIGHT: f64 = 1.0;
/// Length of the lever of rotation errors, m: half a head, a foot's toes.
const LEVER: f64 = 0.05;
/// Weight of rotation relative to position.
const ROTATION_WEIGHT: f64 = 0.5;
/// Weight of the joint loss relative to one nat of KL per dimension.
const JOINT_WEIGHT: f64 = 0.1 * 1000.0;

/// Value of a loss over a clip and its gradient to the features `[T, 57]`.
pub(crate) struct Loss {
    pub(crate) value: f64,
    pub(crate) d_features: Vec<f32>,
}

/// Joints and rotations of a true clip.
pub(crate) struct Truth {
    joints: Vec<JointPositions>,
    rotations: Vec<LocalRotations>,
}

impl Truth {
    pub(crate) fn of(chart: &Chart, bones: &Bones, features: &[f32]) -> Self {
        let rotations: Vec<_> = features.chunks_exact(N_FEATURES).map(|row| chart.rotations(&frame(row))).collect();
        Self { joints: rotations.iter().map(|local| bones.posed(local).joints).collect(), rotations }
    }
}

/// Joints of every frame.
pub(crate) fn joints_of(chart: &Chart, bones: &Bones, features: &[f32]) -> Vec<JointPositions> {
    features.chunks_exact(N_FEATURES).map(|row| bones.joints(chart, &frame(row))).collect()
}

/// The joint loss of a clip, times `weight` (1 over the number of clips).
pub(crate) fn joint_loss(chart: &Chart, bones: &Bones, features: &[f32], truth: &Truth, weight: f64) -> Loss {
    let n_frames = truth.joints.len();
    let frames: Vec<_> = features.chunks_exact(N_FEATURES).map(frame).collect();
    let locals: Vec<_> = frames.iter().map(|f| chart.rotations(f)).collect();
    let posed: Vec<_> = locals.iter().map(|local| bones.posed(local)).collect();
    let error = |t: usize, j: usize| posed[t].joints[j] - truth.joints[t][j];
    let mut pulls = vec![[Vector3::zeros(); N_JOINTS]; n_frames];
    let mut value = 0.0;
    let stencils: [(&[f64], f64, f64); 3] = [
        (&[1.0], 1.0, POSITION_SCALE),
        (&[1.0, -1.0], VELOCITY_WEIGHT, DIFFERENCE_SCALE),
        (&[1.0, -2.0, 1.0], ACCELERATION_WEIGHT, DIFFERENCE_SCALE),
    ];
    for (stencil, share, scale) in stencils {
        let n_terms = (n_frames + 1).saturating_sub(stencil.len());
        let unit = weight * JOINT_WEIGHT * share / (n_terms.max(1) * (N_JOINTS - 1)) as f64;
        for t in 0..n_terms {
            for j in 1..N_JOINTS {
                let x: Vector3<f64> = stencil.iter().enumerate().map(|(k, c)| error(t + k, j) * *c).sum();
                let root = (x.norm_squared() + scale * scale).sqrt();
                value += unit * (root - scale);
                stencil.iter().enumerate().for_each(|(k, c)| pulls[t + k][j] += x * (unit * c / root));
            }
        }
    }
    let mut d_features = Vec::with_capacity(features.len());
    for (t, ((posed, features), pull)) in posed.iter().zip(&frames).zip(&pulls).enumerate() {
        let mut d = [0.0; N_FEATURES];
        bones.pull_back(posed, features, pull, &mut d);
        let unit = weight * JOINT_WEIGHT * ROTATION_WEIGHT / (n_frames * LATENT_JOINTS.len()) as f64;
        value += unit * rotation_loss(&locals[t], &truth.rotations[t], features, unit, &mut d);
        d_features.extend(d.map(|v| v as f32));
    }
    Loss { value, d_features }
}

/// `sum rho(x, s)` over the joints of a frame with the chord `x^2 = l^2 |R - T|^2 / 2 = l^2 (3 - tr T^T R)`, which is
/// `(l angle)^2` to first order; adds its gradient, times `unit`: `R exp(e)` changes `tr T^T R` by `-e . w`, w the axial
/// vector `(A_32 - A_23, A_13 - A_31, A_21 - A_12)` of `A = T^T R`.
fn rotation_loss(
    found: &LocalRotations,
    truth: &LocalRotations,
    features: &Features,
    unit: f64,
    d_features: &mut Features,
) -> f64 {
    let mut value = 0.0;
    for (i, joint) in LATENT_JOINTS.iter().enumerate() {
        let between = truth[*joint].tr_mul(&found[*joint]);
        let root = (LEVER * LEVER * (3.0 - between.trace()) + POSITION_SCALE * POSITION_SCALE).sqrt();
        value += root - POSITION_SCALE;
        let axial = rotation::axial(&between);
        let u = Vector3::from_column_slice(&features[3 * i..3 * i + 3]);
        let d = rotation::right_jacobian(&u).tr_mul(&axial) * (unit * 0.5 * LEVER * LEVER / root);
        (0..3).for_each(|axis| d_features[3 * i + axis] += d[axis]);
    }
    value
}

/// Scale of the excess over a joint's range, rad (3 degrees): a smaller excess counts quadratically.
const LIMIT_SCALE: f64 = 0.05;
/// Weight of one radian beyond one range in every frame relative to one nat of KL.
const LIMIT_WEIGHT: f64 = 10.0;

/// The excess of rotation vectors over their joints' ranges, `sum rho(excess)`, times `weight`.
pub(crate) fn limit_loss(chart: &Chart, features: &[f32], weight: f64) -> Loss {
    let ranges = joint_ranges();
    let n_frames = features.len() / N_FEATURES;
    let unit = weight * LIMIT_WEIGHT / n_frames.max(1) as f64;
    let mut loss = Loss { value: 0.0, d_features: vec![0.0; features.len()] };
    for (row, d_row) in features.chunks_exact(N_FEATURES).zip(loss.d_features.chunks_exact_mut(N_FEATURES)) {
        for (i, (joint, mean)) in LATENT_JOINTS.iter().zip(&chart.means).enumerate() {
            let u = Vector3::from_fn(|axis, _| f64::from(row[3 * i + axis]));
            let turn = rotation::log(&(mean * rotation::exp(&u)));
            let excess = excess(&turn, &ranges[*joint]);
            let square = excess.norm_squared();
            if square == 0.0 {
                continue;
            }
            let root = (square + LIMIT_SCALE * LIMIT_SCALE).sqrt();
            loss.value += unit * (root - LIMIT_SCALE);
            // log(M exp(u + e)) = log(M exp(u) exp(J_r(u) e)) = log(M exp(u)) + J_r^-1(log M exp(u)) J_r(u) e
            let by_features = rotation::right_jacobian_inverse(&turn) * rotation::right_jacobian(&u);
            let d = by_features.tr_mul(&excess) * (unit / root);
            (0..3).for_each(|axis| d_row[3 * i + axis] += d[axis] as f32);
        }
    }
    loss
}

/// Excess of a rotation vector over the range, per component; zero inside.
pub(crate) fn excess(turn: &Vector3<f64>, range: &JointRange) -> Vector3<f64> {
    Vector3::from_fn(|axis, _| (turn[axis] - range.max[axis]).max(0.0) + (turn[axis] - range.min[axis]).min(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn setting() -> (Chart, Bones, Vec<f32>) {
        let chart = Chart { means: [rotation::exp(&Vector3::new(0.3, 0.2, -0.2)); LATENT_JOINTS.len()] };
        let features = (0..5 * N_FEATURES).map(|i| (i as f32 * 0.37).sin() * 0.9).collect();
        (chart, Bones::of_default_body(), features)
    }

    /// Steps of 1e-3 in single precision are good to 1e-3 of gradients of the order of 1.
    fn agree_with_differences(features: &[f32], loss: impl Fn(&[f32]) -> Loss) {
        let gradient = loss(features).d_features;
        assert!(gradient.iter().any(|d| d.abs() > 1e-2));
        for i in (0..features.len()).step_by(7) {
            let stepped = |h: f32| {
                let mut features = features.to_vec();
                features[i] += h;
                loss(&features).value
            };
            let difference = (stepped(1e-3) - stepped(-1e-3)) / 2e-3;
            assert!((difference - f64::from(gradient[i])).abs() < 1e-3 * (1.0 + difference.abs()), "{i}");
        }
    }

    #[test]
    fn the_gradients_agree_with_central_differences() {
        let (chart, bones, features) = setting();
        let other: Vec<f32> = features.iter().map(|f| f * 0.8).collect();
        let truth = Truth::of(&chart, &bones, &other);
        agree_with_differences(&features, |f| joint_loss(&chart, &bones, f, &truth, 1.0));
        agree_with_differences(&features, |f| limit_loss(&chart, f, 1.0));
    }

    #[test]
    fn the_truth_and_the_rest_pose_have_no_loss() {
        let (chart, bones, features) = setting();
        let truth = Truth::of(&chart, &bones, &features);
        assert!(joint_loss(&chart, &bones, &features, &truth, 1.0).value < 1e-9);
        let ranges = joint_ranges();
        let rest = Chart { means: LATENT_JOINTS.map(|j| rotation::exp(&ranges[j].rest)) };
        assert_eq!(limit_loss(&rest, &[0.0; N_FEATURES], 1.0).value, 0.0);
    }
}
