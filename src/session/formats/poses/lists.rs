//! One file per camera or recording: AlphaPose's and COCO's lists of people, MMPose's list of frames. Read item by item.

use super::found::FoundPoses;
use super::frame_files::{Instance, Track};
use super::frame_name::frame_name;
use super::points::Points;
use super::tool_json::ToolJson;
use crate::session::formats::joints::JointOrder;
use crate::session::recording::Detection;
use crate::session::upload::error::{Fault, UploadError, shown};
use crate::session::upload::json::{Fields, Items, JsonStream, List, Reading};
use serde::Deserialize;
use serde::de::{MapAccess, SeqAccess};
use std::collections::BTreeMap;
use std::io::Read;

/// Number, file name and size of the images of a COCO data set, by number.
pub(crate) type ImageTable = BTreeMap<i64, CocoImage>;

/// One row of an [`ImageTable`].
#[derive(Debug, Clone, Deserialize)]
pub(crate) struct CocoImage {
    id: i64,
    file_name: Option<String>,
    width: Option<u32>,
    height: Option<u32>,
    frame_id: Option<i64>,
}

/// One person of AlphaPose or COCO.
#[derive(Deserialize)]
struct Person {
    image_id: ImageId,
    keypoints: Points,
    #[serde(alias = "track_id")]
    idx: Option<Track>,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum ImageId {
    Number(i64),
    Name(String),
}

/// Reads AlphaPose's list, COCO's list of results, or a COCO data set with `annotations`.
///
/// `images`: COCO's images by number; rows of a data set are added to it. An image without a row has the number of its frame.
///
/// # Errors
/// Invalid content, with its pointer.
pub(crate) fn read_list(
    reader: impl Read,
    is_document: bool,
    images: &mut ImageTable,
    reading: &mut Reading<'_>,
) -> Result<FoundPoses, UploadError> {
    let mut people = People { found: FoundPoses::default(), images };
    read_whole(reader, is_document, &mut people, reading)?;
    Ok(people.found)
}

/// Reads a document that is an object, or a list alone.
fn read_whole(
    reader: impl Read,
    is_document: bool,
    target: &mut (impl Fields + Items),
    reading: &mut Reading<'_>,
) -> Result<(), UploadError> {
    let mut stream = JsonStream::new(ToolJson::new(reader), reading.limits);
    match is_document {
        true => stream.next(target, reading)?,
        false => stream.next_list(target, reading)?,
    }
    stream.expect_end(reading)
}

struct People<'i> {
    found: FoundPoses,
    images: &'i mut ImageTable,
}

impl People<'_> {
    fn add(&mut self, person: Person, reading: &mut Reading<'_>) -> Result<(), UploadError> {
        let detection = Detection { track_id: person.idx.and_then(|track| track.id()), keypoints: person.keypoints.0 };
        let (name, number) = match &person.image_id {
            ImageId::Name(name) => (Some(name.as_str()), None),
            ImageId::Number(id) => {
                let row = self.images.get(id);
                let numbered = row.map_or(Some(*id), |row| row.frame_id);
                (row.and_then(|row| row.file_name.as_deref()), numbered)
            }
        };
        let size = match &person.image_id {
            ImageId::Number(id) => self.images.get(id).and_then(|row| row.width.zip(row.height)),
            ImageId::Name(_) => None,
        };
        let place = name.map(|name| name.rsplit_once('/').unwrap_or(("", name)));
        let numbered = place.and_then(|(_, file_name)| frame_name(file_name));
        let frame = number.or(numbered.as_ref().map(|name| name.frame)).ok_or_else(|| {
            Fault::FrameInvalid
                .with(format!("the name of image {} does not end in a frame number", shown(name.unwrap_or_default())))
        })?;
        // The camera's name is the images' folder, or in a common folder the part before the frame number.
        let folder = place.map(|(folder, _)| folder.rsplit('/').next().unwrap_or(folder)).filter(|f| !f.is_empty());
        let stem = numbered.map(|name| name.stem).filter(|stem| !stem.is_empty());
        let camera = folder.map(str::to_owned).or(stem);
        if let Some((width, height)) = size {
            self.found.image_size.entry(camera.clone()).or_insert([width, height]);
        }
        self.found.add(camera.as_deref(), frame, detection, reading)
    }
}

impl Items for People<'_> {
    fn item<'d, S: SeqAccess<'d>>(&mut self, _i: usize, seq: &mut S, reading: &mut Reading) -> Result<bool, S::Error> {
        let Some(person) = seq.next_element::<Person>()? else { return Ok(false) };
        self.add(person, reading).map_err(|e| reading.refuse(e))?;
        Ok(true)
    }
}

