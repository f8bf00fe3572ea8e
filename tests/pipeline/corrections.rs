//! Corrections of planted identity errors: the result is that of the session without the error.

use super::worst_pair_deg;
use std::ops::Range;
use wandless::body::default_body;
use wandless::evaluation::identity_error::{IdentityError, IdentityRow, identity_error};
use wandless::pipeline::checkpoints::Checkpoints;
use wandless::pipeline::corrections::Correction;
use wandless::pipeline::provisional::{ProvisionalScene, Watcher};
use wandless::pipeline::{Options, SolvedSession, solve};
use wandless::progress::Progress;
use wandless::session::{Reconstruction, Session};
use wandless::simulation::{Preset, Simulated, SimulationConfig, Tracks, simulate};

/// Frames in which no camera detects the people of the planted errors: too long for evidence from positions.
const GAP: Range<usize> = 100..190;

fn simulated() -> Simulated {
    let preset = SimulationConfig::preset(Preset::Paper);
    simulate(&SimulationConfig { people: 3, frames: 290, tracks: Tracks::PerView, seed: 11, ..preset }).unwrap()
}

/// Changes the detections with their frame and true person; those for which `change` returns false lose their keypoints.
fn with_detections(
    simulated: &Simulated,
    mut change: impl FnMut(&mut Option<i64>, usize, usize, &dyn Fn(usize) -> Option<i64>) -> bool,
) -> Session {
    let mut session = simulated.session.clone();
    for (view, truth) in session.views.iter_mut().zip(&simulated.truth.identities) {
        let all = view.frames.iter().flatten().zip(truth.iter().flatten());
        let mut numbers = [None; 3];
        all.for_each(|(detection, person)| numbers[person.unwrap()] = detection.track_id.or(numbers[person.unwrap()]));
        let number_of = |person: usize| numbers[person];
        for (frame, (detections, truth)) in view.frames.iter_mut().zip(truth).enumerate() {
            for (detection, person) in detections.iter_mut().zip(truth) {
                if !change(&mut detection.track_id, frame, person.unwrap(), &number_of) {
                    detection.keypoints.iter_mut().for_each(|k| k.confidence = 0.0);
                }
            }
        }
    }
    session
}

fn solved(session: &Session, corrections: Vec<Correction>, earlier: Option<&SolvedSession>) -> SolvedSession {
    let options = Options { corrections, ..Options::default() };
    let earlier = earlier.map(|solved| &solved.continuation);
    solve(session, &options, &default_body(), &Checkpoints::none(), earlier, &Watcher::none(), &Progress::silent())
        .unwrap()
}

/// Identities against the truth; detections without keypoints do not count.
fn identities(simulated: &Simulated, session: &Session, found: &Reconstruction) -> IdentityError {
    let mut rows = Vec::new();
    for ((view, truth), given) in session.views.iter().zip(&simulated.truth.identities).zip(&found.identities) {
        for ((detection, truth), given) in
            view.frames.iter().flatten().zip(truth.iter().flatten()).zip(given.iter().flatten())
        {
            if detection.keypoints.iter().any(|k| k.is_present()) {
                let (truth, given) = (truth.map(|p| p as i64), given.map(|p| p.0.to_string()));
                rows.push(IdentityRow { truth, given, track_id: None });
            }
        }
    }
    identity_error(&rows)
}

/// The person of a result that most detections of a true person in some frames are assigned to.
fn person_of(simulated: &Simulated, found: &Reconstruction, truth: usize, frames: Range<usize>) -> usize {
    let mut counts = [0; 16];
    for (view, given) in simulated.truth.identities.iter().zip(&found.identities) {
        for frame in frames.clone() {
            for (t, given) in view[frame].iter().zip(&given[frame]) {
                if let Some(person) = given.filter(|_| *t == Some(truth)) {
                    counts[person.0] += 1;
                }
            }
        }
    }
    (0..counts.len()).max_by_key(|&person| counts[person]).unwrap()
}

