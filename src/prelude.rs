//! The names that most programs need: `use wandless::prelude::*;`.

pub use crate::body::skeleton::{JOINT_NAMES, KeypointConvention};
pub use crate::export::{ResultContext, write_result};
pub use crate::geometry::{Distortion, Intrinsics, Rigid};
pub use crate::pipeline::{Options, PipelineError, as_solved, reconstruct};
pub use crate::progress::{Canceled, Progress, ProgressEvent};
pub use crate::session::people::BodyPose;
pub use crate::session::reconstruction::{ExportFormat, SolvedCamera, Verdict};
pub use crate::session::upload::{LoadedSession, UploadError, UploadLimits, read_path};
pub use crate::session::{
    BodyMotion, Detection, JointTrajectory, Keypoint, Reconstruction, Session, SessionBuilder, View,
};
