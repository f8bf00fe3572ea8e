//! The same recording in every pose dialect gives the same session.

use crate::take::{CAMERAS, COCO17, Files, HEIGHT, N_FRAMES, Point, WIDTH, calib_toml, header, people, read};
use serde_json::{Value, json};
use wandless::body::skeleton::KeypointConvention;
use wandless::session::upload::LoadedSession;

const COCO18: [&str; 18] = [
    "nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
    "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle", "right_eye", "left_eye",
    "right_ear", "left_ear",
];

pub(crate) fn flat(points: &[Point]) -> Vec<f64> {
    points.iter().flatten().copied().collect()
}

/// One file per camera and frame.
pub(crate) fn per_frame(
    name: impl Fn(&str, i64) -> String,
    joints: &[&str],
    content: impl Fn(&[Vec<Point>]) -> Value,
) -> Files {
    let mut files = vec![header(), calib_toml()];
    for (i, camera) in CAMERAS.iter().enumerate() {
        for frame in 0..N_FRAMES {
            files.push((name(camera, frame), content(&people(i, frame, joints)).to_string().into_bytes()));
        }
    }
    files
}

/// One file per camera, with one item per person.
fn per_camera(name: impl Fn(&str) -> String, item: impl Fn(&str, i64, usize, &[Point]) -> Value) -> Files {
    let mut files = vec![header(), calib_toml()];
    for (i, camera) in CAMERAS.iter().enumerate() {
        let mut items = Vec::new();
        for frame in 0..N_FRAMES {
            for (person, points) in people(i, frame, &COCO17).iter().enumerate() {
                items.push(item(camera, frame, person, points));
            }
        }
        files.push((name(camera), Value::Array(items).to_string().into_bytes()));
    }
    files
}

pub(crate) fn openpose(joints: &[&str]) -> Files {
    per_frame(
        |camera, frame| format!("pose/{camera}_json/{camera}_{frame:012}_keypoints.json"),
        joints,
        |people| {
            let person = |points: &Vec<Point>| {
                json!({"person_id": [-1], "pose_keypoints_2d": flat(points), "face_keypoints_2d": [1.0, 2.0, 0.5],
                       "hand_left_keypoints_2d": [], "hand_right_keypoints_2d": [], "pose_keypoints_3d": []})
            };
            json!({"version": 1.3, "people": people.iter().map(person).collect::<Vec<_>>()})
        },
    )
}

fn openpose_of_version_0_1() -> Files {
    per_frame(
        |camera, frame| format!("{camera}/frame_{frame:06}.json"),
        &COCO17,
        |people| {
            let person = |points: &Vec<Point>| json!({"pose_keypoints": flat(points)});
            json!({"version": 0.1, "people": people.iter().map(person).collect::<Vec<_>>()})
        },
    )
}

fn dmmr() -> Files {
    let mut files = per_frame(
        |camera, frame| format!("keypoints/take/{camera}/{frame:06}_keypoints.json"),
        &COCO17,
        |people| {
            let person = |points: &Vec<Point>| json!({"pose_keypoints_2d": flat(points)});
            json!({"version": 1.1, "people": people.iter().map(person).collect::<Vec<_>>()})
        },
    );
    // A placeholder for a third person makes indices identities.
    let first = &mut files.iter_mut().find(|(name, _)| name.starts_with("keypoints/")).unwrap().1;
    let mut document: Value = serde_json::from_slice(first).unwrap();
    document["people"].as_array_mut().unwrap().push(Value::Null);
    *first = document.to_string().into_bytes();
    files
}

pub(crate) fn alphapose(confidence_scale: f64) -> Files {
    per_camera(
        |camera| format!("{camera}/alphapose-results.json"),
        |_, frame, person, points| {
            let scaled = points.iter().flat_map(|[x, y, c]| [*x, *y, c * confidence_scale]).collect::<Vec<_>>();
            json!({"image_id": format!("{frame}.jpg"), "category_id": 1, "keypoints": scaled, "score": 2.9,
                   "box": [1, 2, 3, 4], "idx": [person]})
        },
    )
}

