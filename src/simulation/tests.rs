use super::*;
use crate::body::skeleton::{KeypointConvention, N_JOINTS, PARENTS};
use crate::geometry::rotation;
use crate::session::Session;
use crate::session::digest::NamedDigest;
use crate::session::formats::native::to_json;
use nalgebra::Vector3;
use skeleton::joint;

fn small(preset: Preset, seed: u64) -> SimulationConfig {
    SimulationConfig { frames: 60, seed, ..SimulationConfig::preset(preset) }
}

fn with_real_errors(config: SimulationConfig) -> SimulationConfig {
    SimulationConfig { noise: config.noise.with_real_errors(), ..config }
}

fn bytes(simulated: &Simulated) -> Vec<Vec<u8>> {
    let folder = tempfile::tempdir().unwrap();
    write_truth(simulated, folder.path()).unwrap();
    ["cameras", "poses3d", "keypoints3d", "identities", "simulation"]
        .map(|name| std::fs::read(folder.path().join(format!("gt/{name}.json"))).unwrap())
        .to_vec()
}

#[test]
fn the_seed_determines_the_session() {
    let first = simulate(&small(Preset::Hard, 5)).unwrap();
    let again = simulate(&small(Preset::Hard, 5)).unwrap();
    assert_eq!(first, again);
    assert_eq!(bytes(&first), bytes(&again));
    assert_ne!(first.session, simulate(&small(Preset::Hard, 6)).unwrap().session);
    let real = simulate(&with_real_errors(small(Preset::Hard, 5))).unwrap();
    let again = simulate(&with_real_errors(small(Preset::Hard, 5))).unwrap();
    assert_eq!(real, again);
    assert_eq!(bytes(&real), bytes(&again));
    assert_ne!(real.session, first.session);
    assert_ne!(real.session, simulate(&with_real_errors(small(Preset::Hard, 6))).unwrap().session);
}

/// Hash of the uploaded session and the true persons of its detections.
fn digest(config: &SimulationConfig) -> String {
    let Simulated { session, truth, .. } = simulate(config).unwrap();
    let mut digest = NamedDigest::default();
    digest.add("session", &mut to_json(&session).unwrap().as_bytes()).unwrap();
    digest.add("identities", &mut serde_json::to_vec(&truth.identities).unwrap().as_slice()).unwrap();
    digest.finish()[..16].to_owned()
}

/// Earlier releases wrote these bytes; figures on simulated sessions stay comparable only as long as they do not change.
#[test]
fn sessions_of_the_presets_keep_their_bytes() {
    let found = [
        digest(&small(Preset::Easy, 1)),
        digest(&SimulationConfig { tracks: Tracks::PerView, ..small(Preset::Paper, 2) }),
        digest(&SimulationConfig { convention: KeypointConvention::Body25, ..small(Preset::Hard, 3) }),
        digest(&SimulationConfig { frames: 60, ..random_rig_config(4) }),
    ];
    assert_eq!(found, ["ff1dcd562c3c69fc", "d164fb09f1e77a04", "8cb63b34f1b8b2a1", "2d6f2ea3266648c5"]);
}

#[test]
fn another_view_does_not_change_the_others() {
    for mut config in [small(Preset::Hard, 2), with_real_errors(small(Preset::Hard, 2))] {
        config.rig.arrangement = Arrangement::Arc { span_deg: 0.0 };
        let few = simulate(&config).unwrap();
        let more = simulate(&SimulationConfig { views: config.views + 1, ..config }).unwrap();
        assert_eq!(few.session.views[..], more.session.views[..few.session.views.len()]);
    }
}

