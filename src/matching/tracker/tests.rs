use super::*;
use crate::body::bones::limb_bones;
use crate::body::skeleton::KeypointConvention;
use crate::geometry::Rigid;
use crate::geometry::projection::project_normalized;
use crate::matching::normalized::{NormalizedDetection, NormalizedView};
use nalgebra::{Matrix3, Vector3};

/// A person whose bones all hang straight down from `top`.
fn hanging(camera: &Rigid, top: Vector3<f64>, size: f64) -> NormalizedDetection {
    let mut heights = [0.0; 17];
    limb_bones(KeypointConvention::Coco17).iter().for_each(|b| heights[b.b] = heights[b.a] + b.length);
    let point = |y: &f64| project_normalized(camera, &(top + Vector3::y() * *y)).unwrap().normalized;
    NormalizedDetection::of_points(heights.iter().map(point).collect(), size)
}

fn tracked(views: &[NormalizedView], cameras: &[Option<Rigid>]) -> Vec<TrackedPerson> {
    tracked_at(30.0, views, cameras)
}

fn tracked_at(fps: f64, views: &[NormalizedView], cameras: &[Option<Rigid>]) -> Vec<TrackedPerson> {
    let bones = limb_bones(KeypointConvention::Coco17);
    let scene = TrackerScene {
        views,
        cameras,
        bones: &bones,
        mirror: &KeypointConvention::Coco17.mirror(),
        fps,
        n_frames: views[0].frames.len(),
        is_backwards: false,
    };
    track(&scene, &TrackerConfig::default(), &Progress::silent()).unwrap()
}

#[test]
fn two_people_passing_one_camera_keep_their_identities() {
    let camera = Rigid::identity();
    let at = |frame: usize| {
        let s = frame as f64 / 30.0;
        [(s - 1.0, 3.0), (1.0 - s, 5.0)].map(|(x, z)| hanging(&camera, Vector3::new(x, 0.0, z), 0.8 / z)).to_vec()
    };
    let views = [NormalizedView { focal: 1000.0, frames: (0..60).map(at).collect() }];
    let people = tracked(&views, &[Some(camera)]);
    assert_eq!(people.len(), 2);
    for person in &people {
        let shown = person.assignments[0].1[0];
        assert!(person.assignments.len() == 60 && person.assignments.iter().all(|(_, a)| a[0] == shown));
    }
}

/// A view loses a person for half a second, in which the person runs towards the other camera, along its rays.
#[test]
fn a_person_moving_along_the_rays_of_a_view_is_reacquired() {
    let aside = Matrix3::new(0.0, 0.0, 1.0, 0.0, 1.0, 0.0, -1.0, 0.0, 0.0);
    let cameras = [Some(Rigid::identity()), Some(Rigid { rotation: aside, translation: Vector3::new(-5.0, 0.0, 5.0) })];
    let x = |frame: usize| -1.0 + 3.0 / 30.0 * (frame as f64 - 15.0).clamp(0.0, 15.0);
    let frames = |view: usize, is_blind: bool| -> Vec<Vec<NormalizedDetection>> {
        let at = |frame| match is_blind && (15..30).contains(&frame) {
            true => Vec::new(),
            false => vec![hanging(cameras[view].as_ref().unwrap(), Vector3::new(x(frame), 0.0, 5.0), 0.2)],
        };
        (0..60).map(at).collect()
    };
    let views = [(0, true), (1, false)].map(|(v, b)| NormalizedView { focal: 1000.0, frames: frames(v, b) });
    let people = tracked(&views, &cameras);
    assert_eq!(people.len(), 1);
    let assignments = &people[0].assignments;
    assert!(assignments.len() == 60 && assignments[30..].iter().all(|(_, a)| *a == [Some(Shown::as_detected(0)); 2]));
    let end = people[0].skeletons[59][0].unwrap();
    assert!((end.x - 0.5).abs() < 0.01, "{end}");
}

/// Two views of people who run at 10 m/s, 0.4 m from frame to frame at 25 Hz: more than two gates.
#[test]
fn a_runner_was_a_new_person_in_every_frame() {
    let aside = Matrix3::new(0.0, 0.0, 1.0, 0.0, 1.0, 0.0, -1.0, 0.0, 0.0);
    let far = Rigid { rotation: aside, translation: Vector3::new(-6.0, 0.0, 6.0) };
    let cameras = [Some(Rigid::identity()), Some(far)];
    let starts = |n: usize| &[[-4.0, 5.0], [-4.8, 7.5]][..n];
    for n in [1, 2] {
        let at = |camera: &Rigid, frame: usize| -> Vec<NormalizedDetection> {
            let top = |[x, z]: &[f64; 2]| Vector3::new(x + 0.4 * frame as f64, -0.8, *z);
            starts(n).iter().map(|start| hanging(camera, top(start), 0.2)).collect()
        };
        let frames = |camera: &Rigid| (0..20).map(|frame| at(camera, frame)).collect();
        let views = cameras.map(|c| NormalizedView { focal: 1000.0, frames: frames(&c.unwrap()) });
        let people = tracked_at(25.0, &views, &cameras);
        assert_eq!(people.len(), n);
        for person in people {
            let d = person.assignments[0].1[0];
            assert!(person.assignments.len() == 20 && person.assignments.iter().all(|(_, a)| *a == [d, d]), "{n}");
        }
    }
}

