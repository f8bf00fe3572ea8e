//! `<person>.c3d`: the 24 joints and the detector's own keypoints as points, in the layout of the C3D user's guide (c3d.org).
//!
//! Little-endian, 32-bit floats; millimetres, z up (`POINT:X_SCREEN` +X, `Y_SCREEN` +Z). Keypoints have the
//! prefix `detected_`. A point's residual is -1 where no camera detected the person or the keypoint is unknown: its coordinates
//! are then zero. Frames have the session's frame numbers where the 16 bits of the header can represent those of the whole
//! take (1 to 65535), else they count from 1 at its first frame: the files of all people have one clock.
//! `TRIAL:ACTUAL_START_FIELD` contains the same in 32 bits.
//!
//! Known limit: the header counts at most 65535 frames; `POINT:LONG_FRAMES` contains the number of a longer motion.

use super::files::ResultFiles;
use super::markers::markers;
use super::take::Take;
use crate::session::BodyMotion;
use crate::session::recording::UpAxis;
use nalgebra::Vector3;
use std::io;

const BLOCK_BYTES: usize = 512;
/// Blocks are numbered from 1; the header is the first.
const FIRST_PARAMETER_BLOCK: u8 = 2;
/// Marks header and parameters as C3D.
const KEY: u8 = 0x50;
/// Code for numbers in the byte order of Intel processors.
const LITTLE_ENDIAN: u8 = 84;
const MM: f64 = 1000.0;

/// First and last frame number in the file.
struct FrameRange {
    first: u32,
    last: u32,
}

/// Writes a file per person.
pub(super) fn write(files: &mut ResultFiles, take: &Take) -> io::Result<()> {
    let take = take.with_up_axis(UpAxis::Z);
    for motion in &take.motions {
        files.bytes(&format!("{}.c3d", motion.person.0), "application/octet-stream", &points(&take, motion))?;
    }
    Ok(())
}

fn points(take: &Take, motion: &BodyMotion) -> Vec<u8> {
    let (range, markers) = (frame_range(take.frame_range(), motion), markers(take, motion));
    // The parameters contain the number of the data block behind them, which does not change their length.
    let n_parameter_blocks = parameters(take, motion, &markers.names, &range, 0).len() / BLOCK_BYTES;
    let data_block = u16::from(FIRST_PARAMETER_BLOCK) + n_parameter_blocks as u16;
    let mut bytes = header(take, markers.names.len(), &range, data_block);
    bytes.extend(parameters(take, motion, &markers.names, &range, data_block));
    for (pose, points) in motion.frames.iter().zip(&markers.frames) {
        for point in points {
            let known = point.filter(|_| pose.valid);
            let (point, residual) = known.map_or((Vector3::zeros(), -1.0), |point| (point * MM, 0.0));
            for value in [point.x, point.y, point.z, residual] {
                bytes.extend((value as f32 + 0.0).to_le_bytes()); // never a negative zero
            }
        }
    }
    fill_block(&mut bytes);
    bytes
}

/// `start`, `end`: first and last frame number of the take.
fn frame_range([start, end]: [i64; 2], motion: &BodyMotion) -> FrameRange {
    let first_number = match (u16::try_from(start), u16::try_from(end)) {
        (Ok(start @ 1..), Ok(_)) => u32::from(start),
        _ => 1,
    };
    let first = first_number + motion.first.0 as u32;
    FrameRange { first, last: first + motion.frames.len().saturating_sub(1) as u32 }
}

fn header(take: &Take, n_points: usize, range: &FrameRange, data_block: u16) -> Vec<u8> {
    let mut bytes = vec![FIRST_PARAMETER_BLOCK, KEY];
    let word = |value: u32| u16::try_from(value).unwrap_or(u16::MAX).to_le_bytes();
    bytes.extend((n_points as u16).to_le_bytes());
    bytes.extend(0u16.to_le_bytes()); // analog values a frame
    bytes.extend(word(range.first));
    bytes.extend(word(range.last));
    bytes.extend(0u16.to_le_bytes()); // longest gap that was filled by interpolation
    bytes.extend((-1.0f32).to_le_bytes()); // negative: points are floats
    bytes.extend(data_block.to_le_bytes());
    bytes.extend(0u16.to_le_bytes()); // analog samples a frame
    bytes.extend((take.fps as f32).to_le_bytes());
    fill_block(&mut bytes);
    bytes
}