#[test]
fn without_noise_points_lie_at_their_projections() {
    let config = SimulationConfig { noise: NoiseConfig::NONE, ..small(Preset::Paper, 3) };
    let Simulated { session, truth, .. } = simulate(&config).unwrap();
    let (mut n, mut expected) = (0, 0);
    for (v, view) in session.views.iter().enumerate() {
        for (f, detections) in view.frames.iter().enumerate() {
            for (d, detection) in detections.iter().enumerate() {
                let person = truth.identities[v][f][d].unwrap();
                assert_eq!(detection.track_id, Some(person as i64));
                for (keypoint, point) in detection.keypoints.iter().zip(&truth.keypoints[f][person]) {
                    let pixel = view.intrinsics.pixel_from_camera(&truth.cameras[v].transform(point)).unwrap();
                    let inside = pixel.x > 0.0 && pixel.y > 0.0 && pixel.x < 1280.0 && pixel.y < 720.0;
                    assert_eq!(keypoint.is_present(), inside);
                    expected += 1;
                    if keypoint.is_present() {
                        n += 1;
                        // Half of the last decimal in both axes.
                        assert!((keypoint.pixel - pixel).norm() < 0.0072);
                    }
                }
            }
        }
    }
    assert!(expected > 0 && n > expected * 9 / 10, "{n} of {expected} points are in the image");
}

#[test]
fn presets_have_their_documented_difficulty() {
    // Reference simulator: median error 2.0, 5.2, 8.8 px; joints kept 0.956, 0.901, 0.809. Motions and positions differ here:
    // tolerance a quarter in pixels, 0.07 in shares.
    for (preset, median, kept) in [(Preset::Easy, 2.0, 0.956), (Preset::Paper, 5.2, 0.901), (Preset::Hard, 8.8, 0.809)]
    {
        let mut config = SimulationConfig::preset(preset);
        if preset == Preset::Hard {
            config.convention = KeypointConvention::Body25;
        }
        let s = simulate(&config).unwrap().truth.statistics;
        let found = s.err_px_median.unwrap();
        assert!((found / median - 1.0).abs() < 0.25, "{preset:?}: median error {found} px, {median} expected");
        assert!((s.joint_rate - kept).abs() < 0.07, "{preset:?}: {} of the joints kept, {kept} expected", s.joint_rate);
        assert!(s.det_rate > 0.85, "{preset:?}: {s:?}");
        assert_eq!(s.swaps > 0, preset != Preset::Easy, "{preset:?}: {s:?}");
    }
}

#[test]
fn bones_keep_their_lengths_and_people_differ() {
    let Simulated { truth, .. } = simulate(&small(Preset::Hard, 9)).unwrap();
    let bone = |frame: usize, person: usize, j: usize| {
        let joints = &truth.joints[frame][person];
        (joints[j] - joints[PARENTS[j].unwrap()]).norm()
    };
    for person in 0..4 {
        for j in 1..N_JOINTS {
            assert!((bone(0, person, j) - bone(59, person, j)).abs() < 1e-12);
        }
    }
    let thigh = joint("left_knee");
    assert!((bone(0, 0, thigh) / bone(0, 1, thigh) - 1.0).abs() > 0.005);
}

#[test]
fn procedural_people_stand_stay_near_and_move_naturally() {
    let config = SimulationConfig { frames: 1800, people: 3, ..SimulationConfig::preset(Preset::Paper) };
    let people = choreography::procedural_people(&config);
    let feet = [joint("left_foot"), joint("right_foot")];
    let (mut accelerations, mut lowest_pelvis, mut highest_wrist) = (Vec::new(), 9.0_f64, 0.0_f64);
    let posed: Vec<Vec<_>> =
        people.iter().map(|p| p.poses.iter().map(|pose| p.skeleton.pose(pose).joints).collect()).collect();
    for (p, frames) in posed.iter().enumerate() {
        for (f, joints) in frames.iter().enumerate() {
            // The ball of the foot lies at most 25 mm x 1.15 above the sole, the sole at most 11 mm above the floor.
            let lowest = feet.iter().map(|&j| joints[j].y).fold(9.0, f64::min);
            assert!(lowest > 0.0 && lowest < 0.10, "person {p}, frame {f}: lowest foot {lowest} m");
            assert!(joints[0].x.hypot(joints[0].z) < 2.8, "person {p}, frame {f} left the scene");
            lowest_pelvis = lowest_pelvis.min(joints[0].y);
            highest_wrist = highest_wrist.max(joints[joint("left_wrist")].y).max(joints[joint("right_wrist")].y);
            if f > 1 {
                let second = |j: usize| (joints[j] - frames[f - 1][j] * 2.0 + frames[f - 2][j]).norm() * 900.0;
                accelerations.extend((0..N_JOINTS).map(second));
            }
        }
    }
    accelerations.sort_by(f64::total_cmp);
    let (mean, worst) =
        (accelerations.iter().sum::<f64>() / accelerations.len() as f64, accelerations[accelerations.len() - 1]);
    // Walking and gesturing people: 3 to 6 m/s^2 on average; a swung wrist reaches some 50, a heel strike 100.
    assert!(mean > 1.0 && mean < 8.0, "mean acceleration {mean} m/s^2");
    assert!(worst < 150.0, "greatest acceleration {worst} m/s^2");
    assert!(lowest_pelvis < 0.7 && highest_wrist > 1.6, "lowest pelvis {lowest_pelvis}, highest wrist {highest_wrist}");
    for (a, b) in [(0, 1), (0, 2), (1, 2)] {
        let nearest = (0..1800).map(|f| (posed[a][f][0] - posed[b][f][0]).xz().norm()).fold(9.0, f64::min);
        assert!(nearest > 0.2, "people {a} and {b} walk through each other: {nearest} m");
    }
}