fn alphapose_cmu() -> Files {
    per_frame(
        |camera, frame| format!("{camera}/sep-json/{frame}.json"),
        &COCO18,
        |people| {
            let body = |points: &Vec<Point>| json!({"joints": flat(points)});
            json!({"version": 0.1, "bodies": people.iter().map(body).collect::<Vec<_>>()})
        },
    )
}

fn alphapose_open() -> Files {
    per_frame(
        |camera, frame| format!("{camera}/sep-json/{frame}.json"),
        &COCO18,
        |people| {
            let person = |points: &Vec<Point>| json!({"pose_keypoints_2d": flat(points)});
            json!({"version": "AlphaPose v0.3", "people": people.iter().map(person).collect::<Vec<_>>()})
        },
    )
}

pub(crate) fn coco() -> Files {
    let id = |camera: usize, frame: i64| 1000 * (camera as i64 + 1) + frame;
    let mut images = Vec::new();
    let mut results = Vec::new();
    for (i, camera) in CAMERAS.iter().enumerate() {
        for frame in 0..N_FRAMES {
            let name = format!("{camera}/{frame:06}.jpg");
            images.push(json!({"id": id(i, frame), "file_name": name, "width": WIDTH, "height": HEIGHT}));
            for points in people(i, frame, &COCO17) {
                let keypoints = flat(&points);
                results.push(json!({"image_id": id(i, frame), "category_id": 1, "keypoints": keypoints, "score": 0.9}));
            }
        }
    }
    let categories = json!([{"id": 1, "name": "person", "keypoints": COCO17, "skeleton": [[1, 2]]}]);
    let table = json!({"info": {}, "images": images, "annotations": [], "categories": categories});
    vec![
        header(),
        calib_toml(),
        ("image_info.json".to_owned(), table.to_string().into_bytes()),
        ("results.json".to_owned(), Value::Array(results).to_string().into_bytes()),
    ]
}

pub(crate) fn mmpose(with_meta: bool) -> Files {
    let mut files = vec![header(), calib_toml()];
    for (i, camera) in CAMERAS.iter().enumerate() {
        let instance = |points: &Vec<Point>| {
            let xy: Vec<[f64; 2]> = points.iter().map(|[x, y, _]| [*x, *y]).collect();
            let scores: Vec<f64> = points.iter().map(|[.., c]| *c).collect();
            json!({"keypoints": xy, "keypoint_scores": scores, "bbox": [[1, 2, 3, 4]], "bbox_score": 0.9})
        };
        let frame = |frame: i64| {
            let instances: Vec<Value> = people(i, frame, &COCO17).iter().map(instance).collect();
            json!({"frame_id": frame, "instances": instances})
        };
        let frames: Vec<Value> = (0..N_FRAMES).map(frame).collect();
        let names: serde_json::Map<String, Value> =
            COCO17.iter().enumerate().map(|(i, name)| (i.to_string(), json!(name))).collect();
        let document = json!({"meta_info": {"dataset_name": "coco", "num_keypoints": 17, "keypoint_id2name": names},
                              "instance_info": frames});
        let text = if with_meta { document } else { document["instance_info"].clone() };
        files.push((format!("results_{camera}.json"), text.to_string().into_bytes()));
    }
    files
}

pub(crate) fn easymocap(as_list: bool) -> Files {
    per_frame(
        |camera, frame| format!("annots/{camera}/{frame:06}.json"),
        &COCO17,
        |people| {
            let annotation = |(i, points): (usize, &Vec<Point>)| json!({"bbox": [1, 2, 3, 4, 0.9], "personID": i, "keypoints": points, "isKeyframe": false});
            let annots: Vec<Value> = people.iter().enumerate().map(annotation).collect();
            if as_list {
                return Value::Array(annots);
            }
            json!({"filename": "x.jpg", "width": WIDTH, "height": HEIGHT, "annots": annots, "isKeyframe": false})
        },
    )
}

