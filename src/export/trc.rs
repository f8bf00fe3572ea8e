//! `<person>.trc`: OpenSim's marker file, the 24 joints and the detector's own keypoints as markers; `<person>.ik.xml`: [`super::inverse_kinematics`].
//!
//! Metres, y up. `Frame#` is the session's frame number, `Time` starts at the session's first frame. Keypoints have the prefix
//! `detected_` and empty cells where they are unknown. Joints are never missing: where no camera detected the person, the poses
//! are carried over, and `people.json` lists these frames.

use super::files::{ResultFiles, micro};
use super::inverse_kinematics;
use super::markers::markers;
use super::take::Take;
use crate::session::BodyMotion;
use crate::session::recording::UpAxis;
use std::io;

/// Writes both files of every person.
pub(super) fn write(files: &mut ResultFiles, take: &Take) -> io::Result<()> {
    let take = take.with_up_axis(UpAxis::Y);
    for motion in &take.motions {
        let name = format!("{}.trc", motion.person.0);
        files.bytes(&name, "text/plain", text(&take, motion, &name).as_bytes())?;
        let set_up = inverse_kinematics::set_up(&take, motion);
        files.bytes(&format!("{}.ik.xml", motion.person.0), "application/xml", set_up.as_bytes())?;
    }
    Ok(())
}

fn text(take: &Take, motion: &BodyMotion, file_name: &str) -> String {
    let (fps, n_frames, first) = (take.fps, motion.frames.len(), take.presence(motion)[0]);
    let markers = markers(take, motion);
    let n_markers = markers.names.len();
    let names: String = markers.names.iter().map(|name| format!("\t{name}\t\t")).collect();
    let axes: String = (1..=n_markers).map(|i| format!("\tX{i}\tY{i}\tZ{i}")).collect();
    let mut text = format!(
        "PathFileType\t4\t(X/Y/Z)\t{file_name}\n\
         DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n\
         {fps:?}\t{fps:?}\t{n_frames}\t{n_markers}\tm\t{fps:?}\t{first}\t{n_frames}\n\
         Frame#\tTime{names}\n\t{axes}\n\n"
    );
    for (i, points) in markers.frames.iter().enumerate() {
        let index = motion.first.0 + i;
        text += &format!("{}\t{:.6}", take.frame_number(index), index as f64 / fps);
        for point in points {
            match point.map(|point| point.map(micro)) {
                Some(point) => text += &format!("\t{:.6}\t{:.6}\t{:.6}", point.x, point.y, point.z),
                None => text += "\t\t\t",
            }
        }
        text.push('\n');
    }
    text
}