/// Mean distance of the joints of a true person in two results, m, in frames in which it is detected.
fn joint_distance(simulated: &Simulated, a: &Reconstruction, b: &Reconstruction, truth: usize) -> f64 {
    let motion = |found: &Reconstruction| {
        let person = person_of(simulated, found, truth, 0..GAP.start);
        found.motions.iter().find(|motion| motion.person.0 == person).unwrap().clone()
    };
    let (a, b) = (motion(a), motion(b));
    let mut distances = Vec::new();
    for frame in (0..290).filter(|frame| !GAP.contains(frame)) {
        let pose =
            |m: &wandless::session::BodyMotion| m.frames.get(frame.checked_sub(m.first.0)?).map(|pose| pose.joints);
        let (Some(a), Some(b)) = (pose(&a), pose(&b)) else { continue };
        distances.extend(a.iter().zip(&b).map(|(a, b)| (a - b).norm()));
    }
    distances.iter().sum::<f64>() / distances.len() as f64
}

/// Two people come back after a pause with each other's track numbers.
#[test]
fn exchanged_people_are_put_right() {
    let simulated = simulated();
    let in_sight = |frame: usize, person: usize| person == 2 || !GAP.contains(&frame);
    let right = with_detections(&simulated, |_, frame, person, _| in_sight(frame, person));
    let wrong = with_detections(&simulated, |id, frame, person, number_of| {
        if frame >= GAP.end && person < 2 {
            *id = number_of(1 - person);
        }
        in_sight(frame, person)
    });
    let (clean, base) = (solved(&right, Vec::new(), None), solved(&wrong, Vec::new(), None));
    assert!(identities(&simulated, &wrong, &base.reconstruction).accuracy < 0.9, "the error is not planted");
    let people = [0, 1].map(|truth| person_of(&simulated, &base.reconstruction, truth, 0..GAP.start));
    let frame = GAP.end as i64;
    let exchange = || vec![Correction::Exchange { people, frame, last_frame: None }];
    let corrected = solved(&wrong, exchange(), Some(&base)).reconstruction;
    let [before, after] = [&clean.reconstruction, &corrected].map(|found| identities(&simulated, &wrong, found));
    assert_eq!((before.accuracy, after.accuracy), (1.0, 1.0));
    assert!((before.coverage - after.coverage).abs() < 0.002, "{} and {}", before.coverage, after.coverage);
    for truth in 0..3 {
        let distance = joint_distance(&simulated, &clean.reconstruction, &corrected, truth);
        assert!(distance < 0.005, "person {truth}: {distance} m");
    }
    assert_eq!(corrected, solved(&wrong, exchange(), None).reconstruction, "the continuation changes no bit");
}

/// The second half of one person is found as another person that has left: a split and a merge.
#[test]
fn joined_people_are_split_and_merged() {
    let simulated = simulated();
    let in_sight = |frame: usize, person: usize| match person {
        0 => !GAP.contains(&frame),
        1 => frame < GAP.start,
        _ => true,
    };
    let right = with_detections(&simulated, |_, frame, person, _| in_sight(frame, person));
    let wrong = with_detections(&simulated, |id, frame, person, number_of| {
        if frame >= GAP.end && person == 0 {
            *id = number_of(1);
        }
        in_sight(frame, person)
    });
    let (clean, base) = (solved(&right, Vec::new(), None), solved(&wrong, Vec::new(), None));
    assert!(identities(&simulated, &wrong, &base.reconstruction).accuracy < 0.95, "the error is not planted");
    let [zero, one] = [0, 1].map(|truth| person_of(&simulated, &base.reconstruction, truth, 0..GAP.start));
    let corrections = vec![
        Correction::Split { person: one, frame: GAP.end as i64 },
        Correction::Merge { people: vec![zero, 3] },
        Correction::Rename { person: zero, name: "lead".to_owned() },
    ];
    let corrected = solved(&wrong, corrections, Some(&base)).reconstruction;
    assert_eq!(identities(&simulated, &wrong, &corrected).accuracy, 1.0);
    let distance = joint_distance(&simulated, &clean.reconstruction, &corrected, 0);
    assert!(distance < 0.005, "{distance} m");
    let report = corrected.report.people.iter().find(|person| person.id == zero).unwrap();
    assert_eq!(report.name.as_deref(), Some("lead"));
}

