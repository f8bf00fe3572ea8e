//! Reads a finished result back as a [`Take`], from which further formats can be written.

use super::people::{Hand, Hands};
use super::skin::free_body;
use super::take::{Take, TakeCamera, carry_over_non_finite};
use crate::body::hand::N_FINGER_JOINTS;
use crate::body::skeleton::{JOINT_NAMES, N_JOINTS};
use crate::geometry::{Distortion, Intrinsics, Rigid, rotation};
use crate::session::json_file::{JsonFileError, read_json_file};
use crate::session::people::{BodyPose, HandMotion, HandPose};
use crate::session::reconstruction::BodyModelId;
use crate::session::recording::UpAxis;
use crate::session::{BodyMotion, FrameIndex, PersonId};
use nalgebra::{Matrix3, Vector3};
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Why a folder cannot be read as a finished result.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// A file cannot be read, or is not the expected JSON.
    #[error(transparent)]
    File(#[from] JsonFileError),
    /// The files contradict each other or themselves.
    #[error("{file}: {what}: expected {expected}, found {found}")]
    Contradiction {
        /// Name of the file.
        file: &'static str,
        /// The part of the file that is wrong.
        what: String,
        /// The expected content.
        expected: String,
        /// The content found.
        found: String,
    },
}

#[derive(Deserialize)]
struct ManifestFile {
    input: Input,
    publish: Publish,
}

#[derive(Deserialize)]
struct Input {
    name: String,
}

#[derive(Deserialize)]
struct Publish {
    up_axis: UpAxis,
    frame_range: [i64; 2],
    fps: f64,
}

#[derive(Deserialize)]
struct CamerasFile {
    cameras: Vec<Camera>,
}

#[derive(Deserialize)]
struct Camera {
    id: String,
    width: u32,
    height: u32,
    #[serde(rename = "K")]
    matrix: [[f64; 3]; 3],
    dist: Vec<f64>,
    /// Present where the coefficients alone do not determine the model.
    distortion_model: Option<String>,
    #[serde(rename = "R")]
    rotation: Option<[[f64; 3]; 3]>,
    #[serde(rename = "t")]
    translation: Option<[f64; 3]>,
}

#[derive(Deserialize)]
struct PeopleFile {
    body_model: BodyModelId,
    people: Vec<Person>,
}

#[derive(Deserialize)]
struct Person {
    id: usize,
    #[serde(default)]
    name: Option<String>,
    betas: Vec<Option<f64>>,
    frames: Vec<i64>,
    global_orient: Vec<[Option<f64>; 3]>,
    body_pose: Vec<Vec<Option<f64>>>,
    transl: Vec<[Option<f64>; 3]>,
    valid: Vec<bool>,
    #[serde(default)]
    joint_sigma_mm: Option<Vec<[Option<f64>; N_JOINTS]>>,
    #[serde(default)]
    hands: Option<Hands>,
}

/// `poses3d.json` or `keypoints3d.json`.
#[derive(Deserialize)]
struct PosesFile {
    joint_names: Vec<String>,
    frames: BTreeMap<i64, JointsByPerson>,
}

/// Joints; null for a joint that is not finite.
type JointsByPerson = BTreeMap<usize, Vec<Option<[f64; 3]>>>;

/// Longest time line that is read, frames: nine hours at 30 fps, the limit of sessions.
const MAX_FRAMES: i64 = 1_000_000;