/// Three people turn about two cameras' middle for 25 s, which is two windows; one is out of sight at their seam for a second.
#[test]
fn people_of_a_long_take_go_on_from_window_to_window() {
    let aside = Matrix3::new(0.0, 0.0, 1.0, 0.0, 1.0, 0.0, -1.0, 0.0, 0.0);
    let cameras = [Some(Rigid::identity()), Some(Rigid { rotation: aside, translation: Vector3::new(-5.0, 0.0, 5.0) })];
    let hidden = 360..390;
    let shown = |frame: usize| {
        let order = if frame.is_multiple_of(2) { [0, 1, 2] } else { [2, 1, 0] };
        order.into_iter().filter(|person| *person != 2 || !hidden.contains(&frame)).collect::<Vec<usize>>()
    };
    let at = |camera: &Rigid, frame: usize| -> Vec<NormalizedDetection> {
        let angle = |person: usize| 0.02 * frame as f64 + 2.1 * person as f64;
        let top = |person: usize| Vector3::new(angle(person).cos(), -0.8, 5.0 + angle(person).sin());
        shown(frame).into_iter().map(|person| hanging(camera, top(person), 0.2)).collect()
    };
    let views = cameras
        .map(|c| NormalizedView { focal: 1000.0, frames: (0..750).map(|frame| at(&c.unwrap(), frame)).collect() });
    let bones = limb_bones(KeypointConvention::Coco17);
    let scene = TrackerScene {
        views: &views,
        cameras: &cameras,
        bones: &bones,
        mirror: &KeypointConvention::Coco17.mirror(),
        fps: 30.0,
        n_frames: 750,
        is_backwards: false,
    };
    let config = TrackerConfig::default();
    assert_eq!(TrackingWindows::of(&scene, &config).frames(), [0..375, 345..750]);
    let people = track(&scene, &config, &Progress::silent()).unwrap();
    let n_frames: Vec<usize> = people.iter().map(|person| person.assignments.len()).collect();
    assert_eq!(n_frames, [750, 750, 720]);
    for person in people {
        let first = shown(0)[person.assignments[0].1[0].unwrap().detection];
        let is_first = |(frame, seen): &(usize, Assignment)| {
            seen.iter().all(|d| d.map(|d| shown(*frame)[d.detection]) == Some(first))
        };
        assert!(person.assignments.iter().all(is_first) && person.assignments.is_sorted_by_key(|(frame, _)| *frame));
    }
}

/// A person who stands at `place` and faces along the z axis, 1.6 m high and 0.4 m wide; y points down.
fn standing(camera: &Rigid, place: Vector3<f64>) -> NormalizedDetection {
    const HEIGHTS: [f64; 17] = [1.6, 1.62, 1.62, 1.6, 1.6, 1.4, 1.4, 1.1, 1.1, 0.9, 0.9, 0.9, 0.9, 0.5, 0.5, 0.1, 0.1];
    let side = |k: usize| if k == 0 { 0.0 } else { 0.4 * (k % 2) as f64 - 0.2 };
    let point = |(k, height): (usize, &f64)| place + Vector3::new(side(k), -height, 0.0);
    let seen = |point: Vector3<f64>| project_normalized(camera, &point).unwrap().normalized;
    NormalizedDetection::of_points(HEIGHTS.iter().enumerate().map(point).map(seen).collect(), 0.3)
}

/// Cameras at the height of 0.8 m, 5 m from the origin: 40 degrees to its sides, and before it.
fn three_cameras() -> [Option<Rigid>; 3] {
    [-0.7, 0.7, 0.0].map(|angle| {
        let rotation = nalgebra::Rotation3::from_axis_angle(&Vector3::y_axis(), angle).into_inner();
        Some(Rigid { rotation, translation: Vector3::new(0.0, 0.8, 5.0) })
    })
}

/// What a camera with exchanged sides reports.
fn exchanged(seen: &NormalizedDetection) -> NormalizedDetection {
    let normalized = KeypointConvention::Coco17.mirror().iter().map(|&twin| seen.normalized[twin]).collect();
    NormalizedDetection { normalized, ..seen.clone() }
}

