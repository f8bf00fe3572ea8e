//! Readers of 2D poses by dialect, recognised by content. Some dialects have one file per frame, others one per camera or
//! recording.

mod arrays;
mod found;
mod frame_files;
mod frame_name;
mod hands;
mod lists;
mod points;
mod sniff;
mod tables;
mod time_stamps;
mod tool_json;

pub(crate) use arrays::{is_array, read_array};
pub(crate) use found::FoundPoses;
pub(crate) use frame_files::{FrameContent, read_frame};
pub(crate) use frame_name::frame_name;
pub(crate) use hands::level_hands;
pub(crate) use lists::{ImageTable, read_list, read_mmpose};
pub(crate) use sniff::{PoseDialect, recognise};
pub(crate) use tables::{read_caliscope, read_deeplabcut, read_timestamps};
pub(crate) use tool_json::without_mark;
