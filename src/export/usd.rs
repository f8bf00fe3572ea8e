//! `scene.usda`: USD as text, with a skinned UsdSkel skeleton and its animation per person and a camera per camera;
//! `scene.usdz`: the same in a package.
//!
//! Joint axes lie along the bones ([`super::rig`]). Metres (`metersPerUnit` 1), y up; time codes are the session's frame numbers. Lengths of a UsdGeomCamera are in tenths of
//! a unit; the principal point is its aperture offset. Distortion model and coefficients, K and the image size are custom
//! attributes (`userProperties:…`), since UsdGeomCamera has none. `visibility` marks the frames in which a person is present,
//! `userProperties:valid` those in which a camera detected them.

mod mesh;
mod package;
mod text;

use super::files::ResultFiles;
use super::film::{film_lens, world_from_film};
use super::names::{identifiers, person_name, quoted};
use super::rig::{Rig, joint_turn};
use super::rotation_forms::quaternions_xyzw;
use super::skin::skin_mesh;
use super::take::{Take, TakeCamera};
use crate::session::BodyMotion;
use crate::session::formats::rounded;
use crate::session::people::BodyPose;
use crate::session::recording::UpAxis;
use std::io;
use text::{list, matrix, tuple};

/// Tenths of a unit per unit; a unit is a metre.
const TENTHS: f64 = 10.0;

/// Writes both files.
pub(super) fn write(files: &mut ResultFiles, take: &Take) -> io::Result<()> {
    let scene = scene(&take.with_up_axis(UpAxis::Y));
    files.bytes("scene.usda", "model/vnd.usda", scene.as_bytes())?;
    files.bytes("scene.usdz", "model/vnd.usdz+zip", &package::package("scene.usda", scene.as_bytes())?)
}

fn scene(take: &Take) -> String {
    let ([first, last], fps) = (take.frame_range(), take.fps);
    let mut text = format!(
        "#usda 1.0\n(\n    defaultPrim = \"World\"\n    metersPerUnit = 1\n    upAxis = \"Y\"\n    \
         startTimeCode = {first}\n    endTimeCode = {last}\n    timeCodesPerSecond = {fps:?}\n    \
         framesPerSecond = {fps:?}\n)\n\ndef Xform \"World\"\n{{\n"
    );
    for motion in &take.motions {
        text += &person(take, motion);
    }
    let names = identifiers(take.cameras.iter().map(|camera| camera.id.as_str()));
    for (camera, name) in take.cameras.iter().zip(names) {
        text += &film_camera(camera, &name);
    }
    text + "}\n"
}

fn person(take: &Take, motion: &BodyMotion) -> String {
    let (name, rig) = (person_name(take, motion), Rig::of(motion));
    let joints = 0..rig.n_joints();
    let paths = list(joints.clone().map(|joint| quoted(&path(&rig, joint))));
    let is_root = |joint: usize| rig.parents[joint].is_none();
    let posed = |joint: usize, pose: &BodyPose| if is_root(joint) { pose.joints[joint] } else { rig.offset(joint) };
    let mesh = take.body.as_ref().map(|body| mesh::prim(&name, &skin_mesh(body, motion))).unwrap_or_default();
    format!(
        r#"    def SkelRoot "{name}"
    {{
        token visibility.timeSamples = {visibility}
        custom bool userProperties:valid
        bool userProperties:valid.timeSamples = {valid}

        def Skeleton "{name}_skeleton" (
            prepend apiSchemas = ["SkelBindingAPI"]
        )
        {{
            uniform token[] joints = {paths}
            uniform matrix4d[] bindTransforms = {bind}
            uniform matrix4d[] restTransforms = {rest}
            rel skel:animationSource = </World/{name}/{name}_skeleton/{name}_animation>

            def SkelAnimation "{name}_animation"
            {{
                uniform token[] joints = {paths}
                half3[] scales = {scales}
                float3[] translations.timeSamples = {translations}
                quatf[] rotations.timeSamples = {rotations}
            }}
        }}
{mesh}    }}
"#,
        visibility = visibility(take, motion),
        valid = valid(take, motion),
        bind = list(joints.clone().map(|joint| matrix(&rig.axes[joint], &rig.joints[joint]))),
        rest = list(joints.clone().map(|joint| matrix(&rig.rest(joint), &rig.offset(joint)))),
        scales = list(joints.clone().map(|_| "(1, 1, 1)".to_owned())),
        translations = samples(take, motion, |t| list(joints.clone().map(|j| tuple(&posed(j, &motion.frames[t]))))),
        rotations = rotations(take, motion, &rig),
    )
}

