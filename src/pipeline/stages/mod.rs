//! The stages of the pipeline, one folder each; no stage imports another.

pub mod association;
pub mod body_fit;
pub mod bundle_adjustment;
pub mod camera_init;
pub mod denoising;
pub mod fit_figures;
pub mod joint_trajectories;
pub mod metric_scale;
pub mod verdict;
pub mod world_frame;
