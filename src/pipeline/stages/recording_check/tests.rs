//! Each test sees its mistake, and nothing in a right recording.

use super::agreement::explained_share;
use super::block_step::Step;
use super::clock::slip;
use super::handedness::{handedness, upside_down};
use super::labels::exchange;
use super::lens::SeenPeople;
use super::movement::{turn, zoom};
use super::parameters::{delays, likeliest_exchange, smaller_images, wrong_lenses};
use super::reading::{Question, Reading};
use super::takes::{Groups, groups};
use crate::body::detector_noise::DetectorNoise;
use crate::geometry::Rigid;
use crate::matching::normalized::normalized_views;
use crate::matching::tracklets::{Tracklet, TrackletConfig, tracklets};
use crate::pipeline::calibration::{Adjusted, AdjustedCamera, CameraUncertainty, FocalEstimate, TrackedPeople};
use crate::pipeline::focal_spread::{FoundFactors, MIN_LOG_EVIDENCE};
use crate::session::{FrameIndex, JointTrajectory, PersonId, PersonTrack, Session};
use crate::simulation::mistakes::MISTAKES;
use crate::simulation::{Preset, SimulationConfig, simulate};
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// A simulated recording with its true cameras and people.
struct Scene {
    session: Session,
    cameras: Vec<Option<Rigid>>,
    people: Vec<JointTrajectory>,
    tracks: Vec<PersonTrack>,
}

fn scene() -> Scene {
    let config = SimulationConfig { frames: 150, views: 4, ..SimulationConfig::preset(Preset::Paper) };
    let simulated = simulate(&config).unwrap();
    let truth = &simulated.truth;
    let person = |i: usize| JointTrajectory {
        person: PersonId(i),
        first: FrameIndex(0),
        points: truth.keypoints.iter().map(|people| people[i].iter().map(|p| Some(*p)).collect()).collect(),
        n_views: truth.keypoints.iter().map(|people| vec![4; people[i].len()]).collect(),
    };
    let people: Vec<JointTrajectory> = (0..truth.people.len()).map(person).collect();
    let tracks = (0..people.len()).map(|i| track(&simulated.session, &truth.identities, i)).collect();
    Scene { cameras: truth.cameras.iter().copied().map(Some).collect(), session: simulated.session, people, tracks }
}

/// The true detections of a person.
fn track(session: &Session, identities: &[Vec<Vec<Option<usize>>>], person: usize) -> PersonTrack {
    let at = |view: usize, frame: usize| identities[view][frame].iter().position(|id| *id == Some(person));
    let of_frame = |frame| (0..session.views.len()).map(|view| at(view, frame)).collect();
    let detections = (0..session.n_frames).map(of_frame).collect();
    PersonTrack { person: PersonId(person), first: FrameIndex(0), detections }
}

/// What a test finds in the people of a scene.
fn of_people<T>(scene: &Scene, test: impl Fn(&TrackedPeople) -> T) -> T {
    let noise = DetectorNoise::published(scene.session.convention);
    let Scene { session, cameras, people, tracks } = scene;
    test(&TrackedPeople { session, noise: &noise, cameras, tracks, points: people })
}

fn with_mistake(scene: Scene, name: &str) -> Scene {
    let mistake = MISTAKES.iter().find(|mistake| mistake.name == name).unwrap();
    Scene { session: (mistake.inject)(&scene.session).unwrap(), ..scene }
}

fn followed(session: &Session, view: usize) -> Vec<Tracklet> {
    tracklets(&normalized_views(session)[view], session.fps, &TrackletConfig::default())
}

/// The best other reading of the second camera's files, and the shares that it and the files as they are explain.
fn reading(scene: &Scene) -> (Reading, f64, f64) {
    let question = Question {
        session: &scene.session,
        view: 1,
        tracklets: &followed(&scene.session, 1),
        people: &scene.people,
        camera: scene.cameras[1].as_ref(),
        seed: 0,
    };
    let [given, other, factor] = question.judged();
    let best = if factor.explained > other.explained { factor } else { other };
    (best.reading, best.explained, given.explained)
}

#[test]
fn names_the_reading_that_explains_a_camera() {
    let cases = [
        ("images mirrored in one camera", Reading::Mirrored),
        ("y counted upwards in one camera", Reading::Mirrored),
        ("left and right exchanged in one camera", Reading::LabelsExchanged),
    ];
    for (name, expected) in cases {
        let (best, explained, given) = reading(&with_mistake(scene(), name));
        assert!(best == expected && explained > given + 0.2, "{name}: {best:?} {explained} {given}");
    }
    let (best, explained, given) = reading(&with_mistake(scene(), "7 frames late"));
    let is_near = matches!(best, Reading::Late(6..=8));
    assert!(is_near && explained > given, "{best:?} {explained} {given}");
}