pub(crate) fn deeplabcut() -> Files {
    let mut files = vec![header(), calib_toml()];
    for (i, camera) in CAMERAS.iter().enumerate() {
        let row = |key: &str, cell: &dyn Fn(usize, &str, &str) -> String| {
            let mut line = key.to_owned();
            for person in 0..2 {
                for joint in COCO17 {
                    for axis in ["x", "y", "likelihood"] {
                        line += &format!(",{}", cell(person, joint, axis));
                    }
                }
            }
            line + "\n"
        };
        let mut text = row("scorer", &|_, _, _| "net".to_owned());
        text += &row("individuals", &|person, _, _| format!("mouse{person}"));
        text += &row("bodyparts", &|_, joint, _| joint.to_owned());
        text += &row("coords", &|_, _, axis| axis.to_owned());
        for frame in 0..N_FRAMES {
            let points = people(i, frame, &COCO17);
            let numbers: Vec<String> = points.iter().flat_map(|p| flat(p)).map(|n| n.to_string()).collect();
            text += &format!("{frame},{}\n", numbers.join(","));
        }
        files.push((format!("{camera}.csv"), text.into_bytes()));
    }
    files
}

fn native_poses() -> Files {
    let mut files = vec![header(), calib_toml()];
    for (i, camera) in CAMERAS.iter().enumerate() {
        let person = |points: &Vec<Point>| json!({"track_id": null, "keypoints": points});
        let frame = |n: i64| {
            let people: Vec<Value> = people(i, n, &COCO17).iter().map(person).collect();
            json!({"frame": n, "people": people})
        };
        let frames: Vec<Value> = (0..N_FRAMES).map(frame).collect();
        files.push((format!("poses/{camera}.json"), json!({"frames": frames}).to_string().into_bytes()));
    }
    // One camera by another tool: mixed dialects.
    files.retain(|(name, _)| name != "poses/cam3.json");
    let other = openpose(&COCO17);
    files.extend(other.into_iter().filter(|(name, _)| name.contains("cam3")));
    files
}

/// Compares a session with the recording over `joints`; `tracks` is `None` where a dialect has no identities.
fn check(loaded: &LoadedSession, what: &str, joints: &[&str], tracks: Option<[i64; 2]>) {
    let session = &loaded.session;
    assert_eq!((session.fps, session.first_frame, session.n_frames), (50.0, 0, N_FRAMES as usize), "{what}");
    assert_eq!(session.views.iter().map(|view| view.id.as_str()).collect::<Vec<_>>(), CAMERAS, "{what}");
    for (i, view) in session.views.iter().enumerate() {
        assert_eq!(view.delivered.len(), N_FRAMES as usize, "{what}");
        for frame in 0..N_FRAMES {
            let found = &view.frames[frame as usize];
            assert_eq!(found.len(), 2, "{what}: frame {frame}");
            for (person, expected) in people(i, frame, joints).iter().enumerate() {
                let track = found[person].track_id;
                assert_eq!(track, tracks.map(|ids| ids[person]), "{what}");
                for (name, [x, y, confidence]) in joints.iter().zip(expected) {
                    let Some(index) = session.convention.index_of(name) else { panic!("{what}: no {name}") };
                    let own = &found[person].keypoints[index];
                    // Six times a confidence, divided by six, has a rounding error.
                    assert!((own.confidence - confidence).abs() < 1e-12, "{what}: {name} {own:?} {confidence}");
                    assert_eq!((own.pixel.x, own.pixel.y), (*x, *y), "{what}: {name} in frame {frame}");
                }
            }
        }
    }
}

