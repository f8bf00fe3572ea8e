//! Joint angles: the table against the rotations of `people.json`, and OpenSim's files.

use crate::result::{FIRST_FRAME, FPS, both_up_axes};
use std::collections::BTreeMap;
use wandless::session::reconstruction::ExportFormat;

/// Columns by name, empty cells as NaN.
fn columns(text: &str, separator: char) -> BTreeMap<String, Vec<f64>> {
    let mut lines = text.lines();
    let names: Vec<String> = lines.next().unwrap().split(separator).map(str::to_owned).collect();
    let mut columns: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    for line in lines {
        let cells: Vec<&str> = line.split(separator).collect();
        assert_eq!(cells.len(), names.len());
        for (name, cell) in names.iter().zip(cells) {
            columns.entry(name.clone()).or_default().push(cell.parse().unwrap_or(f64::NAN));
        }
    }
    columns
}

#[test]
fn angles_follow_from_the_joints() {
    // The angle between thigh and shank, from positions alone: flexion and adduction of the knee turn the shank by it.
    for written in both_up_axes(&[ExportFormat::JointAngles, ExportFormat::Trc]) {
        for person in written.people() {
            let table = columns(&written.text(&format!("{}.angles.csv", person.id)), ',');
            assert_eq!(table["frame"], person.frames.iter().map(|frame| *frame as f64).collect::<Vec<_>>());
            for (i, joints) in person.joints.iter().enumerate() {
                assert!((table["time_s"][i] - (person.frames[i] - FIRST_FRAME) as f64 / FPS).abs() < 1e-6);
                assert_eq!(table["detected"][i], f64::from(u8::from(person.valid[i])));
                for (side, hip, knee, ankle) in [("l", 1, 4, 7), ("r", 2, 5, 8)] {
                    let between = (joints[hip] - joints[knee]).angle(&(joints[knee] - joints[ankle]));
                    let column = |name: &str| table[&format!("knee_{name}_{side}_deg")][i].to_radians();
                    let bend = (column("flexion").cos() * column("adduction").cos()).acos();
                    assert!((between - bend).abs() < 1e-4, "frame {i}: {between} and {bend}");
                    assert!(table[&format!("knee_flexion_{side}_sd_deg")][i] > 0.5); // of the joints' 10 mm
                }
            }
        }
    }
}

#[test]
fn opensim_files_have_the_times_and_names_of_the_others() {
    let [written, _] = both_up_axes(&[ExportFormat::JointAngles, ExportFormat::Trc]);
    for person in written.people() {
        let table = columns(&written.text(&format!("{}.angles.csv", person.id)), ',');
        let text = written.text(&format!("{}.mot", person.id));
        let (header, body) = text.split_once("endheader\n").unwrap();
        assert!(header.contains(&format!("nRows={}\n", person.frames.len())) && header.contains("inDegrees=yes\n"));
        let motion = columns(body, '\t');
        assert!(header.contains(&format!("nColumns={}\n", motion.len())));
        assert_eq!(motion["time"], table["time_s"]);
        for (ours, theirs) in motion["knee_angle_r"].iter().zip(&table["knee_flexion_r_deg"]) {
            assert!((ours - theirs).abs() < 1e-3);
        }
        let set_up = written.text(&format!("{}.ik.xml", person.id));
        let set_up = roxmltree::Document::parse(&set_up).unwrap();
        let tasks: Vec<&str> = set_up
            .descendants()
            .filter(|n| n.has_tag_name("IKMarkerTask"))
            .filter_map(|n| n.attribute("name"))
            .collect();
        assert_eq!(tasks, wandless::body::skeleton::JOINT_NAMES);
        let range = set_up.descendants().find(|n| n.has_tag_name("time_range")).unwrap().text().unwrap();
        let last = table["time_s"].last().unwrap();
        assert_eq!(range, format!("{:.6} {last:.6}", table["time_s"][0]));
    }
}

/// The people of the written result walk on: their events are in the frames in which they are detected, feet in turn.
#[test]
fn events_of_the_gait_lie_in_detected_frames() {
    for written in both_up_axes(&[ExportFormat::JointAngles]) {
        for person in written.people() {
            let text = written.text(&format!("{}.gait.csv", person.id));
            let (header, rows) = text.split_once('\n').unwrap();
            assert_eq!(header, "frame,time_s,foot,event,time_sd_s,confidence");
            for row in rows.lines() {
                let cells: Vec<&str> = row.split(',').collect();
                let (frame, secs): (i64, f64) = (cells[0].parse().unwrap(), cells[1].parse().unwrap());
                assert!((secs * FPS - (frame - FIRST_FRAME) as f64).abs() <= 0.51, "{row}");
                let at = person.frames.iter().position(|known| *known == frame).unwrap();
                assert!(person.valid[at], "{row}");
            }
        }
    }
}
