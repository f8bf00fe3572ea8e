//! Each mistake is named, and a recording without one raises no suspicion.

use super::{suspicions, turned_with_images, without_doubles};
use crate::body::skeleton::KeypointConvention;
use crate::geometry::{Intrinsics, Rigid, rotation};
use crate::session::recording::{Detection, FrameIndex, Keypoint, Session, View};
use crate::session::suspicion::SuspicionCode as Code;
use nalgebra::{Vector2, Vector3};

const N_FRAMES: usize = 60;
/// Frames between the two cameras' pictures of the same walk.
const LAG: usize = 1000;

/// A stick figure that walks through the image; `time` in frames.
fn walker(time: usize) -> Detection {
    let place = |name: &str| {
        let side = match name.split('_').next() {
            Some("left") => 30.0,
            Some("right") => -30.0,
            _ => 0.0,
        };
        let heights =
            [("knee", 330.0), ("ankle", 480.0), ("hip", 180.0), ("shoulder", 0.0), ("elbow", 90.0), ("wrist", 170.0)];
        let height = heights.iter().find(|(part, _)| name.ends_with(part)).map_or(-60.0, |(_, height)| *height);
        let x = 80.0 + 1100.0 * ((time as f64 * 0.037).sin() * 0.5 + 0.5) + side;
        Vector2::new(x, 190.0 + height + 5.0 * (time as f64 * 0.61).sin())
    };
    let names = KeypointConvention::Coco17.names();
    let keypoint = |name: &&str| Keypoint::new(place(name), 0.8);
    Detection { track_id: None, keypoints: names.iter().map(keypoint).collect() }
}

fn session() -> Session {
    let view = |v: usize| View {
        id: format!("c{v}"),
        intrinsics: Intrinsics::PLAIN,
        has_intrinsics: true,
        camera_from_world: None,
        time_offset: 0.0,
        frames: (0..N_FRAMES).map(|f| vec![walker(f + LAG * v)]).collect(),
        delivered: (0..N_FRAMES).map(FrameIndex).collect(),
    };
    Session {
        name: String::new(),
        fps: 25.0,
        first_frame: 0,
        n_frames: N_FRAMES,
        dense: None,
        convention: KeypointConvention::Coco17,
        up_axis: None,
        start_timecode: None,
        views: vec![view(0), view(1)],
    }
}

/// Codes and cameras of the suspicions about a changed session.
fn found(change: impl Fn(&mut Session)) -> Vec<(Code, Vec<String>)> {
    let mut session = session();
    change(&mut session);
    suspicions(&session).into_iter().map(|s| (s.code, s.cameras)).collect()
}

fn pixels(session: &mut Session, change: impl Fn(Vector2<f64>) -> Vector2<f64>) {
    let detections = session.views[1].frames.iter_mut().flatten();
    detections.flat_map(|d| &mut d.keypoints).for_each(|k| k.pixel = change(k.pixel));
}

fn second(code: Code) -> Vec<(Code, Vec<String>)> {
    vec![(code, vec!["c1".to_owned()])]
}

#[test]
fn a_right_recording_raises_no_suspicion() {
    assert_eq!(found(|_| {}), []);
}

#[test]
fn names_wrong_coordinates() {
    let shares = |p: Vector2<f64>| Vector2::new(p.x / 1280.0, p.y / 720.0);
    assert_eq!(found(|s| pixels(s, shares)), second(Code::NormalizedCoordinates));
    assert_eq!(found(|s| pixels(s, |p| 0.5 * p)), second(Code::Resolution));
    assert_eq!(found(|s| pixels(s, |p| 2.0 * p)), second(Code::Resolution));
    assert_eq!(found(|s| pixels(s, |p| Vector2::new(p.y, 1279.0 - p.x))), second(Code::Rotated));
}

/// The principal point of images that had been turned was mirrored by the repair: people lie in them, which says how they were turned.
#[test]
fn a_camera_is_turned_as_its_images_were() {
    let lens = Intrinsics { cx: 620.0, cy: 380.0, fy: 1010.0, ..Intrinsics::PLAIN };
    let pose =
        Rigid { rotation: rotation::exp(&Vector3::new(0.1, -0.7, 0.2)), translation: Vector3::new(0.1, 0.2, 4.0) };
    let clockwise: fn(Vector2<f64>) -> Vector2<f64> = |p| Vector2::new(719.0 - p.y, p.x);
    let back: fn(Vector2<f64>) -> Vector2<f64> = |p| Vector2::new(p.y, 1279.0 - p.x);
    for (change, word) in [(clockwise, " clockwise"), (back, "counterclockwise")] {
        for is_size_of_video in [false, true] {
            let mut turned = session();
            pixels(&mut turned, change);
            let size = if is_size_of_video { (720, 1280) } else { (1280, 720) };
            let view = &mut turned.views[1];
            view.camera_from_world = Some(pose);
            view.intrinsics = Intrinsics { width: size.0, height: size.1, ..lens };
            let named = suspicions(&turned);
            assert_eq!(named.iter().map(|s| s.code).collect::<Vec<_>>(), [Code::Rotated]);
            assert!(named[0].evidence.ends_with(word), "{}", named[0].evidence);
            let (found, camera_from_world) = turned_with_images(turned.convention, &turned.views[1]).unwrap();
            let point = Vector3::new(0.3, -0.2, 1.0);
            let pixel = lens.pixel_from_camera(&pose.transform(&point)).unwrap();
            let seen = found.pixel_from_camera(&camera_from_world.unwrap().transform(&point)).unwrap();
            assert!((seen - change(pixel)).norm() < 1e-9);
            assert_eq!((found.width, found.height), (720, 1280));
        }
    }
    assert_eq!(turned_with_images(KeypointConvention::Coco17, &session().views[1]), None, "people stand");
}

