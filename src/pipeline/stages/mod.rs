//! The stages of the pipeline, one folder each; no stage imports another.

pub mod association;
pub mod body_fit;
pub mod bundle_adjustment;
pub mod camera_init;
pub mod camera_registration;
pub mod denoising;
pub mod detector_noise;
pub mod fit_statistics;
pub mod hand_association;
pub mod hand_fit;
pub mod joint_trajectories;
pub mod keyframe_selection;
pub mod metric_scale;
pub mod recording_check;
pub mod time_offsets;
pub mod verdict;
pub mod world_frame;
