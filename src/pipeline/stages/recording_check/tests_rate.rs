//! Steps and movements show the frame rate.

use super::frame_rate::{POSSIBLE_RATIOS, steps};
use super::gravity::Accelerations;
use super::motion_rate::{MotionRate, motion_rate};
use crate::body::skeleton::KeypointConvention;
use crate::session::{FrameIndex, JointTrajectory, PersonId};
use crate::simulation::{MotionSource, Preset, SimulationConfig, simulate};
use nalgebra::Vector3;

/// Of the simulated world.
const UP: Vector3<f64> = Vector3::new(0.0, 1.0, 0.0);

/// Keypoints of simulated people, their convention and frame rate.
fn people(config: &SimulationConfig) -> (Vec<JointTrajectory>, KeypointConvention, f64) {
    let simulated = simulate(config).unwrap();
    let keypoints = &simulated.truth.keypoints;
    let person = |i: usize| JointTrajectory {
        person: PersonId(i),
        first: FrameIndex(0),
        points: keypoints.iter().map(|people| people[i].iter().map(|p| Some(*p)).collect()).collect(),
        n_views: Vec::new(),
    };
    let people = (0..simulated.truth.people.len()).map(person).collect();
    (people, simulated.session.convention, simulated.session.fps)
}

#[test]
fn steps_show_the_frame_rate() {
    let (people, convention, fps) = people(&SimulationConfig { frames: 300, ..SimulationConfig::preset(Preset::Easy) });
    let ratio = |rate: f64| steps(convention, &people, &UP, rate * fps).unwrap().ratio;
    let [least, most] = POSSIBLE_RATIOS;
    assert!((least..most).contains(&ratio(1.0)), "{}", ratio(1.0));
    assert!(ratio(0.25) > most && ratio(2.4) < least, "{} {}", ratio(0.25), ratio(2.4));
}

/// The seed's people take too few steps from place to place.
#[test]
fn a_wrong_rate_passed_where_people_hardly_walk() {
    for seed in 0..3 {
        let (people, convention, fps) =
            people(&SimulationConfig { frames: 300, seed, ..SimulationConfig::preset(Preset::Paper) });
        let found = |rate: f64| {
            let shown = steps(convention, &people, &UP, rate * fps);
            motion_rate(convention, &people, &UP, rate * fps, shown).unwrap()
        };
        let right = found(1.0);
        assert!(!right.is_wrong() && (right.range[0]..=right.range[1]).contains(&1.0), "{seed}: {right:?}");
        let is_wrong = |rate: f64| {
            let MotionRate { factor, .. } = found(rate);
            found(rate).is_wrong() && (factor * rate).ln().abs() < 0.6
        };
        for rate in [0.25, 0.4, 2.4, 4.0] {
            assert!(is_wrong(rate), "{seed}, {rate}: {:?}", found(rate));
        }
    }
}

/// Dancers who held their poses were too slow for people, at six times the rate.
#[test]
fn people_who_stand_still_show_no_rate() {
    let (mut people, convention, fps) =
        people(&SimulationConfig { frames: 300, ..SimulationConfig::preset(Preset::Paper) });
    for person in &mut people {
        let first = person.points[0].clone();
        for (t, points) in person.points.iter_mut().enumerate() {
            let breath = 0.005 * (0.25 * std::f64::consts::TAU * t as f64 / fps).sin(); // 15 breaths a minute, 5 mm
            *points = first.iter().map(|p| p.map(|p| p + Vector3::repeat(breath))).collect();
        }
    }
    let shown = steps(convention, &people, &UP, fps);
    let found = motion_rate(convention, &people, &UP, fps, shown).unwrap();
    assert!(!found.is_wrong() && !found.is_human, "{found:?}");
}

#[test]
fn runners_are_known_at_any_frame_rate() {
    let running = SimulationConfig {
        people: 1,
        frames: 120,
        motion: MotionSource::Running { speed: 6.0 },
        ..SimulationConfig::preset(Preset::Easy)
    };
    let (people, convention, fps) = people(&running);
    for rate in [0.5, 1.0, 2.0] {
        assert!(steps(convention, &people, &UP, rate * fps).is_some_and(|steps| steps.is_running), "{rate}");
    }
    let (walkers, convention, fps) =
        self::people(&SimulationConfig { frames: 300, ..SimulationConfig::preset(Preset::Easy) });
    assert!(steps(convention, &walkers, &UP, 2.0 * fps).is_some_and(|steps| !steps.is_running));
}

/// A runner who crossed the images in 1.5 s was too fast for people.
#[test]
fn two_steps_of_a_runner_were_too_few() {
    let running = SimulationConfig {
        people: 1,
        frames: 120,
        motion: MotionSource::Running { speed: 6.0 },
        ..SimulationConfig::preset(Preset::Easy)
    };
    let (mut people, convention, fps) = people(&running);
    let n_steps = |people: &[JointTrajectory]| steps(convention, people, &UP, fps).map_or(0, |steps| steps.n);
    while n_steps(&people) > 2 {
        people[0].points.pop();
    }
    assert!(steps(convention, &people, &UP, fps).is_some_and(|steps| steps.is_running));
}

/// A stiff person who goes up and down as `height` says, m by s.
fn moving_up_and_down(height: impl Fn(f64) -> f64) -> (Vec<JointTrajectory>, KeypointConvention, f64) {
    let (mut people, convention, fps) =
        people(&SimulationConfig { people: 1, frames: 250, ..SimulationConfig::preset(Preset::Easy) });
    let standing = people[0].points[0].clone();
    for (t, points) in people[0].points.iter_mut().enumerate() {
        let moved = UP * height(t as f64 / fps);
        *points = standing.iter().map(|p| p.map(|p| p + moved)).collect();
    }
    (people, convention, fps)
}

/// Jumps of 0.5 s every 2 s: height from falls, $h = g t (T - t) / 2$.
#[test]
fn flights_show_the_frame_rate() {
    let jumps = |secs: f64| {
        let (t, flight) = (secs.rem_euclid(2.0), 0.5);
        if t < flight { 0.5 * 9.81 * t * (flight - t) } else { 0.0 }
    };
    let (people, convention, fps) = moving_up_and_down(jumps);
    let shown = Accelerations::of_people(convention, &people, &UP).unwrap();
    assert_eq!([0.5, 0.7, 1.0, 1.4, 2.0].map(|rate| shown.n_flights(rate * fps)), [0, 0, 5, 0, 0]);
    let strongest = |rate: f64| shown.strongest(rate * fps).unwrap();
    assert!((0.8..1.0).contains(&strongest(1.0)) && strongest(1.4) > 1.5, "{} {}", strongest(1.0), strongest(1.4));
    assert!(shown.log_likelihood(1.4 * fps) < shown.log_likelihood(fps) - 5.0);
}

/// Knees that bend 10 cm once a second: 2 m/s^2 at most, which four times the rate makes 32.
#[test]
fn no_floor_pulls_people_down() {
    let (people, convention, fps) = moving_up_and_down(|secs| 0.05 * (secs * std::f64::consts::TAU).cos());
    let shown = Accelerations::of_people(convention, &people, &UP).unwrap();
    assert!(shown.strongest(fps).unwrap() < 0.25, "{:?}", shown.strongest(fps));
    assert!(shown.strongest(4.0 * fps).unwrap() > 1.3, "{:?}", shown.strongest(4.0 * fps));
    assert_eq!(shown.log_likelihood(fps), 0.0);
    assert!(shown.log_likelihood(4.0 * fps) < -2.0);
}
