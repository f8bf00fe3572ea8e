//! Two people dancing: face to face within arms' reach, turning about each other, arms at the partner's sides or spread.
//!
//! All coordinates except the stride are sums of slow sine waves of time; the stride's phase follows the distance covered.

use super::action_generator::STEP;
use super::config::SimulationConfig;
use super::gait::{self, Arm, Posture, Stance};
use super::random::{Purpose, stream};
use super::skeleton::SimulatedPerson;
use nalgebra::Vector2;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{PI, TAU};

/// Smallest and largest distance between the dancers' feet, m. A stepping dancer leans over them: the hips come up to 0.3 m
/// nearer, 0.3 to 0.7 m.
const NEAR: f64 = 0.62;
const FAR: f64 = 0.80;
/// Turning rate of the couple, rad/s: one turn in some ten seconds.
const TURN_RATE: f64 = 0.6;
/// Step length of dancers relative to walkers of the same speed.
const STEP_SHARE: f64 = 0.6;
/// Ground speed at which a dancer steps half as high as a walker, m/s.
const SHUFFLE: f64 = 0.15;

/// A slow sine wave in time: `size * sin(2 pi hertz t + phase)`.
#[derive(Debug, Clone, Copy)]
struct Wave {
    size: f64,
    hertz: f64,
    phase: f64,
}

impl Wave {
    /// A wave of about the given size and frequency.
    fn random(size: f64, hertz: f64, rng: &mut ChaCha8Rng) -> Self {
        let mut about = |value: f64| value * rng.random_range(0.7..1.0);
        Self { size: about(size), hertz: about(hertz), phase: rng.random_range(0.0..TAU) }
    }

    fn at(&self, time: f64) -> f64 {
        self.size * (TAU * self.hertz * time + self.phase).sin()
    }
}

/// Position and rotation of the couple over time.
struct Couple {
    middle: [Wave; 2],
    distance: Wave,
    turn_rate: f64,
    turn: Wave,
}

impl Couple {
    fn random(rng: &mut ChaCha8Rng) -> Self {
        let sign = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
        Self {
            middle: std::array::from_fn(|_| Wave::random(0.4, 0.08, rng)),
            distance: Wave { size: 0.5 * (FAR - NEAR), ..Wave::random(1.0, 0.2, rng) },
            turn_rate: sign * TURN_RATE * rng.random_range(0.7..1.3),
            turn: Wave::random(0.6, 0.12, rng),
        }
    }

    /// Direction from the first dancer to the second, rad from +z towards +x.
    fn direction(&self, time: f64) -> f64 {
        self.turn.phase + self.turn_rate * time + self.turn.at(time)
    }

    /// Midpoint between a dancer's ankles, world (x, z), m.
    fn position(&self, dancer: usize, time: f64) -> Vector2<f64> {
        let (sin, cos) = self.direction(time).sin_cos();
        let half = 0.5 * (0.5 * (NEAR + FAR) + self.distance.at(time));
        let side = if dancer == 0 { -half } else { half };
        Vector2::from(self.middle.map(|wave| wave.at(time))) + Vector2::new(sin, cos) * side
    }
}

/// Motion of one dancer relative to the couple.
struct Dancer {
    heading: Wave,
    crouch: Wave,
    lean: Wave,
    trunk: [Wave; 2],
    head: [Wave; 2],
    /// Per arm: waves of the share between hold and spread, and of flexion, abduction and elbow added to it.
    arms: [[Wave; 4]; 2],
    phase: f64,
}

/// The first dancer's arms at the partner's sides and spread; below the second's, so that they do not collide.
const LOW: [Arm; 2] = [
    Arm { flexion: 0.35, abduction: 0.50, elbow: 0.50, swing: 0.0 },
    Arm { flexion: 0.20, abduction: 0.80, elbow: 0.15, swing: 0.0 },
];
/// The second dancer's arms.
const HIGH: [Arm; 2] = [
    Arm { flexion: 0.35, abduction: 1.15, elbow: 0.35, swing: 0.0 },
    Arm { flexion: 0.15, abduction: 1.45, elbow: 0.10, swing: 0.0 },
];

impl Dancer {
    fn random(rng: &mut ChaCha8Rng) -> Self {
        let mut wave = |size: f64, hertz: f64| Wave::random(size, hertz, rng);
        Self {
            heading: wave(0.2, 0.2),
            crouch: wave(0.03, 0.4),
            lean: wave(0.05, 0.25),
            trunk: [wave(0.2, 0.3), wave(0.1, 0.3)],
            head: [wave(0.5, 0.25), wave(0.2, 0.3)],
            arms: std::array::from_fn(|_| [wave(0.5, 0.2), wave(0.15, 0.4), wave(0.12, 0.4), wave(0.25, 0.5)]),
            phase: wave(0.0, 0.0).phase,
        }
    }

    /// The posture at a time; `[hold, spread]` are the arms' extreme positions.
    fn posture(&self, [hold, spread_out]: &[Arm; 2], time: f64) -> Posture {
        let arm = |[spread, flexion, abduction, elbow]: &[Wave; 4]| {
            let share = 0.5 + spread.at(time);
            let between = |hold: f64, spread: f64, wave: &Wave| hold + (spread - hold) * share + wave.at(time);
            Arm {
                flexion: between(hold.flexion, spread_out.flexion, flexion),
                abduction: between(hold.abduction, spread_out.abduction, abduction),
                elbow: between(hold.elbow, spread_out.elbow, elbow),
                swing: 0.0,
            }
        };
        Posture {
            // A wave about its own amplitude: the knees are never stretched.
            crouch: self.crouch.size + self.crouch.at(time),
            sit: 0.0,
            lean: self.lean.at(time),
            trunk_yaw: self.trunk[0].at(time),
            trunk_roll: self.trunk[1].at(time),
            head_yaw: self.head[0].at(time),
            head_pitch: self.head[1].at(time),
            arms: self.arms.each_ref().map(arm),
        }
    }
}