/// A value of a parameter.
enum Value<'a> {
    Integers(&'a [u16]),
    Floats(&'a [f32]),
    Text(&'a str),
    Texts(&'a [&'a str]),
}

fn parameters(take: &Take, motion: &BodyMotion, names: &[String], range: &FrameRange, data_block: u16) -> Vec<u8> {
    let n_frames = u16::try_from(motion.frames.len()).unwrap_or(u16::MAX);
    let halves = |value: u32| [value as u16, (value >> 16) as u16]; // the low 16 bits come first
    let rate = take.fps as f32;
    let labels: Vec<&str> = names.iter().map(String::as_str).collect();
    let descriptions = vec![""; names.len()];
    let groups: [(&str, &[(&str, Value)]); 3] = [
        (
            "POINT",
            &[
                ("USED", Value::Integers(&[names.len() as u16])),
                ("FRAMES", Value::Integers(&[n_frames])),
                ("LONG_FRAMES", Value::Floats(&[motion.frames.len() as f32])),
                ("SCALE", Value::Floats(&[-1.0])),
                ("RATE", Value::Floats(&[rate])),
                ("DATA_START", Value::Integers(&[data_block])),
                ("LABELS", Value::Texts(&labels)),
                ("DESCRIPTIONS", Value::Texts(&descriptions)),
                ("UNITS", Value::Text("mm")),
                ("X_SCREEN", Value::Text("+X")),
                ("Y_SCREEN", Value::Text("+Z")),
            ],
        ),
        ("ANALOG", &[("USED", Value::Integers(&[0])), ("RATE", Value::Floats(&[rate]))]),
        (
            "TRIAL",
            &[
                ("ACTUAL_START_FIELD", Value::Integers(&halves(range.first))),
                ("ACTUAL_END_FIELD", Value::Integers(&halves(range.last))),
                ("CAMERA_RATE", Value::Floats(&[rate])),
            ],
        ),
    ];
    let mut records = Vec::new();
    for (i, (name, group)) in groups.iter().enumerate() {
        let id = i as i8 + 1;
        add_record(&mut records, name, -id, &[]);
        for (name, value) in *group {
            add_record(&mut records, name, id, &encoded(value));
        }
    }
    // The end of the records is marked by a name of length zero.
    let n_blocks = (4 + records.len() + 1).div_ceil(BLOCK_BYTES);
    let mut bytes = vec![1, KEY, n_blocks as u8, LITTLE_ENDIAN];
    bytes.extend(records);
    bytes.push(0);
    fill_block(&mut bytes);
    bytes
}

/// Name, group, distance to the next record, value, and an empty description.
fn add_record(records: &mut Vec<u8>, name: &str, group: i8, value: &[u8]) {
    records.push(name.len() as u8);
    records.push(group.to_le_bytes()[0]);
    records.extend(name.as_bytes());
    records.extend((value.len() as u16 + 3).to_le_bytes());
    records.extend(value);
    records.push(0);
}

/// Type (-1 text, 2 integers, 4 floats), number of dimensions, dimensions, values.
fn encoded(value: &Value) -> Vec<u8> {
    const TEXT: u8 = 0xff;
    match value {
        Value::Integers(values) => {
            let data = values.iter().flat_map(|v| v.to_le_bytes());
            [2, 1, values.len() as u8].into_iter().chain(data).collect()
        }
        Value::Floats(values) => {
            let data = values.iter().flat_map(|v| v.to_le_bytes());
            [4, 1, values.len() as u8].into_iter().chain(data).collect()
        }
        Value::Text(text) => [TEXT, 1, text.len() as u8].into_iter().chain(text.bytes()).collect(),
        Value::Texts(texts) => {
            let width = texts.iter().map(|text| text.len()).max().unwrap_or(0).max(1);
            let data = texts.iter().flat_map(|text| format!("{text:width$}").into_bytes());
            [TEXT, 2, width as u8, texts.len() as u8].into_iter().chain(data).collect()
        }
    }
}

fn fill_block(bytes: &mut Vec<u8>) {
    bytes.resize(bytes.len().next_multiple_of(BLOCK_BYTES), 0);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::sample_motion::motion;
    use crate::session::FrameIndex;

    #[test]
    fn a_person_that_came_later_had_another_clock() {
        let later = BodyMotion { first: FrameIndex(5), ..motion() };
        let firsts = |start: i64| [&motion(), &later].map(|motion| frame_range([start, start + 7], motion).first);
        // Takes that begin at frame 0 or before, and one that ends beyond 16 bits.
        assert_eq!([0, -3, 65_530].map(firsts), [[1, 6]; 3]);
        assert_eq!(firsts(300), [300, 305]);
    }
}
