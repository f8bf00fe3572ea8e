//! BVH, read like its players do: a tree of offsets, with channels applied in their order.

use crate::result::{FIRST_FRAME, FPS, N_FRAMES, assert_near, both_up_axes};
use nalgebra::{Rotation3, Vector3};
use wandless::session::reconstruction::ExportFormat;
use wandless::session::recording::UpAxis;

struct Joint {
    name: String,
    parent: Option<usize>,
    offset: Vector3<f64>,
    channels: Vec<String>,
}

struct Bvh {
    joints: Vec<Joint>,
    frame_secs: f64,
    frames: Vec<Vec<f64>>,
}

fn parse(text: &str) -> Bvh {
    let (hierarchy, motion) = text.split_once("MOTION").unwrap();
    let mut joints: Vec<Joint> = Vec::new();
    let mut open: Vec<Option<usize>> = Vec::new(); // None: an end site
    let mut pending = None;
    for line in hierarchy.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.as_slice() {
            ["ROOT" | "JOINT", name] => {
                let parent = open.last().copied().flatten();
                joints.push(Joint { name: (*name).to_owned(), parent, offset: Vector3::zeros(), channels: Vec::new() });
                pending = Some(joints.len() - 1);
            }
            ["End", "Site"] => pending = None,
            ["{"] => open.push(pending),
            ["}"] => drop(open.pop().unwrap()),
            ["OFFSET", x, y, z] => {
                if let Some(joint) = open.last().unwrap() {
                    joints[*joint].offset = Vector3::from([x, y, z].map(|c| c.parse::<f64>().unwrap()));
                }
            }
            ["CHANNELS", count, channels @ ..] => {
                assert_eq!(count.parse::<usize>().unwrap(), channels.len());
                let joint = open.last().unwrap().unwrap();
                joints[joint].channels = channels.iter().map(|c| (*c).to_owned()).collect();
            }
            _ => assert_eq!(words, ["HIERARCHY"]),
        }
    }
    assert!(open.is_empty());
    let mut lines = motion.trim().lines();
    let n_frames: usize = lines.next().unwrap().strip_prefix("Frames: ").unwrap().parse().unwrap();
    let frame_secs = lines.next().unwrap().strip_prefix("Frame Time: ").unwrap().parse().unwrap();
    let frames: Vec<Vec<f64>> = lines.map(|l| l.split(' ').map(|v| v.parse().unwrap()).collect()).collect();
    assert_eq!(frames.len(), n_frames);
    Bvh { joints, frame_secs, frames }
}

/// Joint positions of one frame in the world, in the file's unit.
fn posed(bvh: &Bvh, frame: &[f64]) -> Vec<Vector3<f64>> {
    let mut values = frame.iter();
    let mut posed: Vec<(Rotation3<f64>, Vector3<f64>)> = Vec::new();
    for joint in &bvh.joints {
        let (mut turn, mut place) = joint.parent.map_or((Rotation3::identity(), Vector3::zeros()), |p| posed[p]);
        let mut shift = joint.offset;
        let mut local = Rotation3::identity();
        for channel in &joint.channels {
            let value = *values.next().unwrap();
            let axis = match channel.as_bytes()[0] {
                b'X' => Vector3::x_axis(),
                b'Y' => Vector3::y_axis(),
                _ => Vector3::z_axis(),
            };
            if channel.ends_with("position") {
                shift += axis.into_inner() * value;
            } else {
                local *= Rotation3::from_axis_angle(&axis, value.to_radians());
            }
        }
        place += turn * shift;
        turn *= local;
        posed.push((turn, place));
    }
    assert!(values.next().is_none());
    posed.into_iter().map(|(_, place)| place).collect()
}

#[test]
fn joints_match_the_result() {
    for written in both_up_axes(&[ExportFormat::Bvh]) {
        for person in written.people() {
            let bvh = parse(&written.text(&format!("{}.bvh", person.id)));
            assert!((bvh.frame_secs - 1.0 / FPS).abs() < 1e-8);
            assert_eq!(bvh.frames.len(), N_FRAMES, "all people share one clock");
            for (t, frame) in bvh.frames.iter().enumerate() {
                let joints = &person.joints[person.at(FIRST_FRAME + t as i64).1];
                for (joint, place) in bvh.joints.iter().zip(posed(&bvh, frame)) {
                    let names = wandless::body::skeleton::JOINT_NAMES;
                    let j = names.iter().position(|name| *name == joint.name).unwrap();
                    assert_near(&written.turned(UpAxis::Y, &joints[j]), &(place / 100.0), &joint.name);
                }
            }
        }
    }
}

#[test]
fn curves_are_continuous_and_profiles_differ_in_names() {
    let [written, _] = both_up_axes(&[ExportFormat::Bvh]);
    let smpl = parse(&written.text("0.bvh"));
    for pair in smpl.frames.windows(2) {
        assert!(pair[0].iter().zip(&pair[1]).all(|(a, b)| (a - b).abs() < 150.0), "a jump by full turns");
    }
    let profiles = [("humanik", "LeftForeArm"), ("mixamo", "mixamorig:LeftForeArm"), ("unreal", "lowerarm_l")];
    for (profile, name) in profiles {
        let other = parse(&written.text(&format!("0.{profile}.bvh")));
        assert_eq!(other.frames, smpl.frames);
        let elbow = smpl.joints.iter().position(|joint| joint.name == "left_elbow").unwrap();
        assert_eq!(other.joints[elbow].name, name);
    }
}
