//! A synthetic result that is difficult for every format: people that come and go, asymmetric cameras, unusual names.

use nalgebra::{Matrix3, Vector2, Vector3};
use serde_json::Value;
use std::fs;
use std::path::PathBuf;
use tempfile::TempDir;
use wandless::body::skeleton::{KeypointConvention, N_JOINTS};
use wandless::body::skinning::skinned;
use wandless::body::{Betas, default_body, kinematics};
use wandless::export::{ResultContext, write_result};
use wandless::geometry::{Distortion, Intrinsics, Rigid, rotation};
use wandless::session::people::{BodyMotion, BodyPose, JointTrajectory};
use wandless::session::reconstruction::*;
use wandless::session::recording::UpAxis;
use wandless::session::{FrameIndex, PersonId, Reconstruction, Session, View};

/// Largest distance between joints of exports and `poses3d.json`, m.
pub(crate) const JOINT_TOLERANCE: f64 = 0.5e-3;
/// Largest distance between a scene's skinned vertices and the body's own skinning, m.
pub(crate) const SKIN_TOLERANCE: f64 = 1e-3;
/// Largest distance between projections by exports and by `cameras.json`, px.
pub(crate) const PIXEL_TOLERANCE: f64 = 0.1;
pub(crate) const FIRST_FRAME: i64 = 100;
pub(crate) const N_FRAMES: usize = 40;
pub(crate) const FPS: f64 = 30.0;

/// A result folder and its JSON files.
pub(crate) struct Written {
    pub(crate) dir: TempDir,
    pub(crate) up_axis: UpAxis,
}

/// One person of `people.json` and `poses3d.json`, in the result's world.
pub(crate) struct WrittenPerson {
    pub(crate) id: usize,
    pub(crate) frames: Vec<i64>,
    pub(crate) valid: Vec<bool>,
    /// [frames][24]
    pub(crate) joints: Vec<Vec<Vector3<f64>>>,
    /// `people.json`'s entry.
    entry: Value,
}

impl WrittenPerson {
    /// Whether a frame of the time line is one of the person's, and the nearest of the person's frames.
    pub(crate) fn at(&self, frame: i64) -> (bool, usize) {
        let last = self.frames.len() as i64 - 1;
        let index = frame - self.frames[0];
        ((0..=last).contains(&index), index.clamp(0, last) as usize)
    }

    /// Vertices of the person's body in the `i`th frame by the body's own skinning, in the result's world.
    pub(crate) fn skin(&self, i: usize) -> Vec<Vector3<f64>> {
        let turns: Vec<f64> =
            ["global_orient", "body_pose"].iter().flat_map(|name| numbers(&self.entry[name][i])).collect();
        let pose = kinematics::Pose {
            rotations: std::array::from_fn(|j| rotation::exp(&Vector3::from_column_slice(&turns[3 * j..3 * j + 3]))),
            translation: Vector3::from_vec(numbers(&self.entry["transl"][i])),
        };
        skinned(&default_body(), &Betas::from_vec(numbers(&self.entry["betas"])), &pose)
    }
}

/// One camera of `cameras.json`.
#[derive(Clone)]
pub(crate) struct WrittenCamera {
    pub(crate) id: String,
    pub(crate) lens: Intrinsics,
    pub(crate) camera_from_world: Rigid,
}

impl WrittenCamera {
    pub(crate) fn pixel(&self, point_in_world: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.lens.pixel_from_camera(&self.camera_from_world.transform(point_in_world))
    }
}

/// The result in these formats, with y and with z up.
pub(crate) fn both_up_axes(formats: &[ExportFormat]) -> [Written; 2] {
    [UpAxis::Y, UpAxis::Z].map(|up_axis| written(up_axis, formats))
}

fn written(up_axis: UpAxis, formats: &[ExportFormat]) -> Written {
    let dir = tempfile::tempdir().unwrap();
    let context = ResultContext {
        input_sha256: "00",
        options: Value::Null,
        solver_version: "0.0.0",
        exports: formats,
        continuation: None,
    };
    write_result(dir.path(), &session(), &context, &reconstruction(up_axis)).unwrap();
    Written { dir, up_axis }
}

