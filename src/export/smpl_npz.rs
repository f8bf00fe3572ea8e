//! `smpl/<person>.npz` and `smplh/<person>.npz`: AMASS's layout in the result's own world.
//!
//! `poses` (T, 72 or 156) axis-angle, rad; `trans` (T, 3) SMPL's `transl`, m; `betas` (10); `gender`; the frame rate
//! under both of AMASS's spellings; `surface_model_type`. Ours: `up_axis`, `frames` (T) the session's numbers, `valid`
//! (T). AMASS itself has z up: `up_axis` says which world this is.
//!
//! Known limit: SMPL-H has 30 finger joints where SMPL has two hands; they are written as the rest pose.

use super::files::ResultFiles;
use super::people::axis_angles;
use super::take::{Take, letter};
use crate::session::BodyMotion;
use npyz::{AutoSerialize, DType, Serialize as NpySerialize, WriterBuilder};
use std::io::{self, Cursor, Write};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, System, ZipWriter};

/// Numbers of a frame that SMPL and SMPL-H share: the root and 21 body joints.
const SHARED_WIDTH: usize = 66;
/// Numbers of an SMPL-H frame: the shared ones and 30 finger joints.
const SMPLH_WIDTH: usize = 156;

/// Writes both files of every person.
pub(super) fn write(files: &mut ResultFiles, take: &Take) -> io::Result<()> {
    for motion in &take.motions {
        // [frames, 72]
        let smpl: Vec<Vec<f64>> = motion.frames.iter().map(axis_angles).collect();
        let smplh: Vec<Vec<f64>> = smpl.iter().map(|pose| with_fingers_at_rest(pose)).collect();
        for (model, poses) in [("smpl", smpl), ("smplh", smplh)] {
            let bytes = motion_npz(take, motion, model, &poses)?;
            files.bytes(&format!("{model}/{}.npz", motion.person.0), "application/octet-stream", &bytes)?;
        }
    }
    Ok(())
}

fn with_fingers_at_rest(pose: &[f64]) -> Vec<f64> {
    let mut wide = vec![0.0; SMPLH_WIDTH];
    wide[..SHARED_WIDTH].copy_from_slice(&pose[..SHARED_WIDTH]);
    wide
}

fn motion_npz(take: &Take, motion: &BodyMotion, model: &str, poses: &[Vec<f64>]) -> io::Result<Vec<u8>> {
    let n_frames = poses.len() as u64;
    let width = poses.first().map_or(0, Vec::len) as u64;
    let frames = (0..motion.frames.len()).map(|i| take.frame_number(motion.first.0 + i));
    let mut npz = NpzFile::new();
    npz.array("poses", &[n_frames, width], poses.iter().flatten().copied())?;
    npz.array("trans", &[n_frames, 3], motion.frames.iter().flat_map(|pose| <[f64; 3]>::from(pose.translation)))?;
    npz.array("betas", &[10], motion.betas)?;
    npz.text("gender", "neutral")?;
    npz.array("mocap_framerate", &[], [take.fps])?;
    npz.array("mocap_frame_rate", &[], [take.fps])?;
    npz.text("surface_model_type", model)?;
    npz.text("up_axis", letter(take.up_axis))?;
    npz.array("frames", &[n_frames], frames)?;
    npz.array("valid", &[n_frames], motion.frames.iter().map(|pose| pose.valid))?;
    npz.finish()
}

/// An npz in memory: stored members without a clock, so that the same motion gives the same bytes.
struct NpzFile(ZipWriter<Cursor<Vec<u8>>>);

impl NpzFile {
    fn new() -> Self {
        Self(ZipWriter::new(Cursor::new(Vec::new())))
    }

    /// Adds an array in C order.
    fn array<T: AutoSerialize>(
        &mut self,
        name: &str,
        shape: &[u64],
        values: impl IntoIterator<Item = T>,
    ) -> io::Result<()> {
        self.typed(name, shape, T::default_dtype(), values)
    }

    /// Adds a string as a scalar array of numpy's unicode type.
    fn text(&mut self, name: &str, text: &str) -> io::Result<()> {
        let type_text = format!("<U{}", text.chars().count());
        let dtype = type_text.parse().map(DType::Plain);
        let dtype = dtype.map_err(|_| io::Error::other(format!("{type_text} is no numpy type")))?;
        self.typed(name, &[], dtype, [text.to_owned()])
    }

    fn typed<T: NpySerialize>(
        &mut self,
        name: &str,
        shape: &[u64],
        dtype: DType,
        values: impl IntoIterator<Item = T>,
    ) -> io::Result<()> {
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Stored)
            .last_modified_time(DateTime::default())
            .system(System::Unix)
            .unix_permissions(0o644);
        let mut bytes = Vec::new();
        let mut writer = npyz::WriteOptions::new().dtype(dtype).shape(shape).writer(&mut bytes).begin_nd()?;
        writer.extend(values)?;
        writer.finish()?;
        self.0.start_file(npyz::npz::file_name_from_array_name(name), options)?;
        self.0.write_all(&bytes)
    }

    fn finish(self) -> io::Result<Vec<u8>> {
        Ok(self.0.finish()?.into_inner())
    }
}
