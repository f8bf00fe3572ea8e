//! Options of a job. They are stored with the job, so that a run can be repeated.

use super::corrections::Correction;
use super::error::PipelineError;
use crate::body::scale::HEIGHT_RANGE;
use crate::session::reconstruction::ExportFormat;
use crate::session::recording::{FPS_RANGE, UpAxis};
use crate::session::{Session, View};
use serde::{Deserialize, Deserializer, Serialize};
use std::borrow::Cow;

/// Options of one job; names and defaults are those of the HTTP API.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "service", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Number of people, where it is known.
    #[cfg_attr(feature = "service", schema(minimum = 1))]
    pub people: Option<usize>,
    /// Frame rate that replaces the session's, frames per second.
    pub fps: Option<f64>,
    /// Treatment of the cameras' poses.
    pub extrinsics: Extrinsics,
    /// Treatment of the cameras' intrinsics.
    pub intrinsics: IntrinsicsMode,
    /// Source of the metric scale.
    pub scale: ScaleSource,
    /// Up axis of the result's world.
    #[cfg_attr(feature = "service", schema(value_type = String, pattern = "^[yz]$"))]
    pub up_axis: UpAxis,
    /// Whether detections are repaired by physics-geometry consistency.
    pub denoise: bool,
    /// What is known of human motion beside the cameras; `true` is `denoiser`, `false` is `none`.
    #[serde(deserialize_with = "named_or_switched")]
    #[cfg_attr(feature = "service", schema(value_type = MotionPriorChoice))]
    pub motion_prior: MotionPriorMode,
    /// Whether collisions between bodies are resolved.
    pub collision: bool,
    /// Name of a registered body model.
    pub body: String,
    /// Time offsets between cameras.
    pub sync: Sync,
    /// What is done about probable mistakes in the files.
    pub repair: Repair,
    /// Seed of every random choice.
    pub seed: u64,
    /// Corrections of the people of a solve without corrections.
    pub corrections: Vec<Correction>,
    /// Formats written in addition to the JSON files; repeated ones count once.
    #[serde(deserialize_with = "distinct")]
    pub exports: Vec<ExportFormat>,
    /// Whether cameras are adjusted together with the bodies, and the detector's errors are taken as correlated in time. Not an
    /// option of the API: `bench ablation` shows what it is worth.
    #[serde(skip, default = "adjust_with_bodies")]
    pub adjust_with_bodies: bool,
}

fn adjust_with_bodies() -> bool {
    true
}

/// `options.body` for the embedded body.
pub const DEFAULT_BODY: &str = "default";

impl Default for Options {
    fn default() -> Self {
        Self {
            people: None,
            fps: None,
            extrinsics: Extrinsics::Estimate,
            intrinsics: IntrinsicsMode::Fixed,
            scale: ScaleSource::Body {},
            up_axis: UpAxis::Y,
            denoise: true,
            motion_prior: MotionPriorMode::Denoiser,
            collision: true,
            body: DEFAULT_BODY.to_owned(),
            sync: Sync::Given,
            repair: Repair::Suggest,
            seed: 0,
            corrections: Vec::new(),
            exports: vec![ExportFormat::SmplNpz],
            adjust_with_bodies: true,
        }
    }
}

/// Reads a list without repetitions, in the order of the first occurrences.
fn distinct<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<ExportFormat>, D::Error> {
    let mut formats = Vec::<ExportFormat>::deserialize(deserializer)?;
    let mut known = Vec::new();
    formats.retain(|format| {
        let is_new = !known.contains(format);
        if is_new {
            known.push(*format);
        }
        is_new
    });
    Ok(formats)
}

/// Reads a mode by its name, or as a switch.
fn named_or_switched<'de, D: Deserializer<'de>>(deserializer: D) -> Result<MotionPriorMode, D::Error> {
    let found = serde_json::Value::deserialize(deserializer)?;
    let named = match &found {
        serde_json::Value::Bool(true) => Some(MotionPriorMode::Denoiser),
        serde_json::Value::Bool(false) => Some(MotionPriorMode::None),
        name => MotionPriorMode::deserialize(name).ok(),
    };
    named.ok_or_else(|| {
        let remedy = "use \"denoiser\", \"latent\", \"pose\", \"none\", true or false";
        serde::de::Error::custom(format!("motion_prior: {found} is not a motion prior; {remedy}"))
    })
}

