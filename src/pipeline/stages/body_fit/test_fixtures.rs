//! What the tests of the fit share: surroundings of a fit, a camera, observations.

use super::config::BodyFitConfig;
use super::context::FitContext;
use super::observations::{ErrorShape, Observations, PixelObservation};
use crate::body::BodyModel;
use crate::body::default_body;
use crate::body::kinematics::{Pose, PosedSkeleton, landmark_position, posed};
use crate::body::model::Betas;
use crate::geometry::{Intrinsics, Rigid, rotation};
use crate::optim::block_banded::SystemPool;
use crate::pipeline::calibration::PosedCamera;
use crate::progress::Progress;
use nalgebra::{Vector2, Vector3};

/// What a context refers to.
pub(super) struct Surroundings {
    pub model: BodyModel,
    pub config: BodyFitConfig,
    pub progress: Progress,
    systems: SystemPool,
}

impl Surroundings {
    /// The default body and settings.
    pub(super) fn new() -> Self {
        Self {
            model: default_body(),
            config: BodyFitConfig::default(),
            progress: Progress::silent(),
            systems: SystemPool::default(),
        }
    }

    /// At 30 frames a second in a world with y up, with one set of settings.
    pub(super) fn context(&self) -> FitContext<'_> {
        let Self { model, config, progress, systems } = self;
        let (frame_interval, up, noise) = (1.0 / 30.0, Vector3::y(), None);
        FitContext {
            model,
            config,
            first_config: config,
            frame_interval,
            up,
            progress,
            noise,
            averaged_noise: noise,
            systems,
        }
    }
}

/// A camera 4 m in front of a person at the origin, turned about the upward axis.
pub(super) fn camera_in_front(turn: f64) -> PosedCamera {
    let upside_down = rotation::exp(&(Vector3::x() * std::f64::consts::PI));
    PosedCamera {
        intrinsics: Intrinsics::PLAIN,
        camera_from_world: Rigid {
            rotation: upside_down * rotation::exp(&(Vector3::y() * turn)),
            translation: Vector3::new(0.0, 1.0, 4.0),
        },
    }
}

/// A landmark that a camera shows, for tests to which it does not matter where.
pub(super) fn seen(landmark: usize, camera: usize) -> PixelObservation {
    PixelObservation { landmark, camera, pixel: Vector2::zeros(), scale_px: 1.0, error: ErrorShape::Round }
}

/// What two cameras detect of a person of average shape, without errors.
pub(super) fn detected(model: &BodyModel, poses: &[Pose]) -> Observations {
    let cameras = vec![camera_in_front(0.0), camera_in_front(1.2)];
    let body = model.shaped(&Betas::zeros());
    let pixel = |skeleton: &PosedSkeleton, landmark: usize, camera: usize| {
        let place = cameras[camera].pixel_of(&landmark_position(model, &body, skeleton, landmark));
        PixelObservation { landmark, camera, pixel: place.unwrap(), scale_px: 400.0, error: ErrorShape::Round }
    };
    let frame = |pose: &Pose| {
        let skeleton = posed(&body, pose);
        let of_landmark = |landmark| [0, 1].map(|camera| pixel(&skeleton, landmark, camera));
        (0..model.landmarks.len()).flat_map(of_landmark).collect()
    };
    Observations { pixels: poses.iter().map(frame).collect(), points: vec![Vec::new(); poses.len()], cameras }
}
