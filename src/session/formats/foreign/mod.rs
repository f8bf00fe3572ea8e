//! Sessions from other tools' files: calibration files and pose files in any mixture of dialects.
//!
//! An optional `session.json` beside them adds what they do not contain: `fps`, `keypoint_convention` or `keypoint_names`,
//! image sizes, the up axis. The response to the upload reports the dialects in the format's name and the joint mapping in
//! the warnings.

mod header;
mod names;
mod order_evidence;
mod skeleton;
mod sources;
mod survey;

pub(crate) use survey::{Survey, survey};

use crate::session::formats::calibration::Calibration;
use crate::session::formats::poses::PoseDialect;
use crate::session::upload::error::{Fault, UploadError, shown};
use crate::session::upload::json::{Reading, ShortList};
use crate::session::upload::members::Members;
use crate::session::upload::raw::{MembersRead, RawCamera, RawSession};
use crate::session::upload::warnings::Warnings;
use header::Header;
use sources::{Source, read_bytes, read_sources};
use std::collections::{BTreeMap, BTreeSet};
use std::io::{Read, Seek};

/// Largest header and calibration file, bytes; a calibration of a thousand images has some megabytes.
const MAX_HEADER_BYTES: u64 = 4 << 20;
const MAX_CALIBRATION_BYTES: u64 = 32 << 20;
/// Frame rate where no file contains one, frames per second: the rate of most cameras.
const DEFAULT_FPS: f64 = 30.0;

/// Whether the header names the joints of a custom skeleton, which only this reader supports.
pub(crate) fn names_joints<R: Read + Seek>(members: &mut Members<R>, header: &str) -> bool {
    let header = read_bytes(members, header, MAX_HEADER_BYTES).and_then(|bytes| Header::read(&bytes));
    header.is_ok_and(|header| header.keypoint_names.is_some())
}

/// Reads the files of a survey.
///
/// # Errors
/// The first problem, with its location.
pub(crate) fn read_members<R: Read + Seek>(
    survey: Survey,
    members: &mut Members<R>,
    reading: &mut Reading<'_>,
) -> Result<MembersRead, UploadError> {
    let mut header = read_header(&survey, members)?;
    let header_cameras = header.take_cameras();
    let (calibration, calibrated) = read_calibrations(&survey, &header_cameras, members, reading)?;
    let found = read_sources(&survey, members, reading)?;
    let mut sources = found.sources;
    sources.retain(|source| !source.poses.order.is_empty());
    Fault::NoFrames.when(sources.is_empty(), || "the pose files contain no frame")?;
    let cameras = match calibrated {
        none if none.is_empty() => without_lenses(&header_cameras, &sources),
        cameras => with_unknown_lenses(cameras, &header_cameras, &sources)?,
    };
    let (cameras, mut sources) = paired(cameras, sources, reading)?;
    let convention = skeleton::unify(&mut sources, &header, reading.warnings)?;
    let cameras: Vec<RawCamera> = cameras
        .into_iter()
        .zip(&sources)
        .map(|(camera, source)| sized(camera, source, &header_cameras, reading))
        .collect::<Result<_, _>>()?;
    survey.hints.iter().for_each(|hint| reading.warnings.add(hint.clone()));
    survey.ignored().into_iter().for_each(|line| reading.warnings.add(line));
    let fps = header.fps.map(|rate| rate.0).or(found.fps).or(calibration.fps).unwrap_or_else(|| {
        let line =
            format!("no file contains the frame rate: {DEFAULT_FPS} per second are assumed; give the option `fps`, or a file session.json with {{\"fps\": 25}} beside the others");
        reading.warnings.add(line);
        DEFAULT_FPS
    });
    let frames = || sources.iter().flat_map(|source| source.poses.order.iter().copied());
    let first_frame = header.first_frame.or(frames().min()).unwrap_or(0);
    let last_frame = frames().max().unwrap_or(first_frame);
    let n_found = last_frame.saturating_sub(first_frame).saturating_add(1).max(0).unsigned_abs();
    let format = format_name(&sources, &calibration, &header_cameras);
    let of_poses = || sources.first().map(|source| source.poses.file.clone());
    let file = survey.header.clone().or(survey.calibrations.first().map(|(name, _)| name.clone())).or_else(of_poses);
    let raw = RawSession {
        file: file.unwrap_or_default(),
        name: header.name.unwrap_or_default(),
        fps,
        first_frame,
        n_frames: header.n_frames.or(Some(n_found)),
        keypoint_convention: convention.name().to_owned(),
        landmarks: None,
        up_axis: header.up_axis,
        start_timecode: header.start_timecode,
        poses: cameras.iter().map(|camera| camera.id.clone()).zip(sources.into_iter().map(|s| s.poses)).collect(),
        cameras,
    };
    Ok(MembersRead { raw, format, files: files_of(survey) })
}

