//! A synthetic result, written and read back.

use super::*;
use crate::body::skeleton::{JOINT_NAMES, KeypointConvention, N_JOINTS};
use crate::geometry::{Distortion, Intrinsics, Rigid, rotation};
use crate::session::people::{BodyMotion, BodyPose, HandMotion, HandPose, JointTrajectory};
use crate::session::reconstruction::*;
use crate::session::recording::UpAxis;
use crate::session::{Detection, FrameIndex, Keypoint, PersonId, View};
use nalgebra::{Matrix3, Vector2, Vector3};
use serde_json::{Value, json};
use std::fs;
use std::io::Read;

const TURN: Vector3<f64> = Vector3::new(0.3, -0.2, 0.1);

fn session() -> Session {
    let detection = Detection { track_id: None, keypoints: vec![Keypoint::new(Vector2::new(1.0, 2.0), 1.0); 17] };
    let view = |id: &str| View {
        id: id.to_owned(),
        intrinsics: Intrinsics {
            width: 640,
            height: 480,
            fx: 500.0,
            fy: 501.0,
            cx: 320.0,
            cy: 240.0,
            skew: 0.0,
            dist: Distortion::None,
        },
        has_intrinsics: true,
        camera_from_world: None,
        time_offset: 0.0,
        frames: vec![vec![detection.clone()], Vec::new(), vec![detection.clone(), detection.clone()]],
        delivered: vec![FrameIndex(2), FrameIndex(0)],
    };
    Session {
        name: "made up".to_owned(),
        fps: 25.0,
        first_frame: 300,
        n_frames: 3,
        dense: None,
        convention: KeypointConvention::Coco17,
        up_axis: None,
        start_timecode: None,
        views: vec![view("b"), view("a")],
    }
}

fn reconstruction() -> Reconstruction {
    let camera_from_world = Rigid { rotation: rotation::exp(&TURN), translation: Vector3::new(0.1, 0.2, 1.0 / 3.0) };
    let camera = |camera_from_world: Option<Rigid>| SolvedCamera {
        camera_from_world,
        reprojection_px: camera_from_world.map(|_| ErrorSummary { mean: 2.5, median: f64::NAN }),
        n_observations: 34,
        sigma_position_mm: camera_from_world.map(|_| 1.5),
        sigma_angle_deg: None,
        time_offset: None,
        focal_factor: None,
    };
    let pose = |x: f64| BodyPose {
        rotations: std::array::from_fn(|j| if j == 1 { rotation::exp(&TURN) } else { Matrix3::identity() }),
        translation: Vector3::new(x, 1.0 / 3.0, 0.0),
        joints: std::array::from_fn(|j| Vector3::new(j as f64, x, 0.0)),
        valid: x < 0.5,
    };
    let mut points = vec![None; 17];
    points[5] = Some(Vector3::new(1.0, f64::INFINITY, 0.0));
    points[6] = Some(Vector3::new(1.0, 2.0, 3.000_000_4));
    Reconstruction {
        cameras: vec![camera(Some(camera_from_world)), camera(None)],
        keypoints: vec![JointTrajectory {
            person: PersonId(0),
            first: FrameIndex(0),
            points: vec![points, vec![None; 17]],
            n_views: vec![vec![0; 17]; 2],
        }],
        motions: vec![BodyMotion {
            person: PersonId(0),
            first: FrameIndex(1),
            betas: [0.5; 10],
            frames: vec![pose(0.25), pose(0.75)],
            joint_sigmas: Some(vec![[0.0125; 24], [0.02; 24]]),
            hands: None,
        }],
        identities: vec![
            vec![vec![Some(PersonId(0))], vec![], vec![None, Some(PersonId(0))]],
            vec![vec![None], vec![], vec![None, None]],
        ],
        up_axis: UpAxis::Y,
        body_model: BodyModelId { name: "default".to_owned(), sha256: "00".repeat(32) },
        hand_sources: None,
        repairs: Some(DetectionRepairs {
            identities_before: vec![
                vec![vec![Some(PersonId(0))], vec![], vec![Some(PersonId(0)), Some(PersonId(1))]],
                vec![vec![None], vec![], vec![None, None]],
            ],
            repaired: vec![RepairedDetection {
                view: 0,
                frame: FrameIndex(2),
                detection: 1,
                sources: (0..17).map(|k| (k > 0).then_some(if k == 5 { 6 } else { k })).collect(),
            }],
        }),
        report: Report {
            detector: KeypointBias::default(),
            landmarks: None,
            consistency: None,
            geometry: GeometryReport::default(),
            penetration: PenetrationReport::default(),
            stages: vec![],
            cameras: vec![],
            people: vec![],
            heldout_px: Some(f64::INFINITY),
            scale: None,
            rejected_detections: 0.25,
            keypoints_from: "points".to_owned(),
            suspicions: vec![],
            quality: Quality { verdict: Verdict::Warn, reasons: vec!["few views".to_owned()] },
        },
    }
}