/// The two people of a configuration, each with a random body.
pub(super) fn dancing_people(config: &SimulationConfig) -> Vec<SimulatedPerson> {
    let couple = Couple::random(&mut stream(config.seed, Purpose::Placement, 0, 0));
    let person = |index: usize| {
        let dancer = Dancer::random(&mut stream(config.seed, Purpose::Motion, 0, index));
        let mut person = SimulatedPerson::still(config, index, "dance");
        let arms = if index == 0 { &LOW } else { &HIGH };
        let stances = stances(&couple, &dancer, index, config);
        let poses = stances.iter().enumerate().map(|(frame, stance)| {
            gait::pose(&person.skeleton, stance, &dancer.posture(arms, frame as f64 / config.fps))
        });
        person.poses = poses.collect();
        person
    };
    (0..2).map(person).collect()
}

/// One dancer's stances by frame.
fn stances(couple: &Couple, dancer: &Dancer, index: usize, config: &SimulationConfig) -> Vec<Stance> {
    let speed = |time: f64| {
        (couple.position(index, time + 0.5 * STEP) - couple.position(index, time - 0.5 * STEP)).norm() / STEP
    };
    let (mut phase, mut step) = (dancer.phase, 0_u64);
    let stance = |frame: usize| {
        let time = frame as f64 / config.fps;
        while step as f64 * STEP < time {
            let speed = speed(step as f64 * STEP);
            phase += STEP * PI * speed / (STEP_SHARE * gait::step_length(speed));
            step += 1;
        }
        let speed = speed(time);
        let facing = couple.direction(time) + if index == 0 { 0.0 } else { PI };
        Stance {
            position: couple.position(index, time),
            heading: facing + dancer.heading.at(time),
            phase,
            step: STEP_SHARE * gait::step_length(speed),
            activity: speed * speed / (speed * speed + SHUFFLE * SHUFFLE),
        }
    };
    (0..config.frames).map(stance).collect()
}

#[cfg(test)]
mod tests {
    use super::super::{Bodies, MotionSource, Preset, SimulationError, Truth, simulate};
    use super::*;
    use crate::body::capsules::BodyCapsules;
    use crate::body::default_body;
    use crate::body::kinematics::{Pose, posed};

    fn truth(seed: u64, frames: usize, fps: f64) -> Truth {
        let preset = SimulationConfig::preset(Preset::Easy);
        let (motion, bodies) = (MotionSource::Dance, Bodies::Default);
        let config = SimulationConfig { seed, frames, fps, views: 1, motion, bodies, ..preset };
        simulate(&config).unwrap().truth
    }

    /// Deepest overlap of the two bodies in a frame, m.
    fn overlap(truth: &Truth, capsules: &BodyCapsules, frame: usize) -> f64 {
        let model = default_body();
        let [a, b] = [0, 1].map(|index| {
            let person = &truth.people[index];
            let (betas, pose) = (person.betas.unwrap(), &person.poses[frame]);
            let shaped = model.shaped(&betas);
            let translation = pose.pelvis - shaped.rest_joints[0];
            capsules.posed(&betas, &posed(&shaped, &Pose { rotations: pose.rotations, translation }))
        });
        let depth =
            |a| b.iter().map(move |b| -crate::geometry::capsule::TaperedCapsule::distance_to_capsule(a, b).distance);
        a.iter().flat_map(depth).fold(0.0, f64::max)
    }

    #[test]
    fn dancers_stay_in_reach_without_collision() {
        let capsules = BodyCapsules::of(&default_body());
        for seed in 0..6 {
            let truth = truth(seed, 300, 30.0);
            let mut deepest: Vec<f64> = (0..300).step_by(5).map(|f| overlap(&truth, &capsules, f)).collect();
            deepest.sort_by(f64::total_cmp);
            for frame in &truth.joints {
                let [a, b] = [&frame[0], &frame[1]].map(|joints| joints[0].xz());
                let apart = (a - b).norm();
                assert!((0.3..0.8).contains(&apart), "seed {seed}: {apart} m");
            }
            // Hands may touch; bodies do not overlap.
            assert!(deepest[45] < 0.03 && deepest[59] < 0.10, "seed {seed}: {deepest:?}");
            let heading = |f: usize| truth.people[0].poses[f].rotations[0].column(2).xz();
            assert!(heading(0).angle(&heading(150)) > 0.5 || heading(0).angle(&heading(250)) > 0.5, "they turn");
        }
    }

    #[test]
    fn the_dance_does_not_depend_on_the_frame_rate() {
        let (slow, fast) = (truth(3, 30, 30.0), truth(3, 60, 60.0));
        let apart = (slow.joints[29][1][20] - fast.joints[58][1][20]).norm();
        assert!(apart < 5e-3, "{apart}"); // one step of the stride
    }

    #[test]
    fn a_dance_needs_two_people() {
        let preset = SimulationConfig::preset(Preset::Easy);
        let config = SimulationConfig { people: 3, motion: MotionSource::Dance, ..preset };
        let error = simulate(&config).unwrap_err();
        assert!(matches!(error, SimulationError::Config { field: "people", .. }), "{error}");
    }
}
