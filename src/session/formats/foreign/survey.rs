//! Survey of other tools' files: each file recognised by its first bytes, frame files collected into groups.

use crate::session::formats::calibration::{self, CalibrationFormat};
use crate::session::formats::poses::{self, PoseDialect, frame_name};
use crate::session::upload::error::shown;
use crate::session::upload::members::Members;
use crate::session::upload::pictures::is_picture;
use std::collections::{BTreeMap, BTreeSet};
use std::io::{Read, Seek};

/// The files by kind, each list in the order of names.
#[derive(Debug, Default)]
pub(crate) struct Survey {
    /// `session.json`, at the top or below one folder.
    pub(crate) header: Option<String>,
    pub(crate) calibrations: Vec<(String, CalibrationFormat)>,
    /// Pose files of a whole camera or recording.
    pub(crate) streams: Vec<(String, PoseDialect)>,
    pub(crate) groups: Vec<FrameGroup>,
    /// Unrecognised files: one name and the number of files that it stands for.
    pub(crate) unrecognised: Vec<(String, usize)>,
    /// Videos and images.
    pub(crate) pictures: Vec<String>,
    /// Files that could be read after a conversion, with instructions, and folders that hold a result, one sentence each.
    pub(crate) hints: Vec<String>,
}

/// The pose files of one camera with one file per frame.
#[derive(Debug)]
pub(crate) struct FrameGroup {
    pub(crate) dialect: PoseDialect,
    pub(crate) folder: String,
    /// The part before the frame number in every name.
    pub(crate) stem: String,
    /// Whether the folder also contains files of other stems.
    pub(crate) shares_folder: bool,
    /// Frame number and name.
    pub(crate) files: Vec<(i64, String)>,
}

/// Number of bytes of a file that are examined: up to the first list of a COCO data set.
const HEAD_BYTES: u64 = 1 << 16;
/// Number of files of a group that are examined: cameras may begin with empty frames.
const MAX_TRIES: usize = 8;
/// Larger groups of numbered files are frames and not calibrations of as many cameras.
const MAX_NUMBERED: usize = 256;

enum FileKind {
    Calibration(CalibrationFormat),
    Poses(PoseDialect),
    Hdf5,
    Picture,
}

/// HDF5's first bytes.
const HDF5: &[u8] = b"\x89HDF\r\n\x1a\n";

/// Examines every single file, and examples of the frame files.
pub(crate) fn survey<R: Read + Seek>(members: &mut Members<R>) -> Survey {
    let mut survey = Survey::default();
    let mut groups: BTreeMap<(String, String, String), Vec<(i64, String)>> = BTreeMap::new();
    let mut singles: Vec<String> = Vec::new();
    let results = result_folders(members);
    for name in members.names() {
        let (folder, file_name) = name.rsplit_once('/').unwrap_or(("", name));
        let is_hidden = name.starts_with("__MACOSX/") || name.split('/').any(|part| part.starts_with('.'));
        let is_of_result = results.iter().any(|result| name.starts_with(result.as_str()));
        if is_hidden || is_of_result || file_name.is_empty() || folder.split('/').any(|part| part == "gt") {
            continue;
        }
        if file_name == "session.json" && !folder.contains('/') && survey.header.is_none() {
            survey.header = Some(name.to_owned());
            continue;
        }
        match frame_name(file_name) {
            Some(numbered) => {
                let end = file_name.rsplit_once(|c: char| c.is_ascii_digit()).map_or("", |(_, end)| end);
                let key = (folder.to_owned(), numbered.stem, end.to_owned());
                groups.entry(key).or_default().push((numbered.frame, name.to_owned()));
            }
            None => singles.push(name.to_owned()),
        }
    }
    for ((folder, stem, _), files) in groups {
        let kind_of = files.iter().take(MAX_TRIES).find_map(|(_, name)| kind_of(members, name));
        match kind_of {
            Some(FileKind::Poses(dialect)) if dialect.is_file_per_frame() => {
                survey.groups.push(FrameGroup { dialect, folder, stem, shares_folder: false, files });
            }
            Some(FileKind::Picture) => survey.pictures.extend(files.into_iter().map(|(_, name)| name)),
            Some(_) if files.len() <= MAX_NUMBERED => singles.extend(files.into_iter().map(|(_, name)| name)),
            _ => survey.unrecognised.push((files[0].1.clone(), files.len())),
        }
    }
    singles.sort_unstable();
    for name in singles {
        match kind_of(members, &name) {
            Some(FileKind::Calibration(format)) => survey.calibrations.push((name, format)),
            Some(FileKind::Poses(dialect)) if dialect.is_file_per_frame() => survey.unrecognised.push((name, 1)),
            Some(FileKind::Poses(dialect)) => survey.streams.push((name, dialect)),
            Some(FileKind::Hdf5) => survey.hints.push(format!(
                "file {} is HDF5, which is not supported: convert DeepLabCut's table to CSV (pandas.read_hdf(FILE).to_csv(OTHER))",
                shown(&name)
            )),
            Some(FileKind::Picture) => survey.pictures.push(name),
            None => survey.unrecognised.push((name, 1)),
        }
    }
    let ignored = |result: String| format!("folder {} holds the result of a solve: it is ignored", shown(&result));
    survey.hints.extend(results.into_iter().map(ignored));
    mark_shared_folders(&mut survey.groups);
    survey
}