#[test]
fn reads_every_dialect_alike() {
    let by_place = Some([0, 1]);
    let cases: Vec<(&str, Files, Option<[i64; 2]>)> = vec![
        ("openpose", openpose(&COCO17), None),
        ("openpose", openpose_of_version_0_1(), None),
        ("dmmr", dmmr(), by_place),
        ("alphapose", alphapose(1.0), by_place),
        ("alphapose", alphapose(6.0), by_place),
        ("coco", coco(), None),
        ("mmpose", mmpose(true), None),
        ("mmpose", mmpose(false), None),
        ("easymocap", easymocap(false), by_place),
        ("easymocap", easymocap(true), by_place),
        ("deeplabcut", deeplabcut(), by_place),
    ];
    for (name, files, tracks) in cases {
        let loaded = read(&files).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_eq!(loaded.format, format!("{name} with toml"));
        assert_eq!(loaded.session.convention, KeypointConvention::Coco17, "{name}");
        assert!(loaded.warnings.iter().any(|line| line.contains("17 joints kept as coco17")), "{:?}", loaded.warnings);
        check(&loaded, name, &COCO17, tracks);
    }
    let mixed = read(&native_poses()).unwrap();
    assert_eq!(mixed.format, "native+openpose with toml");
    check(&mixed, "mixed", &COCO17, None);
}

#[test]
fn keeps_the_neck_of_eighteen_points() {
    for (name, files) in [("alphapose_cmu", alphapose_cmu()), ("alphapose_open", alphapose_open())] {
        let loaded = read(&files).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_eq!(
            (loaded.format, loaded.session.convention),
            (format!("{name} with toml"), KeypointConvention::Coco18)
        );
    }
    check(&read(&openpose(&COCO18)).unwrap(), "coco18", &COCO18, None);
}

#[test]
fn distinguishes_orders_of_twenty_five_points() {
    let vitpose: Vec<&str> = ["nose", "left_eye", "right_eye", "left_ear", "right_ear", "neck"]
        .into_iter()
        .chain(["left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist"])
        .chain(["left_hip", "right_hip", "mid_hip", "left_knee", "right_knee", "left_ankle", "right_ankle"])
        .chain(["left_big_toe", "left_small_toe", "left_heel", "right_big_toe", "right_small_toe", "right_heel"])
        .collect();
    let of = |convention: KeypointConvention| convention.names().to_vec();
    for (name, joints, convention) in [
        ("\"body25\"", of(KeypointConvention::Body25), KeypointConvention::Body25),
        ("\"body25b\"", of(KeypointConvention::Body25b), KeypointConvention::Body25b),
        ("\"vitpose25\"", vitpose, KeypointConvention::Body25),
    ] {
        let loaded = read(&openpose(&joints)).unwrap();
        assert_eq!(loaded.session.convention, convention, "{name}");
        assert!(loaded.warnings.iter().any(|line| line.contains(name)), "{name}: {:?}", loaded.warnings);
        check(&loaded, name, &joints, None);
    }
}

/// Writes a hand of OpenPose into the files of a camera, in every second frame: 21 points right of the person's wrist.
fn add_hands(files: &mut Files, camera: &str, field: &str, wrist: &str) {
    let wrist = KeypointConvention::Body25.index_of(wrist).unwrap();
    let frames = files.iter_mut().filter(|(name, _)| name.contains(&format!("{camera}_0")));
    for (_, content) in frames.step_by(2) {
        let mut document: Value = serde_json::from_slice(content).unwrap();
        for person in document["people"].as_array_mut().unwrap() {
            let at = |c: usize| person["pose_keypoints_2d"][3 * wrist + c].as_f64().unwrap();
            let hand: Vec<f64> = (0..21).flat_map(|k| [at(0) + k as f64, at(1), 0.75]).collect();
            person[field] = json!(hand);
        }
        *content = document.to_string().into_bytes();
    }
}

