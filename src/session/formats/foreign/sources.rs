//! Reader of the pose files of a survey: each camera's people, with points in the order of the file.

use super::survey::{FrameGroup, Survey};
use crate::session::formats::joints::JointOrder;
use crate::session::formats::native;
use crate::session::formats::poses::{
    FoundPoses, FrameContent, ImageTable, PoseDialect, level_hands, read_array, read_caliscope, read_deeplabcut,
    read_frame, read_list, read_mmpose, read_timestamps, without_mark,
};
use crate::session::recording::Detection;
use crate::session::upload::detections::add_frame;
use crate::session::upload::error::{Fault, UploadError};
use crate::session::upload::json::Reading;
use crate::session::upload::limits::PERSON_AS_KEYPOINTS;
use crate::session::upload::members::Members;
use crate::session::upload::raw::RawPoses;
use rayon::prelude::*;
use std::io::{Read, Seek};

/// One camera's poses from a file or a group of files.
#[derive(Debug)]
pub(super) struct Source {
    pub(super) dialect: PoseDialect,
    /// Possible names of the camera, the most likely first.
    pub(super) names: Vec<String>,
    pub(super) poses: RawPoses,
    /// Whether the files contain placeholders of absent people: indices in the list are then identities.
    pub(super) has_placeholders: bool,
    /// Whether AlphaPose wrote it; its confidences may reach 6.
    pub(super) is_alphapose: bool,
    pub(super) order: Option<JointOrder>,
    pub(super) image_size: Option<[u32; 2]>,
    /// Time offset of the camera, s, where the file contains time stamps.
    pub(super) time_offset: Option<f64>,
}

/// Content of all pose files.
#[derive(Debug, Default)]
pub(super) struct Sources {
    pub(super) sources: Vec<Source>,
    /// Frames per second, where a file contains time stamps.
    pub(super) fps: Option<f64>,
}

/// Largest file of one frame, bytes: a thousand people of 136 points.
const MAX_FRAME_FILE_BYTES: u64 = 16 << 20;
/// Number of bytes and files that are in memory at a time while they are parsed.
const BATCH_BYTES: usize = 16 << 20;
const BATCH_FILES: usize = 512;
/// Reads every pose file of the survey.
///
/// # Errors
/// The first file that cannot be read.
pub(super) fn read_sources<R: Read + Seek>(
    survey: &Survey,
    members: &mut Members<R>,
    reading: &mut Reading<'_>,
) -> Result<Sources, UploadError> {
    let mut all = Sources::default();
    let mut images = ImageTable::new();
    // Tables of image numbers come before the lists that use the numbers.
    let tables = survey.streams.iter().filter(|(_, dialect)| *dialect == PoseDialect::CocoImages);
    let others = survey.streams.iter().filter(|(_, dialect)| *dialect != PoseDialect::CocoImages);
    for (name, dialect) in tables.chain(others) {
        reading.place.file = Some(name.clone());
        let found = read_stream(name, *dialect, members, &mut images, &mut all.fps, reading);
        let found = found.map_err(|e| reading.place.of(e))?;
        all.fps = all.fps.or(found.fps);
        all.sources.extend(split_by_camera(name, *dialect, found));
    }
    for group in &survey.groups {
        all.sources.push(read_group(group, members, reading)?);
    }
    reading.place.file = None;
    Ok(all)
}

fn read_stream<R: Read + Seek>(
    name: &str,
    dialect: PoseDialect,
    members: &mut Members<R>,
    images: &mut ImageTable,
    fps: &mut Option<f64>,
    reading: &mut Reading<'_>,
) -> Result<FoundPoses, UploadError> {
    if dialect == PoseDialect::Native {
        let poses = native::read_poses(members, name, reading)?;
        return Ok(FoundPoses { by_camera: [(None, poses)].into(), ..FoundPoses::default() });
    }
    if dialect == PoseDialect::MediaPipeArray {
        return read_array(members.open(name)?, reading);
    }
    let is_document = is_document(members, name)?;
    let reader = members.open(name)?;
    match dialect {
        PoseDialect::Mmpose => read_mmpose(reader, is_document, reading),
        PoseDialect::CaliscopeCsv => read_caliscope(reader, reading),
        PoseDialect::DeepLabCutCsv => read_deeplabcut(reader, reading),
        PoseDialect::CaliscopeTimestamps => {
            *fps = fps.or(read_timestamps(reader)?);
            Ok(FoundPoses::default())
        }
        _ => read_list(reader, is_document, images, reading),
    }
}

/// Whether the document is a JSON object (and not a list).
fn is_document<R: Read + Seek>(members: &mut Members<R>, name: &str) -> Result<bool, UploadError> {
    let mut head = Vec::new();
    let read = members.open(name)?.take(4096).read_to_end(&mut head);
    read.map_err(crate::session::upload::json::fault_of_io)?;
    Ok(without_mark(&head).trim_ascii_start().first() == Some(&b'{'))
}

