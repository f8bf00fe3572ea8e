use super::*;
use crate::body::skeleton::KeypointConvention;
use crate::geometry::Intrinsics;
use crate::session::{FrameIndex, Keypoint};

/// Cameras at `centers` that look along +z at one person 5 m ahead, moving by `step` px per frame.
fn session(centers: &[[f64; 3]], n_frames: usize, step: f64) -> Session {
    let person = |frame: usize| {
        let x = 500.0 + step * frame as f64;
        let point = |i: usize| Vector2::new(x, 200.0 + 300.0 * i as f64 / 16.0);
        let keypoints = (0..17).map(|i| Keypoint::new(point(i), 0.9)).collect();
        vec![Detection { track_id: None, keypoints }]
    };
    let view = |(i, center): (usize, &[f64; 3])| View {
        id: format!("c{i}"),
        intrinsics: Intrinsics::PLAIN,
        time_offset: 0.0,
        has_intrinsics: true,
        camera_from_world: Some(Rigid { rotation: Matrix3::identity(), translation: -Vector3::from(*center) }),
        frames: (0..n_frames).map(person).collect(),
        delivered: (0..n_frames).map(FrameIndex).collect(),
    };
    Session {
        name: String::new(),
        fps: 25.0,
        first_frame: 0,
        n_frames,
        dense: None,
        convention: KeypointConvention::Coco17,
        up_axis: None,
        start_timecode: None,
        views: centers.iter().enumerate().map(view).collect(),
    }
}

fn codes(session: &Session) -> Vec<&'static str> {
    inspect(session, 2).findings.iter().map(|finding| finding.code).collect()
}

#[test]
fn a_good_rig_has_a_distance_and_no_findings() {
    let good = session(&[[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 0.0, 4.0]], 100, 5.0);
    let inspection = inspect(&good, 2);
    assert_eq!(inspection.findings, []);
    assert_eq!(inspection.groups, [["c0", "c1", "c2"]]);
    assert!((inspection.cameras[0].distance_m.unwrap() - 5.0).abs() < 1e-9); // 1000 px * 1.5 m / 300 px
    assert_eq!(inspection.pairs.len(), 3);
    assert_eq!(inspection.pairs[2].baseline_m, Some(5.0));
    assert_eq!(inspection.expected.cameras_per_person, 3.0);
}

#[test]
fn reports_degenerate_sessions() {
    let apart = [[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 0.0, 4.0]];
    assert_eq!(codes(&session(&apart, 100, 0.0)), ["static"]);
    assert_eq!(codes(&session(&apart, 20, 20.0)), ["few_frames"]);
    let row = session(&[[0.0; 3], [2.0, 0.0, 0.0], [4.0, 0.01, 0.0]], 100, 5.0);
    assert_eq!(codes(&row), ["collinear"]);
    let close = session(&[[0.0; 3], [0.1, 0.0, 0.0], [0.0, 0.0, 4.0], [3.0, 0.0, 2.0]], 100, 5.0);
    assert_eq!(codes(&close), ["tiny_baseline"]);
}

#[test]
fn reports_groups_without_shared_frames() {
    let mut split = session(&[[0.0; 3], [3.0, 0.0, 0.0], [0.0, 0.0, 4.0]], 100, 5.0);
    for frame in 0..50 {
        split.views[2].frames[frame].clear();
    }
    for view in &mut split.views[..2] {
        view.frames[50..].iter_mut().for_each(Vec::clear);
    }
    assert_eq!(codes(&split), ["split"]);
    split.views[2].frames.iter_mut().for_each(Vec::clear);
    let inspection = inspect(&split, 2);
    assert_eq!(inspection.findings.iter().map(|f| f.code).collect::<Vec<_>>(), ["no_person"]);
    assert_eq!(inspection.groups, [vec!["c0", "c1"], vec!["c2"]]);
}

/// A camera that was started two seconds late seemed never to see people together with the other.
#[test]
fn time_offsets_were_ignored_by_the_inspection() {
    let mut late = session(&[[0.0; 3], [3.0, 0.0, 0.0]], 200, 5.0);
    late.views[0].frames[..100].iter_mut().for_each(Vec::clear);
    late.views[1].frames[50..].iter_mut().for_each(Vec::clear);
    assert_eq!(codes(&late), ["split"]);
    late.views[1].time_offset = 100.0 / late.fps;
    let inspection = inspect(&late, 2);
    assert_eq!(inspection.pairs[0].frames_together, 50);
    assert_eq!((inspection.findings.len(), inspection.cameras[1].frames_with_people), (0, 50));
}

#[test]
fn two_people_standing_apart_looked_like_movement() {
    let mut still = session(&[[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 0.0, 4.0]], 100, 0.0);
    for people in still.views.iter_mut().flat_map(|view| &mut view.frames) {
        let mut other = people[0].clone();
        other.keypoints.iter_mut().for_each(|keypoint| keypoint.pixel.x += 400.0);
        people.push(other);
    }
    assert_eq!(codes(&still), ["static"]);
}