fn context() -> ResultContext<'static> {
    ResultContext {
        input_sha256: "ab",
        options: json!({"seed": 0, "people": null}),
        solver_version: "0.0.0",
        exports: &[ExportFormat::SmplNpz],
        continuation: None,
    }
}

fn written() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    write_result(dir.path(), &session(), &context(), &reconstruction()).unwrap();
    dir
}

fn read(dir: &Path, name: &str) -> Value {
    serde_json::from_slice(&fs::read(dir.join(name)).unwrap()).unwrap()
}

#[test]
fn cameras_keep_all_digits_and_unsolved_are_null() {
    let dir = written();
    let cameras = read(dir.path(), "cameras.json");
    let (solved, unsolved) = (&cameras["cameras"][0], &cameras["cameras"][1]);
    let pose = reconstruction().cameras[0].camera_from_world.unwrap();
    assert_eq!(solved["R"][1][2].as_f64(), Some(pose.rotation[(1, 2)]));
    assert_eq!(solved["t"][2].as_f64(), Some(1.0 / 3.0));
    assert_eq!(solved["position"][0].as_f64(), Some(pose.center().x));
    assert_eq!(solved["reprojection_px"], json!({"mean": 2.5, "median": null}));
    assert_eq!((&solved["status"], &solved["sigma_position_mm"]), (&json!("solved"), &json!(1.5)));
    assert_eq!((&unsolved["id"], &unsolved["status"]), (&json!("a"), &json!("unsolved")));
    assert!(unsolved["R"].is_null() && unsolved["t"].is_null() && unsolved["position"].is_null());
}

#[test]
fn people_and_joints_have_the_sessions_frame_numbers() {
    let dir = written();
    let person = &read(dir.path(), "people.json")["people"][0];
    assert_eq!(person["frames"], json!([301, 302]));
    assert_eq!(person["valid"], json!([true, false]));
    assert_eq!(person["transl"][0], json!([0.25, 0.333333, 0.0]));
    assert_eq!(person["body_pose"][0].as_array().unwrap().len(), 69);
    assert_eq!(person["body_pose"][0][0], json!(0.3));
    assert_eq!(person["global_orient"][1], json!([0.0, 0.0, 0.0]));
    assert_eq!(person["joint_sigma_mm"], json!([vec![12.5; 24], vec![20.0; 24]]));

    let joints = read(dir.path(), "poses3d.json");
    assert_eq!(joints["joint_names"], json!(JOINT_NAMES));
    assert_eq!(joints["frames"]["302"]["0"][2], json!([2.0, 0.75, 0.0]));
    assert_eq!(joints["frames"]["301"]["0"].as_array().unwrap().len(), N_JOINTS);

    let keypoints = read(dir.path(), "keypoints3d.json");
    assert_eq!(keypoints["joint_names"].as_array().unwrap().len(), 17);
    assert_eq!(keypoints["frames"].as_object().unwrap().len(), 1, "a frame without points is left out");
    assert_eq!(keypoints["frames"]["300"]["0"][5], Value::Null, "infinity is not written");
    assert_eq!(keypoints["frames"]["300"]["0"][6], json!([1.0, 2.0, 3.0]));
}

#[test]
fn identities_follow_the_order_of_the_input() {
    let dir = written();
    let text = fs::read_to_string(dir.path().join("identities.json")).unwrap();
    assert_eq!(text, "{\"b\":[[null,0],[0]],\"a\":[[null,null],[null]]}\n");
}

#[test]
fn numbers_that_are_not_finite_become_null() {
    let dir = written();
    assert_eq!(read(dir.path(), "report.json")["heldout_px"], Value::Null);
}