#[test]
fn a_right_camera_is_explained_as_it_is() {
    let scene = scene();
    let (best, explained, given) = reading(&scene);
    assert!(given > 0.9 && explained < given + 0.01, "{best:?} {explained} {given}");
    let view = &normalized_views(&scene.session)[1];
    let turned = scene.cameras[1].unwrap().perturbed_left(&Vector3::zeros(), &Vector3::new(0.0, 0.1, 0.0));
    assert!(explained_share(view, &turned, &scene.people, 0) < 0.3);
}

#[test]
fn exchanged_labels_fit_the_other_way_round() {
    let shown = |scene: &Scene| {
        let camera = scene.cameras[1].as_ref().unwrap();
        let view = &normalized_views(&scene.session)[1];
        exchange(scene.session.convention, 1, view, camera, &scene.tracks, &scene.people)
    };
    let (right, wrong) = (shown(&scene()), shown(&with_mistake(scene(), "left and right exchanged in one camera")));
    assert!(right.n > 50 && right.exchanged < 0.1, "{right:?}");
    assert!(wrong.n > 50 && wrong.exchanged > 0.9, "{wrong:?}");
}

#[test]
fn people_of_a_mirrored_world_look_backwards() {
    let Scene { session, people, .. } = scene();
    let right = handedness(session.convention, &people, session.fps).unwrap();
    assert!(right.n >= 8 && right.backwards < 0.2 && !right.is_mirrored(), "{right:?}");
    let mut mirrored = people;
    mirrored.iter_mut().flat_map(|p| p.points.iter_mut().flatten().flatten()).for_each(|point| point.x = -point.x);
    assert!(handedness(session.convention, &mirrored, session.fps).unwrap().is_mirrored());
}

#[test]
fn people_are_upside_down_where_y_counts_upwards() {
    let share = |scene: Scene| upside_down(scene.session.convention, &scene.session.views[1]).unwrap();
    assert!(share(scene()) < 0.1);
    assert!(share(with_mistake(scene(), "y counted upwards in one camera")) > 0.9);
}

#[test]
fn a_knocked_camera_has_a_step() {
    let steps = |scene: &Scene| -> Vec<f64> {
        of_people(scene, |people| (0..people.cameras.len()).map(|view| turn(people, view).unwrap().sigmas).collect())
    };
    assert!(steps(&scene()).iter().all(|sigmas| *sigmas < 6.0), "{:?}", steps(&scene()));
    let knocked = steps(&with_mistake(scene(), "camera knocked by 0.5 degrees"));
    assert!(knocked[1] > 8.0 && knocked.iter().all(|sigmas| *sigmas <= knocked[1]), "{knocked:?}");
}

/// A camera that zoomed by 10 % halfway passed, its pose 74 mm off and stated to 4.
#[test]
fn a_camera_that_zooms_has_a_step() {
    let step_of = |scene: Scene| of_people(&scene, |people| zoom(people, 1).unwrap());
    let Step { frame, size, sigmas, .. } = step_of(with_mistake(scene(), "camera zoomed by 10 %"));
    assert!(frame.abs_diff(75) <= 15 && (size - 1.1f64.ln()).abs() < 0.02 && sigmas > 10.0, "{frame} {size} {sigmas}");
    let still = step_of(scene());
    assert!(still.sigmas < 5.0 || still.size < 0.01, "{still:?}");
    let knocked = step_of(with_mistake(scene(), "camera knocked by 0.5 degrees"));
    assert!(knocked.size < 0.01, "{knocked:?}");
}

/// A constant delay has no step, dropped frames have one of their number.
#[test]
fn a_camera_that_drops_frames_has_a_step() {
    let slips = |scene: &Scene| -> Vec<Step> {
        of_people(scene, |people| (0..people.cameras.len()).map(|view| slip(people, view).unwrap()).collect())
    };
    let shifted = |n_before: i64, n_after: i64| {
        let mut scene = scene();
        let truth = (scene.session.views[1].frames.clone(), scene.tracks.clone());
        for frame in 0..scene.session.n_frames {
            let late = if frame < 75 { n_before } else { n_after };
            let shown = (frame as i64 - late).clamp(0, 149) as usize;
            scene.session.views[1].frames[frame] = truth.0[shown].clone();
            for (track, right) in scene.tracks.iter_mut().zip(&truth.1) {
                track.detections[frame][1] = right.detections[shown][1];
            }
        }
        scene
    };
    for right in [slips(&scene()), slips(&shifted(2, 2))] {
        assert!(right.iter().all(|step| step.size < 0.6 || step.sigmas < 5.0), "{right:?}");
    }
    let dropped = slips(&shifted(0, -2))[1];
    assert!((dropped.size - 2.0).abs() < 0.5 && dropped.sigmas > 5.0, "{dropped:?}");
    assert!(dropped.frame.abs_diff(75) <= 15, "{dropped:?}");
}

