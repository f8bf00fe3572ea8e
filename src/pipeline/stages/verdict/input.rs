//! Input of the verdict.

use crate::pipeline::up_direction::UpRival;
use crate::session::Suspicion;
use crate::session::reconstruction::{CameraReport, GeometryReport, PenetrationReport, PersonReport, ScaleReport};

/// Everything that the verdict depends on.
#[derive(Debug, Clone, Copy)]
pub struct VerdictInput<'a> {
    /// Frames per second.
    pub fps: f64,
    /// In the session's order.
    pub cameras: &'a [CameraReport],
    /// All persons of the result.
    pub people: &'a [PersonReport],
    /// People that were followed and have no body.
    pub without_body: &'a [FollowedPerson],
    /// Coverage of the persons by the views.
    pub geometry: &'a GeometryReport,
    /// The metric scale; `None` where nothing determines it.
    pub scale: Option<&'a ScaleReport>,
    /// Overlaps between bodies.
    pub penetration: &'a PenetrationReport,
    /// Whether collisions were resolved (`options.collision`).
    pub resolves_collisions: bool,
    /// Share of confident keypoints explained.
    pub explained: f64,
    /// Largest standard deviation of a camera's orientation, degrees, where it is known.
    pub sigma_angle_deg: Option<f64>,
    /// Share of keypoints that the best clearly different arrangement of the cameras explained; 0 without one.
    pub rival_explained: f64,
    /// Probable mistakes in the files of the recording.
    pub suspicions: &'a [Suspicion],
    /// Where focal lengths were refined and stay as given: logarithm of the recording's likelihood under others over that under these.
    pub lens_evidence: Option<f64>,
    /// Whether the cameras were estimated without a start.
    pub estimated: bool,
    /// How far the cameras are from their given poses, where these were refined; else empty.
    pub changes: &'a [PoseChange],
    /// Another way up of the world, where that was estimated.
    pub up_rival: Option<UpRival>,
}

/// A refined camera against its given pose.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseChange {
    /// The camera's name.
    pub camera: String,
    /// Between the orientations, degrees.
    pub angle_deg: f64,
    /// Between the centres, mm.
    pub distance_mm: f64,
}

/// A person that was followed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FollowedPerson {
    /// The person's number.
    pub id: usize,
    /// Number of the first frame.
    pub first_frame: i64,
    /// Number of the last frame.
    pub last_frame: i64,
}

impl VerdictInput<'_> {
    pub(super) fn n_placed(&self) -> usize {
        self.cameras.iter().filter(|camera| camera.solved).count()
    }
}
