//! `<person>.bvh`, `<person>.humanik.bvh`, `<person>.mixamo.bvh`: the same skeleton and motion with three sets of joint
//! names.
//!
//! Centimetres, degrees, y up; rest pose: SMPL's T-pose with all joint frames parallel to the world. Rotation channels are `Z
//! X Y` (`R = R_z R_x R_y`), without jumps of full turns. The root's offset is zero: its channels contain the pelvis
//! position. The file starts with the person's first frame, whose number the format cannot represent (see `publish.people` of
//! the manifest), nor can it mark frames in which no camera detected the person.

use super::files::ResultFiles;
use super::rotation_forms::{ZxyAngles, nearest_angles, zxy_angles};
use super::take::{Take, rest_joints};
use crate::body::skeleton::{JOINT_NAMES, N_JOINTS, PARENTS};
use crate::session::BodyMotion;
use crate::session::formats::rounded;
use crate::session::recording::UpAxis;
use nalgebra::Vector3;
use std::io;

/// Centimetres in a metre.
const CM: f64 = 100.0;
/// Length of the end site of a leaf joint, as a share of the leaf's own bone.
const END_SHARE: f64 = 0.5;

/// HumanIK's names, as MotionBuilder uses them; Mixamo's are the same with the prefix `mixamorig:`.
const HUMANIK_NAMES: [&str; N_JOINTS] = [
    "Hips", "LeftUpLeg", "RightUpLeg", "Spine", "LeftLeg", "RightLeg", "Spine1", "LeftFoot", "RightFoot", "Spine2",
    "LeftToeBase", "RightToeBase", "Neck", "LeftShoulder", "RightShoulder", "Head", "LeftArm", "RightArm",
    "LeftForeArm", "RightForeArm", "LeftHand", "RightHand", "LeftHandMiddle1", "RightHandMiddle1",
];

/// Writes three files per person.
pub(super) fn write(files: &mut ResultFiles, take: &Take) -> io::Result<()> {
    let take = take.with_up_axis(UpAxis::Y);
    let profiles = [
        ("", JOINT_NAMES.map(str::to_owned)),
        (".humanik", HUMANIK_NAMES.map(str::to_owned)),
        (".mixamo", HUMANIK_NAMES.map(|name| format!("mixamorig:{name}"))),
    ];
    for motion in &take.motions {
        let rest = rest_joints(motion);
        let motion_text = motion_section(&take, motion);
        for (suffix, names) in &profiles {
            let mut text = "HIERARCHY\n".to_owned();
            add_joint(&mut text, names, &rest, 0, 0);
            text += &motion_text;
            files.bytes(&format!("{}{suffix}.bvh", motion.person.0), "text/plain", text.as_bytes())?;
        }
    }
    Ok(())
}

/// Adds a joint and its descendants, children in order of their numbers.
fn add_joint(
    text: &mut String,
    names: &[String; N_JOINTS],
    rest: &[Vector3<f64>; N_JOINTS],
    joint: usize,
    depth: usize,
) {
    let indent = "\t".repeat(depth);
    let offset = PARENTS[joint].map_or_else(Vector3::zeros, |parent| rest[joint] - rest[parent]);
    let (kind, channels) = match PARENTS[joint] {
        None => ("ROOT", "6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"),
        Some(_) => ("JOINT", "3 Zrotation Xrotation Yrotation"),
    };
    *text += &format!("{indent}{kind} {}\n{indent}{{\n{indent}\tOFFSET {}\n", names[joint], place(&offset));
    *text += &format!("{indent}\tCHANNELS {channels}\n");
    if children(joint).next().is_none() {
        let end = place(&(offset * END_SHARE));
        *text += &format!("{indent}\tEnd Site\n{indent}\t{{\n{indent}\t\tOFFSET {end}\n{indent}\t}}\n");
    }
    for child in children(joint) {
        add_joint(text, names, rest, child, depth + 1);
    }
    *text += &format!("{indent}}}\n");
}

fn children(joint: usize) -> impl Iterator<Item = usize> {
    (0..N_JOINTS).filter(move |&child| PARENTS[child] == Some(joint))
}

/// The joints in the order of the hierarchy.
fn hierarchy_order() -> Vec<usize> {
    fn visit(joint: usize, order: &mut Vec<usize>) {
        order.push(joint);
        children(joint).for_each(|child| visit(child, order));
    }
    let mut order = Vec::with_capacity(N_JOINTS);
    visit(0, &mut order);
    order
}

fn motion_section(take: &Take, motion: &BodyMotion) -> String {
    let order = hierarchy_order();
    let mut before = [ZxyAngles { z: 0.0, x: 0.0, y: 0.0 }; N_JOINTS];
    let mut text = format!("MOTION\nFrames: {}\nFrame Time: {:.9}\n", motion.frames.len(), 1.0 / take.fps);
    for pose in &motion.frames {
        text += &place(&pose.joints[0]);
        for &joint in &order {
            let angles = nearest_angles(zxy_angles(&pose.rotations[joint]), before[joint]);
            before[joint] = angles;
            let [z, x, y] = [angles.z, angles.x, angles.y].map(|angle| rounded(angle.to_degrees(), 6));
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
