//! Every reason, from made evidence: a good capture and one thing wrong with it.

use super::*;
use crate::session::reconstruction::{ErrorSummary, KeypointReport, Overlap, SigmaSummary};

/// A capture as good as a verdict wants it: four cameras, two people, twenty seconds.
#[derive(Clone)]
struct Made {
    cameras: Vec<CameraReport>,
    people: Vec<PersonReport>,
    geometry: GeometryReport,
    penetration: PenetrationReport,
    gave_way: bool,
    explained: f64,
    sigma_angle_deg: Option<f64>,
    rival_explained: f64,
    estimated: bool,
}

fn error(median: f64) -> Option<ErrorSummary> {
    Some(ErrorSummary { mean: 1.2 * median, median })
}

fn camera(k: usize) -> CameraReport {
    CameraReport {
        id: format!("cam{k}"),
        solved: true,
        n_detections: 1000,
        n_rejected_detections: 20,
        reprojection_px: error(4.0),
        reprojection_mm: error(16.0 + k as f64),
        rejected_keypoints: 0.02,
        time_offset: None,
    }
}

fn keypoint(name: &str) -> KeypointReport {
    KeypointReport {
        keypoint: name.to_owned(),
        n_observations: 1500,
        rejected: 0.02,
        reprojection_px: error(4.0),
        reprojection_mm: error(16.0),
        sigma_mm: Some(SigmaSummary { median: 22.0, p95: 40.0 }),
    }
}

fn person(id: usize) -> PersonReport {
    PersonReport {
        id,
        first_frame: 100,
        last_frame: 399,
        n_detections: 1200,
        reprojection_px: error(4.0),
        reprojection_mm: error(16.0),
        share_in_two_views: 0.95,
        sigma_mm: Some(SigmaSummary { median: 20.0, p95: 40.0 }),
        ray_angle_deg: Some(80.0),
        dilution: Some(1.3),
        keypoints: vec![keypoint("nose"), keypoint("left_wrist")],
        bone_length_spread: Some(0.05),
        jitter_m_per_s2: Some(5.0),
    }
}

impl Made {
    fn good() -> Self {
        Self {
            cameras: (0..4).map(camera).collect(),
            people: (0..2).map(person).collect(),
            geometry: GeometryReport { people_spread_m: Some(1.0), ray_angle_deg: Some(80.0), dilution: Some(1.3) },
            penetration: PenetrationReport::default(),
            gave_way: true,
            explained: 0.97,
            sigma_angle_deg: Some(0.1),
            rival_explained: 0.5,
            estimated: true,
        }
    }

    fn judged(&self) -> Quality {
        quality(&Evidence {
            fps: 30.0,
            cameras: &self.cameras,
            people: &self.people,
            geometry: &self.geometry,
            penetration: &self.penetration,
            gave_way: self.gave_way,
            explained: self.explained,
            sigma_angle_deg: self.sigma_angle_deg,
            rival_explained: self.rival_explained,
            estimated: self.estimated,
        })
    }
}

/// A good capture with one thing changed is judged so, with one reason that holds all of `words`, the last of them in the
/// remedy.
#[track_caller]
fn assert_reason(verdict: Verdict, words: &[&str], change: impl FnOnce(&mut Made)) {
    let mut made = Made::good();
    change(&mut made);
    let found = made.judged();
    assert_eq!((found.verdict, found.reasons.len()), (verdict, 1), "{:?}", found.reasons);
    let (_, remedy) = found.reasons[0].rsplit_once("; ").expect("what to do about it");
    assert!(words.iter().all(|word| found.reasons[0].contains(word)), "{}", found.reasons[0]);
    assert!(words.last().is_none_or(|word| remedy.contains(word)), "{remedy}");
}

#[test]
fn nothing_speaks_against_a_good_capture() {
    assert_eq!(Made::good().judged(), Quality { verdict: Verdict::Pass, reasons: Vec::new() });
}

#[test]
fn a_camera_that_stands_out_is_named() {
    let words = ["cam2", "moved during the take"];
    assert_reason(Verdict::Warn, &words, |made| made.cameras[2].reprojection_mm = error(40.0));
    assert_reason(Verdict::Warn, &words, |made| made.cameras[2].rejected_keypoints = 0.4);
    assert_reason(Verdict::Warn, &words, |made| made.cameras[2].n_rejected_detections = 500);
    let mut bad_throughout = Made::good();
    bad_throughout.cameras.iter_mut().for_each(|camera| camera.reprojection_mm = error(40.0));
    assert_eq!(bad_throughout.judged().verdict, Verdict::Pass, "nobody stands out where all are alike");
    let mut two = Made::good();
    two.cameras.truncate(2);
    two.cameras[1].reprojection_mm = error(40.0);
    assert_eq!(two.judged().verdict, Verdict::Pass, "of two cameras none stands out");
}

#[test]
fn an_unplaced_camera_is_named_and_not_compared() {
    assert_reason(Verdict::Warn, &["cam1", "synchronisation"], |made| {
        made.cameras[1] = CameraReport {
            solved: false,
            n_rejected_detections: 1000,
            reprojection_px: None,
            reprojection_mm: None,
            ..made.cameras[1].clone()
        };
    });
}