/// Reads `manifest.json`, `cameras.json`, `people.json`, `poses3d.json` and `keypoints3d.json` of a result.
///
/// # Errors
/// [`ReadError`] where the folder is not a result, or was changed inconsistently.
pub fn read_take(dir: &Path) -> Result<Take, ReadError> {
    let manifest: ManifestFile = read_json_file(&dir.join("manifest.json"))?;
    let cameras: CamerasFile = read_json_file(&dir.join("cameras.json"))?;
    let people: PeopleFile = read_json_file(&dir.join("people.json"))?;
    let poses: PosesFile = read_json_file(&dir.join("poses3d.json"))?;
    let keypoints: PosesFile = read_json_file(&dir.join("keypoints3d.json"))?;
    let Publish { up_axis, frame_range: [first, last], fps } = manifest.publish;
    let length = last.checked_sub(first).filter(|length| (0..MAX_FRAMES).contains(length));
    let Some(length) = length else {
        let found = format!("[{first}, {last}]");
        return Err(contradiction("manifest.json", "publish.frame_range", "a first and a last frame", found));
    };
    if !(fps.is_finite() && fps > 0.0) {
        return Err(contradiction("manifest.json", "publish.fps", "a positive number", fps.to_string()));
    }
    if poses.joint_names != JOINT_NAMES {
        let found = poses.joint_names.join(" ");
        return Err(contradiction("poses3d.json", "joint_names", "the 24 joints of SMPL", found));
    }
    let mut take = Take {
        name: manifest.input.name,
        fps,
        first_frame: first,
        n_frames: length as usize + 1,
        up_axis,
        cameras: Vec::new(),
        unsolved: Vec::new(),
        motions: Vec::new(),
        names: BTreeMap::new(),
        keypoint_names: Vec::new(),
        keypoints: BTreeMap::new(),
        body: free_body(&people.body_model),
        body_model: people.body_model,
    };
    for camera in cameras.cameras {
        match solved_camera(&camera)? {
            Some(solved) => take.cameras.push(solved),
            None => take.unsolved.push(camera.id),
        }
    }
    let mut ids = BTreeSet::new();
    for person in &people.people {
        if !ids.insert(person.id) {
            let what = format!("person {}", person.id);
            return Err(contradiction("people.json", &what, "unique ids", "a repeated id".to_owned()));
        }
        take.names.extend(person.name.clone().map(|name| (PersonId(person.id), name)));
        take.motions.extend(carry_over_non_finite(motion(&take, person, &poses)?));
    }
    add_keypoints(&mut take, keypoints)?;
    Ok(take)
}

fn add_keypoints(take: &mut Take, file: PosesFile) -> Result<(), ReadError> {
    let [start, end] = take.frame_range();
    for (frame, people) in file.frames {
        for (person, points) in people {
            if points.len() != file.joint_names.len() || !(start..=end).contains(&frame) {
                let what = format!("frame {frame}: person {person}");
                let expected = format!("{} points in a frame from {start} to {end}", file.joint_names.len());
                return Err(contradiction("keypoints3d.json", &what, &expected, points.len().to_string()));
            }
            let points = points.into_iter().map(|point| point.map(Vector3::from)).collect();
            take.keypoints.entry(PersonId(person)).or_default().insert(frame.abs_diff(start) as usize, points);
        }
    }
    take.keypoint_names = file.joint_names;
    Ok(())
}

fn solved_camera(camera: &Camera) -> Result<Option<TakeCamera>, ReadError> {
    let (Some(rotation), Some(translation)) = (camera.rotation, camera.translation) else { return Ok(None) };
    let fault = |what: &str, expected: &str, found: String| {
        Err(contradiction("cameras.json", &format!("camera {}: {what}", camera.id), expected, found))
    };
    let dist = match camera.distortion_model.as_deref() {
        None | Some("rational") => Distortion::from_opencv(&camera.dist),
        Some("fisheye") => Distortion::from_fisheye(&camera.dist),
        Some(_) => None,
    };
    let Some(dist) = dist else {
        let model = camera.distortion_model.as_deref().unwrap_or("opencv");
        return fault("dist", "a distortion model of OpenCV", format!("{model} {:?}", camera.dist));
    };
    let intrinsics = Intrinsics::from_matrix([camera.width, camera.height], &camera.matrix, dist);
    if camera.width == 0 || camera.height == 0 {
        return fault("size", "a positive image size", format!("{}x{}", camera.width, camera.height));
    }
    if intrinsics.fx.min(intrinsics.fy) <= 0.0 {
        return fault("K", "positive focal lengths", format!("{} and {}", intrinsics.fx, intrinsics.fy));
    }
    let rotation = Matrix3::from_fn(|r, c| rotation[r][c]);
    // A matrix rounded to three digits passes, a scaled or mirrored one does not.
    let is_rotation = (rotation.transpose() * rotation - Matrix3::identity()).norm() < 1e-2;
    if !(is_rotation && rotation.determinant() > 0.0) {
        return fault("R", "a rotation matrix", format!("{:?}", rotation.transpose().as_slice()));
    }
    let camera_from_world = Rigid { rotation, translation: Vector3::from(translation) };
    Ok(Some(TakeCamera { id: camera.id.clone(), intrinsics, camera_from_world }))
}

