//! Mistakes in the files that a solve named wrongly, or not at all.

use nalgebra::Vector2;
use wandless::body::skeleton::KeypointConvention;
use wandless::geometry::Intrinsics;
use wandless::pipeline::config::Repair;
use wandless::pipeline::{Options, PipelineError, as_solved, reconstruct};
use wandless::progress::Progress;
use wandless::session::{Session, Suspicion, SuspicionCode as Code};
use wandless::simulation::mistakes::MISTAKES;
use wandless::simulation::{Preset, SimulationConfig, simulate};

fn session(views: usize) -> Session {
    let config = SimulationConfig { views, frames: 150, ..SimulationConfig::preset(Preset::Paper) };
    simulate(&config).unwrap().session
}

fn with_mistake(session: &Session, name: &str) -> Session {
    let mistake = MISTAKES.iter().find(|mistake| mistake.name == name).unwrap();
    (mistake.inject)(session).unwrap()
}

/// Codes and cameras of what a solve suspects, or of the error that it ends with.
fn suspected(session: &Session, options: &Options) -> Vec<(Code, Vec<String>)> {
    let suspicions: Vec<Suspicion> = match reconstruct(session, options, &Progress::silent()) {
        Ok(found) => found.report.suspicions,
        Err(PipelineError::Unsolvable { suspicions, .. }) => suspicions,
        Err(error) => panic!("{error}"),
    };
    suspicions.into_iter().map(|suspicion| (suspicion.code, suspicion.cameras)).collect()
}

fn ids(session: &Session, views: &[usize]) -> Vec<String> {
    views.iter().map(|&view| session.views[view].id.clone()).collect()
}

/// The camera's pose and the people's points took up most of such an error, so that nothing was suspected.
#[test]
fn a_calibration_of_larger_images_passed() {
    let right = session(5);
    let wrong = with_mistake(&right, "calibration of 1.5 times the resolution");
    assert_eq!(suspected(&wrong, &Options::default()), [(Code::Resolution, ids(&right, &[1]))]);
}

/// Their focal lengths differ too little for an adjustment of focal lengths; their principal points do not.
#[test]
fn exchanged_cameras_with_similar_focal_lengths_passed() {
    let mut right = session(5);
    let lens = right.views[1].intrinsics;
    let partner = &mut right.views[2];
    let other = partner.intrinsics;
    let moved = Intrinsics { cx: lens.cx + 60.0, cy: lens.cy - 20.0, ..other };
    for keypoint in partner.frames.iter_mut().flatten().flat_map(|d| &mut d.keypoints).filter(|k| k.is_present()) {
        keypoint.pixel.x += moved.cx - other.cx;
        keypoint.pixel.y += moved.cy - other.cy;
    }
    partner.intrinsics = moved;
    assert_eq!(suspected(&right, &Options::default()), []);
    let mut wrong = right.clone();
    let frames = std::mem::take(&mut wrong.views[2].frames);
    wrong.views[2].frames = std::mem::replace(&mut wrong.views[1].frames, frames);
    assert_eq!(suspected(&wrong, &Options::default()), [(Code::CamerasExchanged, ids(&right, &[1, 2]))]);
}

/// Every camera was said to explain too little of its keypoints.
#[test]
fn too_few_people_were_blamed_on_cameras() {
    let session = session(4);
    let options = |people: usize| Options { people: Some(people), ..Options::default() };
    assert_eq!(suspected(&session, &options(1)), [(Code::PeopleLimit, vec![])]);
    assert_eq!(suspected(&session, &options(2)), []);
}

/// Offsets were searched up to 1.25 s, so that such a camera was said to be from another take.
#[test]
fn a_camera_started_late_was_of_another_take() {
    let right = session(5);
    let wrong = with_mistake(&right, "2 s late");
    assert_eq!(suspected(&wrong, &Options::default()), [(Code::TimeOffset, ids(&right, &[1]))]);
}

/// Two cameras found a compromise that explained four fifths of the keypoints, with limbs 215 mm off.
#[test]
fn exchanged_labels_of_one_of_two_cameras_passed() {
    let right = session(2);
    assert_eq!(suspected(&right, &Options::default()), []);
    let wrong = with_mistake(&right, "left and right exchanged in one camera");
    assert_eq!(suspected(&wrong, &Options::default()), [(Code::LabelsExchanged, ids(&right, &[1]))]);
}

/// Every camera fitted as well as the others, with cameras 3 to 9 cm off.
#[test]
fn bent_images_passed() {
    let right = session(5);
    for (name, views) in
        [("distortion of the lenses left out", vec![]), ("distortion of a lens left for undistorted images", vec![1])]
    {
        let wrong = with_mistake(&right, name);
        assert_eq!(suspected(&wrong, &Options::default()), [(Code::LensDistortion, ids(&right, &views))], "{name}");
        let repaired = Options { repair: Repair::Auto, ..Options::default() };
        let found = reconstruct(&wrong, &repaired, &Progress::silent()).unwrap();
        let truth = match views.is_empty() {
            true => right.views[1].intrinsics.with_radial(-0.3),
            false => right.views[1].intrinsics,
        };
        let repaired = as_solved(&wrong, &repaired, &found).views[1].intrinsics;
        // The distortion moves this point by 0.3 * 0.34 * 0.58 focal lengths of 1,000 px, 59 px: a fifth may be left.
        let at = |lens: &Intrinsics| lens.pixel_from_normalized(&Vector2::new(0.5, 0.3));
        let left = (at(&repaired) - at(&truth)).norm();
        assert!(left < 12.0, "{name}: {left} px");
    }
}

/// Keypoints of a repaired result were written with the names of the wrong convention, and with pixels that its cameras do not explain.
#[test]
fn repaired_results_had_the_names_of_the_mistake() {
    let preset = SimulationConfig::preset(Preset::Paper);
    let config = SimulationConfig { views: 4, frames: 60, convention: KeypointConvention::Body25, ..preset };
    let right = simulate(&config).unwrap().session;
    let options = Options { repair: Repair::Auto, ..Options::default() };
    for name in ["body25 declared as body25b", "coordinates from 0 to 1"] {
        let wrong = with_mistake(&right, name);
        let found = reconstruct(&wrong, &options, &Progress::silent()).unwrap();
        let solved = as_solved(&wrong, &options, &found);
        assert_eq!(solved.convention, right.convention, "{name}");
        let pixels =
            |session: &Session| session.views[1].frames[10][0].keypoints.iter().map(|k| k.pixel).collect::<Vec<_>>();
        let farthest = pixels(&solved).iter().zip(pixels(&right)).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
        assert!(farthest < 0.01, "{name}: {farthest} px");
    }
}