/// A bystander and a camera are left out: as if they had not been recorded.
#[test]
fn excluded_people_and_cameras_have_no_effect() {
    let simulated = simulated();
    let base = solved(&simulated.session, Vec::new(), None);
    let without = with_detections(&simulated, |_, _, person, _| person != 2);
    let clean = solved(&without, Vec::new(), None).reconstruction;
    let person = person_of(&simulated, &base.reconstruction, 2, 0..290);
    let corrected = solved(&simulated.session, vec![Correction::ExcludePerson { person }], Some(&base)).reconstruction;
    assert_eq!(corrected.motions.len(), 2);
    let found = identities(&simulated, &without, &corrected);
    assert_eq!(found.accuracy, 1.0);
    let [before, after] = [&clean, &corrected].map(|found| worst_pair_deg(&simulated, found));
    assert!(after < 1.1 * before + 0.01, "{before} degrees without the person, {after} corrected");

    let camera = simulated.session.views[1].id.clone();
    let corrected = solved(&simulated.session, vec![Correction::ExcludeCamera { camera }], Some(&base)).reconstruction;
    assert_eq!(corrected.cameras[1].camera_from_world, None);
    assert!(corrected.report.cameras[1].excluded && corrected.report.cameras[1].n_detections == 0);
    let reasons = &corrected.report.quality.reasons;
    assert!(!reasons.iter().any(|reason| reason.contains("could not be placed")), "{reasons:?}");
    assert!(identities(&simulated, &simulated.session, &corrected).accuracy > 0.999);
}

/// Who watches a solve sees cameras and people before the result, near those of the result, and changes nothing.
#[test]
fn a_watched_solve_gives_the_same_result() {
    let preset = SimulationConfig::preset(Preset::Paper);
    let simulated = simulate(&SimulationConfig { people: 2, views: 4, frames: 90, seed: 3, ..preset }).unwrap();
    let seen = std::cell::RefCell::new(Vec::new());
    let note = |scene: ProvisionalScene| seen.borrow_mut().push(serde_json::to_value(&scene).unwrap());
    let solve_with = |watcher: &Watcher| {
        let (options, body) = (Options::default(), default_body());
        solve(&simulated.session, &options, &body, &Checkpoints::none(), None, watcher, &Progress::silent()).unwrap()
    };
    let (watched, alone) = (solve_with(&Watcher::new(&note)), solve_with(&Watcher::none()));
    assert_eq!(format!("{:?}", watched.reconstruction), format!("{:?}", alone.reconstruction));
    let scenes = seen.into_inner();
    let stages: Vec<&str> = scenes.iter().map(|scene| scene["stage"].as_str().unwrap()).collect();
    assert_eq!(stages, ["cameras", "denoising", "joint_trajectories"]);
    for scene in &scenes {
        assert_eq!((scene["people"].as_array().unwrap().len(), scene["frames"].as_array().unwrap().len()), (2, 90));
        for (camera, solved) in scene["cameras"].as_array().unwrap().iter().zip(&watched.reconstruction.cameras) {
            let position: Vec<f64> = serde_json::from_value(camera["position"].clone()).unwrap();
            let expected = solved.camera_from_world.unwrap().center();
            let off = position.iter().zip(expected.iter()).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
            // Metric scale is not known yet: limbs show it to some 10 per cent of a camera's 5 m.
            assert!(off < 0.15 * expected.norm(), "{off} m of {} m", expected.norm());
        }
    }
}