/// `pelvis/left_hip/left_knee`
fn path(rig: &Rig, joint: usize) -> String {
    match rig.parents[joint] {
        Some(parent) => format!("{}/{}", path(rig, parent), rig.names[joint]),
        None => rig.names[joint].clone(),
    }
}

fn rotations(take: &Take, motion: &BodyMotion, rig: &Rig) -> String {
    let local = |joint: usize| (0..motion.frames.len()).map(move |t| rig.local(joint, &joint_turn(motion, t, joint)));
    // [joints][frames]
    let by_joint: Vec<Vec<[f64; 4]>> = (0..rig.n_joints()).map(|joint| quaternions_xyzw(local(joint))).collect();
    samples(take, motion, |t| {
        list(by_joint.iter().map(|quaternions| {
            let [x, y, z, w] = quaternions[t].map(|c| rounded(c, 9));
            format!("({w:?}, {x:?}, {y:?}, {z:?})")
        }))
    })
}

/// Hidden before the first frame and after the last.
fn visibility(take: &Take, motion: &BodyMotion) -> String {
    let ([start, end], [first, last]) = (take.frame_range(), take.presence(motion));
    let mut samples = vec![(first, "inherited")];
    if first > start {
        samples.insert(0, (start, "invisible"));
    }
    if last < end {
        samples.push((last.saturating_add(1), "invisible"));
    }
    let samples = samples.iter().map(|(frame, word)| format!("{frame}: {}", quoted(word)));
    format!("{{ {} }}", samples.collect::<Vec<_>>().join(", "))
}

/// Samples where the value changes: a bool is held until the next sample.
fn valid(take: &Take, motion: &BodyMotion) -> String {
    let mut samples = Vec::new();
    let mut before = None;
    for (t, pose) in motion.frames.iter().enumerate() {
        if before != Some(pose.valid) {
            samples.push(format!("{}: {}", take.frame_number(motion.first.0 + t), u8::from(pose.valid)));
        }
        before = Some(pose.valid);
    }
    format!("{{ {} }}", samples.join(", "))
}

fn samples(take: &Take, motion: &BodyMotion, value: impl Fn(usize) -> String) -> String {
    let sample = |t: usize| format!("                    {}: {},\n", take.frame_number(motion.first.0 + t), value(t));
    let samples: String = (0..motion.frames.len()).map(sample).collect();
    format!("{{\n{samples}                }}")
}

fn film_camera(camera: &TakeCamera, name: &str) -> String {
    let (lens, film) = (&camera.intrinsics, film_lens(&camera.intrinsics));
    let pose = world_from_film(camera);
    let axis = |c: usize| {
        let column = pose.rotation.column(c);
        format!("({:?}, {:?}, {:?}, 0)", column[0], column[1], column[2])
    };
    let t = pose.translation;
    let k = lens.matrix();
    let k_rows = list((0..3).map(|r| format!("{:?}, {:?}, {:?}", k[(r, 0)], k[(r, 1)], k[(r, 2)])));
    let dist = list(lens.dist.coefficients().iter().map(|d| format!("{d:?}")));
    format!(
        r#"
    def Camera "{name}"
    {{
        float focalLength = {:?}
        float horizontalAperture = {:?}
        float verticalAperture = {:?}
        float horizontalApertureOffset = {:?}
        float verticalApertureOffset = {:?}
        float2 clippingRange = (0.01, 1000)
        token projection = "perspective"
        matrix4d xformOp:transform = ( {}, {}, {}, ({:?}, {:?}, {:?}, 1) )
        uniform token[] xformOpOrder = ["xformOp:transform"]
        custom string userProperties:id = {}
        custom int userProperties:width = {}
        custom int userProperties:height = {}
        custom double[] userProperties:K = {k_rows}
        custom string userProperties:distortion_model = {}
        custom double[] userProperties:dist = {dist}
    }}
"#,
        film.focal_length * TENTHS,
        film.sensor_width * TENTHS,
        film.sensor_height * TENTHS,
        film.offset_right * TENTHS,
        film.offset_up * TENTHS,
        axis(0),
        axis(1),
        axis(2),
        t.x,
        t.y,
        t.z,
        quoted(&camera.id),
        lens.width,
        lens.height,
        quoted(lens.dist.name()),
    )
}