/// Where any file has a detected hand, the session has hands; files without them and zeros are missing points.
#[test]
fn reads_hands_of_openpose() {
    let convention = KeypointConvention::Body25;
    let mut files = openpose(convention.names());
    add_hands(&mut files, "cam2", "hand_right_keypoints_2d", "right_wrist");
    let loaded = read(&files).unwrap();
    let session = &loaded.session;
    assert_eq!(session.convention, KeypointConvention::Body25Hands);
    check(&loaded, "body25_hands", convention.names(), None);
    let wrist = convention.index_of("right_wrist").unwrap();
    for (view, frame) in [(0, 0), (1, 0), (1, 1)] {
        for person in &session.views[view].frames[frame] {
            let hand = &person.keypoints[46..67];
            assert_eq!(person.keypoints.len(), 67);
            assert!(person.keypoints[25..46].iter().all(|keypoint| !keypoint.is_present()));
            assert!(hand.iter().all(|keypoint| keypoint.is_present() == ((view, frame) == (1, 0))));
        }
    }
    let person = &session.views[1].frames[0][0];
    let shift = person.keypoints[46 + 20].pixel - person.keypoints[wrist].pixel;
    assert!((shift.x - 20.0).abs() < 1e-9 && shift.y == 0.0, "{shift}");
    // Hands that no file shows: as OpenPose writes them without a find.
    let mut files = openpose(convention.names());
    for (_, content) in files.iter_mut().filter(|(name, _)| name.ends_with("keypoints.json")) {
        let zeros = format!("\"hand_left_keypoints_2d\":{}", json!(vec![0; 63]));
        let text = String::from_utf8(content.clone()).unwrap().replace("\"hand_left_keypoints_2d\":[]", &zeros);
        *content = text.into_bytes();
    }
    assert_eq!(read(&files).unwrap().session.convention, convention);
}

#[test]
fn rejects_a_hand_of_another_number_of_points() {
    let mut files = openpose(&COCO17);
    let (name, content) = files.iter_mut().find(|(name, _)| name.ends_with("keypoints.json")).unwrap();
    let text = String::from_utf8(content.clone()).unwrap();
    *content = text.replace("\"hand_left_keypoints_2d\":[]", "\"hand_left_keypoints_2d\":[5,6,0.5]").into_bytes();
    let name = name.clone();
    let error = read(&files).unwrap_err();
    assert_eq!((error.code, error.file.as_ref(), error.frame), ("keypoint_count", Some(&name), Some(0)));
}

#[test]
fn merges_mixed_skeletons_into_the_widest_convention() {
    let halpe = KeypointConvention::Halpe26.names();
    let mut files = openpose(&COCO17);
    files.retain(|(name, _)| !name.contains("cam2_"));
    files.extend(openpose(halpe).into_iter().filter(|(name, _)| name.contains("cam2_")));
    let loaded = read(&files).unwrap();
    assert_eq!(loaded.session.convention, KeypointConvention::Halpe26);
    check(&loaded, "mixed", &COCO17, None);
    let toe = KeypointConvention::Halpe26.index_of("left_big_toe").unwrap();
    assert!(loaded.session.views[1].frames[0][0].keypoints[toe].is_present());
    assert!(!loaded.session.views[0].frames[0][0].keypoints[toe].is_present());
}

#[test]
fn reads_a_custom_skeleton_by_names() {
    let joints = ["right_knee", "right_hip", "nose", "left_hip", "neck", "left_knee", "left_ankle"];
    let mut files = openpose(&joints);
    assert_eq!(read(&files).unwrap_err().code, "skeleton_unknown");
    let names = ["RKnee", "RHip", "snout", "LHip", "Neck", "LKnee", "LAnkle"];
    files[0].1 = json!({"fps": 50, "keypoint_names": names}).to_string().into_bytes();
    let known = ["right_knee", "right_hip", "left_hip", "neck", "left_knee", "left_ankle"];
    let loaded = read(&files).unwrap();
    let neck = loaded.session.convention.index_of("neck").unwrap();
    let expected = people(0, 0, &joints)[0][4];
    assert_eq!(loaded.session.views[0].frames[0][0].keypoints[neck].pixel.x, expected[0]);
    assert!(known.iter().all(|name| loaded.session.convention.index_of(name).is_some()));
}

