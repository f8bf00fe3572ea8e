//! The data of a session and its result: recording, tracks, motions, reconstruction; how sessions are read, built and
//! written.

mod border_keypoints;
mod builder;
pub mod digest;
pub mod formats;
pub mod json_file;
pub(crate) mod parser_errors;
pub mod people;
pub mod reconstruction;
pub mod recording;
pub mod recording_tests;
pub mod suspicion;
pub mod upload;

pub use border_keypoints::without_border_keypoints;
pub use builder::SessionBuilder;
pub use people::{BodyMotion, JointTrajectory, PersonTrack};
pub use reconstruction::Reconstruction;
pub use recording::{Detection, FrameIndex, Keypoint, PersonId, Session, View};
pub use suspicion::{Suspicion, SuspicionCode};