fn read_header<R: Read + Seek>(survey: &Survey, members: &mut Members<R>) -> Result<Header, UploadError> {
    let Some(name) = &survey.header else { return Ok(Header::default()) };
    let bytes = read_bytes(members, name, MAX_HEADER_BYTES)?;
    Header::read(&bytes).map_err(|e| UploadError { file: Some(name.clone()), ..e })
}

fn read_calibrations<R: Read + Seek>(
    survey: &Survey,
    header_cameras: &[RawCamera],
    members: &mut Members<R>,
    reading: &mut Reading<'_>,
) -> Result<(Calibration, Vec<RawCamera>), UploadError> {
    let mut calibration = Calibration::default();
    for (name, format) in &survey.calibrations {
        let in_file = |e: UploadError| UploadError { file: Some(name.clone()), ..e };
        let bytes = read_bytes(members, name, MAX_CALIBRATION_BYTES)?;
        calibration.add(*format, name, &bytes, reading.warnings).map_err(in_file)?;
    }
    let own = header_cameras.iter().filter(|camera| camera.matrix.is_some()).cloned();
    let header = survey.header.as_deref().unwrap_or_default();
    let mut cameras = calibration.cameras(own, header, reading.warnings)?;
    cameras.retain(|camera| {
        let is_whole = camera.matrix.is_some();
        if !is_whole {
            reading.warnings.add(format!("camera {} has a pose but no intrinsics: it is ignored", shown(&camera.id)));
        }
        is_whole
    });
    let most = 4 * reading.limits.max_cameras;
    Fault::TooManyCameras.when(cameras.len() > most, || {
        format!("the calibration has {} cameras, at most {most} are read", cameras.len())
    })?;
    Ok((calibration, cameras))
}

/// The cameras of an upload without any calibration: those of the header, else one of each pose file or folder, with the innermost
/// names that differ between all of them (`cam1/annotations.json` and `cam2/annotations.json` are cameras cam1 and cam2).
fn without_lenses(header_cameras: &[RawCamera], sources: &[Source]) -> Vec<RawCamera> {
    if !header_cameras.is_empty() {
        return header_cameras.to_vec();
    }
    let names_at = |level: usize| -> Vec<&String> { sources.iter().filter_map(|s| s.names.get(level)).collect() };
    let differ = |level: &usize| {
        let names = names_at(*level);
        names.len() == sources.len() && names.iter().collect::<BTreeSet<_>>().len() == names.len()
    };
    let n_levels = sources.iter().map(|source| source.names.len()).max().unwrap_or(0);
    let level = (0..n_levels).find(differ).unwrap_or(0);
    names_at(level).into_iter().map(|id| RawCamera { id: id.clone(), ..RawCamera::default() }).collect()
}

/// The calibrated cameras, and those of the header without K that have poses of their own: their focal lengths are estimated.
fn with_unknown_lenses(
    calibrated: Vec<RawCamera>,
    header_cameras: &[RawCamera],
    sources: &[Source],
) -> Result<Vec<RawCamera>, UploadError> {
    let ids: Vec<&str> = calibrated.iter().map(|camera| camera.id.as_str()).collect();
    let source_names: Vec<Vec<String>> = sources.iter().map(|source| source.names.clone()).collect();
    // Its warnings are those of the pairing that follows.
    let matched = names::match_cameras(&source_names, &ids, &mut Warnings::default())?;
    let unmatched: Vec<&Vec<String>> =
        source_names.iter().zip(matched).filter(|(_, camera)| camera.is_none()).map(|(names, _)| names).collect();
    let has_poses = |camera: &&RawCamera| {
        camera.matrix.is_none()
            && !ids.contains(&camera.id.as_str())
            && unmatched.iter().any(|names| names::is_named(names, &camera.id))
    };
    let without_lens: Vec<RawCamera> = header_cameras.iter().filter(has_poses).cloned().collect();
    Ok(calibrated.into_iter().chain(without_lens).collect())
}

/// Pairs cameras with their poses, in the calibration's order; those without a partner are left out with a warning.
fn paired(
    cameras: Vec<RawCamera>,
    sources: Vec<Source>,
    reading: &mut Reading<'_>,
) -> Result<(Vec<RawCamera>, Vec<Source>), UploadError> {
    let ids: Vec<&str> = cameras.iter().map(|camera| camera.id.as_str()).collect();
    let source_names: Vec<Vec<String>> = sources.iter().map(|source| source.names.clone()).collect();
    let matched = names::match_cameras(&source_names, &ids, reading.warnings)?;
    let mut by_camera: BTreeMap<usize, Source> = BTreeMap::new();
    for (mut source, camera) in sources.into_iter().zip(matched) {
        match camera {
            Some(camera) => {
                // From here on messages name the camera.
                source.names = vec![cameras[camera].id.clone()];
                by_camera.insert(camera, source);
            }
            None => {
                let name = source.names.first().map_or("", String::as_str);
                reading.warnings.add(format!("poses of unknown camera {} are ignored", shown(name)));
            }
        }
    }
    Fault::CameraUnknown.when(by_camera.is_empty(), || {
        shown(&format!("no pose file matches a camera of the calibration ({})", ids.join(", ")))
    })?;
    let (mut kept, mut poses) = (Vec::new(), Vec::new());
    for (i, camera) in cameras.into_iter().enumerate() {
        match by_camera.remove(&i) {
            Some(source) => {
                kept.push(camera);
                poses.push(source);
            }
            None => {
                let id = shown(&camera.id);
                reading.warnings.add(format!("camera {id} of the calibration has no poses: it is ignored"));
            }
        }
    }
    Ok((kept, poses))
}