fn motion(take: &Take, person: &Person, poses: &PosesFile) -> Result<BodyMotion, ReadError> {
    let n_frames = person.frames.len();
    let fault = |what: &str, expected: String, found: String| {
        contradiction("people.json", &format!("person {}: {what}", person.id), &expected, found)
    };
    let n_sigmas = person.joint_sigma_mm.as_ref().map_or(n_frames, Vec::len);
    let counts =
        [person.global_orient.len(), person.body_pose.len(), person.transl.len(), person.valid.len(), n_sigmas];
    if let Some(found) = counts.into_iter().find(|count| *count != n_frames) {
        return Err(fault("frames", format!("{n_frames} entries in every list"), found.to_string()));
    }
    let [start, end] = take.frame_range();
    let first = person.frames.first().copied().unwrap_or(start);
    let last = first.saturating_add_unsigned(n_frames.saturating_sub(1) as u64);
    let has_gap = person.frames.windows(2).any(|pair| pair[0].checked_add(1) != Some(pair[1]));
    if first < start || last > end || has_gap {
        let found = format!("{first} to {}", person.frames.last().unwrap_or(&first));
        return Err(fault("frames", format!("consecutive frames from {start} to {end}"), found));
    }
    let Ok(betas) = <[f64; 10]>::try_from(person.betas.iter().map(|b| number(*b)).collect::<Vec<_>>()) else {
        return Err(fault("betas", "10 numbers".to_owned(), person.betas.len().to_string()));
    };
    let mut frames = Vec::with_capacity(n_frames);
    for (i, frame) in person.frames.iter().enumerate() {
        if person.body_pose[i].len() != 3 * (N_JOINTS - 1) {
            return Err(fault("body_pose", "69 numbers".to_owned(), person.body_pose[i].len().to_string()));
        }
        let joints = poses.frames.get(frame).and_then(|people| people.get(&person.id));
        let Some(joints) = joints.filter(|joints| joints.len() == N_JOINTS) else {
            let what = format!("frame {frame}: person {}", person.id);
            let found = joints.map_or(0, Vec::len).to_string();
            return Err(contradiction("poses3d.json", &what, "24 joints", found));
        };
        let angles: Vec<f64> = person.global_orient[i].iter().chain(&person.body_pose[i]).map(|a| number(*a)).collect();
        let turn = |j: usize| rotation::exp(&Vector3::new(angles[3 * j], angles[3 * j + 1], angles[3 * j + 2]));
        frames.push(BodyPose {
            rotations: std::array::from_fn(turn),
            translation: Vector3::from(person.transl[i].map(number)),
            joints: std::array::from_fn(|j| joints[j].map_or(Vector3::repeat(f64::NAN), Vector3::from)),
            valid: person.valid[i],
        });
    }
    let first = FrameIndex(first.abs_diff(start) as usize);
    let metres = |sigmas: &[Option<f64>; N_JOINTS]| sigmas.map(|mm| 1e-3 * number(mm));
    let joint_sigmas = person.joint_sigma_mm.as_ref().map(|frames| frames.iter().map(metres).collect());
    let hands = match &person.hands {
        Some(Hands { left, right }) => {
            let hand = |hand: &Hand| {
                hand_motion(hand, n_frames).ok_or_else(|| {
                    let lengths = [hand.pose.len(), hand.joints.len(), hand.n_views.len()];
                    fault(
                        "hands",
                        format!("{n_frames} frames of 45 angles and 15 joints"),
                        format!("{lengths:?} frames"),
                    )
                })
            };
            Some([hand(left)?, hand(right)?])
        }
        None => None,
    };
    Ok(BodyMotion { person: PersonId(person.id), first, betas, frames, joint_sigmas, hands })
}

/// The fingers of a hand; `None` where a number of frames, angles or joints is not the expected one.
fn hand_motion(hand: &Hand, n_frames: usize) -> Option<HandMotion> {
    let has_all = |n: usize| n == n_frames;
    let is_whole = has_all(hand.pose.len()) && has_all(hand.joints.len()) && has_all(hand.n_views.len());
    let frame = |((angles, joints), n_views): ((&Vec<f64>, &Vec<[f64; 3]>), &u8)| {
        let turns: Vec<_> = angles.as_chunks::<3>().0.iter().map(|turn| rotation::exp(&Vector3::from(*turn))).collect();
        let joints: Vec<_> = joints.iter().map(|joint| Vector3::from(*joint)).collect();
        let (rotations, joints) = (turns.try_into().ok()?, joints.try_into().ok()?);
        (angles.len() == 3 * N_FINGER_JOINTS).then_some(HandPose { rotations, joints, n_views: *n_views })
    };
    let frames = hand.pose.iter().zip(&hand.joints).zip(&hand.n_views).map(frame).collect::<Option<_>>()?;
    is_whole.then_some(HandMotion { frames })
}

/// Null in JSON is a number that is not finite.
fn number(value: Option<f64>) -> f64 {
    value.unwrap_or(f64::NAN)
}

fn contradiction(file: &'static str, what: &str, expected: &str, found: String) -> ReadError {
    ReadError::Contradiction { file, what: what.to_owned(), expected: expected.to_owned(), found }
}
