//! Corrections of small hand-made tracks.

use super::*;
use crate::body::skeleton::KeypointConvention;
use crate::geometry::Intrinsics;
use crate::session::recording::{Detection, Keypoint, PersonId};
use crate::session::{FrameIndex, PersonTrack, Session, SessionBuilder};
use nalgebra::Vector2;

const N_FRAMES: usize = 10;

/// Three cameras, frames 100 to 109, two detections each.
fn session() -> Session {
    let keypoint = Keypoint::new(Vector2::new(600.0, 300.0), 0.9);
    let detection = Detection { track_id: None, keypoints: vec![keypoint; 17] };
    let mut builder = SessionBuilder::new(30.0, KeypointConvention::Coco17).time_line(100, N_FRAMES);
    for camera in ["a", "b", "c"] {
        builder = builder.camera(camera, &Intrinsics::PLAIN, None);
        for frame in 100..100 + N_FRAMES as i64 {
            builder = builder.detections(camera, frame, vec![detection.clone(); 2]);
        }
    }
    builder.build().unwrap()
}

/// Person 0 has detection 0 of all cameras, person 1 detection 1 up to frame 104, person 2 detection 1 from frame 107 on.
fn tracks() -> Vec<PersonTrack> {
    let track = |person: usize, first: usize, n: usize, detection: usize| PersonTrack {
        person: PersonId(person),
        first: FrameIndex(first),
        detections: vec![vec![Some(detection); 3]; n],
    };
    vec![track(0, 0, N_FRAMES, 0), track(1, 0, 5, 1), track(2, 7, 3, 1)]
}

fn corrected(list: &str) -> Result<CorrectedPeople, String> {
    let corrections: Vec<Correction> = serde_json::from_str(list).map_err(|error| error.to_string())?;
    corrected_people(&session(), &tracks(), &corrections).map_err(|error| error.to_string())
}

/// Number, first frame and number of frames of each person.
fn spans(people: &CorrectedPeople) -> Vec<[usize; 3]> {
    people.tracks.iter().map(|track| [track.person.0, track.first.0, track.detections.len()]).collect()
}

