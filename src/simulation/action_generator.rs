//! Generator of one person's actions: a random sequence of actions sets the goals of damped springs, which make every
//! change smooth.

use super::config::SimulationConfig;
use super::gait::{self, Arm, Posture, Stance};
use super::random::{Purpose, stream};
use nalgebra::Vector2;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{PI, TAU};

/// Step of the simulation, s: below 1/200 s linear interpolation between steps errs by less than 0.1 mm.
pub(super) const STEP: f64 = 1.0 / 240.0;
/// Largest distance of walking targets from the centre, m.
const AREA: f64 = 1.9;
/// Rate of the posture's springs, 1/s: a gesture takes some 0.6 s.
const POSTURE_RATE: f64 = 7.0;

/// The current action of a person.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Action {
    Walk { target: Vector2<f64>, speed: f64 },
    Turn { heading: f64 },
    Stand,
    Crouch,
    Sit,
    Reach { arm: usize, goal: Arm, lean: f64 },
}

/// The state of one person's motion, advanced in fixed steps.
#[derive(Debug, Clone)]
pub(super) struct ActionGenerator {
    rng: ChaCha8Rng,
    action: Action,
    until: f64,
    next_gesture: f64,
    position: Vector2<f64>,
    velocity: Vector2<f64>,
    push: Vector2<f64>,
    speed: f64,
    heading: f64,
    turn_rate: f64,
    phase: f64,
    phase_rate: f64,
    activity: f64,
    goal: Posture,
    followed: Posture,
    posture: Posture,
    posture_rate: Posture,
}

impl ActionGenerator {
    /// A standing person at a random position near the centre.
    pub(super) fn new(person: usize, config: &SimulationConfig) -> Self {
        let mut rng = stream(config.seed, Purpose::Motion, 0, person);
        let angle = TAU * person as f64 / config.people as f64 + rng.random_range(0.0..0.8);
        let radius = rng.random_range(0.4..1.3);
        Self {
            position: Vector2::new(radius * angle.sin(), radius * angle.cos()),
            heading: rng.random_range(-PI..PI),
            phase: rng.random_range(0.0..TAU),
            rng,
            action: Action::Stand,
            until: 0.0,
            next_gesture: 0.0,
            velocity: Vector2::zeros(),
            push: Vector2::zeros(),
            speed: 0.0,
            turn_rate: 0.0,
            phase_rate: 0.0,
            activity: 0.0,
            goal: Posture::default(),
            followed: Posture::default(),
            posture: Posture::default(),
            posture_rate: Posture::default(),
        }
    }

    /// The middle between the ankles, world (x, z), m.
    pub(super) fn position(&self) -> Vector2<f64> {
        self.position
    }

    /// The stance `rest` seconds after the last step.
    pub(super) fn stance_after(&self, rest: f64) -> Stance {
        Stance {
            position: self.position + self.velocity * rest,
            heading: self.heading + self.turn_rate * rest,
            phase: self.phase + self.phase_rate * rest,
            step: gait::step_length(self.ground_speed()),
            activity: self.activity,
        }
    }

    /// The posture `rest` seconds after the last step.
    pub(super) fn posture_after(&self, rest: f64) -> Posture {
        self.posture.zip(&self.posture_rate, |value, rate| value + rate * rest)
    }

    /// Speed of the feet, m/s; turning on the spot needs steps, too.
    fn ground_speed(&self) -> f64 {
        self.velocity.norm().max(0.3 * self.turn_rate.abs())
    }

    /// Advances by one step; `push` is the velocity away from other people, m/s.
    pub(super) fn advance(&mut self, time: f64, push: &Vector2<f64>) {
        if time >= self.until || self.has_arrived() {
            self.choose_action(time);
        }
        if time >= self.next_gesture {
            self.choose_gesture(time);
        }
        self.steer(push);
        self.pose();
    }

    fn has_arrived(&self) -> bool {
        matches!(self.action, Action::Walk { target, .. } if (target - self.position).norm() < 0.15)
    }

