//! `<person>.trc`: OpenSim's marker file, the 24 joints as markers.
//!
//! Metres, y up. `Frame#` is the session's frame number, `Time` starts at the session's first frame. The format has no
//! missing markers that OpenSim's inverse kinematics accepts: where no camera detected the person, the poses are carried
//! over, and `people.json` lists these frames.

use super::files::{ResultFiles, micro};
use super::take::Take;
use crate::body::skeleton::{JOINT_NAMES, N_JOINTS};
use crate::session::BodyMotion;
use crate::session::recording::UpAxis;
use std::io;

/// Writes a file per person.
pub(super) fn write(files: &mut ResultFiles, take: &Take) -> io::Result<()> {
    let take = take.with_up_axis(UpAxis::Y);
    for motion in &take.motions {
        let name = format!("{}.trc", motion.person.0);
        files.bytes(&name, "text/plain", markers(&take, motion, &name).as_bytes())?;
    }
    Ok(())
}

fn markers(take: &Take, motion: &BodyMotion, file_name: &str) -> String {
    let (fps, n_frames, first) = (take.fps, motion.frames.len(), take.presence(motion)[0]);
    let names: String = JOINT_NAMES.iter().map(|name| format!("\t{name}\t\t")).collect();
    let axes: String = (1..=N_JOINTS).map(|i| format!("\tX{i}\tY{i}\tZ{i}")).collect();
    let mut text = format!(
        "PathFileType\t4\t(X/Y/Z)\t{file_name}\n\
         DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n\
         {fps:?}\t{fps:?}\t{n_frames}\t{N_JOINTS}\tm\t{fps:?}\t{first}\t{n_frames}\n\
         Frame#\tTime{names}\n\t{axes}\n\n"
    );
    for (i, pose) in motion.frames.iter().enumerate() {
        let index = motion.first.0 + i;
        text += &format!("{}\t{:.6}", take.frame_number(index), index as f64 / fps);
        for joint in &pose.joints {
            text += &format!("\t{:.6}\t{:.6}\t{:.6}", micro(joint.x), micro(joint.y), micro(joint.z));
        }
        text.push('\n');
    }
    text
}
