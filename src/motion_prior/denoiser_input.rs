//! What the denoiser reads: how the seen joints and the pelvis depart from a motion in which all go over the gap as a bridge does.
//!
//! The network learns how the departure of an unseen joint follows from those of the seen ones: how a leg swings while the other
//! leg and the arms swing. The pose itself is left out: with it the network knew its own subjects by their postures, and
//! erred by more than the bridge on others. Joints are read by their positions: keypoints do not show how a limb twists or
//! how the spine's joints share what the trunk does, and recorded skeletons share it in ways of their own.

use super::bridge::{BridgedMotion, DECAY_FRAMES, Place, bridge, bridged_throughout, longest_gaps};
use super::chart::LocalRotations;
use super::dataset::GRID_FPS;
use super::joints::Bones;
use super::observed::{N_DESCRIBED, ObservedMotion};
use crate::geometry::rotation::log;
use nalgebra::Vector3;
use std::sync::OnceLock;

/// Joints whose positions are read: knees, ankles, head, shoulders, elbows, wrists.
const READ_JOINTS: [usize; 11] = [4, 5, 7, 8, 15, 16, 17, 18, 19, 20, 21];

/// Departures of the joints and of the pelvis's rotation and position; way up and velocity (m/s) of the pelvis in its own frame;
/// which joints are unseen; and four numbers of the gap.
pub const N_INPUT: usize = 3 * READ_JOINTS.len() + 6 + 6 + N_DESCRIBED + 4;

/// Frames beyond which the distance from an edge makes no difference.
const FAR: usize = 120;

/// Factors of departures, which are some 0.2 rad and 0.1 m: all inputs are of the order of 1.
const ROTATION_GAIN: f64 = 5.0;
const POSITION_GAIN: f64 = 10.0;
/// Typical length of a gap, frames.
const USUAL_GAP: f64 = 30.0;

/// The input of a motion, with what its output refers to.
#[derive(Debug, Clone, PartialEq)]
pub struct DenoiserInput {
    /// `[T, N_INPUT]`.
    pub values: Vec<f32>,
    /// Unit of the corrections: [`expected_errors`].
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

/// Expected error per axis of every joint of a bridged motion, `[T, 20]`, rad.
pub fn expected_errors(motion: &ObservedMotion, bridged: &BridgedMotion) -> Vec<f32> {
    let of_frame = |(t, (sigma, places)): (usize, (&[f64; N_DESCRIBED], &[Option<Place>; N_DESCRIBED]))| {
        std::array::from_fn::<f32, N_DESCRIBED, _>(|described| {
            expected_error(sigma[described], places[described].map(|place| place.reach(t))) as f32
        })
    };
    motion.sigma.iter().zip(&bridged.places).enumerate().flat_map(of_frame).collect()
}

/// The input of a motion. `rest`: rotations of joints that are never seen.
pub fn denoiser_input(motion: &ObservedMotion, rest: &LocalRotations) -> DenoiserInput {
    let bridged = bridge(motion, rest, DECAY_FRAMES);
    let gaps = longest_gaps(&bridged);
    let (rotations, pelvis) = bridged_throughout(&bridged, &gaps, DECAY_FRAMES);
    static BONES: OnceLock<Bones> = OnceLock::new();
    let bones = BONES.get_or_init(Bones::of_default_body);
    let mut values = Vec::with_capacity(motion.n_frames() * N_INPUT);
    for t in 0..motion.n_frames() {
        let own_from_world = bridged.rotations[t][0].transpose();
        let next = (t + 1).min(motion.n_frames() - 1);
        let velocity = own_from_world * (bridged.pelvis[next] - bridged.pelvis[t]) * GRID_FPS;
        let (own, expected) = (bones.posed(&bridged.rotations[t]).joints, bones.posed(&rotations[t]).joints);
        // Both as seen from the pelvis that goes over the gap as a bridge: where it is fitted wrongly the joints stay where they are.
        let turned = rotations[t][0].transpose() * bridged.rotations[t][0];
        let departure = |&joint: &usize| three((turned * own[joint] - expected[joint]) * POSITION_GAIN);
        values.extend(READ_JOINTS.iter().flat_map(departure));
        let of_pelvis = [
            log(&turned) * ROTATION_GAIN,
            own_from_world * (bridged.pelvis[t] - pelvis[t]) * POSITION_GAIN,
            own_from_world * Vector3::y(),
            velocity,
        ];
        values.extend(of_pelvis.into_iter().flat_map(three));
        values.extend((0..N_DESCRIBED).map(|described| f32::from(u8::from(!motion.is_seen(t, described)))));
        values.extend(gap_numbers(t, gaps[t]));
    }
    DenoiserInput { values, units: expected_errors(motion, &bridged), bridged }
}

fn three(v: Vector3<f64>) -> [f32; 3] {
    [v.x as f32, v.y as f32, v.z as f32]
}

/// Whether a frame lies in a gap, its place there, how far it is from both edges, and the gap's length.
fn gap_numbers(frame: usize, gap: Option<Place>) -> [f32; 4] {
    let Some(gap) = gap else { return [0.0; 4] };
    let far = |distance: usize| distance.min(FAR) as f64;
    let before = gap.before.map_or(FAR as f64, |edge| far(frame - edge));
    let after = gap.after.map_or(FAR as f64, |edge| far(edge - frame));
    let share = before / (before + after);
    [1.0, share as f32, (4.0 * share * (1.0 - share)) as f32, ((before + after) / USUAL_GAP).ln() as f32]
}