#[test]
fn reads_caliscope_points_with_time_stamps() {
    let mut text =
        "sync_index,cam_id,frame_index,frame_time,point_id,img_loc_x,img_loc_y,obj_loc_x,obj_loc_y\n".to_owned();
    let mut stamps = "cam_id,frame_time\n".to_owned();
    for frame in 0..N_FRAMES {
        for i in 0..CAMERAS.len() {
            stamps += &format!("{},{}\n", i + 1, 0.02 * frame as f64);
            for (id, [x, y, _]) in people(i, frame, &COCO17)[0].iter().enumerate() {
                text += &format!("{frame},{},{frame},{},{id},{x},{y},,\n", i + 1, 0.02 * frame as f64);
            }
        }
    }
    let files = vec![
        calib_toml(),
        ("xy_rtmpose.csv".to_owned(), text.into_bytes()),
        ("timestamps.csv".to_owned(), stamps.into_bytes()),
    ];
    let loaded = read(&files).unwrap();
    assert_eq!((loaded.format.as_str(), loaded.session.n_frames), ("caliscope with toml", N_FRAMES as usize));
    assert!((loaded.session.fps - 50.0).abs() < 1e-9);
    let expected = people(2, 5, &COCO17)[0][9];
    assert_eq!(loaded.session.views[2].frames[5][0].keypoints[9].pixel.x, expected[0]);
}

#[test]
fn reads_caliscope_frame_times_as_rate_and_offsets() {
    let mut text = "sync_index,cam_id,frame_index,frame_time,point_id,img_loc_x,img_loc_y\n".to_owned();
    for frame in 0..N_FRAMES {
        for i in 0..CAMERAS.len() {
            let time = 7.0 + 0.04 * frame as f64 + if i == 2 { 0.012 } else { 0.0 };
            for (id, [x, y, _]) in people(i, frame, &COCO17)[0].iter().enumerate() {
                text += &format!("{frame},{},{frame},{time},{id},{x},{y}\n", i + 1);
            }
        }
    }
    let loaded = read(&vec![calib_toml(), ("xy_rtmpose.csv".to_owned(), text.into_bytes())]).unwrap();
    assert!((loaded.session.fps - 25.0).abs() < 1e-6, "{}", loaded.session.fps);
    let offsets: Vec<f64> = loaded.session.views.iter().map(|view| view.time_offset).collect();
    assert!(offsets[0] == 0.0 && offsets[1].abs() < 1e-9 && (offsets[2] - 0.012).abs() < 1e-9, "{offsets:?}");
    assert!(!loaded.warnings.iter().any(|line| line.contains("frame rate")), "{:?}", loaded.warnings);
}

#[test]
fn files_of_other_formats_are_counted_in_one_warning() {
    let mut files = openpose(&COCO17);
    for n in 0..45 {
        files.push((format!("images/board{n}x.png"), b"\x89PNG\r\n\x1a\n".to_vec()));
    }
    files.push(("notes.txt".to_owned(), b"a note".to_vec()));
    let warnings = read(&files).unwrap().warnings;
    let lines: Vec<&String> = warnings.iter().filter(|line| line.contains("other formats")).collect();
    assert!(lines.len() == 1 && lines[0].starts_with("46 files of other formats are ignored ("), "{warnings:?}");
}

#[test]
fn videos_are_answered_with_what_to_run_first() {
    let video = b"\0\0\0\x20ftypisom\0\0\x02\0".to_vec();
    let error = read(&vec![calib_toml(), ("cam1.mp4".to_owned(), video.clone())]).unwrap_err();
    assert_eq!(error.code, "poses_not_detected");
    assert!(error.detail.contains("cam1.mp4") && error.remedy.contains("--write_json"), "{error}");
    let limits = wandless::session::upload::UploadLimits::default();
    let single = wandless::session::upload::read_upload(std::io::Cursor::new(video), "cam1.mp4", &limits);
    assert_eq!(single.unwrap_err().code, "poses_not_detected");
}

