//! The table of formats: the writer of each, and its description for asset systems.

use super::files::ResultFiles;
use super::take::Take;
use super::{
    blender, bvh, c3d, calibration_toml, chan, colmap, easymocap, fbx, glb, joint_angles, losses, opencv_yaml,
    smpl_npz, trc, usd,
};
use crate::session::reconstruction::ExportFormat as F;
use crate::session::recording::UpAxis;
use serde::Serialize;
use std::io;

/// A format of a published take, as AYON describes representations.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Representation {
    /// The format's name in `options.exports`.
    pub name: String,
    /// The files' extension.
    pub ext: &'static str,
    /// The files, as paths below the result folder.
    pub files: Vec<String>,
    /// First frame number.
    #[serde(rename = "frameStart")]
    pub frame_start: i64,
    /// Last frame number.
    #[serde(rename = "frameEnd")]
    pub frame_end: i64,
    /// Frames per second.
    pub fps: f64,
    /// World and losses.
    pub data: RepresentationData,
}

/// The world of a format's files, and its losses.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RepresentationData {
    /// Which axis points up.
    pub up_axis: UpAxis,
    /// Always `right`.
    pub handedness: &'static str,
    /// Length of a unit, m.
    pub metres_per_unit: f64,
    /// Order of Euler angles, first rotation first, where the files do not state it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotation_order: Option<&'static str>,
    /// What the format cannot represent, one sentence each.
    pub lost: Vec<String>,
}

/// The format's name in options and messages.
pub fn name(format: F) -> String {
    match serde_json::to_value(format) {
        Ok(serde_json::Value::String(name)) => name,
        _ => format!("{format:?}"),
    }
}

/// Writes the files of a format and describes them; `files` lists no others.
pub(super) fn write(format: F, files: &mut ResultFiles, take: &Take) -> io::Result<Representation> {
    match format {
        F::SmplNpz => smpl_npz::write(files, take),
        F::Easymocap => easymocap::write(files, take),
        F::Glb => glb::write(files, take),
        F::Bvh => bvh::write(files, take),
        F::Fbx => fbx::write(files, take),
        F::Usd => usd::write(files, take),
        F::Trc => trc::write(files, take),
        F::C3d => c3d::write(files, take),
        F::JointAngles => joint_angles::write(files, take),
        F::OpencvYaml => opencv_yaml::write(files, take, ""),
        F::CalibToml => calibration_toml::write_pose2sim(files, take),
        F::AniposeToml => calibration_toml::write_anipose(files, take),
        F::Colmap => colmap::write(files, take),
        F::Chan => chan::write(files, take),
        F::Blender => blender::write(files, take),
    }?;
    let [frame_start, frame_end] = take.frame_range();
    let (ext, up_axis, metres_per_unit) = layout(format);
    Ok(Representation {
        name: name(format),
        ext,
        files: files.names(),
        frame_start,
        frame_end,
        fps: take.fps,
        data: RepresentationData {
            up_axis: up_axis.unwrap_or(take.up_axis),
            handedness: "right",
            metres_per_unit,
            rotation_order: (format == F::Chan).then_some("ZXY"),
            lost: losses::losses(format, take),
        },
    })
}

/// Extension of the files, the up axis that their readers expect (`None`: that of the result), and metres per unit.
fn layout(format: F) -> (&'static str, Option<UpAxis>, f64) {
    match format {
        F::SmplNpz => ("npz", None, 1.0),
        F::Easymocap => ("json", None, 1.0),
        F::Glb => ("glb", Some(UpAxis::Y), 1.0),
        F::Bvh => ("bvh", Some(UpAxis::Y), 0.01),
        F::Fbx => ("fbx", Some(UpAxis::Y), 0.01),
        F::Usd => ("usda", Some(UpAxis::Y), 1.0),
        F::Trc => ("trc", Some(UpAxis::Y), 1.0),
        F::JointAngles => ("csv", Some(UpAxis::Y), 1.0),
        F::C3d => ("c3d", Some(UpAxis::Z), 0.001),
        F::OpencvYaml => ("yml", None, 1.0),
        F::CalibToml | F::AniposeToml => ("toml", None, 1.0),
        F::Colmap => ("txt", None, 1.0),
        F::Chan => ("chan", Some(UpAxis::Y), 1.0),
        F::Blender => ("py", Some(UpAxis::Z), 1.0),
    }
}
