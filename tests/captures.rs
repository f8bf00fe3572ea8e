//! Solves the captures in the folder that `WANDLESS_TEST_DATA` names; skipped with a message where it is unset.
#![allow(clippy::unwrap_used)] // a test may

use std::path::PathBuf;
use wandless::evaluation::{EvaluationOptions, evaluate};
use wandless::export::{ResultContext, write_result};
use wandless::pipeline::{Options, reconstruct};
use wandless::progress::Progress;
use wandless::session::reconstruction::{Quality, Verdict};
use wandless::session::upload::{UploadLimits, read_path};

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
