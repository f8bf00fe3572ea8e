//! SMPL parameters from AMASS's npz and from EasyMocap's JSON, posed by this file's own forward kinematics.

use crate::result::{FPS, Written, assert_near, both_up_axes, numbers};
use nalgebra::{Rotation3, Vector3};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use wandless::body::skeleton::PARENTS;
use wandless::body::{Betas, default_body};
use wandless::session::reconstruction::ExportFormat;
use wandless::session::recording::UpAxis;

/// Largest distance between joints of the npz and of `poses3d.json`, m.
const NPZ_TOLERANCE: f64 = 1e-4;

/// The members of an npz by name.
fn members(written: &Written, name: &str) -> BTreeMap<String, Vec<u8>> {
    let mut npz = zip::ZipArchive::new(File::open(written.path(name)).unwrap()).unwrap();
    let names: Vec<String> = npz.file_names().map(|name| name.unwrap().into_owned()).collect();
    let mut member = |name: &String| {
        let mut bytes = Vec::new();
        npz.by_name(name).unwrap().read_to_end(&mut bytes).unwrap();
        (name.strip_suffix(".npy").unwrap().to_owned(), bytes)
    };
    names.iter().map(&mut member).collect()
}

fn floats(members: &BTreeMap<String, Vec<u8>>, name: &str) -> Vec<f64> {
    npyz::NpyFile::new(&members[name][..]).unwrap().into_vec().unwrap()
}

fn shape(members: &BTreeMap<String, Vec<u8>>, name: &str) -> Vec<u64> {
    npyz::NpyFile::new(&members[name][..]).unwrap().shape().to_vec()
}

fn text(members: &BTreeMap<String, Vec<u8>>, name: &str) -> String {
    let file = npyz::NpyFile::new(&members[name][..]).unwrap();
    assert!(file.dtype().descr().contains("<U"), "{name} is not unicode text");
    file.into_vec::<String>().unwrap().remove(0)
}

/// SMPL's joints: the first rotation about the rest pelvis, then `transl`.
fn joints(rest: &[Vector3<f64>], angles: &[f64], transl: &Vector3<f64>) -> Vec<Vector3<f64>> {
    let mut turns: Vec<Rotation3<f64>> = Vec::new();
    let mut places = Vec::new();
    for (j, angle) in angles.chunks(3).enumerate() {
        let local = Rotation3::new(Vector3::new(angle[0], angle[1], angle[2]));
        let (turn, place) = match PARENTS[j] {
            None => (local, rest[0] + transl),
            Some(p) => (turns[p] * local, places[p] + turns[p] * (rest[j] - rest[p])),
        };
        turns.push(turn);
        places.push(place);
    }
    places
}

#[test]
fn npz_joints_match_the_result() {
    for written in both_up_axes(&[ExportFormat::SmplNpz]) {
        for person in written.people() {
            let wide = members(&written, &format!("smplh/{}.npz", person.id));
            let npz = members(&written, &format!("smpl/{}.npz", person.id));
            let n_frames = person.frames.len();
            assert_eq!(shape(&npz, "poses"), [n_frames as u64, 72]);
            assert_eq!(shape(&wide, "poses"), [n_frames as u64, 156]);
            assert_eq!(text(&npz, "up_axis"), if written.up_axis == UpAxis::Y { "y" } else { "z" });
            let betas = floats(&npz, "betas");
            let rest = default_body().shaped(&Betas::from_row_slice(&betas)).rest_joints;
            let (poses, poses_wide, trans) = (floats(&npz, "poses"), floats(&wide, "poses"), floats(&npz, "trans"));
            for t in 0..n_frames {
                let angles = &poses[72 * t..72 * (t + 1)];
                assert_eq!(angles[..66], poses_wide[156 * t..156 * t + 66]);
                let transl = Vector3::from_column_slice(&trans[3 * t..3 * t + 3]);
                for (ours, theirs) in person.joints[t].iter().zip(joints(&rest, angles, &transl)) {
                    assert!((ours - theirs).norm() <= NPZ_TOLERANCE, "frame {t}: {} m", (ours - theirs).norm());
                }
            }
        }
    }
}