#[test]
fn npz_reads_back() {
    let dir = written();
    let npz = fs::File::open(dir.path().join("smplh/0.npz")).unwrap();
    let mut npz = zip::ZipArchive::new(npz).unwrap();
    let mut member = |name: &str| {
        let mut bytes = Vec::new();
        npz.by_name(&format!("{name}.npy")).unwrap().read_to_end(&mut bytes).unwrap();
        bytes
    };
    let poses = member("poses");
    let poses = npyz::NpyFile::new(&poses[..]).unwrap();
    assert_eq!(poses.shape(), [2, 156]);
    let poses: Vec<f64> = poses.into_vec().unwrap();
    assert!((Vector3::new(poses[3], poses[4], poses[5]) - TURN).norm() < 1e-12);
    assert!(poses[66..156].iter().all(|x| *x == 0.0));
    let frames: Vec<i64> = npyz::NpyFile::new(&member("frames")[..]).unwrap().into_vec().unwrap();
    assert_eq!(frames, [301, 302]);
    let gender = member("gender");
    let gender = npyz::NpyFile::new(&gender[..]).unwrap();
    assert_eq!((gender.dtype().descr(), gender.shape().len()), ("'<U7'".to_owned(), 0));
    assert_eq!(gender.into_vec::<String>().unwrap(), ["neutral"]);
}

#[test]
fn jaw_and_eyes_of_smplx_come_before_the_fingers() {
    let dir = written();
    assert!(!dir.path().join("smplx").exists(), "no hands were fitted");
    let mut solved = reconstruction();
    let turn = |angle: f64| rotation::exp(&(Vector3::x() * angle));
    let hand = |angle: f64| {
        let pose = HandPose { rotations: [turn(angle); 15], joints: [Vector3::zeros(); 15], n_views: 2 };
        HandMotion { frames: vec![pose; 2] }
    };
    solved.motions[0].hands = Some([hand(0.5), hand(-0.25)]);
    write_result(dir.path(), &session(), &context(), &solved).unwrap();
    let npz = fs::File::open(dir.path().join("smplx/0.npz")).unwrap();
    let mut npz = zip::ZipArchive::new(npz).unwrap();
    let mut array = |name: &str| {
        let mut bytes = Vec::new();
        npz.by_name(&format!("{name}.npy")).unwrap().read_to_end(&mut bytes).unwrap();
        let array = npyz::NpyFile::new(&bytes[..]).unwrap();
        (array.shape().to_vec(), array.into_vec::<f64>().unwrap())
    };
    let (shape, poses) = array("poses");
    assert_eq!(shape, [2, 165]);
    assert!(poses[66..75].iter().all(|angle| *angle == 0.0));
    assert!((poses[75] - 0.5).abs() < 1e-12 && (poses[75 + 45] + 0.25).abs() < 1e-12, "left hand first");
    let (shape, expression) = array("expression");
    assert!(shape == [2, 10] && expression.iter().all(|x| *x == 0.0));
}

#[test]
fn the_manifest_lists_every_file_but_itself() {
    let dir = written();
    let mut manifest = read(dir.path(), "manifest.json");
    for file in manifest["files"].as_array_mut().unwrap() {
        let bytes = fs::read(dir.path().join(file["name"].as_str().unwrap())).unwrap();
        assert_eq!(file["bytes"], json!(bytes.len()));
        assert_eq!(file["sha256"], json!(crate::session::digest::sha256_of_reader(&mut &bytes[..]).unwrap()));
        // Sizes and digests are checked above; they depend on the last digit of the machine's arithmetic.
        (file["bytes"], file["sha256"]) = (json!("checked"), json!("checked"));
    }
    insta::assert_json_snapshot!(manifest);
}

#[test]
fn same_result_gives_same_bytes() {
    let (a, b) = (written(), written());
    for name in ["manifest.json", "people.json", "smpl/0.npz"] {
        assert_eq!(fs::read(a.path().join(name)).unwrap(), fs::read(b.path().join(name)).unwrap(), "{name}");
    }
}

#[test]
fn formats_written_later_have_the_same_bytes() {
    let (at_once, later) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let context = ResultContext { exports: &ExportFormat::ALL, ..context() };
    write_result(at_once.path(), &session(), &context, &reconstruction()).unwrap();
    let take = read_take(at_once.path()).unwrap();
    assert_eq!((take.motions.len(), take.unsolved.as_slice()), (1, &["a".to_owned()][..]));
    let representations = write_formats(later.path(), &take, &ExportFormat::ALL).unwrap();
    let files: Vec<&String> = representations.iter().flat_map(|r| &r.files).collect();
    assert!(files.len() >= 13);
    for name in files {
        assert_eq!(
            fs::read(at_once.path().join(name)).unwrap(),
            fs::read(later.path().join(name)).unwrap(),
            "{name} differs"
        );
    }
}