/// Two cameras that see a runner for twelve frames were no cameras of one take.
#[test]
fn the_seconds_of_a_runner_were_two_takes() {
    let Scene { session, cameras, mut tracks, mut people } = scene();
    let noise = DetectorNoise::published(session.convention);
    tracks.truncate(1);
    people.truncate(1);
    tracks[0].detections.truncate(12);
    people[0].points.truncate(12);
    let people =
        TrackedPeople { session: &session, noise: &noise, cameras: &cameras, tracks: &tracks, points: &people };
    assert_eq!(groups(&people).connected.len(), 1);
}

#[test]
fn cameras_without_common_people_are_groups() {
    let Scene { session, cameras, tracks, people } = scene();
    let noise = DetectorNoise::published(session.convention);
    let groups = |tracks: &[PersonTrack], points: &[JointTrajectory]| {
        groups(&TrackedPeople { session: &session, noise: &noise, cameras: &cameras, tracks, points })
    };
    assert_eq!(groups(&tracks, &people).connected.len(), 1);
    let of_views = |track: &PersonTrack, views: [usize; 2], one_in: usize| {
        let mut part = track.clone();
        let apart = part.detections.iter_mut().enumerate().filter(|(t, _)| !t.is_multiple_of(one_in));
        for assigned in apart.map(|(_, assigned)| assigned) {
            assigned.iter_mut().enumerate().filter(|(view, _)| !views.contains(view)).for_each(|(_, d)| *d = None);
        }
        part
    };
    let split = |one_in: usize| -> Vec<PersonTrack> {
        tracks.iter().flat_map(|track| [[0, 1], [2, 3]].map(|views| of_views(track, views, one_in))).collect()
    };
    let twice: Vec<JointTrajectory> = people.iter().flat_map(|person| [person.clone(), person.clone()]).collect();
    // As people of two takes are, one in twenty is seen by both groups at once by chance.
    assert_eq!(groups(&split(20), &twice).connected, [[0, 1], [2, 3]]);
    // Two cameras of the same people, started two seconds after the others, were connected with these by a third of the people.
    let Groups { connected, close } = groups(&split(3), &twice);
    assert_eq!((connected.len(), close), (1, vec![vec![0, 1], vec![2, 3]]));
}

/// Two of four cameras were stopped a second after the others had been started: they were said to show another take.
#[test]
fn cameras_that_share_a_second_were_two_takes() {
    let mut apart = scene();
    for (view, recorded) in [(0, 0..90), (1, 0..90), (2, 60..150), (3, 60..150)] {
        for frame in (0..150).filter(|frame| !recorded.contains(frame)) {
            apart.session.views[view].frames[frame].clear();
            apart.tracks.iter_mut().for_each(|track| track.detections[frame][view] = None);
        }
    }
    assert_eq!(of_people(&apart, groups).connected, [[0, 1, 2, 3]]);
}

#[test]
fn a_resection_finds_a_wrong_focal_length() {
    let found = |scene: &Scene| {
        of_people(scene, |people| SeenPeople::of(people, 1).unwrap().resected().map(|lens| lens.factor))
    };
    assert_eq!(found(&scene()), None);
    let factor = found(&with_mistake(scene(), "focal length +20 %")).unwrap();
    assert!((factor * 1.2).ln().abs() < 0.06, "{factor}");
}

/// A camera with `fy` 10 % off passed, its pose 227 mm off.
#[test]
fn a_resection_finds_stretched_images() {
    let found = |scene: &Scene| of_people(scene, |people| SeenPeople::of(people, 1).unwrap().likeliest_aspect());
    assert!(found(&scene()).ln().abs() < 0.01, "{}", found(&scene()));
    let aspect = found(&with_mistake(scene(), "images stretched by 10 %"));
    assert!((aspect * 1.1).ln().abs() < 0.02, "{aspect}");
}

