//! Named and random configurations.

use super::config::{Bodies, MotionSource, NoiseConfig, RigConfig, SimulationConfig, Tracks};
use super::random::{Purpose, stream};
use super::real_noise::RealNoise;
use crate::body::skeleton::KeypointConvention;
use rand::RngExt;

/// Difficulty of a session.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Preset {
    /// 2 people, 8 views, a good detector, no swaps.
    Easy,
    /// 2 people, 6 views, a typical detector.
    Paper,
    /// 4 people, 5 views, a poor detector and tracker.
    Hard,
}

impl SimulationConfig {
    /// The configuration of a preset with seed 1.
    pub fn preset(preset: Preset) -> Self {
        let (people, views, frames, radius, height) = match preset {
            Preset::Easy => (2, 8, 240, 4.5, 2.2),
            Preset::Paper => (2, 6, 300, 4.0, 1.9),
            Preset::Hard => (4, 5, 300, 4.5, 1.7),
        };
        Self {
            people,
            views,
            frames,
            fps: 30.0,
            seed: 1,
            noise: NoiseConfig::preset(preset),
            rig: RigConfig { radius, height, ..RigConfig::default() },
            convention: KeypointConvention::Coco17,
            dense: None,
            tracks: Tracks::Consistent,
            time_offsets: Vec::new(),
            bodies: Bodies::Own,
            hands: None,
            motion: MotionSource::Procedural,
        }
    }
}

impl NoiseConfig {
    /// The same rates with the errors of a real detector.
    pub fn with_real_errors(self) -> Self {
        Self { real: Some(RealNoise::MEASURED), ..self }
    }

    /// The noise of a preset.
    pub fn preset(preset: Preset) -> Self {
        match preset {
            Preset::Easy => Self {
                jitter_of_size: 0.006,
                outlier_rate: 0.005,
                outlier_of_size: 0.08,
                missed_joint_rate: 0.005,
                missed_detection_rate: 0.003,
                occluded_joint_missing_rate: 0.5,
                hidden_person_missing_rate: 0.8,
                swaps_per_minute: 0.0,
                flip_rate: 0.001,
                real: None,
                covariances: false,
            },
            Preset::Paper => Self {
                jitter_of_size: 0.012,
                outlier_rate: 0.02,
                outlier_of_size: 0.20,
                missed_joint_rate: 0.02,
                missed_detection_rate: 0.02,
                occluded_joint_missing_rate: 0.8,
                hidden_person_missing_rate: 0.8,
                swaps_per_minute: 4.0,
                flip_rate: 0.006,
                real: None,
                covariances: false,
            },
            Preset::Hard => Self {
                jitter_of_size: 0.022,
                outlier_rate: 0.05,
                outlier_of_size: 0.35,
                missed_joint_rate: 0.06,
                missed_detection_rate: 0.06,
                occluded_joint_missing_rate: 0.92,
                hidden_person_missing_rate: 0.8,
                swaps_per_minute: 10.0,
                flip_rate: 0.02,
                real: None,
                covariances: false,
            },
        }
    }
}

/// A random rig for benchmarks: 3 to 8 cameras (radius 3 to 6 m, height 1.2 to 3 m, field of view 50 to 80 degrees), 1 to
/// 5 people, 10 s at 30 frames a second, the noise of [`Preset::Paper`], no track ids.
pub fn random_rig_config(seed: u64) -> SimulationConfig {
    let mut rng = stream(seed, Purpose::Config, 0, 0);
    SimulationConfig {
        people: rng.random_range(1..=5),
        views: rng.random_range(3..=8),
        frames: 300,
        seed,
        rig: RigConfig {
            radius: rng.random_range(3.0..6.0),
            height: rng.random_range(1.2..3.0),
            fov_deg: rng.random_range(50.0..80.0),
            ..RigConfig::default()
        },
        tracks: Tracks::None,
        ..SimulationConfig::preset(Preset::Paper)
    }
}
