//! Reader of comma-separated tables: Caliscope's points and time stamps, DeepLabCut's tracks. Read line by line.

use super::found::FoundPoses;
use super::frame_name::frame_name;
use super::points::{checked_point, missing};
use super::time_stamps::TimeStamps;
use super::tool_json::without_mark;
use crate::session::formats::joints::JointOrder;
use crate::session::recording::{Detection, Keypoint};
use crate::session::upload::error::{Fault, UploadError};
use crate::session::upload::json::Reading;
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Read};

/// Longest line, bytes: a thousand columns of numbers.
const MAX_LINE_BYTES: u64 = 1 << 20;
/// Largest number of points.
const MAX_POINTS: usize = 1000;

/// Lines of a limited length, without line ends.
struct Lines<R> {
    reader: BufReader<R>,
    n_lines: usize,
    line: Vec<u8>,
}

impl<R: Read> Lines<R> {
    fn new(reader: R) -> Self {
        Self { reader: BufReader::new(reader), n_lines: 0, line: Vec::new() }
    }

    /// The next line's cells; `None` at the end.
    fn next(&mut self) -> Result<Option<Vec<&str>>, UploadError> {
        loop {
            self.line.clear();
            let read = self.reader.by_ref().take(MAX_LINE_BYTES).read_until(b'\n', &mut self.line);
            let n_bytes = read.map_err(crate::session::upload::json::fault_of_io)?;
            if n_bytes == 0 {
                return Ok(None);
            }
            self.n_lines += 1;
            if n_bytes as u64 == MAX_LINE_BYTES {
                return Err(self.invalid("is too long"));
            }
            if !self.line.trim_ascii().is_empty() {
                break;
            }
        }
        let line = if self.n_lines == 1 { without_mark(&self.line) } else { &self.line };
        match std::str::from_utf8(line) {
            Ok(text) => Ok(Some(text.trim_end_matches(['\r', '\n']).split(',').map(str::trim).collect())),
            Err(_) => Err(Fault::Encoding.with(format!("line {} is not UTF-8", self.n_lines))),
        }
    }

    fn invalid(&self, why: &str) -> UploadError {
        invalid(self.n_lines, why)
    }
}

fn invalid(n_lines: usize, why: &str) -> UploadError {
    Fault::TableInvalid.with(format!("line {n_lines} {why}"))
}

/// The number in a cell; NaN where it is empty.
fn number(cell: &str) -> Option<f64> {
    if cell.is_empty() { Some(f64::NAN) } else { cell.parse().ok() }
}

/// Positions of columns by their names.
fn columns<const N: usize>(header: &[&str], names: [&str; N]) -> Result<[usize; N], UploadError> {
    let mut places = [0; N];
    for (place, name) in places.iter_mut().zip(names) {
        let found = header.iter().position(|column| *column == name || (name == "cam_id" && *column == "port"));
        *place = found.ok_or_else(|| Fault::TableInvalid.with(format!("the table has no column {name:?}")))?;
    }
    Ok(places)
}

/// Reads Caliscope's points: one person per camera, confidence 1, frames by `sync_index`; frame rate and time offsets of the
/// cameras by `frame_time`.
///
/// # Errors
/// A missing column or an invalid number.
pub(crate) fn read_caliscope(reader: impl Read, reading: &mut Reading<'_>) -> Result<FoundPoses, UploadError> {
    let mut lines = Lines::new(reader);
    let header = lines.next()?.ok_or_else(|| invalid(1, "is missing"))?;
    let places = columns(&header, ["sync_index", "cam_id", "point_id", "img_loc_x", "img_loc_y"])?;
    let time_column = header.iter().position(|column| *column == "frame_time");
    let mut stamps = TimeStamps::default();
    let mut people: BTreeMap<(String, i64), Vec<Keypoint>> = BTreeMap::new();
    let mut n_points = 0;
    loop {
        let n_lines = lines.n_lines + 1;
        let Some(cells) = lines.next()? else { break };
        let cell = |i: usize| cells.get(places[i]).copied().ok_or_else(|| invalid(n_lines, "has too few columns"));
        let bad = |what: &str| invalid(n_lines, &format!("has no valid {what}"));
        let frame: i64 = cell(0)?.parse().map_err(|_| bad("sync_index"))?;
        let point: usize = cell(2)?.parse().ok().filter(|p| *p < MAX_POINTS).ok_or_else(|| bad("point_id"))?;
        let [x, y] =
            [number(cell(3)?).ok_or_else(|| bad("img_loc_x"))?, number(cell(4)?).ok_or_else(|| bad("img_loc_y"))?];
        if let Some(time) = time_column.and_then(|column| number(cells.get(column)?)) {
            stamps.add(cell(1)?, frame, time);
        }
        let keypoints = people.entry((cell(1)?.to_owned(), frame)).or_default();
        if keypoints.len() <= point {
            reading.spend(point + 1 - keypoints.len())?;
            keypoints.resize(point + 1, missing());
        }
        keypoints[point] = checked_point(x, y, 1.0).map_err(|why| Fault::KeypointInvalid.with(why))?;
        n_points = n_points.max(point + 1);
    }
    let mut found = FoundPoses { fps: stamps.fps(), time_offsets: stamps.offsets(), ..FoundPoses::default() };
    for ((camera, frame), mut keypoints) in people {
        keypoints.resize(n_points, missing());
        found.add(Some(&camera), frame, Detection { track_id: None, keypoints }, reading)?;
    }
    Ok(found)
}