#[test]
fn a_motion_does_not_depend_on_the_frame_rate() {
    let at = |fps: f64, frames: usize| {
        let config = SimulationConfig { fps, frames, people: 1, ..SimulationConfig::preset(Preset::Paper) };
        let people = choreography::procedural_people(&config);
        people[0].skeleton.pose(&people[0].poses[frames - 1]).joints
    };
    let (slow, fast) = (at(25.0, 101), at(100.0, 401));
    for j in 0..N_JOINTS {
        assert!((slow[j] - fast[j]).norm() < 1e-3);
    }
}

#[test]
fn simulates_every_convention_with_mirrored_sides() {
    let person = skeleton::SimulatedSkeleton::generic();
    let rest = crate::motion_prior::motion_file::MotionPose {
        rotations: [nalgebra::Matrix3::identity(); N_JOINTS],
        pelvis: Vector3::zeros(),
    };
    let posed = person.pose(&rest);
    for convention in KeypointConvention::ALL {
        let rules = landmarks::rules(convention).unwrap();
        let points: Vec<_> = rules.iter().map(|rule| rule.point(&posed, 1.0)).collect();
        for (k, &twin) in convention.mirror().iter().enumerate() {
            let mirrored = Vector3::new(-points[twin].x, points[twin].y, points[twin].z);
            assert!((points[k] - mirrored).norm() < 1e-12, "{}: {}", convention.name(), convention.names()[k]);
        }
        let config = SimulationConfig { convention, frames: 3, ..SimulationConfig::preset(Preset::Easy) };
        for config in [config.clone(), with_real_errors(config)] {
            let session = simulate(&config).unwrap().session;
            let detections = session.views.iter().flat_map(|v| v.frames.iter().flatten());
            assert!(detections.into_iter().all(|d| d.keypoints.len() == convention.n_keypoints()));
        }
    }
}

#[test]
fn swaps_exchange_two_people_for_5_to_60_frames() {
    let mut config = SimulationConfig { frames: 900, ..SimulationConfig::preset(Preset::Easy) };
    config.noise = NoiseConfig { swaps_per_minute: 20.0, ..NoiseConfig::NONE };
    let Simulated { session, truth, .. } = simulate(&config).unwrap();
    assert!(truth.statistics.swaps > 10);
    for (v, view) in session.views.iter().enumerate() {
        let swapped = |f: usize| {
            view.frames[f].iter().zip(&truth.identities[v][f]).any(|(d, p)| d.track_id != p.map(|p| p as i64))
        };
        let mut run = 0;
        for f in 0..900 {
            if swapped(f) {
                run += 1;
            } else {
                assert!(run == 0 || run >= 5, "view {v}: a swap of {run} frames ends at {f}");
                run = 0;
            }
        }
    }
    let mut per_view = config;
    per_view.tracks = Tracks::PerView;
    let ids = |s: &Session, v: usize| s.views[v].frames[0].iter().map(|d| d.track_id).collect::<Vec<_>>();
    let session = simulate(&per_view).unwrap().session;
    assert_ne!(ids(&session, 0), ids(&session, 1));
    per_view.tracks = Tracks::None;
    assert!(ids(&simulate(&per_view).unwrap().session, 0).iter().all(Option::is_none));
}