#[test]
fn rejects_implausible_poses_with_location() {
    let code = |files: &Files| read(files).map_err(|e| (e.code, e.file)).unwrap_err();
    let mut normalised = openpose(&COCO17);
    for (name, content) in &mut normalised {
        if name.ends_with("keypoints.json") {
            let mut document: Value = serde_json::from_slice(content).unwrap();
            for number in document["people"]
                .as_array_mut()
                .unwrap()
                .iter_mut()
                .flat_map(|p| p["pose_keypoints_2d"].as_array_mut().unwrap())
            {
                *number = json!(number.as_f64().unwrap() / 1280.0);
            }
            *content = document.to_string().into_bytes();
        }
    }
    assert_eq!(code(&normalised).0, "keypoint_invalid");
    let mut damaged = openpose(&COCO17);
    damaged[10].1 = br#"{"people": [{"pose_keypoints_2d": [Infinity, 1, 1]}]}"#.to_vec();
    assert_eq!(code(&damaged), ("number_not_finite", Some(damaged[10].0.clone())));
    let mut uncalibrated = openpose(&COCO17);
    uncalibrated.remove(1);
    assert_eq!(code(&uncalibrated).0, "image_size_unknown");
    let mut twice = openpose(&COCO17);
    twice.extend(alphapose(1.0).into_iter().filter(|(name, _)| name.contains("cam1/")));
    assert_eq!(code(&twice).0, "session_ambiguous");
}