fn adjusted(delays: &[f64], log_factors: &[f64]) -> Adjusted {
    let uncertainty = CameraUncertainty {
        sigma_position: 0.01,
        sigma_angle: 0.001,
        sigma_delay: Some(0.05),
        sigma_drift: None,
        sigma_radial: None,
    };
    let camera = |delay: &f64| AdjustedCamera {
        camera_from_world: None,
        focal_factor: 1.0,
        delay: *delay,
        drift: 0.0,
        radial: 0.0,
        is_observed: true,
        uncertainty: Some(uncertainty),
    };
    let n = log_factors.len();
    let variance = |i: usize| (0..n).map(|j| if i == j { 1e-4 } else { 0.0 }).collect();
    Adjusted {
        cameras: delays.iter().map(camera).collect(),
        points: Vec::new(),
        bone_lengths: BTreeMap::new(),
        focal: Some(FocalEstimate {
            views: (0..n).collect(),
            log_factors: log_factors.to_vec(),
            covariance: (0..n).map(variance).collect(),
        }),
    }
}

#[test]
fn a_late_camera_is_late_against_most_others() {
    let found: Vec<(usize, f64)> =
        delays(&adjusted(&[0.0, 2.1, 0.1, 0.05, -0.1], &[])).iter().map(|d| (d.view, d.frames)).collect();
    assert_eq!(found, [(1, 2.1 - 0.05)]);
    assert_eq!(delays(&adjusted(&[-2.0, 0.1, 0.0, 0.1, 0.2], &[])).len(), 1, "the reference itself");
    assert!(delays(&adjusted(&[0.0, 0.3, -0.3, 0.1], &[])).is_empty());
}

/// Factors as an adjustment of five cameras finds them, each to 1 %.
fn found(log_factors: &[f64; 5]) -> FoundFactors {
    FoundFactors::of_adjustment(&adjusted(&[], log_factors).focal.unwrap(), |_| 0.0, 0.1).unwrap()
}

/// One of six cameras whose people stayed in a corner was given smaller images when all lenses were 20 % too long.
#[test]
fn wrong_lenses_were_taken_for_smaller_images() {
    let views = [0, 1, 2, 3, 4];
    let size = |log_factors: &[f64; 5], smaller: &[usize]| {
        let shown = found(log_factors);
        let lenses = wrong_lenses(&shown, &views)?;
        smaller_images(&shown, &views, smaller, log_factors[smaller[0]].exp(), lenses.log_evidence)
    };
    assert_eq!(size(&[-0.18; 5], &[2]), None);
    assert_eq!(size(&[-0.29; 5], &[2]), None, "three quarters, but so are all others");
    assert_eq!(size(&[0.005, -0.40, 0.01, -0.005, 0.0], &[1]), Some(2.0 / 3.0));
    assert_eq!(size(&[0.005, -0.17, 0.01, -0.005, 0.0], &[1]), None, "no usual size");
}

#[test]
fn a_wrong_lens_is_named_and_errors_of_a_few_per_cent_are_not() {
    let lenses = |log_factors| wrong_lenses(&found(log_factors), &[0, 1, 2, 3, 4]);
    let one = lenses(&[0.005, -0.17, 0.01, -0.005, 0.0]).unwrap();
    assert_eq!((one.factors.len(), one.factors[0].0, one.is_common), (1, 1, false));
    assert!(lenses(&[-0.1, 0.1, -0.11, 0.09, -0.1]).unwrap().is_common);
    let few = lenses(&[0.02, -0.02, 0.01, -0.01, 0.015]);
    assert!(few.is_none_or(|lenses| lenses.log_evidence < MIN_LOG_EVIDENCE));
}

/// With focal lengths that differ by 8 %: an exchange has the factors that it must have, other errors have not.
#[test]
fn exchanged_calibrations_are_no_wrong_ones() {
    let exchange = |log_factors| {
        let focal = |view: usize| 1000.0 * (0.08 * view as f64).exp();
        likeliest_exchange(&found(log_factors), &[0, 1, 2, 3, 4], focal).map(|exchange| exchange.views)
    };
    assert_eq!(exchange(&[0.005, 0.085, -0.075, -0.005, 0.0]), Some([1, 2]));
    assert_eq!(exchange(&[0.005, 0.17, -0.005, -0.155, 0.0]), Some([1, 3]));
    assert_eq!(exchange(&[0.005, -0.085, 0.075, -0.005, 0.0]), None, "the other way round");
    assert_eq!(exchange(&[0.01, 0.08, 0.0, 0.005, -0.01]), None, "one lens alone");
    assert_eq!(exchange(&[0.02, -0.02, 0.01, -0.01, 0.015]), None);
}
