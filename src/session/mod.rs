//! Every noun that travels; no algorithm.

pub mod people;
pub mod reconstruction;
pub mod recording;
pub mod upload;

pub use people::{BodyMotion, JointTrajectory, PersonTrack};
pub use reconstruction::Reconstruction;
pub use recording::{Detection, FrameIndex, Keypoint, PersonId, Session, View, ViewId};