#[test]
fn reads_a_64_bit_zip_of_frame_files() {
    let mut files = vec![header(), calib_toml()];
    for camera in CAMERAS {
        files.extend((0..22_000).map(|i| (format!("{camera}/{i:06}.json"), br#"{"people":[]}"#.to_vec())));
    }
    assert!(files.len() > usize::from(u16::MAX));
    assert_eq!(read(&files).unwrap().session.n_frames, 22_000);
}

/// MediaPipe's array of two cameras, `[cameras, frames, points, x y]`, little-endian doubles in numpy's layout.
fn array_of(n_frames: usize, n_points: usize, numbers: impl Iterator<Item = f64>) -> Vec<u8> {
    let shape = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': (2, {n_frames}, {n_points}, 2), }}");
    let header = format!("{shape:<117}\n");
    let mut array = b"\x93NUMPY\x01\x00".to_vec();
    array.extend((header.len() as u16).to_le_bytes());
    array.extend(header.as_bytes());
    numbers.for_each(|number| array.extend(number.to_le_bytes()));
    array
}

/// A folder with the array and a calibration of its cameras.
fn folder_of(array: &[u8]) -> tempfile::TempDir {
    let camera = |name: &str| {
        format!(
            "[{name}]\nname = \"{name}\"\nsize = [1280, 720]\nmatrix = [[800, 0, 640], [0, 800, 360], [0, 0, 1]]\n\
             distortions = [0.0, 0.0, 0.0, 0.0]\nrotation = [0.0, 0.0, 0.0]\ntranslation = [0.0, 0.0, 4.0]\n\n"
        )
    };
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("Calib.toml"), camera("0") + &camera("1")).unwrap();
    std::fs::write(folder.path().join("mediapipe2dData.npy"), array).unwrap();
    folder
}

#[test]
fn reads_an_array_of_all_cameras_as_blazepose() {
    let (n_frames, n_points) = (3, 35);
    let mut numbers = Vec::new();
    for i in 0..2 * n_frames * n_points {
        let (frame, point) = (i / n_points, i % n_points);
        let seen = if frame == 1 || point == 4 { f64::NAN } else { 100.0 + i as f64 };
        numbers.extend([seen, seen + 0.5]);
    }
    let array = array_of(n_frames, n_points, numbers.into_iter());
    let folder = folder_of(&array);
    let loaded = wandless::session::upload::read_path(folder.path(), &Default::default()).unwrap();
    let session = &loaded.session;
    assert!(loaded.format.starts_with("mediapipe"), "{}", loaded.format);
    assert_eq!((session.convention.name(), session.n_frames, session.views.len()), ("blazepose33", n_frames, 2));
    assert!(session.views[0].frames[1].is_empty(), "no person was detected");
    let person = &session.views[1].frames[2][0];
    let first = 100.0 + (5 * n_points) as f64;
    assert_eq!((person.keypoints[0].pixel.x, person.keypoints[0].pixel.y), (first, first + 0.5));
    assert!(!person.keypoints[4].is_present() && person.keypoints[5].is_present());
    std::fs::write(folder.path().join("mediapipe2dData.npy"), &array[..array.len() - 8]).unwrap();
    assert!(wandless::session::upload::read_path(folder.path(), &Default::default()).is_err(), "it is truncated");
}

/// Hands follow the body in either order; each is assigned to the arm at whose wrist it begins.
#[test]
fn reads_hands_of_an_array_in_either_order() {
    let convention = KeypointConvention::Blazepose33;
    let (n_frames, n_points) = (3, 80);
    for sides in [["left", "right"], ["right", "left"]] {
        let mut numbers = Vec::new();
        for camera in 0..2 {
            for frame in 0..n_frames {
                let body = &people(camera, frame as i64, convention.names())[0];
                let missing = |[x, y, c]: &Point| if *c > 0.0 { [*x, *y] } else { [f64::NAN; 2] };
                let mut points: Vec<[f64; 2]> = body.iter().map(missing).collect();
                for side in sides {
                    let [x, y, _] = body[convention.index_of(&format!("{side}_wrist")).unwrap()];
                    // In the second frame no hand was detected.
                    let at = |k: usize| if frame == 1 { [f64::NAN; 2] } else { [x + k as f64, y] };
                    points.extend((0..21).map(at));
                }
                points.resize(n_points, [1.0; 2]);
                numbers.extend(points.into_iter().flatten());
            }
        }
        let folder = folder_of(&array_of(n_frames, n_points, numbers.into_iter()));
        let session = wandless::session::upload::read_path(folder.path(), &Default::default()).unwrap().session;
        assert_eq!(session.convention, KeypointConvention::Blazepose75, "{sides:?}");
        for (view, frame) in [(0, 0), (1, 2)] {
            let keypoints = &session.views[view].frames[frame][0].keypoints;
            for (wrist, hand) in [("left_wrist", 33), ("right_wrist", 54)] {
                let wrist = keypoints[convention.index_of(wrist).unwrap()].pixel;
                assert_eq!((keypoints[hand].pixel, keypoints[hand + 20].pixel.x), (wrist, wrist.x + 20.0), "{sides:?}");
            }
        }
        let without = &session.views[0].frames[1][0].keypoints;
        assert!(without.len() == 75 && without[33..].iter().all(|keypoint| !keypoint.is_present()));
    }
}

/// AlphaPose's 136 points, and its 68 without face.
#[test]
fn reads_whole_bodies_of_halpe() {
    let body = KeypointConvention::Halpe26.names();
    for (n_points, hand) in [(136, 94), (68, 26)] {
        let mut files = vec![header(), calib_toml()];
        for (i, camera) in CAMERAS.iter().enumerate() {
            let item = |frame: i64| {
                let mut points = people(i, frame, body).remove(0);
                let [x, y, _] = points[10];
                points.extend((26..n_points).map(|k| [x + k as f64, y, 0.5]));
                json!({"image_id": format!("{frame}.jpg"), "category_id": 1, "keypoints": flat(&points), "score": 2.9})
            };
            let items: Vec<Value> = (0..N_FRAMES).map(item).collect();
            files.push((format!("{camera}/alphapose-results.json"), Value::Array(items).to_string().into_bytes()));
        }
        let session = read(&files).unwrap().session;
        assert_eq!(session.convention, KeypointConvention::Halpe136);
        let keypoints = &session.views[1].frames[3][0].keypoints;
        let wrist = keypoints[10].pixel;
        // The last point of the right hand, and the tip of the left thumb.
        assert!((keypoints[135].pixel.x - wrist.x - n_points as f64 + 1.0).abs() < 1e-9);
        assert!((keypoints[94 + 4].pixel.x - wrist.x - (hand + 4) as f64).abs() < 1e-9);
        assert_eq!(keypoints[40].is_present(), n_points == 136);
    }
}

/// DeepLabCut's HDF5 is refused with instructions for a conversion.
#[test]
fn rejects_hdf5_with_conversion_hint() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("cam1DLC.h5"), b"\x89HDF\r\n\x1a\n\0\0\0\0").unwrap();
    let error = wandless::session::upload::read_path(folder.path(), &Default::default()).unwrap_err();
    assert!(error.to_string().contains("to_csv"), "{error}");
}