#[test]
fn rejects_values_out_of_range_by_name() {
    let mut config = SimulationConfig::preset(Preset::Easy);
    config.rig.fov_deg = f64::NAN;
    assert!(matches!(simulate(&config), Err(SimulationError::Config { field: "fov_deg", .. })));
    let config = SimulationConfig { people: 0, ..SimulationConfig::preset(Preset::Easy) };
    assert!(matches!(simulate(&config), Err(SimulationError::Config { field: "people", .. })));
    let mut config = with_real_errors(SimulationConfig::preset(Preset::Easy));
    config.noise.real = Some(RealNoise { ghosts: 1.0, ..RealNoise::MEASURED });
    assert!(matches!(simulate(&config), Err(SimulationError::Config { field: "ghosts", .. })));
    let motion = MotionSource::Files(vec!["no/such.npz".into()]);
    let config = SimulationConfig { people: 1, motion, ..SimulationConfig::preset(Preset::Easy) };
    assert!(matches!(simulate(&config), Err(SimulationError::Motion { .. })));
}

#[test]
fn random_rigs_stay_in_their_ranges() {
    for seed in 0..50 {
        let c = random_rig_config(seed);
        c.check().unwrap();
        assert!((3..=8).contains(&c.views) && (1..=5).contains(&c.people) && c.frames == 300);
        assert!((3.0..6.0).contains(&c.rig.radius) && (50.0..80.0).contains(&c.rig.fov_deg));
        assert_eq!(c, random_rig_config(seed));
    }
    let s = simulate(&random_rig_config(0)).unwrap().truth.statistics;
    assert!(s.det_rate > 0.7, "{s:?}");
}

/// Writes an AMASS-layout file of one second at 120 Hz: the right knee bends, the body walks and turns.
fn write_take(path: &std::path::Path, z_up: bool) {
    use npyz::WriterBuilder;
    let n = 121;
    let base = if z_up {
        rotation::exp(&Vector3::new(std::f64::consts::FRAC_PI_2, 0.0, 0.0))
    } else {
        nalgebra::Matrix3::identity()
    };
    let mut poses = vec![0.0; n * 156];
    let mut trans = vec![0.0; n * 3];
    for f in 0..n {
        let t = f as f64 / 120.0;
        let root = rotation::log(&(base * rotation::exp(&Vector3::new(0.0, 0.8 * t, 0.0))));
        poses[f * 156..f * 156 + 3].copy_from_slice(root.as_slice());
        poses[f * 156 + 3 * joint("right_knee")] = 0.5 * t;
        trans[f * 3..f * 3 + 3].copy_from_slice((base * Vector3::new(0.3 * t, 0.9, 0.0)).as_slice());
    }
    let mut zip = zip::ZipWriter::new(std::fs::File::create(path).unwrap());
    let arrays: [(&str, &[f64], Vec<u64>); 3] = [
        ("poses", &poses, vec![n as u64, 156]),
        ("trans", &trans, vec![n as u64, 3]),
        ("mocap_framerate", &[120.0], vec![]),
    ];
    for (name, values, shape) in arrays {
        let options = zip::write::SimpleFileOptions::default();
        zip.start_file(npyz::npz::file_name_from_array_name(name), options).unwrap();
        let mut writer = npyz::WriteOptions::new().default_dtype().shape(&shape).writer(&mut zip).begin_nd().unwrap();
        writer.extend(values.iter().copied()).unwrap();
        writer.finish().unwrap();
    }
    zip.finish().unwrap();
}