/// Requirements of Meshcapade's add-on for Blender, in its order: `trans`, `gender` as text, a frame rate under one of two
/// spellings, `betas`, `poses` of SMPL-H's width; frames are stepped by `int(rate / target)`, which must not be zero at its
/// target of 30; no array may need pickle.
#[test]
fn smplh_npz_meets_the_blender_add_ons_requirements() {
    let [written, _] = both_up_axes(&[ExportFormat::SmplNpz]);
    let npz = members(&written, "smplh/0.npz");
    let n_frames = shape(&npz, "trans")[0];
    assert_eq!(shape(&npz, "trans"), [n_frames, 3]);
    assert!(["male", "female", "neutral"].contains(&text(&npz, "gender").as_str()));
    for spelling in ["mocap_framerate", "mocap_frame_rate"] {
        assert_eq!(floats(&npz, spelling), [FPS]);
        assert!((floats(&npz, spelling)[0] / 30.0) as usize >= 1);
    }
    assert!(matches!(shape(&npz, "betas")[..], [10 | 16]));
    assert_eq!(shape(&npz, "poses"), [n_frames, 156]);
    assert_eq!(text(&npz, "surface_model_type"), "smplh");
    for (name, bytes) in &npz {
        let descr = npyz::NpyFile::new(&bytes[..]).unwrap().dtype().descr();
        assert!(!descr.contains('O'), "{name} is {descr}: it needs pickle");
    }
}

#[test]
fn easymocap_joints_match_the_result() {
    for written in both_up_axes(&[ExportFormat::Easymocap]) {
        for person in written.people() {
            for (t, frame) in person.frames.iter().enumerate() {
                let people = written.json(&format!("easymocap/smpl/{frame:06}.json"));
                let theirs = people.as_array().unwrap().iter().find(|p| p["id"] == person.id);
                assert_eq!(
                    theirs.is_some(),
                    person.valid[t],
                    "people are listed in the frames in which they were detected"
                );
                let Some(theirs) = theirs else { continue };
                let row = |key: &str| numbers(&theirs[key][0]);
                let rest = default_body().shaped(&Betas::from_row_slice(&row("shapes"))).rest_joints;
                assert!(row("poses")[..3].iter().all(|angle| *angle == 0.0));
                let turn = Rotation3::new(Vector3::from_vec(row("Rh")));
                let shift = Vector3::from_vec(row("Th"));
                for (ours, posed) in person.joints[t].iter().zip(joints(&rest, &row("poses"), &Vector3::zeros())) {
                    assert_near(ours, &(turn * posed + shift), "easymocap");
                }
            }
        }
        let points = written.json("keypoints3d.json");
        for (frame, people) in points["frames"].as_object().unwrap() {
            let theirs = written.json(&format!("easymocap/keypoints3d/{:06}.json", frame.parse::<i64>().unwrap()));
            assert_eq!(theirs.as_array().unwrap().len(), people.as_object().unwrap().len());
            for theirs in theirs.as_array().unwrap() {
                let ours = people[&theirs["id"].to_string()].as_array().unwrap();
                assert_eq!(theirs["keypoints3d"].as_array().unwrap().len(), ours.len());
                for (ours, theirs) in ours.iter().zip(theirs["keypoints3d"].as_array().unwrap()) {
                    let expected = if ours.is_null() { vec![0.0; 4] } else { [numbers(ours), vec![1.0]].concat() };
                    assert_eq!(numbers(theirs), expected, "frame {frame}");
                }
            }
        }
        let absent = written.json("easymocap/smpl/000139.json");
        assert_eq!(absent.as_array().unwrap().len(), 1, "the second person has left");
    }
}

/// Betas of one model are another body of another model.
#[test]
fn smpl_npz_names_the_body_of_its_betas() {
    for written in both_up_axes(&[ExportFormat::SmplNpz]) {
        let body = &written.json("manifest.json")["models"]["body"];
        for file in ["smpl/0.npz", "smplh/0.npz"] {
            let npz = members(&written, file);
            assert_eq!(text(&npz, "body_model"), body["name"]);
            assert_eq!(text(&npz, "body_model_sha256"), body["sha256"]);
        }
    }
}
