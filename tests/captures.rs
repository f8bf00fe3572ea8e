//! Solves the captures in the folder that `WANDLESS_TEST_DATA` names; skipped with a message where it is unset.
#![allow(clippy::unwrap_used)] // a test may

use std::ops::Range;
use std::path::{Path, PathBuf};
use wandless::evaluation::documents::{read_cameras, read_identities, read_poses};
use wandless::evaluation::{EvaluationOptions, evaluate};
use wandless::export::{ResultContext, write_result};
use wandless::pipeline::{Options, reconstruct};
use wandless::progress::Progress;
use wandless::session::reconstruction::{Quality, Verdict};
use wandless::session::upload::{UploadLimits, read_path};
use wandless::session::{BodyMotion, Session};

/// Error bounds of one capture after a similarity alignment: mm, degrees.
struct Bounds {
    capture: &'static str,
    position_mm: f64,
    angle_deg: f64,
}

const BOUNDS: [Bounds; 4] = [
    Bounds { capture: "shelf", position_mm: 17.0, angle_deg: 0.29 },
    Bounds { capture: "simulated/easy", position_mm: 5.0, angle_deg: 0.10 },
    Bounds { capture: "simulated/paper", position_mm: 9.0, angle_deg: 0.18 },
    Bounds { capture: "simulated/hard", position_mm: 14.0, angle_deg: 0.20 },
];

#[test]
fn solves_captures_without_track_numbers() {
    let Some(data) = std::env::var_os("WANDLESS_TEST_DATA").map(PathBuf::from) else {
        eprintln!("SKIPPED solves_captures_without_track_numbers: WANDLESS_TEST_DATA is not set");
        return;
    };
    for bounds in &BOUNDS {
        let folder = data.join(bounds.capture);
        let mut session = read_path(&folder, &UploadLimits::default()).unwrap().session;
        session.views.iter_mut().flat_map(|v| v.frames.iter_mut().flatten()).for_each(|d| d.track_id = None);
        let options = Options::default();
        let found = reconstruct(&session, &options, &Progress::silent()).unwrap();
        let Quality { verdict, reasons } = &found.report.quality;
        assert_eq!(*verdict, Verdict::Pass, "{}: {reasons:?}", bounds.capture);
        let result = tempfile::tempdir().unwrap();
        let context = ResultContext {
            input_sha256: "",
            options: serde_json::to_value(&options).unwrap(),
            solver_version: "test",
            exports: &options.exports,
            continuation: None,
        };
        write_result(result.path(), &session, &context, &found).unwrap();
        let errors = evaluate(result.path(), &folder.join("gt"), &EvaluationOptions::default()).unwrap();
        let errors = serde_json::to_value(&errors).unwrap();
        let sim3 = &errors["cameras"]["sim3"];
        let (mm, deg) = (sim3["position_mm"].as_f64().unwrap(), sim3["angle_deg"].as_f64().unwrap());
        println!("{}: {mm:.2} mm, {deg:.3} deg", bounds.capture);
        assert_eq!(sim3["n_cameras"].as_u64(), Some(session.views.len() as u64), "{}", bounds.capture);
        assert!(mm <= bounds.position_mm && deg <= bounds.angle_deg, "{}: {mm} mm, {deg} deg", bounds.capture);
        if let Some(accuracy) = errors["identity"]["accuracy"].as_f64() {
            let coverage = errors["identity"]["coverage"].as_f64().unwrap();
            assert!(accuracy >= 0.99 && coverage >= 0.98, "{}: {accuracy}, {coverage}", bounds.capture);
        }
    }
}

/// Removes a person's detections in `frames` from all views but the first.
fn leave_to_first_view(session: &mut Session, truth: &Path, person: usize, frames: &Range<usize>) {
    let identities = read_identities(&truth.join("identities.json")).unwrap();
    for view in &mut session.views[1..] {
        for t in frames.clone() {
            let mut people = identities[&view.id][t].iter();
            view.frames[t].retain(|_| people.next().unwrap().as_deref() != Some(&person.to_string()));
        }
    }
}

/// Mean distance of a person's limb joints from the truth in `frames`, both from the middle of the hips, mm.
fn limb_error(session: &Session, options: &Options, truth: &Path, stretches: &[(usize, Range<usize>)]) -> f64 {
    const LIMBS: [usize; 12] = [1, 2, 4, 5, 7, 8, 16, 17, 18, 19, 20, 21];
    let found = reconstruct(session, options, &Progress::silent()).unwrap();
    let true_camera = read_cameras(&truth.join("cameras.json")).unwrap()[&session.views[0].id];
    let found_camera = found.cameras[0].camera_from_world.unwrap();
    let truth_from_found = true_camera.rotation.transpose() * found_camera.rotation;
    let poses = read_poses(&truth.join("poses3d.json")).unwrap().frames;
    let of_frame = |person: usize, t: usize| {
        let truth = &poses[&(t as i64)][&person.to_string()];
        let at_truth = |j: usize| truth[j].unwrap();
        let of_motion = |motion: &BodyMotion| {
            let at = |j: usize| truth_from_found * motion.frames[t - motion.first.0].joints[j];
            let off = |j: usize| at(j) - (at(1) + at(2)) / 2.0 - at_truth(j) + (at_truth(1) + at_truth(2)) / 2.0;
            LIMBS.iter().map(|j| 1e3 * off(*j).norm()).sum::<f64>() / LIMBS.len() as f64
        };
        found.motions.iter().map(of_motion).fold(f64::INFINITY, f64::min)
    };
    let errors: Vec<f64> =
        stretches.iter().flat_map(|(person, frames)| frames.clone().map(|t| of_frame(*person, t))).collect();
    errors.iter().sum::<f64>() / errors.len() as f64
}

/// While one of the cameras showed a person, arms and legs had been mirrored in depth (106 mm), then the trunk turned to the wrong side
/// (84 mm).
#[test]
fn limbs_that_one_camera_shows_keep_their_side() {
    let Some(data) = std::env::var_os("WANDLESS_TEST_DATA").map(PathBuf::from) else {
        eprintln!("SKIPPED limbs_that_one_camera_shows_keep_their_side: WANDLESS_TEST_DATA is not set");
        return;
    };
    let folder = data.join("simulated/paper");
    let truth = folder.join("gt");
    let mut session = read_path(&folder, &UploadLimits::default()).unwrap().session;
    let stretches = [(0, 60..130), (1, 160..230)];
    stretches.iter().for_each(|(person, frames)| leave_to_first_view(&mut session, &truth, *person, frames));
    let error = limb_error(&session, &Options::default(), &truth, &stretches);
    println!("limbs {error:.1} mm");
    assert!(error < 65.0, "{error}");
}