#[test]
fn every_lens_reads_back() {
    let lenses = [
        Distortion::None,
        Distortion::OpenCv5([-0.1, 0.02, 0.001, -0.0005, 0.004]),
        Distortion::Rational8([0.6, 0.1, 0.0005, -0.0003, 0.01, 0.75, 0.2, 0.02]),
        // A fisheye with zero coefficients still measures angles.
        Distortion::Fisheye4([0.0; 4]),
        Distortion::Fisheye4([-0.03, 0.012, -0.006, 0.001]),
    ];
    for dist in lenses {
        let mut session = session();
        session.views[0].intrinsics.dist = dist;
        let dir = tempfile::tempdir().unwrap();
        write_result(dir.path(), &session, &context(), &reconstruction()).unwrap();
        assert_eq!(read_take(dir.path()).unwrap().cameras[0].intrinsics.dist, dist);
    }
}

#[test]
fn carries_over_poses_that_are_not_finite() {
    let mut broken = reconstruction();
    broken.motions[0].frames[0].joints[3].y = f64::NAN;
    let dir = tempfile::tempdir().unwrap();
    write_result(dir.path(), &session(), &context(), &broken).unwrap();
    let take = read_take(dir.path()).unwrap();
    assert_eq!(take, take::take_of(&session(), &broken));
    let frames = &take.motions[0].frames;
    assert_eq!((frames[0].joints, frames[0].valid), (frames[1].joints, false));
}

#[test]
fn rejects_inconsistent_results() {
    let faults = [
        ("manifest.json", "\"frame_range\":[300,302]", "\"frame_range\":[302,300]", "publish.frame_range"),
        ("manifest.json", "\"frame_range\":[300,302]", "\"frame_range\":[-9223372036854775808,302]", "frame_range"),
        ("people.json", "[301,302]", "[301,303]", "consecutive frames"),
        ("people.json", "[301,302]", "[302,303]", "consecutive frames from 300 to 302"),
        ("people.json", "[true,false]", "[true]", "2 entries in every list"),
        ("people.json", "\"joint_sigma_mm\":[", "\"joint_sigma_mm\":[],\"was\":[", "2 entries in every list"),
        ("poses3d.json", "\"302\"", "\"309\"", "24 joints"),
        ("keypoints3d.json", "\"300\":", "\"299\":", "17 points in a frame from 300 to 302"),
        ("cameras.json", "\"width\":640", "\"width\":0", "camera b: size"),
        ("cameras.json", "[500.0,", "[-500.0,", "focal lengths"),
        ("cameras.json", "\"dist\":[0.0,0.0,", "\"dist\":[", "camera b: dist"),
        ("cameras.json", "\"dist\":", "\"distortion_model\":\"fov\",\"dist\":", "fov [0.0,"),
        ("cameras.json", "\"dist\":", "\"distortion_model\":\"fisheye\",\"dist\":[1.0],\"was\":", "fisheye [1.0]"),
        ("cameras.json", "{", "[", "cameras.json"),
    ];
    for (file, right, wrong, expected) in faults {
        let dir = written();
        let text = fs::read_to_string(dir.path().join(file)).unwrap();
        assert!(text.contains(right), "{file}: {right}");
        fs::write(dir.path().join(file), text.replacen(right, wrong, 1)).unwrap();
        let error = read_take(dir.path()).unwrap_err().to_string();
        assert!(error.contains(expected), "{file}: {error}");
    }
}

/// Header and payload of a self-describing file.
fn opened(dir: &Path, name: &str) -> (Value, Vec<u8>) {
    let bytes = fs::read(dir.join(name)).unwrap();
    let end = 12 + u32::from_le_bytes(bytes[8..12].try_into().unwrap()) as usize;
    (serde_json::from_slice(&bytes[12..end]).unwrap(), bytes[end..].to_vec())
}

/// One f32 of an array by its index.
fn f32_at(payload: &[u8], array: &Value, index: usize) -> f32 {
    assert_eq!(array["type"], "f32");
    let at = array["offset"].as_u64().unwrap() as usize + 4 * index;
    f32::from_le_bytes(payload[at..at + 4].try_into().unwrap())
}

