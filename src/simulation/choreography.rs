//! What people do: they walk to places, stop, turn, crouch, sit, reach and gesture, and keep out of each other's way.
//!
//! A person is a handful of damped springs whose goals an endless random sequence of actions sets; the springs make every
//! change smooth. Time runs in fixed steps of its own, so that a motion does not depend on the frame rate.

use super::config::SimulationConfig;
use super::gait::{self, Arm, Posture, Stance};
use super::random::{Purpose, stream};
use super::skeleton::{Person, Skeleton};
use nalgebra::Vector2;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{PI, TAU};

/// Step of the simulation, s: below 1/200 s straight lines between steps err by less than 0.1 mm.
const STEP: f64 = 1.0 / 240.0;
/// People move this long before the first frame, s, so that nobody starts from rest in a T.
const WARM_UP: f64 = 2.0;
/// People stay within this distance of the centre, m.
const AREA: f64 = 1.9;
/// Nearer than this (m, between the middles of their feet) people step aside.
const PERSONAL_SPACE: f64 = 0.9;
/// How fast the springs of posture answer, 1/s: a gesture takes some 0.6 s.
const POSTURE_RATE: f64 = 7.0;

/// People of `config`, each with an own body and an own random choreography.
pub fn procedural_people(config: &SimulationConfig) -> Vec<Person> {
    let mut movers: Vec<Mover> = (0..config.people).map(|person| Mover::new(person, config)).collect();
    let mut people: Vec<Person> = (0..config.people)
        .map(|person| Person {
            skeleton: Skeleton::random(&mut stream(config.seed, Purpose::Body, 0, person)),
            poses: Vec::with_capacity(config.frames),
            source: "procedural".to_owned(),
        })
        .collect();
    let mut step = 0_u64;
    for frame in 0..config.frames {
        let due = WARM_UP + frame as f64 / config.fps;
        // Up to the last step before the frame; the rest is a straight line.
        while (step + 1) as f64 * STEP <= due {
            advance_all(&mut movers, step as f64 * STEP);
            step += 1;
        }
        let rest = due - step as f64 * STEP;
        for (person, mover) in people.iter_mut().zip(&movers) {
            person.poses.push(gait::pose(&person.skeleton, &mover.stance_after(rest), &mover.posture_after(rest)));
        }
    }
    people
}

fn advance_all(movers: &mut [Mover], time: f64) {
    let positions: Vec<Vector2<f64>> = movers.iter().map(|mover| mover.position).collect();
    for (person, mover) in movers.iter_mut().enumerate() {
        let push = push_from_others(person, &positions);
        mover.advance(time, &push);
    }
}

/// Velocity that takes a person out of the others' space, m/s.
fn push_from_others(person: usize, positions: &[Vector2<f64>]) -> Vector2<f64> {
    let others = positions.iter().enumerate().filter(|(other, _)| *other != person);
    others.fold(Vector2::zeros(), |push, (_, other)| {
        let away = positions[person] - other;
        let distance = away.norm().max(1e-3);
        push + away / distance * (4.0 * (PERSONAL_SPACE - distance)).clamp(0.0, 1.8)
    })
}

/// What a person is at.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Action {
    Walk { target: Vector2<f64>, speed: f64 },
    Turn { heading: f64 },
    Stand,
    Crouch,
    Sit,
    Reach { arm: usize, goal: Arm, lean: f64 },
}

/// One person's state.
#[derive(Debug, Clone)]
struct Mover {
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

impl Mover {
    fn new(person: usize, config: &SimulationConfig) -> Self {
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

    /// The stance `rest` seconds after the last step.
    fn stance_after(&self, rest: f64) -> Stance {
        Stance {
            position: self.position + self.velocity * rest,
            heading: self.heading + self.turn_rate * rest,
            phase: self.phase + self.phase_rate * rest,
            step: gait::step_length(self.ground_speed()),
            activity: self.activity,
        }
    }

    fn posture_after(&self, rest: f64) -> Posture {
        self.posture.zip(&self.posture_rate, |value, rate| value + rate * rest)
    }

    /// Speed that the feet must make, m/s: turning needs steps too.
    fn ground_speed(&self) -> f64 {
        self.velocity.norm().max(0.3 * self.turn_rate.abs())
    }

    fn advance(&mut self, time: f64, push: &Vector2<f64>) {
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
        // A new action brings a new posture at once.
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

    /// Heading and speed follow the action; the stride follows them.
    fn steer(&mut self, push: &Vector2<f64>) {
        let (wanted_heading, wanted_speed) = match self.action {
            Action::Walk { target, speed } => {
                let way = target - self.position;
                (way.x.atan2(way.y), speed * (way.norm() / 0.5).min(1.0))
            }
            Action::Turn { heading } => (heading, 0.0),
            _ => (self.heading, 0.0),
        };
        let off = (wanted_heading - self.heading + PI).rem_euclid(TAU) - PI;
        self.turn_rate += STEP * (16.0 * off.clamp(-0.9, 0.9) - 8.0 * self.turn_rate);
        self.heading += STEP * self.turn_rate;
        self.speed += STEP * 3.5 * (wanted_speed * off.cos().max(0.0) - self.speed);
        self.push += (push - self.push) * (STEP * 8.0);
        self.velocity = Vector2::new(self.heading.sin(), self.heading.cos()) * self.speed + self.push;
        self.position += self.velocity * STEP;
        let ground = self.ground_speed();
        self.activity += STEP * 5.0 * ((ground / 0.5).min(1.0) - self.activity);
        self.phase_rate = PI * ground / gait::step_length(ground);
        self.phase += STEP * self.phase_rate;
    }

    /// Posture follows its goal through a first-order lag and a critically damped spring: no jump even of acceleration.
    fn pose(&mut self) {
        self.followed = self.followed.zip(&self.goal, |value, goal| value + STEP * POSTURE_RATE * (goal - value));
        let pull = self.followed.zip(&self.posture, |goal, value| POSTURE_RATE * POSTURE_RATE * (goal - value));
        let pull = pull.zip(&self.posture_rate, |pull, rate| pull - 2.0 * POSTURE_RATE * rate);
        self.posture_rate = self.posture_rate.zip(&pull, |rate, pull| rate + STEP * pull);
        self.posture = self.posture.zip(&self.posture_rate, |value, rate| value + STEP * rate);
    }
}

impl Posture {
    /// Combines two postures number by number.
    fn zip(&self, other: &Self, f: impl Fn(f64, f64) -> f64) -> Self {
        let arm = |a: &Arm, b: &Arm| Arm {
            flexion: f(a.flexion, b.flexion),
            abduction: f(a.abduction, b.abduction),
            elbow: f(a.elbow, b.elbow),
            swing: f(a.swing, b.swing),
        };
        Self {
            crouch: f(self.crouch, other.crouch),
            sit: f(self.sit, other.sit),
            lean: f(self.lean, other.lean),
            trunk_yaw: f(self.trunk_yaw, other.trunk_yaw),
            trunk_roll: f(self.trunk_roll, other.trunk_roll),
            head_yaw: f(self.head_yaw, other.head_yaw),
            head_pitch: f(self.head_pitch, other.head_pitch),
            arms: [arm(&self.arms[0], &other.arms[0]), arm(&self.arms[1], &other.arms[1])],
        }
    }
}
