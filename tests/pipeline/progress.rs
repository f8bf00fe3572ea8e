//! Progress of whole runs: the share of the work never falls and ends at 1, for every set of passes.

use std::sync::{Arc, Mutex};
use wandless::pipeline::config::{Extrinsics, IntrinsicsMode, MotionPriorMode, ScaleSource, Sync};
use wandless::pipeline::{Options, reconstruct};
use wandless::progress::{Progress, ProgressEvent};
use wandless::session::Session;
use wandless::simulation::{Preset, SimulationConfig, simulate};

fn events_of(session: &Session, options: &Options) -> Vec<ProgressEvent> {
    let events = Arc::new(Mutex::new(Vec::new()));
    let listener = events.clone();
    let progress = Progress::new(move |event| listener.lock().unwrap().push(event.clone()), Arc::default());
    reconstruct(session, options, &progress).unwrap();
    events.lock().unwrap().clone()
}

#[test]
fn progress_never_falls_and_ends_at_one_for_all_options() {
    let config = SimulationConfig { people: 2, views: 4, frames: 60, ..SimulationConfig::preset(Preset::Easy) };
    let simulated = simulate(&config).unwrap();
    let mut posed = simulated.session.clone();
    for (view, truth) in posed.views.iter_mut().zip(&simulated.truth.cameras) {
        view.camera_from_world = Some(*truth);
    }
    let default = Options::default;
    let height = ScaleSource::Height { metres: 1.75, who: "tallest".to_owned() };
    let (sync, focal) = (Sync::Estimate, IntrinsicsMode::RefineFocal);
    let runs = [
        (&simulated.session, default(), 7),
        (&simulated.session, Options { denoise: false, ..default() }, 6),
        (&simulated.session, Options { sync, intrinsics: focal, scale: height, ..default() }, 9),
        (&simulated.session, Options { sync, denoise: false, collision: false, ..default() }, 7),
        (&posed, Options { extrinsics: Extrinsics::Fixed, motion_prior: MotionPriorMode::None, ..default() }, 7),
        (&posed, Options { extrinsics: Extrinsics::Fixed, denoise: false, ..default() }, 6),
        (&posed, Options { extrinsics: Extrinsics::Refine, intrinsics: focal, ..default() }, 8),
    ];
    for (session, options, n_stages) in runs {
        let events = events_of(session, &options);
        let pairs = || events.iter().zip(&events[1..]);
        assert!(pairs().all(|(a, b)| a.fraction <= b.fraction && a.stage_index <= b.stage_index), "{options:?}");
        assert!(
            events.iter().all(|event| event.stage_count == n_stages && event.stage_index < n_stages),
            "{options:?}"
        );
        let begun = pairs().filter(|(a, b)| a.stage != b.stage).count() + 1;
        assert_eq!(begun, n_stages, "{options:?}");
        assert_eq!((events[0].fraction, events.last().unwrap().fraction), (0.0, 1.0), "{options:?}");
        let steps = events.iter().map(|event| &event.message).filter(|message| !message.is_empty());
        for step in steps {
            assert!(step.split(' ').next().unwrap().ends_with("ing"), "{step:?} is not an activity");
        }
    }
}