/// The folders, with a slash at their ends, that hold a result: many write it beside the poses, and solve again.
fn result_folders<R: Read + Seek>(members: &Members<R>) -> Vec<String> {
    let names: BTreeSet<&str> = members.names().collect();
    let is_result = |folder: &&str| {
        let files = ["manifest.json", "report.json", "people.json"];
        files.iter().all(|file| names.contains(format!("{folder}{file}").as_str()))
    };
    let folders = names.iter().filter_map(|name| name.strip_suffix("identities.json"));
    folders.filter(|folder| folder.ends_with('/')).filter(is_result).map(str::to_owned).collect()
}

impl Survey {
    /// Whether there are poses in a dialect other than the native one.
    pub(crate) fn has_foreign_poses(&self) -> bool {
        let is_foreign = |(_, dialect): &(String, PoseDialect)| {
            !matches!(dialect, PoseDialect::Native | PoseDialect::CocoImages | PoseDialect::CaliscopeTimestamps)
        };
        !self.groups.is_empty() || self.streams.iter().any(is_foreign)
    }

    /// A sentence about the files that are not read; `None` if every file is read.
    pub(crate) fn ignored(&self) -> Option<String> {
        const MAX_NAMES: usize = 3;
        let singles = self.pictures.iter().map(|name| (name, 1));
        let all: Vec<(&String, usize)> = self.unrecognised.iter().map(|(name, n)| (name, *n)).chain(singles).collect();
        let n: usize = all.iter().map(|(_, n)| n).sum();
        let names: Vec<String> = all.iter().take(MAX_NAMES).map(|(name, _)| shown(name)).collect();
        let names = names.join(", ");
        match n {
            0 => None,
            1 => Some(format!("file {names} is neither poses nor a calibration: it is ignored")),
            _ if n > all.len().min(MAX_NAMES) => Some(format!("{n} files of other formats are ignored ({names}, …)")),
            _ => Some(format!("{n} files of other formats are ignored ({names})")),
        }
    }

    /// Whether there are poses at all.
    pub(crate) fn has_poses(&self) -> bool {
        !self.groups.is_empty() || self.streams.iter().any(|(_, d)| *d != PoseDialect::CaliscopeTimestamps)
    }
}

fn mark_shared_folders(groups: &mut [FrameGroup]) {
    for i in 0..groups.len() {
        let folder = &groups[i].folder;
        let shares = groups.iter().enumerate().any(|(other, group)| other != i && group.folder == *folder);
        groups[i].shares_folder = shares;
    }
}

/// Recognises a file; `None` for one that cannot be read: the reader that needs it reports the error.
fn kind_of<R: Read + Seek>(members: &mut Members<R>, name: &str) -> Option<FileKind> {
    let mut head = Vec::new();
    members.open(name).ok()?.take(HEAD_BYTES).read_to_end(&mut head).ok()?;
    if head.starts_with(HDF5) {
        return Some(FileKind::Hdf5);
    }
    if is_picture(&head) {
        return Some(FileKind::Picture);
    }
    if poses::is_array(&head) {
        return Some(FileKind::Poses(PoseDialect::MediaPipeArray));
    }
    if calibration::is_opencap(&head) {
        return Some(FileKind::Calibration(CalibrationFormat::OpenCap));
    }
    if head.contains(&0) {
        return None;
    }
    let head = String::from_utf8_lossy(poses::without_mark(&head));
    let poses = poses::recognise(&head).map(FileKind::Poses);
    poses.or_else(|| calibration::recognise(&head).map(FileKind::Calibration))
}