/// One source per camera of a file, named as in the file, or after the file.
fn split_by_camera(name: &str, dialect: PoseDialect, found: FoundPoses) -> Vec<Source> {
    let FoundPoses { by_camera, order, image_size, fps: _, time_offsets } = found;
    let n_cameras = by_camera.len();
    let source = |(camera, poses): (Option<String>, RawPoses)| Source {
        dialect,
        image_size: image_size.get(&camera).copied(),
        time_offset: camera.as_ref().and_then(|camera| time_offsets.get(camera)).copied(),
        // Images without a camera's name are named after the file.
        names: camera.clone().into_iter().chain(if n_cameras > 1 { Vec::new() } else { path_names(name) }).collect(),
        poses,
        has_placeholders: false,
        is_alphapose: dialect == PoseDialect::AlphaPose,
        order: order.clone(),
    };
    by_camera.into_iter().map(source).collect()
}

/// A file's name without its ending, then its folders from the innermost.
fn path_names(path: &str) -> Vec<String> {
    let mut parts: Vec<String> = path.split('/').rev().map(str::to_owned).collect();
    if let Some(file_name) = parts.first_mut() {
        *file_name = file_name.rsplit_once('.').map_or(file_name.as_str(), |(stem, _)| stem).to_owned();
    }
    parts
}

/// Reads a group of frame files in batches: bytes sequentially, parsing in parallel.
fn read_group<R: Read + Seek>(
    group: &FrameGroup,
    members: &mut Members<R>,
    reading: &mut Reading<'_>,
) -> Result<Source, UploadError> {
    let mut names: Vec<String> = group.folder.split('/').rev().map(str::to_owned).filter(|n| !n.is_empty()).collect();
    let stem = Some(group.stem.clone()).filter(|stem| !stem.is_empty());
    if group.shares_folder {
        names = stem.into_iter().collect();
    } else {
        names.extend(stem);
    }
    let mut source = Source {
        dialect: group.dialect,
        names,
        poses: RawPoses { file: group.folder.clone(), ..RawPoses::default() },
        has_placeholders: false,
        is_alphapose: group.dialect == PoseDialect::AlphaPoseCmu,
        order: None,
        image_size: None,
        time_offset: None,
    };
    Fault::TooManyFrames.when(group.files.len() > reading.limits.max_frames, || {
        format!("the camera has {} frames, at most {} are read", group.files.len(), reading.limits.max_frames)
    })?;
    let mut rest = group.files.as_slice();
    while !rest.is_empty() {
        let mut batch: Vec<(i64, &str, Vec<u8>)> = Vec::new();
        let mut n_bytes = 0;
        while let Some((frame, name)) = rest.first().filter(|_| n_bytes < BATCH_BYTES && batch.len() < BATCH_FILES) {
            let bytes = read_bytes(members, name, MAX_FRAME_FILE_BYTES)?;
            n_bytes += bytes.len();
            batch.push((*frame, name, bytes));
            rest = &rest[1..];
        }
        let parsed: Vec<Result<FrameContent, UploadError>> =
            batch.par_iter().map(|(_, _, bytes)| read_frame(group.dialect, bytes)).collect();
        for ((frame, name, _), content) in batch.iter().zip(parsed) {
            let added = content.and_then(|content| add_content(&mut source, *frame, content, reading));
            added.map_err(|e| UploadError { file: Some((*name).to_owned()), frame: Some(*frame), ..e })?;
        }
    }
    level_hands(source.poses.detections.values_mut().flatten(), reading)?;
    Ok(source)
}

fn add_content(
    source: &mut Source,
    frame: i64,
    content: FrameContent,
    reading: &mut Reading,
) -> Result<(), UploadError> {
    reading.spend(content.people.iter().flatten().map(|person| person.keypoints.len() + PERSON_AS_KEYPOINTS).sum())?;
    source.has_placeholders |= content.people.iter().any(Option::is_none);
    source.is_alphapose |= content.is_alphapose;
    source.image_size = source.image_size.or(content.image_size);
    // A placeholder is kept as a person without points until all files have been read.
    let absent = Detection { track_id: None, keypoints: Vec::new() };
    let people = content.people.into_iter().map(|person| person.unwrap_or_else(|| absent.clone())).collect();
    add_frame(&mut source.poses, frame, people, reading)
}

/// Reads a small file as a whole.
///
/// # Errors
/// [`Fault::TooLarge`], or the error of reading.
pub(super) fn read_bytes<R: Read + Seek>(
    members: &mut Members<R>,
    name: &str,
    max_bytes: u64,
) -> Result<Vec<u8>, UploadError> {
    let mut bytes = Vec::new();
    let of_file = |e| UploadError { file: Some(name.to_owned()), ..e };
    let read = members.open(name)?.take(max_bytes + 1).read_to_end(&mut bytes);
    read.map_err(|e| of_file(crate::session::upload::json::fault_of_io(e)))?;
    Fault::TooLarge
        .when(bytes.len() as u64 > max_bytes, || format!("the file has more than {max_bytes} bytes"))
        .map_err(of_file)?;
    Ok(bytes)
}
