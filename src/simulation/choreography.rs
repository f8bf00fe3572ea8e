//! Random motions of several people, who walk, stop, turn, crouch, sit, reach and gesture, and avoid each other.
//!
//! Time advances in fixed steps, so that a motion does not depend on the frame rate.

use super::action_generator::{ActionGenerator, STEP};
use super::config::SimulationConfig;
use super::gait;
use super::skeleton::SimulatedPerson;
use nalgebra::Vector2;

/// Time that is simulated before the first frame, s, so that people do not start at rest in a T-pose.
const WARM_UP: f64 = 2.0;
/// People nearer to each other than this step aside, m between the midpoints of their feet.
const PERSONAL_SPACE: f64 = 0.9;

/// The people of a configuration, each with a random body and a random sequence of actions.
pub fn procedural_people(config: &SimulationConfig) -> Vec<SimulatedPerson> {
    let mut generators: Vec<ActionGenerator> =
        (0..config.people).map(|person| ActionGenerator::new(person, config)).collect();
    let mut people: Vec<SimulatedPerson> =
        (0..config.people).map(|p| SimulatedPerson::still(config, p, "procedural")).collect();
    let mut step = 0_u64;
    for frame in 0..config.frames {
        let due = WARM_UP + frame as f64 / config.fps;
        // Up to the last step before the frame; the rest is extrapolated linearly.
        while (step + 1) as f64 * STEP <= due {
            advance_all(&mut generators, step as f64 * STEP);
            step += 1;
        }
        let rest = due - step as f64 * STEP;
        for (person, generator) in people.iter_mut().zip(&generators) {
            person.poses.push(gait::pose(
                &person.skeleton,
                &generator.stance_after(rest),
                &generator.posture_after(rest),
            ));
        }
    }
    people
}

fn advance_all(generators: &mut [ActionGenerator], time: f64) {
    let positions: Vec<Vector2<f64>> = generators.iter().map(|generator| generator.position()).collect();
    for (person, generator) in generators.iter_mut().enumerate() {
        let push = push_from_others(person, &positions);
        generator.advance(time, &push);
    }
}

/// Velocity that moves a person away from the others, m/s.
fn push_from_others(person: usize, positions: &[Vector2<f64>]) -> Vector2<f64> {
    let others = positions.iter().enumerate().filter(|(other, _)| *other != person);
    others.fold(Vector2::zeros(), |push, (_, other)| {
        let away = positions[person] - other;
        let distance = away.norm().max(1e-3);
        push + away / distance * (4.0 * (PERSONAL_SPACE - distance)).clamp(0.0, 1.8)
    })
}