    fn choose_action(&mut self, time: f64) {
        let rng = &mut self.rng;
        let choice: f64 = rng.random();
        let (action, seconds) = if choice < 0.48 {
            let (angle, radius) = (rng.random_range(0.0..TAU), AREA * rng.random::<f64>().sqrt());
            let target = Vector2::new(radius * angle.sin(), radius * angle.cos());
            (Action::Walk { target, speed: rng.random_range(0.6..1.5) }, 6.0)
        } else if choice < 0.62 {
            (Action::Stand, rng.random_range(1.0..3.0))
        } else if choice < 0.74 {
            let heading = self.heading + rng.random_range(1.0..PI) * if rng.random_bool(0.5) { 1.0 } else { -1.0 };
            (Action::Turn { heading }, 1.8)
        } else if choice < 0.82 {
            (Action::Crouch, rng.random_range(1.4..2.6))
        } else if choice < 0.88 {
            (Action::Sit, rng.random_range(1.8..3.5))
        } else {
            let goal = Arm {
                flexion: rng.random_range(0.3..2.6),
                abduction: rng.random_range(-0.2..1.0),
                elbow: rng.random_range(-0.2..0.5),
                swing: 0.0,
            };
            let lean = rng.random_range(0.0..0.6);
            (Action::Reach { arm: rng.random_range(0..2), goal, lean }, rng.random_range(1.2..2.4))
        };
        self.action = action;
        self.until = time + seconds;
        // A new action starts with a new posture.
        self.next_gesture = time;
    }

    fn choose_gesture(&mut self, time: f64) {
        let (action, rng) = (self.action, &mut self.rng);
        let walks = matches!(action, Action::Walk { .. } | Action::Turn { .. });
        let mut arm = || {
            if rng.random_bool(if walks { 0.8 } else { 0.35 }) {
                return Arm { swing: 1.0, ..Arm::default() };
            }
            Arm {
                flexion: rng.random_range(-0.2..1.5),
                abduction: rng.random_range(-0.1..0.9),
                elbow: rng.random_range(0.0..1.8),
                swing: 0.2,
            }
        };
        let mut arms = [arm(), arm()];
        let mut lean = rng.random_range(-0.05..0.12);
        if let Action::Reach { arm, goal, lean: reached } = action {
            arms[arm] = goal;
            lean = reached;
        }
        self.goal = Posture {
            crouch: if action == Action::Crouch { rng.random_range(0.5..0.9) } else { 0.0 },
            sit: if action == Action::Sit { rng.random_range(0.85..1.0) } else { 0.0 },
            lean,
            trunk_yaw: rng.random_range(-0.35..0.35),
            trunk_roll: rng.random_range(-0.12..0.12),
            head_yaw: rng.random_range(-0.7..0.7),
            head_pitch: rng.random_range(-0.2..0.4),
            arms,
        };
        self.next_gesture = time + rng.random_range(0.6..1.6);
    }

    /// Moves heading and speed towards the action's goal, and the stride with them.
    fn steer(&mut self, push: &Vector2<f64>) {
        let (target_heading, target_speed) = match self.action {
            Action::Walk { target, speed } => {
                let offset = target - self.position;
                (offset.x.atan2(offset.y), speed * (offset.norm() / 0.5).min(1.0))
            }
            Action::Turn { heading } => (heading, 0.0),
            _ => (self.heading, 0.0),
        };
        let off = (target_heading - self.heading + PI).rem_euclid(TAU) - PI;
        self.turn_rate += STEP * (16.0 * off.clamp(-0.9, 0.9) - 8.0 * self.turn_rate);
        self.heading += STEP * self.turn_rate;
        self.speed += STEP * 3.5 * (target_speed * off.cos().max(0.0) - self.speed);
        self.push += (push - self.push) * (STEP * 8.0);
        self.velocity = Vector2::new(self.heading.sin(), self.heading.cos()) * self.speed + self.push;
        self.position += self.velocity * STEP;
        let ground = self.ground_speed();
        self.activity += STEP * 5.0 * ((ground / 0.5).min(1.0) - self.activity);
        self.phase_rate = PI * ground / gait::step_length(ground);
        self.phase += STEP * self.phase_rate;
    }

    /// Moves the posture to its goal through a first-order lag and a critically damped spring, so that even the acceleration
    /// is continuous.
    fn pose(&mut self) {
        self.followed = self.followed.zip(&self.goal, |value, goal| value + STEP * POSTURE_RATE * (goal - value));
        let pull = self.followed.zip(&self.posture, |goal, value| POSTURE_RATE * POSTURE_RATE * (goal - value));
        let pull = pull.zip(&self.posture_rate, |pull, rate| pull - 2.0 * POSTURE_RATE * rate);
        self.posture_rate = self.posture_rate.zip(&pull, |rate, pull| rate + STEP * pull);
        self.posture = self.posture.zip(&self.posture_rate, |value, rate| value + STEP * rate);
    }
}
