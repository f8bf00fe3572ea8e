//! `<person>.angles.csv`: joint angles of [`crate::body::joint_angles`] with their standard deviations, a row per frame of the
//! person; `<person>.mot`: those that OpenSim's full-body models have, under their names of coordinates; `<person>.gait.csv`: heel
//! strikes and toe-offs of [`crate::body::gait`], a row per event.
//!
//! Degrees and seconds; time 0 s is the take's first frame. `detected` is 0 where no camera detected the person: the pose is
//! then carried over. Angles are continuous over full turns. Standard deviations are empty where the result has none for the
//! joints.
//!
//! Known limits of the `.mot`: names and signs are those of Rajagopal et al. 2016 (IEEE TBME 63), but the axes are those of the
//! body model, so that a musculoskeletal model shows the motion approximately; for its own angles run inverse kinematics on
//! the `.trc`. Shoulders and wrists, whose sequences differ there, are left out.

use super::files::{ResultFiles, micro};
use super::rig::rest_joints;
use super::take::Take;
use crate::body::gait::{Foot, GaitEventKind, gait_events};
use crate::body::joint_angles::{N_ANGLES, angle_names, angle_sigmas, joint_angles};
use crate::session::BodyMotion;
use crate::session::formats::rounded;
use crate::session::recording::UpAxis;
use std::f64::consts::TAU;
use std::io;

/// OpenSim's coordinates and our angles.
const COORDINATES: [(&str, &str); 20] = [
    ("pelvis_tilt", "pelvis_tilt"),
    ("pelvis_list", "pelvis_list"),
    ("pelvis_rotation", "pelvis_rotation"),
    ("hip_flexion_r", "hip_flexion_r"),
    ("hip_adduction_r", "hip_adduction_r"),
    ("hip_rotation_r", "hip_internal_rotation_r"),
    ("knee_angle_r", "knee_flexion_r"),
    ("ankle_angle_r", "ankle_dorsiflexion_r"),
    ("subtalar_angle_r", "ankle_inversion_r"),
    ("hip_flexion_l", "hip_flexion_l"),
    ("hip_adduction_l", "hip_adduction_l"),
    ("hip_rotation_l", "hip_internal_rotation_l"),
    ("knee_angle_l", "knee_flexion_l"),
    ("ankle_angle_l", "ankle_dorsiflexion_l"),
    ("subtalar_angle_l", "ankle_inversion_l"),
    ("lumbar_extension", "trunk_extension"),
    ("lumbar_bending", "trunk_bending_right"),
    ("lumbar_rotation", "trunk_rotation_left"),
    ("elbow_flex_r", "elbow_flexion_r"),
    ("elbow_flex_l", "elbow_flexion_l"),
];

/// Angles of a frame and their standard deviations, degrees.
struct FrameAngles {
    angles: [f64; N_ANGLES],
    sigmas: Option<[f64; N_ANGLES]>,
}

/// Writes the three files of every person.
pub(super) fn write(files: &mut ResultFiles, take: &Take) -> io::Result<()> {
    let take = take.with_up_axis(UpAxis::Y);
    for motion in &take.motions {
        let frames = angles_of(motion);
        let person = motion.person.0;
        files.bytes(&format!("{person}.angles.csv"), "text/csv", table(&take, motion, &frames).as_bytes())?;
        files.bytes(&format!("{person}.mot"), "text/plain", coordinates(&take, motion, &frames).as_bytes())?;
        files.bytes(&format!("{person}.gait.csv"), "text/csv", events(&take, motion).as_bytes())?;
    }
    Ok(())
}

fn angles_of(motion: &BodyMotion) -> Vec<FrameAngles> {
    let rest = rest_joints(motion);
    let mut before = [0.0; N_ANGLES];
    let frame = |(t, pose): (usize, &crate::session::people::BodyPose)| {
        let angles = joint_angles(&rest, &pose.rotations);
        let sigmas = motion.joint_sigmas.as_ref().and_then(|frames| frames.get(t));
        let sigmas = sigmas.map(|sigmas| angle_sigmas(&angles, &rest, sigmas).map(f64::to_degrees));
        before = std::array::from_fn(|k| angles[k] - ((angles[k] - before[k]) / TAU).round() * TAU);
        FrameAngles { angles: before.map(f64::to_degrees), sigmas }
    };
    motion.frames.iter().enumerate().map(frame).collect()
}

