//! `scene.py`: a script that builds the take in Blender: cameras with shifted lenses, an armature per person, keyframes.
//!
//! Run as `blender --python scene.py`. The data have y up, below one empty object that rotates them to Blender's z up; frames
//! have the session's frame numbers. K and the distortion model with its coefficients are custom properties of the camera
//! objects. Armatures are hidden where the person is absent; the custom property `carried` lists the frames in which no
//! camera detected the person.
//!
//! Known limit: Blender has one image size and one pixel aspect per scene; the script uses those of the first camera.

use super::files::{ResultFiles, micro, micro_entries};
use super::film::{film_lens, world_from_film};
use super::names::person_name;
use super::rig::rest_joints;
use super::rotation_forms::{quaternion_xyzw, quaternions_xyzw};
use super::take::{Take, TakeCamera};
use crate::body::skeleton::{JOINT_NAMES, N_JOINTS, PARENTS};
use crate::session::BodyMotion;
use crate::session::formats::{entries, rounded, rows};
use crate::session::recording::UpAxis;
use serde_json::{Value, json};
use std::io;

/// The part of the script that builds the scene from the data.
const BUILD: &str = include_str!("blender/build.py");
const MM: f64 = 1000.0;

/// Writes the file.
pub(super) fn write(files: &mut ResultFiles, take: &Take) -> io::Result<()> {
    let take = take.with_up_axis(UpAxis::Y);
    let data = json!({
        "name": take.name,
        "fps": take.fps,
        "frame_range": take.frame_range(),
        "joint_names": JOINT_NAMES,
        "parents": PARENTS,
        "cameras": take.cameras.iter().map(camera).collect::<Vec<_>>(),
        "people": take.motions.iter().map(|motion| person(&take, motion)).collect::<Vec<_>>(),
    });
    // The JSON text as a string literal: every escape of JSON strings is also valid in Python.
    let literal = serde_json::to_string(&data.to_string())?;
    let script = format!("import json\n\nTAKE = json.loads({literal})\n\n{BUILD}");
    files.bytes("scene.py", "text/x-python", script.as_bytes())
}

fn camera(camera: &TakeCamera) -> Value {
    let (lens, film) = (&camera.intrinsics, film_lens(&camera.intrinsics));
    let pose = world_from_film(camera);
    json!({
        "id": camera.id,
        "width": lens.width,
        "height": lens.height,
        "location": entries(&pose.translation),
        "rotation_xyzw": quaternion_xyzw(&pose.rotation),
        "focal_length_mm": film.focal_length * MM,
        "sensor_width_mm": film.sensor_width * MM,
        // Blender measures both shifts in widths of the sensor.
        "shift": [film.offset_right / film.sensor_width, film.offset_up / film.sensor_width],
        "pixel_aspect": lens.fx / lens.fy,
        "K": rows(&lens.matrix()),
        "distortion_model": lens.dist.name(),
        "dist": lens.dist.coefficients(),
    })
}

fn person(take: &Take, motion: &BodyMotion) -> Value {
    // [joints][frames][4]
    let turns: Vec<Vec<[f64; 4]>> = (0..N_JOINTS)
        .map(|joint| {
            let turns = quaternions_xyzw(motion.frames.iter().map(|pose| pose.rotations[joint]));
            turns.into_iter().map(|q| q.map(|c| rounded(c, 9))).collect()
        })
        .collect();
    let carried: Vec<i64> = (0..motion.frames.len())
        .filter(|&t| !motion.frames[t].valid)
        .map(|t| take.frame_number(motion.first.0 + t))
        .collect();
    json!({
        "id": motion.person.0,
        "name": person_name(take, motion),
        "first_frame": take.presence(motion)[0],
        "rest_joints": rest_joints(motion).map(|joint| entries(&joint).map(micro)),
        "pelvis": motion.frames.iter().map(|pose| micro_entries(&pose.joints[0])).collect::<Vec<_>>(),
        "rotations_xyzw": turns,
        "carried": carried,
    })
}