#[test]
fn weak_cameras_are_told_of() {
    assert_reason(Verdict::Warn, &["70 %", "synchronisation"], |made| made.explained = 0.7);
    assert_reason(Verdict::Reject, &["50 %", "synchronisation"], |made| {
        (made.explained, made.rival_explained) = (0.5, 0.2);
    });
    assert_reason(Verdict::Warn, &["1.0 degrees", "walk"], |made| made.sigma_angle_deg = Some(1.0));
    assert_reason(Verdict::Reject, &["3.0 degrees", "walk"], |made| made.sigma_angle_deg = Some(3.0));
    assert_reason(Verdict::Warn, &["uncertainty", "longer"], |made| made.sigma_angle_deg = None);
    assert_reason(Verdict::Warn, &["ambiguous", "independently"], |made| made.rival_explained = 0.96);
}

#[test]
fn weak_geometry_is_told_of() {
    assert_reason(Verdict::Warn, &["0.05 m", "walk"], |made| made.geometry.people_spread_m = Some(0.05));
    assert_reason(Verdict::Warn, &["cam0, cam1", "15 degrees", "across"], |made| {
        made.geometry.ray_angle_deg = Some(15.0)
    });
    assert_reason(Verdict::Reject, &["3 degrees", "across"], |made| made.geometry.ray_angle_deg = Some(3.0));
    assert_reason(Verdict::Warn, &["1.0 s", "longer"], |made| {
        made.people.iter_mut().for_each(|person| person.last_frame = person.first_frame + 14);
    });
}

#[test]
fn given_cameras_are_not_doubted_for_what_only_an_estimate_needs() {
    let mut made = Made { estimated: false, sigma_angle_deg: None, rival_explained: 1.0, ..Made::good() };
    made.geometry.people_spread_m = Some(0.01);
    assert_eq!(made.judged().verdict, Verdict::Pass);
}

#[test]
fn a_person_whom_single_cameras_see_is_named() {
    let words = ["person 1", "100 to 399", "aim another camera"];
    assert_reason(Verdict::Warn, &words, |made| made.people[1].share_in_two_views = 0.4);
    assert_reason(Verdict::Warn, &words, |made| made.people[1].share_in_two_views = 0.1);
    assert_reason(Verdict::Reject, &words, |made| {
        made.people.remove(0);
        made.people[0].share_in_two_views = 0.1;
    });
}

#[test]
fn uncertain_keypoints_are_named_with_the_worst_of_them() {
    let coarse = |made: &mut Made, median: f64| {
        made.people[1].sigma_mm = Some(SigmaSummary { median, p95: 2.0 * median });
        made.people[1].keypoints[1].sigma_mm = Some(SigmaSummary { median: 2.0 * median, p95: 4.0 * median });
    };
    assert_reason(Verdict::Warn, &["person 1", "left_wrist to 240 mm", "nearer"], |made| coarse(made, 120.0));
    assert_reason(Verdict::Reject, &["person 1", "300 mm", "from the side"], |made| {
        coarse(made, 300.0);
        made.people[1].ray_angle_deg = Some(12.0);
        made.people.remove(0);
    });
}

#[test]
fn contradicted_keypoints_are_named() {
    assert_reason(Verdict::Warn, &["left_wrist of person 0", "60 %", "keypoint_convention"], |made| {
        made.people[0].keypoints[1].rejected = 0.6;
    });
    let mut rare = Made::good();
    rare.people[0].keypoints[1] = KeypointReport { rejected: 0.9, n_observations: 20, ..keypoint("left_wrist") };
    assert_eq!(rare.judged().verdict, Verdict::Pass, "twenty detections are no judgement");
}

#[test]
fn people_who_move_as_no_body_does_are_named() {
    let (bones, jitter) = (["person 1", "20 %", "who is who"], ["person 0", "40 m/s^2", "fps"]);
    assert_reason(Verdict::Warn, &bones, |made| made.people[1].bone_length_spread = Some(0.2));
    assert_reason(Verdict::Warn, &jitter, |made| made.people[0].jitter_m_per_s2 = Some(40.0));
}

#[test]
fn a_deep_overlap_is_named_with_its_frame_and_joints() {
    let overlap =
        Overlap { depth_mm: 90.0, frame: 217, people: [0, 1], joints: ["left_elbow".to_owned(), "spine3".to_owned()] };
    let deep = |gave_way: bool| {
        let penetration = PenetrationReport { deepest: Some(overlap.clone()), ..PenetrationReport::default() };
        move |made: &mut Made| (made.penetration, made.gave_way) = (penetration, gave_way)
    };
    assert_reason(Verdict::Warn, &["left_elbow", "90 mm", "frame 217", "two cameras"], deep(true));
    assert_reason(Verdict::Warn, &["spine3", "collision: true"], deep(false));
}

#[test]
fn one_view_is_judged_as_one_view() {
    let mut made = Made::good();
    made.cameras.truncate(1);
    made.geometry = GeometryReport::default();
    made.people.iter_mut().for_each(|person| person.share_in_two_views = 0.0);
    let found = made.judged();
    assert_eq!((found.verdict, found.reasons.len()), (Verdict::Warn, 1), "{:?}", found.reasons);
}

#[test]
fn nobody_is_a_reason_to_reject() {
    assert_reason(Verdict::Reject, &["nobody", "overlap"], |made| made.people.clear());
}