#[test]
fn motion_bin_reads_back() {
    let mut session = session();
    for (frame, track_id) in [(0, 7), (2, 8)] {
        session.views[0].frames[frame].iter_mut().for_each(|d| d.track_id = Some(track_id));
    }
    let dir = tempfile::tempdir().unwrap();
    write_result(dir.path(), &session, &context(), &reconstruction()).unwrap();
    let (header, payload) = opened(dir.path(), "stages/motion.bin");
    assert_eq!(header["world"], read(dir.path(), "cameras.json"));
    assert_eq!((&header["first_frame"], &header["n_frames"]), (&json!(300), &json!(3)));
    let person = &header["people"][0];
    assert_eq!(person["first"], 1);
    assert_eq!(person["joints"]["shape"], json!([2, 24, 3]));
    assert_eq!(f32_at(&payload, &person["joints"], (24 + 5) * 3), 5.0);
    assert_eq!(f32_at(&payload, &person["joints"], (24 + 5) * 3 + 1), 0.75);
    // The trajectory starts a frame before the motion; its second row, the motion's first, has no points.
    assert!(f32_at(&payload, &person["keypoints"], 6 * 3).is_nan());
    assert_eq!(person["repairs"], json!([[2, 0]]));
    let rejected = header["rejected"]["offset"].as_u64().unwrap() as usize;
    assert_eq!(payload[rejected..rejected + 6], [0, 0, 1, 1, 0, 2]);
    let repaired = header["repaired"]["offset"].as_u64().unwrap() as usize;
    assert_eq!(payload[repaired..repaired + 6], [0, 0, 1, 0, 0, 0]);
    // Joint 4 is a child of joint 1, the only rotated one.
    let turns = person["turns"]["offset"].as_u64().unwrap() as usize + 2 * 4 * 4;
    let turn = |i: usize| i16::from_le_bytes([payload[turns + 2 * i], payload[turns + 2 * i + 1]]);
    let half = TURN.norm() / 2.0;
    assert_eq!(turn(3), (half.cos() * f64::from(i16::MAX)).round() as i16);
    let x = TURN.x / TURN.norm() * half.sin();
    assert_eq!(turn(0), (x * f64::from(i16::MAX)).round() as i16);
}

#[test]
fn motion_bin_has_fingers_where_hands_were_fitted() {
    let dir = written();
    let (header, _) = opened(dir.path(), "stages/motion.bin");
    assert!(header.get("hands").is_none() && header["people"][0].get("fingers").is_none());
    let mut solved = reconstruction();
    let hand = |x: f64| {
        let joints = |frame: usize| std::array::from_fn(|j| Vector3::new(x, frame as f64, j as f64));
        let pose = |frame| HandPose { rotations: [Matrix3::identity(); 15], joints: joints(frame), n_views: 2 };
        HandMotion { frames: (0..2).map(pose).collect() }
    };
    solved.motions[0].hands = Some([hand(0.5), hand(-0.5)]);
    write_result(dir.path(), &session(), &context(), &solved).unwrap();
    let (header, payload) = opened(dir.path(), "stages/motion.bin");
    assert_eq!(header["hands"]["wrists"], json!([20, 21]));
    assert_eq!(
        header["hands"]["parents"].as_array().unwrap()[..5],
        [json!(null), json!(0), json!(1), json!(null), json!(3)]
    );
    let fingers = &header["people"][0]["fingers"];
    assert_eq!(fingers["shape"], json!([2, 2, 15, 3]));
    // Right hand of the second frame, joint 14.
    let at = ((2 + 1) * 15 + 14) * 3;
    assert_eq!([0, 1, 2].map(|c| f32_at(&payload, fingers, at + c)), [-0.5, 1.0, 14.0]);
}

#[test]
fn detections_bin_reads_back() {
    let dir = written();
    let (header, payload) = opened(dir.path(), "stages/detections.bin");
    let camera = &header["cameras"][0];
    let at = |name: &str| camera[name]["offset"].as_u64().unwrap() as usize;
    assert_eq!(camera["id"], "b");
    assert_eq!(payload[at("starts")..at("starts") + 16], [0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 3, 0, 0, 0]);
    assert_eq!(payload[at("person")..at("person") + 6], [0, 0, 0xff, 0xff, 0, 0]);
    assert_eq!(f32_at(&payload, &camera["pixels"], 3), 2.0);
    assert_eq!(payload[at("confidence")], 255);
    assert_eq!(payload[at("before")..at("before") + 6], [0, 0, 0, 0, 1, 0]);
    assert_eq!((&camera["repaired"]["shape"], payload[at("repaired")]), (&json!([1]), 2));
    assert_eq!(payload[at("sources")..at("sources") + 6], [255, 1, 2, 3, 4, 6]);
    assert_eq!(header["cameras"][1]["repaired"]["shape"], json!([0]));
}
