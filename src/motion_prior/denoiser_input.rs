//! What the denoiser reads: the bridged motion, and how well each joint of each frame is known.
//!
//! Everything is relative to the pelvis or to the parent joint, so that neither the place nor the heading of a person
//! matters and no pose is singular: the way up, the velocity and the angular velocity in the pelvis's frame stand for the
//! motion of the root.

use super::bridge::{BridgedMotion, DECAY_FRAMES, Place, bridge};
use super::chart::{LATENT_JOINTS, LocalRotations};
use super::dataset::GRID_FPS;
use super::observed::{DESCRIBED_JOINTS, N_DESCRIBED, ObservedMotion};
use crate::geometry::rotation::{log, to_6d};
use nalgebra::Vector3;

/// Two columns of each rotation; up, velocity (m/s) and angular velocity (tenths of rad/s) of the pelvis; the bridge's
/// difference from the shortest rotation; and for each joint four numbers of its gap.
pub const N_INPUT: usize = 6 * LATENT_JOINTS.len() + 9 + 3 * N_DESCRIBED + 4 * N_DESCRIBED;

/// Frames beyond which the distance from an edge makes no difference.
const FAR: usize = 120;

/// Factor of the bridge's difference from the shortest rotation, which is some 0.2 rad: all inputs are of the order of 1.
const DIFFERENCE_GAIN: f64 = 5.0;

/// The input of a motion, with what its output refers to.
#[derive(Debug, Clone, PartialEq)]
pub struct DenoiserInput {
    /// `[T, N_INPUT]`.
    pub values: Vec<f32>,
    /// Unit of the corrections, `[T, 20]`, rad: the expected error of the bridge.
    pub units: Vec<f32>,
    /// The motion that the output corrects.
    pub bridged: BridgedMotion,
}

/// Expected error per axis of an observation or a bridge, rad: the standard deviation of a seen joint; in a gap a rough curve,
/// 1 degree beside an edge and 16 degrees 30 frames away from it, which the network corrects.
fn expected_error(sigma: f64, reach: Option<usize>) -> f64 {
    match reach {
        None => (sigma + 0.005).min(0.5),
        Some(reach) => {
            let reach = reach.min(FAR) as f64;
            0.01 + 0.45 * (reach / (reach + 12.0)).powf(1.5)
        }
    }
}

/// The input of a motion. `rest`: rotations of joints that are never seen.
pub fn denoiser_input(motion: &ObservedMotion, rest: &LocalRotations) -> DenoiserInput {
    let bridged = bridge(motion, rest, DECAY_FRAMES);
    let shortest = bridge(motion, rest, 0.0);
    let mut values = Vec::with_capacity(motion.n_frames() * N_INPUT);
    let mut units = Vec::with_capacity(motion.n_frames() * N_DESCRIBED);
    for t in 0..motion.n_frames() {
        let frame = &bridged.rotations[t];
        values.extend(LATENT_JOINTS.iter().flat_map(|&joint| to_6d(&frame[joint])).map(|x| x as f32));
        values.extend(root_motion(&bridged, t).iter().flat_map(|v| v.iter().map(|x| *x as f32)));
        for (described, &joint) in DESCRIBED_JOINTS.iter().enumerate() {
            let off = match bridged.places[t][described] {
                Some(_) => log(&(shortest.rotations[t][joint].transpose() * frame[joint])),
                None => Vector3::zeros(),
            };
            values.extend(off.iter().map(|x| (x * DIFFERENCE_GAIN) as f32));
        }
        for described in 0..N_DESCRIBED {
            let place = bridged.places[t][described];
            let sigma = motion.sigma[t][described];
            values.extend(gap_numbers(t, place, sigma));
            units.push(expected_error(sigma, place.map(|place| place.reach(t))) as f32);
        }
    }
    DenoiserInput { values, units, bridged }
}

/// Up, velocity in m/s and angular velocity in 10 rad/s of the pelvis, in its own frame.
fn root_motion(motion: &BridgedMotion, t: usize) -> [Vector3<f64>; 3] {
    let own_from_world = motion.rotations[t][0].transpose();
    let next = (t + 1).min(motion.pelvis.len() - 1);
    let velocity = own_from_world * (motion.pelvis[next] - motion.pelvis[t]) * GRID_FPS;
    let turning = log(&(own_from_world * motion.rotations[next][0])) * (0.1 * GRID_FPS);
    [own_from_world * Vector3::y(), velocity, turning]
}

/// Whether a joint is unseen, how well it is known, its place in the gap and the gap's length.
fn gap_numbers(frame: usize, place: Option<Place>, sigma: f64) -> [f32; 4] {
    let Some(place) = place else { return [0.0, (1.0 + (sigma + 1e-3).ln() / 5.0) as f32, 0.0, 0.0] };
    let far = |distance: usize| distance.min(FAR) as f64;
    let before = place.before.map_or(FAR as f64, |edge| far(frame - edge));
    let after = place.after.map_or(FAR as f64, |edge| far(edge - frame));
    [1.0, 1.0, (before / (before + after) - 0.5) as f32, ((before + after).ln() / 5.0) as f32]
}
