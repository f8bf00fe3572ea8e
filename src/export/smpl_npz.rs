//! `smpl/<person>.npz`, `smplh/<person>.npz` and, of people whose hands were fitted, `smplx/<person>.npz`: AMASS's layout in the
//! result's world.
//!
//! `poses` (T, 72, 156 or 165) axis-angle, rad; `trans` (T, 3) SMPL's `transl`, m; `betas` (10); `gender`; the frame rate under
//! both of AMASS's spellings; `surface_model_type`. In addition: `up_axis`, `frames` (T) frame numbers, `valid` (T),
//! `body_model` and `body_model_sha256`: the model that the betas belong to (of another model they give another body). AMASS
//! itself has z up: `up_axis` states the axis of this file.
//!
//! SMPL-H has 30 finger joints in place of SMPL's two hands; where hands were not fitted they are written in the rest pose. SMPL-X has
//! jaw and eyes before the fingers: they rest in the head, which the corners of eyes and mouth turn, and `expression` (T, 10) is zero.
//! Betas of SMPL-X's own model are others than those of `body_model`.

use super::files::ResultFiles;
use super::people::{axis_angles, finger_axis_angles};
use super::take::Take;
use crate::formats::npz::{CompressionMethod, NpzWriter};
use crate::session::BodyMotion;
use std::io::{self, Cursor};

/// Numbers of a frame that SMPL and SMPL-H share: the root and 21 body joints.
const SHARED_WIDTH: usize = 66;
/// Numbers of an SMPL-H frame: the shared ones and 30 finger joints.
const SMPLH_WIDTH: usize = 156;
/// Numbers of SMPL-X's jaw and eyes.
const FACE_WIDTH: usize = 9;
/// Numbers of an expression of SMPL-X.
const EXPRESSION_WIDTH: usize = 10;

/// Writes the files of every person.
pub(super) fn write(files: &mut ResultFiles, take: &Take) -> io::Result<()> {
    for motion in &take.motions {
        // [frames, 72]
        let smpl: Vec<Vec<f64>> = motion.frames.iter().map(axis_angles).collect();
        let smplh: Vec<Vec<f64>> = smpl.iter().enumerate().map(|(t, pose)| with_fingers(pose, motion, t)).collect();
        let smplx = motion.hands.is_some().then(|| smplh.iter().map(|pose| with_resting_face(pose)).collect());
        let layouts = [("smpl", smpl), ("smplh", smplh)].into_iter().chain(smplx.map(|poses| ("smplx", poses)));
        for (model, poses) in layouts {
            let bytes = motion_npz(take, motion, model, &poses)?;
            files.bytes(&format!("{model}/{}.npz", motion.person.0), "application/octet-stream", &bytes)?;
        }
    }
    Ok(())
}

fn with_fingers(pose: &[f64], motion: &BodyMotion, t: usize) -> Vec<f64> {
    let mut wide = pose[..SHARED_WIDTH].to_vec();
    let hands = motion.hands.iter().flatten();
    hands.for_each(|hand| wide.extend(finger_axis_angles(&hand.frames[t])));
    wide.resize(SMPLH_WIDTH, 0.0);
    wide
}

/// SMPL-X's frame of an SMPL-H frame.
fn with_resting_face(smplh: &[f64]) -> Vec<f64> {
    let (body, fingers) = smplh.split_at(SHARED_WIDTH);
    [body, &[0.0; FACE_WIDTH], fingers].concat()
}

fn motion_npz(take: &Take, motion: &BodyMotion, model: &str, poses: &[Vec<f64>]) -> io::Result<Vec<u8>> {
    let n_frames = poses.len();
    let width = poses.first().map_or(0, Vec::len);
    let frames = (0..motion.frames.len()).map(|i| take.frame_number(motion.first.0 + i));
    let mut npz = NpzWriter::new(Cursor::new(Vec::new()), CompressionMethod::Stored);
    npz.array("poses", &[n_frames, width], poses.iter().flatten().copied())?;
    npz.array("trans", &[n_frames, 3], motion.frames.iter().flat_map(|pose| <[f64; 3]>::from(pose.translation)))?;
    npz.array("betas", &[10], motion.betas)?;
    npz.text("gender", "neutral")?;
    npz.array("mocap_framerate", &[], [take.fps])?;
    npz.array("mocap_frame_rate", &[], [take.fps])?;
    npz.text("surface_model_type", model)?;
    npz.text("body_model", &take.body_model.name)?;
    npz.text("body_model_sha256", &take.body_model.sha256)?;
    npz.text("up_axis", &format!("{:?}", take.up_axis).to_lowercase())?;
    npz.array("frames", &[n_frames], frames)?;
    if model == "smplx" {
        npz.array("expression", &[n_frames, EXPRESSION_WIDTH], vec![0.0; n_frames * EXPRESSION_WIDTH])?;
    }
    npz.array("valid", &[n_frames], motion.frames.iter().map(|pose| pose.valid))?;
    Ok(npz.finish()?.into_inner())
}