impl Written {
    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    pub(crate) fn text(&self, name: &str) -> String {
        fs::read_to_string(self.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    pub(crate) fn json(&self, name: &str) -> Value {
        serde_json::from_str(&self.text(name)).unwrap()
    }

    /// Converts a point of this result's world to a world with `up_axis` up.
    pub(crate) fn turned(&self, up_axis: UpAxis, p: &Vector3<f64>) -> Vector3<f64> {
        match (up_axis, self.up_axis) {
            (UpAxis::Y, UpAxis::Z) => Vector3::new(p.x, p.z, -p.y),
            (UpAxis::Z, UpAxis::Y) => Vector3::new(p.x, -p.z, p.y),
            _ => *p,
        }
    }

    pub(crate) fn people(&self) -> Vec<WrittenPerson> {
        let poses = self.json("poses3d.json");
        let people = self.json("people.json");
        let person = |person: &Value| {
            let id = person["id"].as_u64().unwrap() as usize;
            let frames: Vec<i64> = numbers(&person["frames"]).iter().map(|f| *f as i64).collect();
            let joints = frames.iter().map(|frame| {
                let joints = poses["frames"][frame.to_string()][id.to_string()].as_array().unwrap();
                joints.iter().map(|joint| Vector3::from_vec(numbers(joint))).collect()
            });
            let valid = person["valid"].as_array().unwrap().iter().map(|v| v.as_bool().unwrap()).collect();
            WrittenPerson { id, valid, joints: joints.collect(), frames, entry: person.clone() }
        };
        people["people"].as_array().unwrap().iter().map(person).collect()
    }

    /// The cameras with a solved pose.
    pub(crate) fn cameras(&self) -> Vec<WrittenCamera> {
        let file = self.json("cameras.json");
        let placed = file["cameras"].as_array().unwrap().iter().filter(|camera| !camera["R"].is_null());
        let matrix = |value: &Value| {
            let rows: Vec<Vec<f64>> = value.as_array().unwrap().iter().map(numbers).collect();
            Matrix3::from_fn(|r, c| rows[r][c])
        };
        placed
            .map(|camera| {
                let k = matrix(&camera["K"]);
                WrittenCamera {
                    id: camera["id"].as_str().unwrap().to_owned(),
                    lens: Intrinsics {
                        width: camera["width"].as_u64().unwrap() as u32,
                        height: camera["height"].as_u64().unwrap() as u32,
                        fx: k[(0, 0)],
                        fy: k[(1, 1)],
                        cx: k[(0, 2)],
                        cy: k[(1, 2)],
                        skew: k[(0, 1)],
                        dist: distortion(camera),
                    },
                    camera_from_world: Rigid {
                        rotation: matrix(&camera["R"]),
                        translation: Vector3::from_vec(numbers(&camera["t"])),
                    },
                }
            })
            .collect()
    }

    /// The losses of a format that the manifest lists.
    pub(crate) fn lost(&self, format: &str) -> Vec<String> {
        let manifest = self.json("manifest.json");
        let all = manifest["publish"]["representations"].as_array().unwrap();
        let one = all.iter().find(|r| r["name"] == format).unwrap();
        one["data"]["lost"].as_array().unwrap().iter().map(|s| s.as_str().unwrap().to_owned()).collect()
    }

    /// Compares a reader's projection of all joints with that of `cameras.json`; `hold` removes parameters that the format
    /// does not support.
    pub(crate) fn assert_projects(
        &self,
        camera: &WrittenCamera,
        hold: impl Fn(&mut Intrinsics),
        pixel: impl Fn(&Vector3<f64>) -> Vector2<f64>,
    ) {
        let mut camera = camera.clone();
        hold(&mut camera.lens);
        let mut n_compared = 0;
        for joint in self.people().iter().flat_map(|person| person.joints.iter().flatten()) {
            if let Some(ours) = camera.pixel(joint) {
                let distance = (ours - pixel(joint)).norm();
                assert!(distance <= PIXEL_TOLERANCE, "camera {}: {distance} px", camera.id);
                n_compared += 1;
            }
        }
        assert!(n_compared > 500, "camera {} sees too few joints", camera.id);
    }
}

fn distortion(camera: &Value) -> Distortion {
    let dist = numbers(&camera["dist"]);
    if camera["distortion_model"] == "fisheye" {
        Distortion::Fisheye4(dist.try_into().unwrap())
    } else {
        Distortion::from_opencv(&dist).unwrap()
    }
}

pub(crate) fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

pub(crate) fn assert_near(ours: &Vector3<f64>, theirs: &Vector3<f64>, what: &str) {
    let distance = (ours - theirs).norm();
    assert!(distance <= JOINT_TOLERANCE, "{what}: {distance} m");
}

/// Compares a scene's vertices, y up, with the body's own.
pub(crate) fn assert_same_skin(written: &Written, ours: &[Vector3<f64>], theirs: &[Vector3<f64>], what: &str) {
    assert_eq!(ours.len(), theirs.len());
    let distance = |(a, b): (&Vector3<f64>, &Vector3<f64>)| (written.turned(UpAxis::Y, a) - b).norm();
    let worst = ours.iter().zip(theirs).map(distance).fold(0.0, f64::max);
    assert!(worst <= SKIN_TOLERANCE, "{what}: {worst} m");
}

/// Sets the principal point to the image centre, for formats without one.
pub(crate) fn centred(lens: &mut Intrinsics) {
    lens.cx = (f64::from(lens.width) - 1.0) / 2.0;
    lens.cy = (f64::from(lens.height) - 1.0) / 2.0;
}

fn session() -> Session {
    let lens = |cx: f64, fy: f64, skew: f64, dist: Distortion| Intrinsics {
        width: 1920,
        height: 1080,
        fx: 1400.0,
        fy,
        cx,
        cy: 530.25,
        skew,
        dist,
    };
    let lenses = [
        lens(970.5, 1400.0, 0.0, Distortion::None),
        lens(940.0, 1410.0, 0.0, Distortion::OpenCv5([-0.1, 0.02, 0.001, -0.0005, 0.0])),
        lens(960.0, 1390.0, 0.0, Distortion::OpenCv5([-0.1, 0.02, 0.001, -0.0005, 0.004])),
        lens(960.0, 1400.0, 1.5, Distortion::None),
        lens(950.0, 1400.0, 0.0, Distortion::Rational8([0.6, 0.1, 0.0005, -0.0003, 0.01, 0.75, 0.2, 0.02])),
        lens(965.0, 1405.0, 0.0, Distortion::Fisheye4([-0.03, 0.012, -0.006, 0.001])),
        lens(960.0, 1400.0, 0.0, Distortion::None),
    ];
    let view = |(id, intrinsics): (&str, Intrinsics)| View {
        id: id.to_owned(),
        intrinsics,
        has_intrinsics: true,
        camera_from_world: None,
        time_offset: 0.0,
        frames: vec![Vec::new(); N_FRAMES],
        delivered: (0..N_FRAMES).map(FrameIndex).collect(),
    };
    Session {
        name: "a \"take\" \\ with 'quotes' ü\n".to_owned(),
        fps: FPS,
        first_frame: FIRST_FRAME,
        n_frames: N_FRAMES,
        convention: KeypointConvention::Coco17,
        dense: None,
        up_axis: None,
        start_timecode: None,
        views: ["01", "left/front", "cam c", "kamera-4", "wide", "dome", "lost"]
            .into_iter()
            .zip(lenses)
            .map(view)
            .collect(),
    }
}

fn reconstruction(up_axis: UpAxis) -> Reconstruction {
    let camera = |camera_from_world| SolvedCamera {
        camera_from_world,
        reprojection_px: None,
        n_observations: 0,
        sigma_position_mm: None,
        sigma_angle_deg: None,
        time_offset: None,
        focal_factor: None,
    };
    // Cameras around the people, looking at a point at chest height.
    let up = if up_axis == UpAxis::Y { Vector3::y() } else { Vector3::z() };
    let side = Vector3::x();
    let front = side.cross(&up);
    let look = |i: usize| {
        let angle = 1.3 * i as f64 + 0.4;
        let center = (side * angle.cos() + front * angle.sin()) * 4.0 + up * (1.2 + 0.5 * i as f64);
        let z = (up - center).normalize();
        let x = z.cross(&up).normalize();
        let rotation = Matrix3::from_rows(&[x.transpose(), z.cross(&x).transpose(), z.transpose()]);
        Rigid { rotation, translation: -(rotation * center) }
    };
    let placed = (0..6).map(|i| camera(Some(look(i))));
    let motions = vec![motion(0, 0, N_FRAMES, up_axis), motion(1, 7, 20, up_axis)];
    Reconstruction {
        cameras: placed.chain([camera(None)]).collect(),
        keypoints: motions.iter().map(keypoints).collect(),
        motions,
        identities: Vec::new(),
        up_axis,
        body_model: BodyModelId { name: "default".to_owned(), sha256: default_body().sha256() },
        hand_sources: None,
        repairs: None,
        report: Report {
            landmarks: None,
            detector: Default::default(),
            consistency: None,
            geometry: Default::default(),
            penetration: Default::default(),
            stages: Vec::new(),
            cameras: Vec::new(),
            people: Vec::new(),
            heldout_px: None,
            scale: None,
            rejected_detections: 0.0,
            keypoints_from: String::new(),
            suspicions: Vec::new(),
            quality: Quality { verdict: Verdict::Pass, reasons: Vec::new() },
        },
    }
}

/// The keypoint `k` of the fixture is this vector from joint `k`; `None` in every fourth frame of keypoint 3.
pub(crate) fn keypoint_offset(frame: usize, keypoint: usize) -> Option<Vector3<f64>> {
    (keypoint != 3 || !frame.is_multiple_of(4)).then(|| Vector3::new(0.01, 0.02, 0.001 * keypoint as f64))
}

fn keypoints(motion: &BodyMotion) -> JointTrajectory {
    let n_keypoints = KeypointConvention::Coco17.n_keypoints();
    let frame = |(i, pose): (usize, &BodyPose)| {
        (0..n_keypoints).map(|k| keypoint_offset(i, k).map(|offset| pose.joints[k] + offset)).collect()
    };
    JointTrajectory {
        person: motion.person,
        first: motion.first,
        points: motion.frames.iter().enumerate().map(frame).collect(),
        n_views: vec![vec![3; n_keypoints]; motion.frames.len()],
    }
}

/// A person who moves all joints and turns around twice; no camera detected frames 5 to 7 of the motion.
fn motion(person: usize, first: usize, n_frames: usize, up_axis: UpAxis) -> BodyMotion {
    let betas = Betas::from_fn(|k, _| 0.6 * (person as f64 + k as f64).sin());
    let body = default_body().shaped(&betas);
    let upright = if up_axis == UpAxis::Y {
        Matrix3::identity()
    } else {
        rotation::exp(&(Vector3::x() * std::f64::consts::FRAC_PI_2))
    };
    let pose = |t: usize| {
        let phase = t as f64 * 0.3 + person as f64;
        let swing = |j: usize| {
            let j = j as f64;
            Vector3::new((phase + j).sin(), (phase + 1.7 * j).cos(), (phase - j).sin()) * 0.7
        };
        let heading = rotation::exp(&(Vector3::y() * (phase * 1.1)));
        let mut rotations: [Matrix3<f64>; N_JOINTS] = std::array::from_fn(|j| rotation::exp(&swing(j)));
        rotations[0] = upright * heading * rotations[0];
        let place = upright * Vector3::new(0.3 * phase.sin() + person as f64, 0.1, 0.2 * phase);
        let pose = kinematics::Pose { rotations, translation: place - body.rest_joints[0] + upright * Vector3::y() };
        let posed = kinematics::posed(&body, &pose);
        BodyPose { rotations, translation: pose.translation, joints: posed.joints, valid: !(5..8).contains(&t) }
    };
    BodyMotion {
        person: PersonId(person),
        first: FrameIndex(first),
        betas: betas.into(),
        frames: (0..n_frames).map(pose).collect(),
        joint_sigmas: Some(vec![[0.01; N_JOINTS]; n_frames]),
        hands: None,
    }
}

#[test]
fn the_manifest_describes_every_format() {
    for written in both_up_axes(&ExportFormat::ALL) {
        let manifest = written.json("manifest.json");
        let publish = &manifest["publish"];
        assert_eq!(publish["people"][1]["frame_range"], serde_json::json!([107, 126]));
        let representations = publish["representations"].as_array().unwrap();
        assert_eq!(representations.len(), ExportFormat::ALL.len());
        for representation in representations {
            assert_eq!((&representation["frameStart"], &representation["frameEnd"]), (&100.into(), &139.into()));
            let files = representation["files"].as_array().unwrap();
            assert!(!files.is_empty() && files.iter().all(|file| written.path(file.as_str().unwrap()).is_file()));
        }
        assert!(written.lost("colmap").iter().any(|line| line.contains("camera kamera-4") && line.contains("skew")));
        assert!(written.lost("calib_toml").iter().any(|line| line.contains("camera cam c") && line.contains("k3")));
        let lists = |format: &str, id: &str, what: &str| {
            written.lost(format).contains(&format!("camera {id}: the format does not support {what}; see cameras.json"))
        };
        assert!(lists("calib_toml", "wide", "rational distortion"));
        assert!(lists("glb", "dome", "the principal point and fisheye distortion"));
        assert!(lists("opencv_yaml", "dome", "fisheye distortion") && lists("easymocap", "dome", "fisheye distortion"));
        let absent = "person 1: absent before frame 107 and after frame 126; the nearest pose is held";
        assert_eq!(written.lost("bvh"), [format!("{absent}, since the format cannot hide a person")]);
        assert!(written.lost("fbx")[0].starts_with(absent));
        assert_eq!(written.lost("opencv_yaml").len(), 2);
        assert_eq!(written.lost("anipose_toml"), ["camera lost: its pose was not solved, and the camera is left out"]);
    }
}
