//! One file per frame: OpenPose and similar layouts, EasyMocap's annotations, MMPose's images.

use super::hands::with_hands;
use super::points::Points;
use super::sniff::PoseDialect;
use super::tool_json::standard_json;
use crate::session::recording::{Detection, Keypoint};
use crate::session::upload::error::{Fault, UploadError};
use crate::session::upload::json::document_from_bytes;
use serde::Deserialize;

/// The people of one frame.
#[derive(Debug, Default)]
pub(crate) struct FrameContent {
    /// People; `None` is a placeholder of an absent person, and the index in the list is then the person's identity.
    pub(crate) people: Vec<Option<Detection>>,
    /// Width and height of the image, px, where the file contains them.
    pub(crate) image_size: Option<[u32; 2]>,
    /// Whether AlphaPose wrote the file in another tool's layout.
    pub(crate) is_alphapose: bool,
}

/// Reads the file of one frame.
///
/// # Errors
/// Invalid content, with its pointer.
pub(crate) fn read_frame(dialect: PoseDialect, bytes: &[u8]) -> Result<FrameContent, UploadError> {
    let bytes = &*standard_json(bytes);
    match dialect {
        PoseDialect::AlphaPoseCmu => document_from_bytes(bytes).map(cmu),
        PoseDialect::EasyMocap => document_from_bytes(bytes).map(easymocap),
        PoseDialect::MmposeFrame => document_from_bytes::<Vec<Instance>>(bytes).and_then(mmpose),
        _ => document_from_bytes(bytes).and_then(openpose),
    }
}

#[derive(Deserialize)]
struct OpenPose {
    version: Option<Version>,
    people: Vec<Option<OpenPosePerson>>,
}

/// OpenPose writes a number, AlphaPose a text with its name.
#[derive(Deserialize)]
#[serde(untagged)]
enum Version {
    Number(#[allow(dead_code)] f64),
    Text(String),
}

#[derive(Deserialize)]
struct OpenPosePerson {
    /// Version 1.2 on: `[-1]` where the detector does not track.
    #[serde(default)]
    person_id: Option<Track>,
    /// Version 1.0 on.
    pose_keypoints_2d: Option<Points>,
    /// Version 0.1.
    pose_keypoints: Option<Points>,
    /// Empty where the detector looks for no hands, zeros where it found none.
    #[serde(default, alias = "hand_left_keypoints")]
    hand_left_keypoints_2d: Option<Points>,
    #[serde(default, alias = "hand_right_keypoints")]
    hand_right_keypoints_2d: Option<Points>,
}

/// A track number: a number, or a list that contains it (`[-1]`, AlphaPose's list of one).
#[derive(Deserialize)]
#[serde(untagged)]
pub(super) enum Track {
    One(f64),
    List(Vec<f64>),
}

impl Track {
    /// The track number, where there is one.
    pub(super) fn id(&self) -> Option<i64> {
        let number = match self {
            Self::One(number) => *number,
            Self::List(numbers) => *numbers.first()?,
        };
        (number.fract() == 0.0 && (0.0..9e15).contains(&number)).then_some(number as i64)
    }
}

fn openpose(file: OpenPose) -> Result<FrameContent, UploadError> {
    let person = |person: OpenPosePerson| {
        let body = person.pose_keypoints_2d.or(person.pose_keypoints).unwrap_or_default().0;
        let hands = [person.hand_left_keypoints_2d, person.hand_right_keypoints_2d];
        let keypoints = with_hands(body, hands.map(|hand| hand.unwrap_or_default().0))?;
        Ok(Detection { track_id: person.person_id.and_then(|track| track.id()), keypoints })
    };
    let is_alphapose = matches!(file.version, Some(Version::Text(text)) if text.starts_with("AlphaPose"));
    let people: Result<_, UploadError> = file.people.into_iter().map(|entry| entry.map(person).transpose()).collect();
    Ok(FrameContent { people: people?, image_size: None, is_alphapose })
}

#[derive(Deserialize)]
struct Cmu {
    bodies: Vec<CmuBody>,
}

#[derive(Deserialize)]
struct CmuBody {
    joints: Points,
    idx: Option<Track>,
}

fn cmu(file: Cmu) -> FrameContent {
    let person =
        |body: CmuBody| Some(Detection { track_id: body.idx.and_then(|track| track.id()), keypoints: body.joints.0 });
    FrameContent { people: file.bodies.into_iter().map(person).collect(), image_size: None, is_alphapose: true }
}

#[derive(Deserialize)]
#[serde(untagged)]
enum EasyMocap {
    File { annots: Vec<Annotation>, width: Option<u32>, height: Option<u32> },
    List(Vec<Annotation>),
}

#[derive(Deserialize)]
struct Annotation {
    #[serde(rename = "personID", alias = "id")]
    person: Option<Track>,
    #[serde(alias = "keypoints2d")]
    keypoints: Option<Points>,
}

fn easymocap(file: EasyMocap) -> FrameContent {
    let (annots, image_size) = match file {
        EasyMocap::File { annots, width, height } => (annots, width.zip(height).map(|(w, h)| [w, h])),
        EasyMocap::List(annots) => (annots, None),
    };
    let person = |annotation: Annotation| {
        let track_id = annotation.person.and_then(|track| track.id());
        Some(Detection { track_id, keypoints: annotation.keypoints.unwrap_or_default().0 })
    };
    FrameContent { people: annots.into_iter().map(person).collect(), image_size, is_alphapose: false }
}

/// One person of MMPose, with points and scores in separate lists.
#[derive(Deserialize)]
pub(super) struct Instance {
    keypoints: Points,
    #[serde(default)]
    keypoint_scores: Vec<Option<f64>>,
    #[serde(default, alias = "instance_id")]
    track_id: Option<Track>,
}

impl Instance {
    /// The person with each point's score as its confidence.
    pub(super) fn into_detection(self) -> Result<Detection, UploadError> {
        let (n_points, n_scores) = (self.keypoints.0.len(), self.keypoint_scores.len());
        // A person of nothing but NaN has lost its points already.
        if n_scores != 0 && n_points != 0 && n_scores != n_points {
            return Err(Fault::KeypointCount.with(format!("the person has {n_points} keypoints but {n_scores} scores")));
        }
        let mut keypoints = self.keypoints.0;
        for (keypoint, score) in keypoints.iter_mut().zip(&self.keypoint_scores) {
            if keypoint.is_present() {
                let score = score.filter(|score| *score > 0.0);
                *keypoint = score.map_or(super::points::missing(), |confidence| Keypoint { confidence, ..*keypoint });
            }
        }
        Ok(Detection { track_id: self.track_id.and_then(|track| track.id()), keypoints })
    }
}

fn mmpose(instances: Vec<Instance>) -> Result<FrameContent, UploadError> {
    let people: Result<_, _> = instances.into_iter().map(|instance| instance.into_detection().map(Some)).collect();
    Ok(FrameContent { people: people?, image_size: None, is_alphapose: false })
}
