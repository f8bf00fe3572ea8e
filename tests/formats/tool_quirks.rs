//! What other tools write beside the letter of their formats: bare NaN, byte order marks, names of their own, wrong declarations.

use crate::dialects::{alphapose, deeplabcut, flat, mmpose, openpose};
use crate::take::{CAMERAS, COCO17, N_FRAMES, calib_toml, header, people, read};
use serde_json::{Value, json};
use wandless::body::skeleton::KeypointConvention;

/// Pose2Sim writes bare NaN for people that it has lost; one of them had rejected the whole recording.
#[test]
fn nan_of_pose2sim_rejected_the_whole_recording() {
    let mut files = openpose(&COCO17);
    let mut frames = files.iter_mut().filter(|(name, _)| name.contains("cam1_0"));
    let nan = |n: usize| vec!["NaN"; n].join(", ");
    let lost = format!(r#"{{"person_id": [-1], "pose_keypoints_2d": [{}]}}"#, nan(51));
    frames.next().unwrap().1 = format!(r#"{{"version": 1.3, "people": [{lost}, {lost}]}}"#).into_bytes();
    let halves: Vec<String> = people(0, 1, &COCO17)
        .iter()
        .map(|person| {
            let numbers: Vec<String> = flat(&person[8..]).iter().map(f64::to_string).collect();
            format!(r#"{{"pose_keypoints_2d": [{}, {}]}}"#, nan(24), numbers.join(", "))
        })
        .collect();
    frames.next().unwrap().1 = format!(r#"{{"people": [{}, {lost}]}}"#, halves.join(", ")).into_bytes();
    let frames = read(&files).unwrap().session.views[0].frames.clone();
    assert_eq!((frames[0].len(), frames[1].len(), frames[2].len()), (0, 2, 2));
    let present: Vec<bool> = frames[1][1].keypoints.iter().map(|keypoint| keypoint.is_present()).collect();
    assert!(present.iter().enumerate().all(|(k, present)| *present == (k >= 8)), "{present:?}");
}

/// People write the result beside the poses and solve again: its files were read as poses, and refused.
#[test]
fn a_result_beside_the_poses_was_read_as_poses() {
    let plain = read(&openpose(&COCO17)).unwrap();
    let mut files = openpose(&COCO17);
    let names = ["manifest", "report", "people", "identities", "poses3d", "keypoints3d", "cameras"];
    let file = |name: &str| (format!("result/{name}.json"), br#"{"frames": {"0": {}}, "cameras": []}"#.to_vec());
    files.extend(names.map(file));
    let read = read(&files).unwrap();
    assert_eq!(read.session, plain.session);
    let is_named = |warning: &String| warning.contains("folder \"result/\" holds the result");
    assert!(read.warnings.iter().any(is_named), "{:?}", read.warnings);
}

#[test]
fn nan_in_lists_of_people_is_a_missing_point() {
    for (name, files) in [("alphapose", alphapose(1.0)), ("mmpose", mmpose(true))] {
        let mut damaged = files;
        let (_, content) = damaged.iter_mut().find(|(name, _)| name.contains("cam2")).unwrap();
        let text = String::from_utf8(content.clone()).unwrap();
        let at = text.find("\"keypoints\":[").unwrap() + 13;
        let start = at + text[at..].find(|c: char| c.is_ascii_digit()).unwrap();
        let end = start + text[start..].find(',').unwrap();
        *content = format!("{}NaN{}", &text[..start], &text[end..]).into_bytes();
        let session = read(&damaged).unwrap_or_else(|e| panic!("{name}: {e}")).session;
        let keypoints = &session.views[1].frames[0][0].keypoints;
        assert!(!keypoints[0].is_present() && keypoints[1].is_present(), "{name}");
    }
}

/// MMPose names the points of its whole body; 110 of 133 had been dropped.
#[test]
fn named_whole_bodies_of_mmpose_lost_their_hands() {
    let body = KeypointConvention::CocoWholebody133.names();
    let detail = |k: usize| match k {
        23..91 => format!("face-{}", k - 23),
        91 => "left_hand_root".to_owned(),
        112 => "right_hand_root".to_owned(),
        _ => format!("{}_finger{}", if k < 112 { "left" } else { "right" }, k),
    };
    let name = |k: usize| body.get(k).map_or_else(|| detail(k), |name| (*name).to_owned());
    let names: serde_json::Map<String, Value> = (0..133).map(|k| (k.to_string(), json!(name(k)))).collect();
    let mut files = vec![header(), calib_toml()];
    for (i, camera) in CAMERAS.iter().enumerate() {
        let frame = |frame: i64| {
            let mut points = people(i, frame, body).remove(0);
            let [x, y, _] = points[10];
            points.extend((23..133).map(|k| [x + k as f64, y, 0.5]));
            let xy: Vec<[f64; 2]> = points.iter().map(|[x, y, _]| [*x, *y]).collect();
            let scores: Vec<f64> = points.iter().map(|[.., c]| *c).collect();
            json!({"frame_id": frame, "instances": [{"keypoints": xy, "keypoint_scores": scores}]})
        };
        let frames: Vec<Value> = (0..N_FRAMES).map(frame).collect();
        let meta = json!({"dataset_name": "coco_wholebody", "keypoint_id2name": names});
        let document = json!({"meta_info": meta, "instance_info": frames});
        files.push((format!("results_{camera}.json"), document.to_string().into_bytes()));
    }
    let session = read(&files).unwrap().session;
    assert_eq!(session.convention, KeypointConvention::CocoWholebody133);
    assert!(session.views[0].frames[0][0].keypoints[23..].iter().all(|keypoint| keypoint.is_present()));
}

/// Files that .NET and PowerShell had written were not recognised.
#[test]
fn files_with_a_byte_order_mark_were_not_recognised() {
    for (name, files) in [("openpose", openpose(&COCO17)), ("mmpose", mmpose(true)), ("deeplabcut", deeplabcut())] {
        let mark = |(name, content): &(String, Vec<u8>)| {
            let is_header = name == "session.json";
            (name.clone(), if is_header { content.clone() } else { [&b"\xef\xbb\xbf"[..], content].concat() })
        };
        let marked = read(&files.iter().map(mark).collect()).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_eq!(marked.session, read(&files).unwrap().session, "{name}");
    }
}

/// Names that did not fit were ignored, and the points read in the order of another skeleton.
#[test]
fn declared_names_of_another_number_were_ignored() {
    let mut files = openpose(KeypointConvention::Halpe26.names());
    let mut detail = |declared: Value| {
        files[0].1 = declared.to_string().into_bytes();
        let error = read(&files).unwrap_err();
        assert_eq!(error.code, "keypoint_count");
        error.detail
    };
    let names = detail(json!({"fps": 50, "keypoint_names": KeypointConvention::Body25.names()}));
    assert!(names.contains("session.json names 25 keypoints") && names.contains("has 26"), "{names}");
    let convention = detail(json!({"fps": 50, "keypoint_convention": "coco17"}));
    assert!(convention.contains("declares coco17 with 17 keypoints"), "{convention}");
    // No camera shows a hand.
    let mut files = openpose(KeypointConvention::Body25.names());
    files[0].1 = json!({"fps": 50, "keypoint_convention": "body25_hands"}).to_string().into_bytes();
    assert_eq!(read(&files).unwrap().session.convention, KeypointConvention::Body25Hands);
}