/// Facts of a camera that the check of options needs, so that the session itself need not be loaded.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "service", derive(utoipa::ToSchema))]
pub struct CameraFacts {
    /// The camera's name.
    pub id: String,
    /// Whether the session gives its `R` and `t`.
    pub has_extrinsics: bool,
    /// Whether the session gives its `K`.
    #[serde(default = "given")]
    pub has_intrinsics: bool,
}

fn given() -> bool {
    true
}

impl CameraFacts {
    /// Facts of every camera, in the session's order.
    pub fn of(session: &Session) -> Vec<Self> {
        let facts = |view: &View| Self {
            id: view.id.clone(),
            has_extrinsics: view.camera_from_world.is_some(),
            has_intrinsics: view.has_intrinsics,
        };
        session.views.iter().map(facts).collect()
    }
}

/// Why a measured length is refused beside given poses.
const SCALE_OF_POSES: &str =
    "with given camera poses the scale is theirs; use extrinsics \"estimate\", or leave it out";

impl Options {
    /// The session at the frame rate of the options.
    pub fn at_rate<'s>(&self, session: &'s Session) -> Cow<'s, Session> {
        match self.fps {
            Some(fps) if fps != session.fps => Cow::Owned(Session { fps, ..session.clone() }),
            _ => Cow::Borrowed(session),
        }
    }

    /// Checks the options against the session's cameras; `bodies`: names of the registered body models, without the
    /// embedded one.
    ///
    /// # Errors
    /// [`PipelineError::Option`] naming the option and the remedy.
    pub fn check(&self, cameras: &[CameraFacts], bodies: &[String]) -> Result<(), PipelineError> {
        let unposed = cameras.iter().find(|camera| !camera.has_extrinsics);
        if let Some(camera) = unposed.filter(|_| self.extrinsics != Extrinsics::Estimate) {
            let reason = format!(
                "camera {} has no R and t, which fixed and refined extrinsics need of every camera; give them, or use \"estimate\"",
                camera.id
            );
            return refuse("/extrinsics", reason);
        }
        if self.intrinsics == IntrinsicsMode::RefineFocal && self.extrinsics == Extrinsics::Fixed {
            let reason = "refine_focal also changes camera poses; use extrinsics \"refine\" or \"estimate\"";
            return refuse("/intrinsics", reason);
        }
        if self.intrinsics == IntrinsicsMode::RefineFocal && cameras.len() < 2 {
            return refuse("/intrinsics", "a single camera does not determine its focal length; use \"fixed\"");
        }
        if self.sync == Sync::Estimate && cameras.len() < 2 {
            return refuse("/sync", "a single camera has no other camera to be compared with; use \"given\"");
        }
        self.check_unknown_lenses(cameras)?;
        if self.body != DEFAULT_BODY && !bodies.contains(&self.body) {
            let known: String = bodies.iter().map(|name| format!(" or {name:?}")).collect();
            return refuse("/body", format!("{:?} is not a registered body; use \"{DEFAULT_BODY}\"{known}", self.body));
        }
        if self.people == Some(0) {
            return refuse("/people", "0 people cannot be solved; give 1 or more, or null");
        }
        let [min, max] = FPS_RANGE;
        if let Some(fps) = self.fps.filter(|fps| !(min..=max).contains(fps)) {
            return refuse(
                "/fps",
                format!("{fps} frames per second are not a frame rate; give {min} to {max}, or null"),
            );
        }
        if self.up_axis == UpAxis::X {
            return refuse("/up_axis", "up axis x is not supported; use \"y\" or \"z\"");
        }
        self.check_scale(cameras)?;
        self.check_corrections(cameras)
    }

    /// Treatment of the intrinsics of a session: where a camera has no K they are estimated.
    pub fn intrinsics_of(&self, session: &Session) -> IntrinsicsMode {
        let is_known = session.views.iter().all(|view| view.has_intrinsics);
        if is_known { self.intrinsics } else { IntrinsicsMode::Estimate }
    }

    /// The options on which cameras and people of a solve without corrections depend; the others have their defaults.
    pub fn without_corrections(&self) -> Self {
        let Self { corrections, exports, collision, .. } = Self::default();
        Self { corrections, exports, collision, ..self.clone() }
    }

    /// Checks what is known of corrections before the solve: cameras and heights.
    fn check_corrections(&self, cameras: &[CameraFacts]) -> Result<(), PipelineError> {
        for (i, correction) in self.corrections.iter().enumerate() {
            let refuse = |reason: String| Err(PipelineError::from(correction.error(i, reason)));
            if let Some(id) = correction.camera().filter(|id| cameras.iter().all(|camera| camera.id != *id)) {
                return refuse(format!("the session has no camera {id:?}; name one of its cameras"));
            }
            let [min, max] = HEIGHT_RANGE;
            match correction {
                Correction::SetHeight { metres, .. } if !(min..=max).contains(metres) => {
                    return refuse(format!("{metres} m is not a plausible height of a person; give {min} to {max} m"));
                }
                Correction::SetHeight { .. } if self.extrinsics != Extrinsics::Estimate => {
                    return refuse(SCALE_OF_POSES.to_owned());
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn check_unknown_lenses(&self, cameras: &[CameraFacts]) -> Result<(), PipelineError> {
        let unknown = cameras.iter().find(|camera| !camera.has_intrinsics);
        let why = match unknown {
            Some(camera) => format!("camera {} has no K, so that focal lengths are estimated", camera.id),
            None if self.intrinsics == IntrinsicsMode::Estimate => "focal lengths are estimated".to_owned(),
            None => return Ok(()),
        };
        if self.extrinsics != Extrinsics::Estimate {
            return refuse("/extrinsics", format!("{why}, which changes camera poses; use \"estimate\", or give K"));
        }
        if cameras.len() < 2 {
            return refuse("/intrinsics", format!("{why}, which takes two cameras or more; give K and use \"fixed\""));
        }
        Ok(())
    }

    fn check_scale(&self, known: &[CameraFacts]) -> Result<(), PipelineError> {
        if self.scale != (ScaleSource::Body {}) && self.extrinsics != Extrinsics::Estimate {
            return refuse("/scale", SCALE_OF_POSES);
        }
        match &self.scale {
            ScaleSource::Body {} => Ok(()),
            ScaleSource::Height { metres, .. } if !(HEIGHT_RANGE[0]..=HEIGHT_RANGE[1]).contains(metres) => {
                let [min, max] = HEIGHT_RANGE;
                let reason = format!("{metres} m is not a plausible height of a person; give {min} to {max} m");
                refuse("/scale/metres", reason)
            }
            ScaleSource::Height { who, .. } if who != "tallest" && who.parse::<i64>().is_err() => {
                refuse("/scale/who", format!("{who:?} is neither \"tallest\" nor a track id"))
            }
            ScaleSource::Height { .. } => Ok(()),
            ScaleSource::CameraDistance { cameras, metres } => {
                if !(metres.is_finite() && *metres > 0.0) {
                    return refuse(
                        "/scale/metres",
                        format!("{metres} m is not a distance between cameras; give metres above 0"),
                    );
                }
                if cameras[0] == cameras[1] {
                    return refuse("/scale/cameras", "both cameras are the same; name two different cameras");
                }
                match cameras.iter().find(|id| known.iter().all(|camera| camera.id != **id)) {
                    Some(id) => {
                        refuse("/scale/cameras", format!("the session has no camera {id:?}; name two of its cameras"))
                    }
                    None => Ok(()),
                }
            }
        }
    }
}

fn refuse(option: &'static str, reason: impl Into<String>) -> Result<(), PipelineError> {
    Err(PipelineError::Option { option, reason: reason.into() })
}

/// `options.extrinsics`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "service", derive(utoipa::ToSchema))]
#[serde(rename_all = "lowercase")]
pub enum Extrinsics {
    /// Estimated without a start.
    Estimate,
    /// Those of the session, unchanged.
    Fixed,
    /// Refined, starting from those of the session.
    Refine,
}

/// `options.intrinsics`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "service", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum IntrinsicsMode {
    /// As given.
    Fixed,
    /// One focal factor per camera is refined.
    RefineFocal,
    /// Focal lengths are estimated; those of the session are guesses.
    Estimate,
}

/// `options.scale`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "service", derive(utoipa::ToSchema))]
#[serde(tag = "from", rename_all = "snake_case", deny_unknown_fields)]
pub enum ScaleSource {
    /// From the people's bone lengths.
    // Braces: a variant without fields accepts and ignores any.
    Body {},
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

/// `options.motion_prior`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "service", derive(utoipa::ToSchema))]
#[serde(rename_all = "lowercase")]
pub enum MotionPriorMode {
    /// Likely poses and standing feet; joints that no camera shows for a while are completed from the rest of the motion.
    Denoiser,
    /// The motions are codes of a latent motion prior, fitted together with the cameras.
    Latent,
    /// Likely poses and standing feet.
    Pose,
    /// Smoothness alone.
    None,
}

/// What `options.motion_prior` accepts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "service", derive(utoipa::ToSchema))]
#[serde(untagged)]
pub enum MotionPriorChoice {
    /// By name.
    Mode(MotionPriorMode),
    /// `true` is `denoiser`, `false` is `none`.
    Switch(bool),
}

/// `options.sync`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "service", derive(utoipa::ToSchema))]
#[serde(rename_all = "lowercase")]
pub enum Sync {
    /// Those of the session; 0 where it gives none.
    Given,
    /// Estimated, starting from those of the session.
    Estimate,
}

/// `options.repair`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "service", derive(utoipa::ToSchema))]
#[serde(rename_all = "lowercase")]
pub enum Repair {
    /// Suspicions say what to do.
    Suggest,
    /// Mistakes with a single remedy are undone, and the recording is solved again.
    Auto,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeated_exports_count_once() {
        let options: Options = serde_json::from_str(r#"{"exports": ["glb", "bvh", "glb", "glb"]}"#).unwrap();
        assert_eq!(options.exports, [ExportFormat::Glb, ExportFormat::Bvh]);
    }

    /// Its offset was reported as uncertain by more than a quarter of a frame.
    #[test]
    fn offsets_of_a_single_camera_were_estimated() {
        let camera = |id: &str| CameraFacts { id: id.to_owned(), has_extrinsics: false, has_intrinsics: true };
        let options = Options { sync: Sync::Estimate, ..Options::default() };
        let refused = options.check(&[camera("a")], &[]).unwrap_err().to_string();
        assert!(refused.starts_with("/sync: ") && refused.contains("\"given\""), "{refused}");
        assert!(options.check(&[camera("a"), camera("b")], &[]).is_ok());
    }

    /// A height or a distance was ignored without a word where the poses of the cameras are given.
    #[test]
    fn a_scale_beside_given_poses_was_ignored() {
        let camera = |id: &str| CameraFacts { id: id.to_owned(), has_extrinsics: true, has_intrinsics: true };
        let cameras = [camera("a"), camera("b")];
        let distance = ScaleSource::CameraDistance { cameras: ["a", "b"].map(str::to_owned), metres: 4.5 };
        let height = ScaleSource::Height { metres: 1.82, who: "tallest".to_owned() };
        for scale in [distance, height] {
            let options = |extrinsics: Extrinsics| Options { extrinsics, scale: scale.clone(), ..Options::default() };
            assert!(options(Extrinsics::Estimate).check(&cameras, &[]).is_ok());
            for extrinsics in [Extrinsics::Fixed, Extrinsics::Refine] {
                let refused = options(extrinsics).check(&cameras, &[]).unwrap_err().to_string();
                assert!(refused.starts_with("/scale: ") && refused.contains("\"estimate\""), "{refused}");
            }
        }
    }

    /// A height was ignored without a word where `from` did not name it.
    #[test]
    fn a_height_beside_another_source_was_ignored() {
        let read = |text: &str| serde_json::from_str::<Options>(&format!(r#"{{"scale": {text}}}"#));
        assert_eq!(read(r#"{"from": "body"}"#).unwrap(), Options::default());
        let refused = read(r#"{"from": "body", "metres": 1.82}"#).unwrap_err().to_string();
        assert!(refused.contains("`metres`"), "{refused}");
    }

    #[test]
    fn the_motion_prior_has_names_and_switches() {
        let read = |text: &str| serde_json::from_str::<Options>(&format!(r#"{{"motion_prior": {text}}}"#));
        let cases = [
            ("true", "denoiser"),
            ("false", "none"),
            (r#""denoiser""#, "denoiser"),
            (r#""pose""#, "pose"),
            (r#""latent""#, "latent"),
        ];
        for (given, name) in cases {
            let options = read(given).unwrap();
            assert_eq!(serde_json::to_value(&options).unwrap()["motion_prior"], name);
        }
        for wrong in [r#""spline""#, "1", "null"] {
            let refused = read(wrong).unwrap_err().to_string();
            assert!(refused.contains("motion_prior") && refused.contains("\"pose\""), "{refused}");
        }
    }
}
