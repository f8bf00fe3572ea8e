//! `<person>.bvh`, and `<person>.humanik.bvh`, `<person>.mixamo.bvh`, `<person>.unreal.bvh` with the joint names of other
//! programs ([`super::joint_names`]).
//!
//! Centimetres, degrees, y up; rest pose: SMPL's T-pose with all joint frames parallel to the world. Rotation channels are `Z
//! X Y` (`R = R_z R_x R_y`), without jumps of full turns. The root's offset is zero: its channels contain the pelvis
//! position. Every file has all frames of the take, so that several people share one clock; the format has no frame numbers. It
//! cannot hide a person either: before the person's first frame and after the last one the nearest pose is held.

use super::files::ResultFiles;
use super::joint_names::profiles;
use super::rig::{Rig, joint_turn};
use super::take::Take;
use crate::geometry::euler::{EulerAngles, nearest_angles, zxy_angles};
use crate::session::BodyMotion;
use crate::session::formats::rounded;
use crate::session::recording::UpAxis;
use nalgebra::Vector3;
use std::io;

/// Centimetres in a metre.
const CM: f64 = 100.0;
/// Length of the end site of a leaf joint, as a share of the leaf's own bone.
const END_SHARE: f64 = 0.5;

/// Writes a file per person and set of joint names.
pub(super) fn write(files: &mut ResultFiles, take: &Take) -> io::Result<()> {
    let take = take.with_up_axis(UpAxis::Y);
    for motion in &take.motions {
        let rig = Rig::of(motion);
        let motion_text = motion_section(&take, motion, &rig);
        for profile in profiles(&rig) {
            let mut text = "HIERARCHY\n".to_owned();
            add_joint(&mut text, &profile.names, &rig, 0, 0);
            text += &motion_text;
            files.bytes(&format!("{}{}.bvh", motion.person.0, profile.suffix), "text/plain", text.as_bytes())?;
        }
    }
    Ok(())
}

/// Adds a joint and its descendants, children in order of their numbers.
fn add_joint(text: &mut String, names: &[String], rig: &Rig, joint: usize, depth: usize) {
    let indent = "\t".repeat(depth);
    let offset = rig.parents[joint].map_or_else(Vector3::zeros, |parent| rig.joints[joint] - rig.joints[parent]);
    let (kind, channels) = match rig.parents[joint] {
        None => ("ROOT", "6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"),
        Some(_) => ("JOINT", "3 Zrotation Xrotation Yrotation"),
    };
    *text += &format!("{indent}{kind} {}\n{indent}{{\n{indent}\tOFFSET {}\n", names[joint], place(&offset));
    *text += &format!("{indent}\tCHANNELS {channels}\n");
    if rig.children(joint).next().is_none() {
        let end = place(&(offset * END_SHARE));
        *text += &format!("{indent}\tEnd Site\n{indent}\t{{\n{indent}\t\tOFFSET {end}\n{indent}\t}}\n");
    }
    for child in rig.children(joint) {
        add_joint(text, names, rig, child, depth + 1);
    }
    *text += &format!("{indent}}}\n");
}

/// The joints in the order of the hierarchy.
fn hierarchy_order(rig: &Rig) -> Vec<usize> {
    fn visit(rig: &Rig, joint: usize, order: &mut Vec<usize>) {
        order.push(joint);
        rig.children(joint).for_each(|child| visit(rig, child, order));
    }
    let mut order = Vec::with_capacity(rig.n_joints());
    visit(rig, 0, &mut order);
    order
}

fn motion_section(take: &Take, motion: &BodyMotion, rig: &Rig) -> String {
    let order = hierarchy_order(rig);
    let mut before = vec![EulerAngles::default(); rig.n_joints()];
    let mut text = format!("MOTION\nFrames: {}\nFrame Time: {:.9}\n", take.n_frames, 1.0 / take.fps);
    for t in take.frames_on_time_line(motion) {
        text += &place(&motion.frames[t].joints[0]);
        for &joint in &order {
            let angles = nearest_angles(zxy_angles(&joint_turn(motion, t, joint)), before[joint]);
            before[joint] = angles;
            let [z, x, y] = [angles.outer, angles.middle, angles.inner].map(|angle| rounded(angle.to_degrees(), 6));
            text += &format!(" {z:.6} {x:.6} {y:.6}");
        }
        text.push('\n');
    }
    text
}

fn place(point: &Vector3<f64>) -> String {
    let [x, y, z] = [point.x, point.y, point.z].map(|c| rounded(c * CM, 6));
    format!("{x:.6} {y:.6} {z:.6}")
}
