//! What a user may ask for. Stored with the job, so that a run can be repeated.

use super::error::PipelineError;
use crate::session::reconstruction::ExportFormat;
use crate::session::recording::UpAxis;
use crate::session::{Session, View};
use serde::{Deserialize, Serialize};

/// Options of one job; names and defaults are the HTTP contract's.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// How many people there are, where it is known.
    pub people: Option<usize>,
    /// What to do with the cameras' poses.
    pub extrinsics: Extrinsics,
    /// What to do with the cameras' intrinsics.
    pub intrinsics: IntrinsicsMode,
    /// Where the metric scale comes from.
    pub scale: ScaleSource,
    /// Up axis of the result's world.
    pub up_axis: UpAxis,
    /// Physics-geometry consistency stage.
    pub denoise: bool,
    /// What is known of human motion: poses that people take, feet that stand still.
    pub motion_prior: bool,
    /// Bodies do not pass through each other.
    pub collision: bool,
    /// Name of a registered body model.
    pub body: String,
    /// Time offsets between cameras.
    pub sync: Sync,
    /// Seed of every random choice.
    pub seed: u64,
    /// Formats to write beside the JSON files.
    pub exports: Vec<ExportFormat>,
}

/// `options.body` for the embedded body.
pub const DEFAULT_BODY: &str = "default";

impl Default for Options {
    fn default() -> Self {
        Self {
            people: None,
            extrinsics: Extrinsics::Estimate,
            intrinsics: IntrinsicsMode::Fixed,
            scale: ScaleSource::Body,
            up_axis: UpAxis::Y,
            denoise: true,
            motion_prior: true,
            collision: true,
            body: DEFAULT_BODY.to_owned(),
            sync: Sync::Given,
            seed: 0,
            exports: vec![ExportFormat::SmplNpz],
        }
    }
}

/// What must be known of a camera to judge the options; a service keeps it beside a session that it does not hold.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CameraFacts {
    /// The camera's name.
    pub id: String,
    /// Whether the session gives its `R` and `t`.
    pub has_extrinsics: bool,
}

impl CameraFacts {
    /// Of every camera, in the session's order.
    pub fn of(session: &Session) -> Vec<Self> {
        let facts = |view: &View| Self { id: view.id.clone(), has_extrinsics: view.camera_from_world.is_some() };
        session.views.iter().map(facts).collect()
    }
}

impl Options {
    /// Checks what can be checked against the session before any work is spent; `bodies`: the names of the registered
    /// body models, beside that of the embedded one.
    ///
    /// # Errors
    /// [`PipelineError::Option`] naming the option and the remedy.
    pub fn check(&self, cameras: &[CameraFacts], bodies: &[String]) -> Result<(), PipelineError> {
        let refuse = |option, reason: String| Err(PipelineError::Option { option, reason });
        let unposed = cameras.iter().find(|camera| !camera.has_extrinsics);
        if let Some(camera) = unposed.filter(|_| self.extrinsics != Extrinsics::Estimate) {
            let reason = format!(
                "camera {}: fixed and refined extrinsics need R and t of every camera; give them, or use \"estimate\"",
                camera.id
            );
            return refuse("/extrinsics", reason);
        }
        if self.intrinsics == IntrinsicsMode::RefineFocal && self.extrinsics == Extrinsics::Fixed {
            let reason = "refine_focal moves cameras, too; use extrinsics \"refine\" or \"estimate\"".to_owned();
            return refuse("/intrinsics", reason);
        }
        if self.intrinsics == IntrinsicsMode::RefineFocal && cameras.len() < 2 {
            return refuse("/intrinsics", "one camera cannot tell its focal length; use \"fixed\"".to_owned());
        }
        if self.body != DEFAULT_BODY && !bodies.contains(&self.body) {
            let known: String = bodies.iter().map(|name| format!(" or {name:?}")).collect();
            return refuse("/body", format!("{:?} is not a registered body; use \"{DEFAULT_BODY}\"{known}", self.body));
        }
        if self.people == Some(0) {
            return refuse("/people", "0 people leave nothing to solve; give 1 or more, or null".to_owned());
        }
        if self.up_axis == UpAxis::X {
            return refuse("/up_axis", "the result's world has y or z up; use \"y\" or \"z\"".to_owned());
        }
        self.check_scale(cameras)
    }

    fn check_scale(&self, known: &[CameraFacts]) -> Result<(), PipelineError> {
        let refuse = |option, reason: String| Err(PipelineError::Option { option, reason });
        match &self.scale {
            ScaleSource::Body => Ok(()),
            ScaleSource::Height { metres, .. } if !(0.5..=2.6).contains(metres) => {
                refuse("/scale/metres", format!("{metres} is not a person's height; give metres between 0.5 and 2.6"))
            }
            ScaleSource::Height { who, .. } if who != "tallest" && who.parse::<i64>().is_err() => {
                refuse("/scale/who", format!("{who:?} is neither \"tallest\" nor a track id"))
            }
            ScaleSource::Height { .. } => Ok(()),
            ScaleSource::CameraDistance { cameras, metres } => {
                if !(metres.is_finite() && *metres > 0.0) {
                    return refuse("/scale/metres", format!("{metres} is no distance; give metres above 0"));
                }
                if cameras[0] == cameras[1] {
                    return refuse("/scale/cameras", "two different cameras are needed".to_owned());
                }
                match cameras.iter().find(|id| known.iter().all(|camera| camera.id != **id)) {
                    Some(id) => refuse("/scale/cameras", format!("there is no camera {id:?} in the session")),
                    None => Ok(()),
                }
            }
        }
    }
}

/// `options.extrinsics`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Extrinsics {
    /// From nothing.
    Estimate,
    /// Those of the session, untouched.
    Fixed,
    /// Those of the session as a start.
    Refine,
}

/// `options.intrinsics`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum IntrinsicsMode {
    /// As given.
    Fixed,
    /// One focal factor per camera is refined.
    RefineFocal,
}

/// `options.scale`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "from", rename_all = "snake_case", deny_unknown_fields)]
pub enum ScaleSource {
    /// From the people's bones.
    Body,
    /// One person's standing height is known.
    Height {
        /// Height, m.
        metres: f64,
        /// `tallest` or a track id.
        who: String,
    },
    /// The distance between two cameras is known.
    CameraDistance {
        /// Camera ids.
        cameras: [String; 2],
        /// Distance of their centres, m.
        metres: f64,
    },
}

/// `options.sync`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Sync {
    /// Frames of equal number were taken at the same time, but for the offsets that the session gives.
    Given,
    /// Offsets are estimated; those that the session gives are the start.
    Estimate,
}