#[test]
fn merges_and_keeps_numbers() {
    let people = corrected(r#"[{"action": "merge", "people": [1, 2]}]"#).unwrap();
    assert_eq!(spans(&people), [[0, 0, 10], [1, 0, 10]]);
    assert_eq!(people.tracks[1].detections[5], [None; 3], "between the parts");
    assert_eq!(people.tracks[1].detections[7], [Some(1); 3]);
}

#[test]
fn splits_with_the_next_free_number() {
    let people = corrected(r#"[{"action": "split", "person": 0, "frame": 104}]"#).unwrap();
    assert_eq!(spans(&people), [[0, 0, 4], [1, 0, 5], [2, 7, 3], [3, 4, 6]]);
    let undone =
        corrected(r#"[{"action": "split", "person": 0, "frame": 104}, {"action": "merge", "people": [0, 3]}]"#);
    assert_eq!(undone.unwrap(), corrected("[]").unwrap());
}

#[test]
fn exchanges_a_range() {
    let list = r#"[{"action": "exchange", "people": [0, 1], "frame": 102, "last_frame": 103}]"#;
    let people = corrected(list).unwrap();
    let shown: Vec<Option<usize>> = people.tracks[0].detections.iter().map(|seen| seen[0]).collect();
    assert_eq!(shown[..5], [Some(0), Some(0), Some(1), Some(1), Some(0)]);
    let whole = corrected(r#"[{"action": "exchange", "people": [0, 1], "frame": 103}]"#).unwrap();
    assert_eq!(spans(&whole), [[0, 0, 5], [1, 0, 10], [2, 7, 3]]);
}

/// A person that the camera left out before had shown alone ended every later correction of frames with an error about it.
#[test]
fn an_unseen_person_stopped_corrections_of_others() {
    let mut tracks = tracks();
    tracks[2].detections.iter_mut().for_each(|seen| (seen[1], seen[2]) = (None, None));
    let applied = |more: &str| {
        let list = format!(r#"[{{"action": "exclude_camera", "camera": "a"}}, {more}]"#);
        let corrections: Vec<Correction> = serde_json::from_str(&list).unwrap();
        corrected_people(&session(), &tracks, &corrections).map_err(|error| error.to_string())
    };
    let people = applied(r#"{"action": "exclude_frames", "frames": [100, 101], "person": 0}"#).unwrap();
    assert_eq!(spans(&people), [[0, 2, 8], [1, 0, 5]]);
    assert!(applied(r#"{"action": "split", "person": 0, "frame": 104}"#).is_ok());
    let error = applied(r#"{"action": "split", "person": 2, "frame": 108}"#).unwrap_err();
    assert!(error.contains("person 2 was removed: correction 1 left out the only camera"), "{error}");
}

#[test]
fn excludes_detections() {
    let people = corrected(r#"[{"action": "exclude_person", "person": 2}]"#).unwrap();
    assert_eq!((spans(&people).len(), people.excluded.len()), (2, 9));
    let left = people.without_excluded(&session());
    assert!(!left.views[1].frames[8][1].keypoints[3].is_present());
    assert!(left.views[1].frames[8][0].keypoints[3].is_present());

    let people = corrected(r#"[{"action": "exclude_camera", "camera": "b"}]"#).unwrap();
    assert_eq!((people.excluded.len(), people.excluded_views.len()), (20, 1));
    assert_eq!(people.tracks[0].detections[0], [Some(0), None, Some(0)]);

    let list = r#"[{"action": "exclude_frames", "frames": [100, 101], "camera": "a", "person": 0}]"#;
    let people = corrected(list).unwrap();
    assert_eq!(people.excluded.iter().copied().collect::<Vec<_>>(), [[0, 0, 0], [0, 1, 0]]);
}

#[test]
fn names_and_heights_belong_to_people() {
    let list =
        r#"[{"action": "rename", "person": 1, "name": "Ana"}, {"action": "set_height", "person": 1, "metres": 1.7}]"#;
    let people = corrected(list).unwrap();
    assert_eq!(people.names[&PersonId(1)], "Ana");
    assert_eq!(people.heights[&PersonId(1)], 1.7);
}

#[test]
fn refuses_what_cannot_be_applied() {
    let gone = r#"{"action": "merge", "people": [1, 2]}, {"action": "rename", "person": 2, "name": "x"}"#;
    let twice = r#"{"action": "rename", "person": 1, "name": "x"}, {"action": "rename", "person": 1, "name": "y"}"#;
    let cases = [
        (r#"{"action": "exclude_person", "person": 7}"#, "person 7 does not exist; the people are 0, 1, 2"),
        (gone, "correction 2 (rename): person 2 was removed: correction 1 merged it into person 1"),
        (twice, "named \"x\" before"),
        (r#"{"action": "split", "person": 1, "frame": 99}"#, "frames are 100 to 109"),
        (r#"{"action": "split", "person": 1, "frame": 100}"#, "choose a frame from 101 to 104"),
        (r#"{"action": "merge", "people": [0, 1]}"#, "camera a shows both person 0 and person 1 in frame 100"),
        (r#"{"action": "merge", "people": [1]}"#, "two different people"),
        (r#"{"action": "exchange", "people": [1, 1], "frame": 103}"#, "two different people"),
        (r#"{"action": "exchange", "people": [1, 2], "frame": 105, "last_frame": 106}"#, "neither"),
        (r#"{"action": "exclude_frames", "frames": [105, 101]}"#, "before the first one"),
        (r#"{"action": "exclude_frames", "frames": [100, 109], "person": 2}"#, "nothing would be left of person 2"),
        (r#"{"action": "exclude_camera", "camera": "z"}"#, "no camera \"z\""),
        (r#"{"action": "rename", "person": 0, "name": " "}"#, "not a name"),
        (r#"{"action": "join", "people": [0, 1]}"#, "unknown variant `join`"),
    ];
    for (list, expected) in cases {
        let found = corrected(&format!("[{list}]")).unwrap_err();
        assert!(found.contains(expected), "{list}: {found}");
    }
    let two = r#"[{"action": "exclude_camera", "camera": "a"}, {"action": "exclude_camera", "camera": "b"}]"#;
    assert!(corrected(two).unwrap_err().contains("leave at least two in"));
    let all = r#"[{"action": "exclude_person", "person": 0}, {"action": "exclude_person", "person": 1},
        {"action": "exclude_person", "person": 2}]"#;
    assert!(corrected(all).unwrap_err().contains("no person is left"));
}