/// Frame rate from Caliscope's `timestamps.csv`, frames per second: that of the camera with the most frames.
///
/// # Errors
/// A missing column.
pub(crate) fn read_timestamps(reader: impl Read) -> Result<Option<f64>, UploadError> {
    struct Span {
        n: usize,
        first: f64,
        last: f64,
    }
    let mut lines = Lines::new(reader);
    let header = lines.next()?.ok_or_else(|| invalid(1, "is missing"))?;
    let [camera, time] = columns(&header, ["cam_id", "frame_time"])?;
    let mut spans: BTreeMap<String, Span> = BTreeMap::new();
    while let Some(cells) = lines.next()? {
        let (Some(camera), Some(time)) = (cells.get(camera), cells.get(time).and_then(|cell| number(cell))) else {
            continue;
        };
        let span = spans.entry((*camera).to_owned()).or_insert(Span { n: 0, first: time, last: time });
        (span.n, span.last) = (span.n + 1, time);
    }
    let longest = spans.values().max_by_key(|span| span.n);
    let rate = longest.map(|span| (span.n.saturating_sub(1)) as f64 / (span.last - span.first));
    Ok(rate.filter(|rate| rate.is_finite() && *rate > 0.0))
}

/// Reads DeepLabCut's table of three header lines, or four with individuals.
///
/// # Errors
/// Inconsistent header lines or an invalid number.
pub(crate) fn read_deeplabcut(reader: impl Read, reading: &mut Reading<'_>) -> Result<FoundPoses, UploadError> {
    let mut lines = Lines::new(reader);
    let mut header: BTreeMap<String, Vec<String>> = BTreeMap::new();
    while !header.contains_key("coords") {
        let n_lines = lines.n_lines + 1;
        let Some(cells) = lines.next()? else { break };
        if header.len() == 4 {
            return Err(invalid(n_lines, "is preceded by no line `coords`"));
        }
        let key = cells.first().copied().unwrap_or_default().to_owned();
        header.insert(key, cells[1..].iter().map(|cell| (*cell).to_owned()).collect());
    }
    let layout = Layout::of_header(&header)?;
    let order = JointOrder::of_names("named", layout.joints.iter().map(String::as_str));
    let mut found = FoundPoses { order: Some(order), ..FoundPoses::default() };
    loop {
        let n_lines = lines.n_lines + 1;
        let Some(cells) = lines.next()? else { break };
        let name = cells.first().copied().unwrap_or_default();
        let frame = frame_name(name.rsplit('/').next().unwrap_or(name));
        let frame = frame.ok_or_else(|| invalid(n_lines, "does not begin with a frame number"))?.frame;
        let mut numbers = Vec::with_capacity(cells.len());
        for cell in &cells[1..] {
            numbers.push(number(cell).ok_or_else(|| invalid(n_lines, "contains an invalid number"))?);
        }
        found.frame(None, frame, reading)?;
        for person in layout.people(&numbers).map_err(|why| Fault::KeypointInvalid.with(why))? {
            found.add(None, frame, person, reading)?;
        }
    }
    Ok(found)
}

/// Columns of every person and joint.
struct Layout {
    individuals: Vec<String>,
    joints: Vec<String>,
    /// `[individual, joint, 0 to 2 for x, y, likelihood]` of every column.
    columns: Vec<[usize; 3]>,
}

impl Layout {
    fn of_header(header: &BTreeMap<String, Vec<String>>) -> Result<Self, UploadError> {
        let row =
            |key: &str| header.get(key).ok_or_else(|| invalid(1, &format!("and the following have no row `{key}`")));
        let (parts, coords) = (row("bodyparts")?, row("coords")?);
        let one = vec![String::new(); parts.len()];
        let owners = header.get("individuals").unwrap_or(&one);
        if parts.len() != coords.len() || parts.len() != owners.len() {
            return Err(invalid(1, "and the following have different numbers of columns"));
        }
        let (mut individuals, mut joints, mut columns) = (Vec::new(), Vec::new(), Vec::new());
        for ((owner, part), coord) in owners.iter().zip(parts).zip(coords) {
            let axis = ["x", "y", "likelihood"].iter().position(|name| name == coord);
            let axis = axis.ok_or_else(|| invalid(3, "contains a coordinate that is not x, y or likelihood"))?;
            columns.push([place_of(&mut individuals, owner), place_of(&mut joints, part), axis]);
        }
        if individuals.len().saturating_mul(joints.len()) > MAX_LINE_BYTES as usize / 8 {
            return Err(invalid(1, "and the following name too many joints"));
        }
        Ok(Self { individuals, joints, columns })
    }

    /// The people with at least one joint; the index of an individual is its identity where there are several.
    fn people(&self, numbers: &[f64]) -> Result<Vec<Detection>, String> {
        let mut triples = vec![[f64::NAN, f64::NAN, 1.0]; self.individuals.len() * self.joints.len()];
        for ([individual, joint, axis], number) in self.columns.iter().zip(numbers) {
            triples[individual * self.joints.len() + joint][*axis] = *number;
        }
        let mut people = Vec::new();
        for (i, triples) in triples.chunks(self.joints.len().max(1)).enumerate() {
            let keypoints: Vec<Keypoint> = triples
                .iter()
                .map(|[x, y, confidence]| checked_point(*x, *y, *confidence))
                .collect::<Result<_, _>>()?;
            // "single" contains points that are not assigned to an individual.
            if keypoints.iter().any(Keypoint::is_present) && self.individuals[i] != "single" {
                let track_id = (self.individuals.len() > 1).then_some(i as i64);
                people.push(Detection { track_id, keypoints });
            }
        }
        Ok(people)
    }
}

fn place_of(names: &mut Vec<String>, name: &str) -> usize {
    names.iter().position(|own| own == name).unwrap_or_else(|| {
        names.push(name.to_owned());
        names.len() - 1
    })
}