#[test]
fn motion_files_are_resampled_and_put_on_the_floor() {
    let folder = tempfile::tempdir().unwrap();
    let poses = [false, true].map(|z_up| {
        let path = folder.path().join(format!("take-{z_up}.npz"));
        write_take(&path, z_up);
        let config = SimulationConfig {
            people: 1,
            frames: 100,
            motion: MotionSource::Files(vec![path]),
            ..SimulationConfig::preset(Preset::Easy)
        };
        let simulated = simulate(&config).unwrap();
        // One second at 30 Hz is 31 frames.
        assert_eq!(simulated.session.n_frames, 31);
        simulated.truth.people[0].clone()
    });
    let [y_up, z_up] = poses;
    for (f, (a, b)) in y_up.poses.iter().zip(&z_up.poses).enumerate() {
        assert!((a.pelvis - b.pelvis).norm() < 1e-9, "frame {f}");
        let knee = rotation::log(&a.rotations[joint("right_knee")]);
        assert!((knee.x - 0.5 * f as f64 / 30.0).abs() < 1e-9, "frame {f}: {knee}");
    }
    let feet = |pose| y_up.skeleton.pose(pose).joints[joint("left_foot")].y;
    assert!((feet(&y_up.poses[0]) - 0.03).abs() < 0.01);
    // Walks 0.3 m within the second, however it was turned.
    assert!(((y_up.poses[30].pelvis - y_up.poses[0].pelvis).norm() - 0.3).abs() < 1e-9);
}

#[test]
fn real_motion_capture_can_be_simulated() {
    let Ok(data) = std::env::var("WANDLESS_TEST_DATA") else {
        eprintln!("SKIPPED real_motion_capture_can_be_simulated: WANDLESS_TEST_DATA is not set");
        return;
    };
    let mut takes = Vec::new();
    let folders = std::fs::read_dir(std::path::Path::new(&data).join("motion/valid")).unwrap();
    for folder in folders {
        takes.extend(std::fs::read_dir(folder.unwrap().path()).unwrap().map(|file| file.unwrap().path()));
    }
    takes.sort();
    let motion = MotionSource::Files(takes);
    let config = SimulationConfig { people: 2, frames: 120, motion, ..SimulationConfig::preset(Preset::Paper) };
    let Simulated { truth, .. } = simulate(&config).unwrap();
    assert!(truth.statistics.det_rate > 0.8, "{:?}", truth.statistics);
    // The left hip is at +x in the pelvis's frame.
    let pelvis = &truth.people[0].poses[0].rotations[0];
    let across = truth.joints[0][0][joint("left_hip")] - truth.joints[0][0][joint("right_hip")];
    assert!(pelvis.column(0).dot(&across) > 0.1);
}

#[test]
fn a_body_between_camera_and_point_hides_it() {
    let generic = skeleton::SimulatedSkeleton::generic();
    let at = |x: f64, z: f64| {
        let rotations = [nalgebra::Matrix3::identity(); N_JOINTS];
        generic
            .pose(&crate::motion_prior::motion_file::MotionPose { rotations, pelvis: Vector3::new(x, 0.97, z) })
            .joints
    };
    let (front, back, aside) = (at(0.0, 1.0), at(0.0, 0.0), at(1.5, 0.0));
    let camera = Vector3::new(0.0, 1.2, 4.0);
    let spine = joint("spine2");
    assert!(occlusion::is_hidden(&camera, &back[spine], 0, &[&back, &front]));
    assert!(!occlusion::is_hidden(&camera, &front[spine], 1, &[&back, &front]));
    assert!(!occlusion::is_hidden(&camera, &back[spine], 0, &[&back, &aside]));
    // A point on a body's surface is not hidden by the same body.
    assert!(!occlusion::is_hidden(&camera, &back[spine], 0, &[&back]));
    let crossing = occlusion::nearest_on_segments(
        &Vector3::new(-1.0, 0.0, 0.0),
        &Vector3::new(1.0, 0.0, 0.0),
        &Vector3::new(0.0, -1.0, 0.25),
        &Vector3::new(0.0, 3.0, 0.25),
    );
    assert!((crossing.distance - 0.25).abs() < 1e-12 && (crossing.along_first - 0.5).abs() < 1e-12);
}