/// The third of three cameras exchanges left and right for half a second, then the first two do, at the same time.
#[test]
fn exchanged_sides_were_another_person_at_the_same_place() {
    let cameras = three_cameras();
    let is_exchanged = |view: usize, frame: usize| if view == 2 { 10..25 } else { 35..50 }.contains(&frame);
    let frames = |view: usize| -> Vec<Vec<NormalizedDetection>> {
        let at = |frame: usize| {
            let seen = standing(cameras[view].as_ref().unwrap(), Vector3::new(0.01 * frame as f64, 0.0, 0.0));
            vec![if is_exchanged(view, frame) { exchanged(&seen) } else { seen }]
        };
        (0..60).map(at).collect()
    };
    let views = [0, 1, 2].map(|view| NormalizedView { focal: 1000.0, frames: frames(view) });
    let people = tracked(&views, &cameras);
    assert_eq!(people.len(), 1);
    for (frame, assignment) in &people[0].assignments {
        let expected = [0, 1, 2].map(|view| Some(Shown { detection: 0, is_exchanged: is_exchanged(view, *frame) }));
        assert_eq!(*assignment, expected, "{frame}");
    }
}

/// Of a person whose sides were exchanged when it came into sight, those of most detections count.
#[test]
fn sides_that_are_exchanged_at_first_are_not_kept() {
    let aside = Matrix3::new(0.0, 0.0, 1.0, 0.0, 1.0, 0.0, -1.0, 0.0, 0.0);
    let oblique = Rigid { rotation: aside, translation: Vector3::new(-5.0, 0.8, 5.0) };
    let cameras = [Some(Rigid { translation: Vector3::new(0.0, 0.8, 0.0), ..Rigid::identity() }), Some(oblique)];
    let at = |view: usize, frame: usize| {
        let seen = standing(cameras[view].as_ref().unwrap(), Vector3::new(0.0, 0.0, 5.0));
        vec![if frame < 10 { exchanged(&seen) } else { seen }]
    };
    let views =
        [0, 1].map(|view| NormalizedView { focal: 1000.0, frames: (0..60).map(|frame| at(view, frame)).collect() });
    let people = tracked(&views, &cameras);
    assert_eq!(people.len(), 1);
    let n_exchanged = |person: &TrackedPerson| {
        person.assignments.iter().filter(|(_, a)| a.iter().flatten().any(|shown| shown.is_exchanged)).count()
    };
    let left_shoulder = people[0].skeletons[30][5].unwrap();
    assert!(left_shoulder.x > 0.15 && n_exchanged(&people[0]) < 15, "{left_shoulder} {}", n_exchanged(&people[0]));
}

/// A person comes into sight of one camera a second before two others see it, and is lost by all for two seconds.
#[test]
fn a_person_was_followed_out_of_the_scene_and_not_into_it() {
    let cameras = three_cameras();
    let is_seen = |view: usize, frame: usize| match view {
        2 => (10..60).contains(&frame) || frame >= 120,
        _ => (40..60).contains(&frame) || frame >= 150,
    };
    let at = |view: usize, frame: usize| {
        let seen = standing(cameras[view].as_ref().unwrap(), Vector3::new(0.01 * frame as f64 - 0.9, 0.0, 0.0));
        if is_seen(view, frame) { vec![seen] } else { Vec::new() }
    };
    let views =
        [0, 1, 2].map(|view| NormalizedView { focal: 1000.0, frames: (0..180).map(|frame| at(view, frame)).collect() });
    let people = tracked(&views, &cameras);
    assert_eq!(people.len(), 1);
    let followed: Vec<usize> = people[0].assignments.iter().map(|(frame, _)| *frame).collect();
    assert_eq!(followed, (10..60).chain(120..180).collect::<Vec<_>>());
    for (frame, assignment) in &people[0].assignments {
        let expected = [0, 1, 2].map(|view| is_seen(view, *frame).then(|| Shown::as_detected(0)));
        assert_eq!(*assignment, expected, "{frame}");
        let nose = people[0].skeletons[followed.iter().position(|f| f == frame).unwrap()][0].unwrap();
        assert!((nose.x - (0.01 * *frame as f64 - 0.9)).abs() < 0.05 && nose.z.abs() < 0.3, "{frame}: {nose}");
    }
}

/// A person who stands still is seen every other second: people are gone after a second out of sight, which was no frame at all.
#[test]
fn below_one_frame_a_second_everyone_had_left() {
    let cameras = three_cameras();
    let seen = |camera: &Option<Rigid>| vec![standing(camera.as_ref().unwrap(), Vector3::zeros())];
    let views = cameras.map(|camera| NormalizedView { focal: 1000.0, frames: vec![seen(&camera); 6] });
    let people = tracked_at(0.5, &views, &cameras);
    assert_eq!(people.iter().map(|person| person.assignments.len()).collect::<Vec<_>>(), [6]);
}