fn table(take: &Take, motion: &BodyMotion, frames: &[FrameAngles]) -> String {
    let columns: String = angle_names().iter().map(|name| format!(",{name}_deg,{name}_sd_deg")).collect();
    let mut text = format!("frame,time_s,detected{columns}\n");
    for (i, (frame, pose)) in frames.iter().zip(&motion.frames).enumerate() {
        let index = motion.first.0 + i;
        let detected = u8::from(pose.valid);
        text += &format!("{},{:.6},{detected}", take.frame_number(index), index as f64 / take.fps);
        for k in 0..N_ANGLES {
            let sigma = frame.sigmas.map(|sigmas| sigmas[k]).filter(|sigma| sigma.is_finite());
            let sigma = sigma.map_or_else(String::new, |sigma| format!("{sigma:.3}"));
            text += &format!(",{:.3},{sigma}", rounded(frame.angles[k], 3));
        }
        text.push('\n');
    }
    text
}

/// Events of the gait in frames where the person is detected.
fn events(take: &Take, motion: &BodyMotion) -> String {
    let joints: Vec<_> = motion.frames.iter().map(|pose| pose.joints).collect();
    let mut text = "frame,time_s,foot,event,time_sd_s,confidence\n".to_owned();
    for event in gait_events(&joints, motion.joint_sigmas.as_deref(), take.fps) {
        let nearest = (event.time_s * take.fps).round() as usize;
        if !motion.frames.get(nearest).is_some_and(|pose| pose.valid) {
            continue;
        }
        let foot = match event.foot {
            Foot::Left => "left",
            Foot::Right => "right",
        };
        let kind = match event.kind {
            GaitEventKind::HeelStrike => "heel_strike",
            GaitEventKind::ToeOff => "toe_off",
        };
        let known = |value: Option<f64>| value.map_or_else(String::new, |value| format!("{value:.3}"));
        let frame = take.frame_number(motion.first.0 + nearest);
        let secs = motion.first.0 as f64 / take.fps + event.time_s;
        text += &format!("{frame},{secs:.4},{foot},{kind},{},{}\n", known(event.sigma_s), known(event.confidence));
    }
    text
}

/// OpenSim's motion file: the pelvis's position is that of the body model's pelvis joint.
fn coordinates(take: &Take, motion: &BodyMotion, frames: &[FrameAngles]) -> String {
    let names = angle_names();
    let column = |name: &str| names.iter().position(|known| known == name);
    let columns: Vec<(&str, usize)> =
        COORDINATES.iter().filter_map(|(coordinate, angle)| Some((*coordinate, column(angle)?))).collect();
    let labels: String = columns.iter().map(|(name, _)| format!("\t{name}")).collect();
    let mut text = format!(
        "person_{}\nversion=1\nnRows={}\nnColumns={}\ninDegrees=yes\nendheader\ntime\tpelvis_tx\tpelvis_ty\tpelvis_tz{labels}\n",
        motion.person.0,
        frames.len(),
        columns.len() + 4,
    );
    for (i, (frame, pose)) in frames.iter().zip(&motion.frames).enumerate() {
        let place = pose.joints[0].map(micro);
        let secs = (motion.first.0 + i) as f64 / take.fps;
        text += &format!("{secs:.6}\t{:.6}\t{:.6}\t{:.6}", place.x, place.y, place.z);
        columns.iter().for_each(|(_, k)| text += &format!("\t{:.4}", rounded(frame.angles[*k], 4)));
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_coordinate_has_an_angle() {
        let names = angle_names();
        assert!(COORDINATES.iter().all(|(_, angle)| names.iter().any(|name| name == angle)));
    }
}
