//! People who run straight through the middle at one speed, past each other.
//!
//! A run through a volume is short and its first frame is as fast as all others: a tracker has no slow start to learn the
//! speed from.

use super::config::SimulationConfig;
use super::gait::{self, Arm, Posture, Stance};
use super::random::{Purpose, stream};
use super::skeleton::SimulatedPerson;
use nalgebra::Vector2;
use rand::RngExt;
use std::f64::consts::{PI, TAU};

/// Distance between the lanes of two runners, m.
const LANE: f64 = 1.2;

/// A runner leans forward and bends the elbows, rad.
const LEAN: f64 = 0.2;
const ELBOW: f64 = 1.1;

/// The people of a configuration, all at `speed` m/s in lanes of one heading, every second one in the opposite direction; all
/// pass the middle at half of the time.
pub(super) fn running_people(config: &SimulationConfig, speed: f64) -> Vec<SimulatedPerson> {
    let heading = stream(config.seed, Purpose::Motion, 0, 0).random_range(-PI..PI);
    (0..config.people).map(|person| runner(config, person, heading, speed)).collect()
}

fn runner(config: &SimulationConfig, person: usize, heading: f64, speed: f64) -> SimulatedPerson {
    let mut runner = SimulatedPerson::still(config, person, "running");
    let mut rng = stream(config.seed, Purpose::Motion, 0, person + 1);
    let lane = LANE * (person as f64 - 0.5 * (config.people as f64 - 1.0)) + rng.random_range(-0.2..0.2);
    let (first_phase, first) = (rng.random_range(0.0..TAU), -0.5 * speed * (config.frames as f64 - 1.0) / config.fps);
    let own_heading = heading + if person.is_multiple_of(2) { 0.0 } else { PI };
    let direction = |angle: f64| Vector2::new(angle.sin(), angle.cos());
    let arm = Arm { flexion: -0.2, abduction: 0.1, elbow: ELBOW, swing: 1.0 };
    let posture = Posture { lean: LEAN, arms: [arm; 2], ..Posture::default() };
    let step = gait::step_length(speed);
    for frame in 0..config.frames {
        let covered = speed * frame as f64 / config.fps;
        let position = direction(own_heading) * (first + covered) + direction(heading + 0.5 * PI) * lane;
        let phase = first_phase + PI * covered / step;
        let stance = Stance { position, heading: own_heading, phase, step, activity: 1.0 };
        runner.poses.push(gait::pose(&runner.skeleton, &stance, &posture));
    }
    runner
}

#[cfg(test)]
mod tests {
    use super::super::simulate;
    use super::*;
    use crate::simulation::{MotionSource, Preset};

    #[test]
    fn runners_keep_their_speed_and_their_lane() {
        let preset = SimulationConfig::preset(Preset::Easy);
        let motion = MotionSource::Running { speed: 8.0 };
        let config = SimulationConfig { people: 2, frames: 41, fps: 25.0, motion, ..preset };
        let joints = simulate(&config).unwrap().truth.joints;
        for person in 0..2 {
            let pelvis = |frame: usize| joints[frame][person][0].xz();
            assert!(((pelvis(40) - pelvis(0)).norm() / 1.6 - 8.0).abs() < 0.2);
            assert!(pelvis(20).norm() < 1.2, "{}", pelvis(20));
        }
        let apart = (0..41).map(|f| (joints[f][0][0] - joints[f][1][0]).xz().norm()).fold(f64::INFINITY, f64::min);
        assert!(apart > 0.6, "{apart}");
    }
}
