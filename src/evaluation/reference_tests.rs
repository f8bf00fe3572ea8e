//! Comparison with an independent reference scorer, on perturbed copies of real and simulated truth.

use super::alignment::Alignment;
use super::report::{EvaluationOptions, evaluate};
use crate::geometry::rotation;
use nalgebra::{Matrix3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Relative tolerance: both compute in doubles, and differ in the order of sums and the decomposition.
const TOLERANCE: f64 = 1e-6;

/// The data and the scorer, where they are available.
fn reference() -> Option<(PathBuf, PathBuf)> {
    let Ok(data) = std::env::var("WANDLESS_TEST_DATA") else {
        eprintln!("SKIPPED: agreement with the reference scorer: WANDLESS_TEST_DATA is not set");
        return None;
    };
    let scorer = Path::new(&data).join("../tools/score.py");
    let numpy = Command::new("python3").args(["-c", "import numpy"]).output();
    if !scorer.is_file() || !numpy.is_ok_and(|output| output.status.success()) {
        eprintln!(
            "SKIPPED: agreement with the reference scorer: {} or python3 with numpy is missing",
            scorer.display()
        );
        return None;
    }
    Some((data.into(), scorer))
}

fn read(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

struct Perturbation(ChaCha8Rng);

impl Perturbation {
    fn normal(&mut self, sd: f64) -> f64 {
        sd * self.0.sample::<f64, _>(StandardNormal)
    }

    fn vector(&mut self, sd: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.normal(sd))
    }

    /// Cameras in another world and unit, each with an error of centimetres and degrees, the last one unsolved.
    fn cameras(&mut self, truth: &Value) -> Value {
        let turn = rotation::exp(&Vector3::new(0.4, -1.0, 0.7));
        let n = truth.as_array().unwrap().len();
        let perturbed = truth.as_array().unwrap().iter().enumerate().map(|(i, camera)| {
            if i + 1 == n && n > 5 {
                return json!({"id": camera["id"], "R": null, "t": null});
            }
            let number = |v: &Value| v.as_f64().unwrap();
            let r = Matrix3::from_fn(|row, column| number(&camera["R"][row][column]));
            let t = Vector3::from_fn(|row, _| number(&camera["t"][row]));
            let center = turn * (-(r.transpose() * t)) * 1.04 + Vector3::new(1.0, 2.0, 3.0) + self.vector(0.03);
            let r = rotation::exp(&self.vector(0.01)) * r * turn.transpose();
            let rows: Vec<Vec<f64>> = r.row_iter().map(|row| row.iter().copied().collect()).collect();
            json!({"id": camera["id"], "R": rows, "t": (-(r * center) * 1e3).as_slice(), "units": "mm"})
        });
        json!({"units": "m", "cameras": perturbed.collect::<Vec<_>>()})
    }

    /// Poses in the same other world: noisy, renamed, with missing joints, people and frames, and an additional person.
    fn poses(&mut self, truth: &Value, names: &str) -> Value {
        let turn = rotation::exp(&Vector3::new(0.4, -1.0, 0.7));
        let mut frames = serde_json::Map::new();
        for (frame, people) in truth["frames"].as_object().unwrap() {
            let mut perturbed = serde_json::Map::new();
            for (person, joints) in people.as_object().unwrap() {
                if self.0.random_bool(0.1) {
                    continue;
                }
                let off = self.vector(0.05);
                let mut joint = |joint: &Value| {
                    if self.0.random_bool(0.04) {
                        return Value::Null;
                    }
                    let heavy = if self.0.random_bool(0.1) { 0.25 } else { 0.02 };
                    let p = Vector3::from_fn(|row, _| joint[row].as_f64().unwrap()) + off + self.vector(heavy);
                    json!((turn * p * 1.04 + Vector3::new(1.0, 2.0, 3.0)).as_slice())
                };
                let joints: Vec<Value> = joints.as_array().unwrap().iter().map(&mut joint).collect();
                if self.0.random_bool(0.1) {
                    perturbed.insert(format!("ghost{person}"), joints.clone().into());
                }
                perturbed.insert(format!("p{}", 7 - person.parse::<i32>().unwrap()), joints.into());
            }
            if !self.0.random_bool(0.05) {
                frames.insert(frame.clone(), perturbed.into());
            }
        }
        json!({"joint_names": truth[names], "units": "m", "frames": frames})
    }

    fn identities(&mut self, truth: &Value) -> Value {
        let mut identity = |person: &Value| match self.0.random::<f64>() {
            u if u < 0.05 => Value::Null,
            u if u < 0.15 => json!(self.0.random_range(10..14)),
            _ => json!(13 - person.as_i64().unwrap()),
        };
        let mut frame = |people: &Value| people.as_array().unwrap().iter().map(&mut identity).collect::<Value>();
        let cameras = truth.as_object().unwrap().iter();
        let cameras =
            cameras.map(|(c, frames)| (c.clone(), frames.as_array().unwrap().iter().map(&mut frame).collect()));
        Value::Object(cameras.collect())
    }
}

/// Asserts that `found` contains every number of `expected`, within the tolerance. The path of the data may differ.
fn assert_same(expected: &Value, found: &Value, at: &str, n: &mut usize) {
    match expected {
        Value::Object(fields) => {
            for (name, value) in fields.iter().filter(|(name, _)| *name != "data") {
                assert_same(value, found.get(name).unwrap_or(&Value::Null), &format!("{at}/{name}"), n);
            }
        }
        Value::Number(number) => {
            let (a, b) = (number.as_f64().unwrap(), found.as_f64().unwrap_or(f64::NAN));
            assert!((a - b).abs() <= TOLERANCE * a.abs().max(1e-9), "{at}: {a} expected, found {found}");
            *n += 1;
        }
        _ => assert_eq!(expected, found, "{at}"),
    }
}

/// Perturbs a truth, scores it with both programs and compares. `poses`: the truth file, its list of joint names, and the
/// scorer's name for the joints.
fn assert_agreement(capture: &str, poses: (&str, &str, &str), up: &str, align: Alignment, seed: u64) {
    let Some((data, scorer)) = reference() else { return };
    let data = data.join(capture);
    let truth = data.join("gt");
    let folder = tempfile::tempdir().unwrap();
    let mut perturbation = Perturbation(ChaCha8Rng::seed_from_u64(seed));
    let (file, names, joints) = poses;
    let write = |name: &str, value: &Value| std::fs::write(folder.path().join(name), value.to_string()).unwrap();
    write("cameras.json", &perturbation.cameras(&read(&truth.join("cameras.json"))));
    write(file, &perturbation.poses(&read(&truth.join(file)), names));
    let mut command = Command::new("python3");
    command.arg(scorer).arg("--data").arg(&data);
    command.arg("--cameras").arg(folder.path().join("cameras.json"));
    command.arg("--poses").arg(folder.path().join(file));
    command.args(["--pred-joints", joints, "--up", up, "--align", align.name()]);
    if truth.join("identities.json").is_file() {
        write("identities.json", &perturbation.identities(&read(&truth.join("identities.json"))));
        command.arg("--identities").arg(folder.path().join("identities.json"));
    }
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let expected: Value = serde_json::from_slice(&output.stdout).unwrap();
    let options = EvaluationOptions { align: Some(align), ..EvaluationOptions::default() };
    let evaluation = evaluate(folder.path(), &truth, &options).unwrap();
    let mut n = 0;
    assert_same(&expected, &serde_json::to_value(&evaluation).unwrap(), capture, &mut n);
    assert!(n > 60, "only {n} numbers were compared");
    let table = evaluation.to_string();
    assert!(table.contains("rigid_pose") && table.contains("PCP"), "{table}");
    eprintln!("{capture}: {n} numbers assert_agreement\n{table}");
}

#[test]
fn agrees_on_a_real_capture() {
    assert_agreement("shelf", ("poses3d.json", "joint_names", "shelf14"), "0,0,1", Alignment::Rigid, 1);
}

#[test]
fn agrees_on_smpl_joints() {
    assert_agreement("simulated/hard", ("poses3d.json", "joint_names", "smpl24"), "0,1,0", Alignment::Sim3, 2);
}

#[test]
fn agrees_on_detector_keypoints() {
    assert_agreement(
        "simulated/hard",
        ("keypoints3d.json", "keypoint_names", "body25"),
        "0,1,0",
        Alignment::RigidPose,
        3,
    );
    assert_agreement("simulated/paper", ("keypoints3d.json", "keypoint_names", "coco17"), "0,1,0", Alignment::Sim3, 4);
}