/// A person who stood far away in the middle of an image was taken for one in an image of half the size.
#[test]
fn a_small_person_in_the_middle_needs_no_smaller_image() {
    let far = |p: Vector2<f64>| Vector2::new(640.0, 330.0) + 0.08 * (p - Vector2::new(640.0, 360.0));
    assert_eq!(found(|s| pixels(s, far)), []);
    let of_half = |p: Vector2<f64>| Vector2::new(320.0, 165.0) + 0.04 * (p - Vector2::new(640.0, 360.0));
    assert_eq!(found(|s| pixels(s, of_half)), second(Code::Resolution));
}

#[test]
fn names_a_wrong_principal_point() {
    let lens = |change: fn(&mut Intrinsics)| found(|s| change(&mut s.views[1].intrinsics));
    assert_eq!(lens(|k| std::mem::swap(&mut k.cx, &mut k.cy)), second(Code::PrincipalPoint));
    assert_eq!(lens(|k| (k.cx, k.cy) = (k.cx * 1.5, k.cy * 1.5)), second(Code::Resolution));
    assert_eq!(lens(|k| k.cx *= 1.6), second(Code::PrincipalPoint));
    assert_eq!(lens(|k| k.cx *= 1.1), [], "a lens that is not quite centred");
    let square = |k: &mut Intrinsics| (k.width, k.height, k.cx, k.cy) = (1280, 960, 480.0, 640.0);
    assert_eq!(lens(square), second(Code::PrincipalPoint), "an exchange moves the point less in nearly square images");
    assert_eq!(lens(|k| (k.cx, k.cy) = (690.0, 420.0)), [], "a shifted lens");
}

#[test]
fn names_repeated_keypoints() {
    let both = vec![(Code::DuplicateCamera, vec!["c0".to_owned(), "c1".to_owned()])];
    assert_eq!(found(|s| s.views[1].frames = s.views[0].frames.clone()), both);
    let shift = |s: &mut Session| s.views[1].frames = (0..N_FRAMES).map(|f| vec![walker(f + 7)]).collect();
    assert_eq!(found(shift), both, "the same video with other frame numbers");
    let frozen = |s: &mut Session| s.views[1].frames = vec![vec![walker(5)]; N_FRAMES];
    assert!(found(frozen).contains(&second(Code::RepeatedFrames)[0]));
    let doubled = |s: &mut Session| s.views[1].frames = (0..N_FRAMES).map(|f| vec![walker(LAG + f / 2)]).collect();
    assert_eq!(found(doubled), second(Code::RepeatedFrames), "a video stored at twice its rate");
}

/// A second detection of everybody ended every track after some frames; no camera was found.
#[test]
fn people_who_are_detected_twice_are_one() {
    let beside = |detection: &Detection, size: f64| {
        let mut second = detection.clone();
        for (k, keypoint) in second.keypoints.iter_mut().enumerate() {
            keypoint.confidence -= 0.1;
            keypoint.pixel.x += if k % 2 == 0 { size } else { -size };
        }
        second
    };
    let double = |s: &mut Session, size: f64| {
        s.views[1].frames.iter_mut().step_by(2).for_each(|people| people.insert(0, beside(&people[0], size)));
    };
    assert_eq!(found(|s| double(s, 20.0)), second(Code::DoubleDetections));
    assert_eq!(found(|s| double(s, 60.0)), [], "another person close by");
    let mut doubled = session();
    double(&mut doubled, 20.0);
    let single = without_doubles(&doubled);
    assert_eq!(suspicions(&single), []);
    let seen = |people: &Vec<Detection>| people.iter().filter(|d| d.keypoints[0].is_present()).cloned().collect();
    let shown: Vec<Vec<Detection>> = single.views[1].frames.iter().map(seen).collect();
    assert_eq!(shown, session().views[1].frames, "the more confident one stays, in its place");
}

#[test]
fn names_periodic_gaps() {
    let thinned = |s: &mut Session, v: usize| s.views[v].frames.iter_mut().skip(1).step_by(2).for_each(Vec::clear);
    assert_eq!(found(|s| thinned(s, 1)), second(Code::PeriodicGaps));
    assert_eq!(found(|s| (0..2).for_each(|v| thinned(s, v))), [(Code::PeriodicGaps, vec![])]);
}

#[test]
fn names_what_a_detector_gives() {
    let faint = |s: &mut Session| {
        let keypoints = s.views.iter_mut().flat_map(|v| v.frames.iter_mut().flatten()).flat_map(|d| &mut d.keypoints);
        keypoints.for_each(|k| k.confidence *= 0.1);
    };
    assert_eq!(found(faint), [(Code::LowConfidence, vec![])]);
}

/// Cameras are placed by keypoints from 0.4 on: without any, the solve ended with advice about overlap and intrinsics.
#[test]
fn confidences_that_place_no_camera_had_no_name() {
    let flat = |s: &mut Session| {
        let keypoints = s.views.iter_mut().flat_map(|v| v.frames.iter_mut().flatten()).flat_map(|d| &mut d.keypoints);
        keypoints.filter(|k| k.is_present()).for_each(|k| k.confidence = 0.35);
    };
    assert_eq!(found(flat), [(Code::LowConfidence, vec![])]);
}