impl Fields for People<'_> {
    const WHAT: &'static str = "a COCO data set";

    fn field<'d, M: MapAccess<'d>>(&mut self, key: &str, map: &mut M, reading: &mut Reading) -> Result<bool, M::Error> {
        match key {
            "images" => map.next_value_seed(List(&mut Images(self.images), reading))?,
            "annotations" => map.next_value_seed(List(self, reading))?,
            "categories" => {
                let categories: Vec<Category> = map.next_value()?;
                let names = categories.into_iter().find_map(|category| category.keypoints);
                let order = |names: Vec<String>| JointOrder::of_names("named", names.iter().map(String::as_str));
                self.found.order = names.map(order);
            }
            "info" | "licenses" => {
                map.next_value::<serde::de::IgnoredAny>()?;
            }
            _ => return Ok(false),
        }
        Ok(true)
    }
}

#[derive(Deserialize)]
struct Category {
    keypoints: Option<Vec<String>>,
}

struct Images<'i>(&'i mut ImageTable);

impl Items for Images<'_> {
    fn item<'d, S: SeqAccess<'d>>(&mut self, _i: usize, seq: &mut S, reading: &mut Reading) -> Result<bool, S::Error> {
        let Some(image) = seq.next_element::<CocoImage>()? else { return Ok(false) };
        if self.0.len() == reading.limits.max_view_frames {
            return Err(reading
                .refuse(Fault::TooManyFrames.with(format!("the data set has more than {} images", self.0.len()))));
        }
        // A row takes the memory of about ten keypoints.
        reading.spend(10).map_err(|e| reading.refuse(e))?;
        self.0.insert(image.id, image);
        Ok(true)
    }
}

/// Reads MMPose's document of `meta_info` and `instance_info`, or its list of frames alone.
///
/// # Errors
/// Invalid content, with its pointer.
pub(crate) fn read_mmpose(
    reader: impl Read,
    is_document: bool,
    reading: &mut Reading<'_>,
) -> Result<FoundPoses, UploadError> {
    let mut frames = MmposeFrames(FoundPoses::default());
    read_whole(reader, is_document, &mut frames, reading)?;
    Ok(frames.0)
}

struct MmposeFrames(FoundPoses);

#[derive(Deserialize)]
struct MmposeFrame {
    frame_id: i64,
    instances: Vec<Instance>,
}

#[derive(Deserialize)]
struct MetaInfo {
    dataset_name: Option<String>,
    keypoint_id2name: Option<BTreeMap<String, String>>,
}

impl Fields for MmposeFrames {
    const WHAT: &'static str = "MMPose's document";

    fn field<'d, M: MapAccess<'d>>(&mut self, key: &str, map: &mut M, reading: &mut Reading) -> Result<bool, M::Error> {
        match key {
            "meta_info" => {
                let meta: MetaInfo = map.next_value()?;
                self.0.order = order_of(&meta);
            }
            "instance_info" => map.next_value_seed(List(self, reading))?,
            _ => return Ok(false),
        }
        Ok(true)
    }
}

/// The order of joints given by `keypoint_id2name`.
fn order_of(meta: &MetaInfo) -> Option<JointOrder> {
    let named = meta.keypoint_id2name.as_ref()?.iter().map(|(id, name)| Some((id.parse::<usize>().ok()?, name)));
    let by_id: BTreeMap<usize, &String> = named.collect::<Option<_>>()?;
    let is_dense = by_id.keys().enumerate().all(|(i, id)| i == *id);
    let name = meta.dataset_name.as_deref().unwrap_or("named");
    is_dense.then(|| JointOrder::of_names(name, by_id.values().map(|name| name.as_str())))
}

impl Items for MmposeFrames {
    fn item<'d, S: SeqAccess<'d>>(&mut self, _i: usize, seq: &mut S, reading: &mut Reading) -> Result<bool, S::Error> {
        let Some(frame) = seq.next_element::<MmposeFrame>()? else { return Ok(false) };
        reading.place.frame = Some(frame.frame_id);
        self.0.frame(None, frame.frame_id, reading).map(|_| ()).map_err(|e| reading.refuse(e))?;
        for instance in frame.instances {
            let added = instance.into_detection().and_then(|person| self.0.add(None, frame.frame_id, person, reading));
            added.map_err(|e| reading.refuse(e))?;
        }
        reading.place.frame = None;
        Ok(true)
    }
}
