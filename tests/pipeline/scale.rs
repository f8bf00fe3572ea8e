//! Metric scale from the known height of one person.

use wandless::body::default_body;
use wandless::evaluation::alignment::{Alignment, truth_from_solved};
use wandless::pipeline::config::ScaleSource;
use wandless::pipeline::{Options, PipelineError, reconstruct};
use wandless::progress::Progress;
use wandless::session::Reconstruction;
use wandless::simulation::{Bodies, Preset, Simulated, SimulationConfig, Tracks, simulate};

/// Two default bodies of random build in four cameras, with correct track ids.
fn two_people() -> Simulated {
    let preset = SimulationConfig::preset(Preset::Paper);
    let config = SimulationConfig { people: 2, views: 4, frames: 100, seed: 3, ..preset };
    simulate(&SimulationConfig { bodies: Bodies::Default, tracks: Tracks::Consistent, ..config }).unwrap()
}

fn statures(simulated: &Simulated) -> Vec<f64> {
    let body = default_body();
    simulated.truth.people.iter().map(|person| body.surface.stature(&person.betas.unwrap())).collect()
}

fn with_height(simulated: &Simulated, metres: f64, who: &str) -> Result<Reconstruction, PipelineError> {
    let scale = ScaleSource::Height { metres, who: who.to_owned() };
    reconstruct(&simulated.session, &Options { scale, ..Options::default() }, &Progress::silent())
}

/// Percentage by which the result is too large, and whether its interval contains the true size.
fn scale_error(simulated: &Simulated, found: &Reconstruction) -> (f64, bool) {
    let placed = found.cameras.iter().zip(&simulated.truth.cameras);
    let (solved, truth): (Vec<_>, Vec<_>) = placed.map(|(c, t)| (c.camera_from_world.unwrap(), *t)).unzip();
    let truth_from_found = truth_from_solved(&solved, &truth, Alignment::Sim3).scale;
    let scale = found.report.scale.as_ref().unwrap();
    let [low, high] = scale.interval95.map(|edge| edge / scale.value);
    (100.0 * (1.0 / truth_from_found - 1.0), (low..=high).contains(&truth_from_found))
}

/// A stated height is accurate to 1 % (shoes, posture); the fit must add less.
#[test]
fn height_of_one_person_gives_scale_to_half_a_percent() {
    let simulated = two_people();
    let statures = statures(&simulated);
    let tallest = statures.iter().copied().fold(0.0, f64::max);
    for (metres, who) in [(tallest, "tallest"), (statures[0], "0"), (statures[1], "1")] {
        let (percent, holds) = scale_error(&simulated, &with_height(&simulated, metres, who).unwrap());
        println!("{who}: {percent:+.2} %");
        assert!(percent.abs() < 0.5 && holds, "{who}: {percent} %");
    }
}

/// An adult's proportions at a child's height, five standard deviations below the mean, are outside the body model: the error
/// uses half of the interval of 3.5 %.
#[test]
fn height_of_a_child_gives_a_smaller_scale() {
    let simulated = two_people();
    let tallest = statures(&simulated).into_iter().fold(0.0, f64::max);
    let (percent, _) = scale_error(&simulated, &with_height(&simulated, 0.75 * tallest, "tallest").unwrap());
    assert!((percent + 25.0).abs() < 1.8, "{percent} %");
}

#[test]
fn refuses_the_height_of_an_unknown_track_id() {
    let error = with_height(&two_people(), 1.8, "77").unwrap_err();
    assert!(matches!(&error, PipelineError::Option { option: "/scale/who", reason } if reason.contains("\"77\"")));
}