/// Scales a camera to the image size of its keypoints: as the pose file or the header states it, else as calibrated. Its time
/// offset is that of the header, else of the calibration, else of the time stamps of its poses.
fn sized(
    mut camera: RawCamera,
    source: &Source,
    header_cameras: &[RawCamera],
    reading: &mut Reading<'_>,
) -> Result<RawCamera, UploadError> {
    let in_camera = |e: UploadError| UploadError { camera: Some(camera.id.clone()), ..e };
    let given = header_cameras.iter().find(|own| own.id == camera.id && own.width > 0 && own.height > 0);
    let stated = source.image_size.or(given.map(|own| [own.width, own.height]));
    let calibrated = [camera.width, camera.height];
    let size = match stated {
        Some(size) => size,
        None if calibrated.contains(&0) => {
            let detail = "neither a calibration nor the poses contain the image size";
            return Err(in_camera(Fault::ImageSizeUnknown.with(detail)));
        }
        None => calibrated,
    };
    if !calibrated.contains(&0) && size != calibrated {
        let scale = scale_between(calibrated, size).map_err(in_camera)?;
        let [[w0, h0], [w, h]] = [calibrated, size];
        reading.warnings.add(format!(
            "camera {} was calibrated at {w0}x{h0}, but its keypoints belong to images of {w}x{h}: K is scaled by {scale}",
            shown(&camera.id)
        ));
        scale_matrix(&mut camera, scale);
    }
    [camera.width, camera.height] = size;
    let of_header = header_cameras.iter().find(|own| own.id == camera.id).and_then(|own| own.time_offset);
    camera.time_offset = of_header.or(camera.time_offset).or(source.time_offset);
    Ok(camera)
}

fn scale_between(calibrated: [u32; 2], size: [u32; 2]) -> Result<f64, UploadError> {
    let ratio = |i: usize| f64::from(size[i]) / f64::from(calibrated[i]);
    let found = format!(
        "the camera was calibrated at {}x{}, but its keypoints belong to images of {}x{}",
        calibrated[0], calibrated[1], size[0], size[1]
    );
    if (ratio(0) / ratio(1) - 1.0).abs() < 0.01 {
        return Ok(ratio(0));
    }
    let is_turned =
        (f64::from(size[0]) / f64::from(calibrated[1]) - f64::from(size[1]) / f64::from(calibrated[0])).abs() < 0.01;
    let why = if is_turned { "the video was rotated" } else { "the image was cropped or stretched" };
    Err(Fault::CameraInvalid.with(format!("{found}: {why}")))
}

/// Scales K to another image size; the centre of the first pixel stays (0, 0).
fn scale_matrix(camera: &mut RawCamera, scale: f64) {
    let Some(ShortList(rows)) = &mut camera.matrix else { return };
    for row in rows.iter_mut().take(2) {
        for (column, value) in row.0.iter_mut().enumerate() {
            *value = if column == 2 { (*value + 0.5) * scale - 0.5 } else { *value * scale };
        }
    }
}

fn format_name(sources: &[Source], calibration: &Calibration, header_cameras: &[RawCamera]) -> String {
    let mut dialects: Vec<&str> = Vec::new();
    let has_placeholders = sources.iter().any(|source| source.has_placeholders);
    for source in sources {
        let is_dmmr = has_placeholders && source.dialect == PoseDialect::OpenPose;
        let name = match source.dialect.name() {
            _ if is_dmmr => "dmmr",
            "openpose" if source.is_alphapose => "alphapose_open",
            name => name,
        };
        if !dialects.contains(&name) {
            dialects.push(name);
        }
    }
    let mut formats = calibration.formats.clone();
    if header_cameras.iter().any(|camera| camera.matrix.is_some()) {
        formats.push("native");
    }
    if formats.is_empty() {
        return dialects.join("+");
    }
    format!("{} with {}", dialects.join("+"), formats.join("+"))
}

fn files_of(survey: Survey) -> Vec<String> {
    let Survey { header, calibrations, streams, groups, unrecognised: _, pictures: _, hints: _ } = survey;
    let named = calibrations.into_iter().map(|(name, _)| name).chain(streams.into_iter().map(|(name, _)| name));
    let frames = groups.into_iter().flat_map(|group| group.files).map(|(_, name)| name);
    header.into_iter().chain(named).chain(frames).collect()
}
