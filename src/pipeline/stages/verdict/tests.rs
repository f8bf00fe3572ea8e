//! Every reason, from constructed input: a good recording with one problem.

use super::input::{FollowedPerson, PoseChange};
use super::*;
use crate::pipeline::up_direction::UpRival;
use crate::session::reconstruction::{
    CameraReport, ErrorSummary, GeometryReport, KeypointReport, Overlap, PenetrationReport, PersonReport, ScaleReport,
    SigmaSummary, StillDetections, UncertainFrames,
};
use crate::session::{Suspicion, SuspicionCode};

/// Owned input of a verdict; a good one has four cameras, two people and twenty seconds.
#[derive(Clone)]
struct OwnedInput {
    cameras: Vec<CameraReport>,
    people: Vec<PersonReport>,
    without_body: Vec<FollowedPerson>,
    geometry: GeometryReport,
    scale: ScaleReport,
    penetration: PenetrationReport,
    resolves_collisions: bool,
    explained: f64,
    sigma_angle_deg: Option<f64>,
    rival_explained: f64,
    suspicions: Vec<Suspicion>,
    lens_evidence: Option<f64>,
    estimated: bool,
    changes: Vec<PoseChange>,
    up_rival: Option<UpRival>,
}

fn error(median: f64) -> Option<ErrorSummary> {
    Some(ErrorSummary { mean: 1.2 * median, median })
}

fn camera(k: usize) -> CameraReport {
    CameraReport {
        excluded: false,
        id: format!("cam{k}"),
        solved: true,
        n_detections: 1000,
        n_rejected_detections: 20,
        still_detections: Vec::new(),
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
        name: None,
        id,
        first_frame: 100,
        last_frame: 399,
        n_detections: 1200,
        reprojection_px: error(4.0),
        reprojection_mm: error(16.0),
        share_in_two_views: 0.95,
        sigma_mm: Some(SigmaSummary { median: 20.0, p95: 40.0 }),
        joint_sigma_mm: Some(SigmaSummary { median: 15.0, p95: 30.0 }),
        uncertain_frames: Vec::new(),
        body: None,
        ray_angle_deg: Some(80.0),
        dilution: Some(1.3),
        keypoints: vec![keypoint("nose"), keypoint("left_wrist")],
        bone_length_spread: Some(0.05),
        jitter_m_per_s2: Some(5.0),
        hands: Vec::new(),
    }
}

impl OwnedInput {
    fn good() -> Self {
        Self {
            cameras: (0..4).map(camera).collect(),
            people: (0..2).map(person).collect(),
            without_body: Vec::new(),
            geometry: GeometryReport { people_spread_m: Some(1.0), ray_angle_deg: Some(80.0), dilution: Some(1.3) },
            scale: ScaleReport { value: 2.0, interval95: [1.8, 2.2], evidence: "2 people".to_owned() },
            penetration: PenetrationReport::default(),
            resolves_collisions: true,
            explained: 0.97,
            sigma_angle_deg: Some(0.1),
            rival_explained: 0.5,
            suspicions: Vec::new(),
            lens_evidence: None,
            estimated: true,
            changes: Vec::new(),
            up_rival: Some(UpRival { ratio: 900.0, angle_deg: 180.0 }),
        }
    }

    fn judged(&self) -> Quality {
        quality(&VerdictInput {
            fps: 30.0,
            cameras: &self.cameras,
            people: &self.people,
            without_body: &self.without_body,
            geometry: &self.geometry,
            scale: Some(&self.scale),
            penetration: &self.penetration,
            resolves_collisions: self.resolves_collisions,
            explained: self.explained,
            sigma_angle_deg: self.sigma_angle_deg,
            rival_explained: self.rival_explained,
            suspicions: &self.suspicions,
            lens_evidence: self.lens_evidence,
            estimated: self.estimated,
            changes: &self.changes,
            up_rival: self.up_rival,
        })
    }
}

/// A good recording with one change has this verdict and one reason that contains all of `words`, the last of them in the
/// remedy.
#[track_caller]
fn assert_reason(verdict: Verdict, words: &[&str], change: impl FnOnce(&mut OwnedInput)) {
    let mut input = OwnedInput::good();
    change(&mut input);
    let found = input.judged();
    assert_eq!((found.verdict, found.reasons.len()), (verdict, 1), "{:?}", found.reasons);
    let (_, remedy) = found.reasons[0].rsplit_once("; ").expect("a remedy");
    assert!(words.iter().all(|word| found.reasons[0].contains(word)), "{}", found.reasons[0]);
    assert!(words.last().is_none_or(|word| remedy.contains(word)), "{remedy}");
}

#[test]
fn a_good_recording_passes() {
    assert_eq!(OwnedInput::good().judged(), Quality { verdict: Verdict::Pass, reasons: Vec::new() });
}

#[test]
fn names_a_camera_with_large_errors() {
    let words = ["cam2", "moved during the recording"];
    assert_reason(Verdict::Warn, &words, |input| input.cameras[2].reprojection_mm = error(40.0));
    assert_reason(Verdict::Warn, &words, |input| input.cameras[2].rejected_keypoints = 0.4);
    assert_reason(Verdict::Warn, &words, |input| input.cameras[2].n_rejected_detections = 500);
    let mut bad_throughout = OwnedInput::good();
    bad_throughout.cameras.iter_mut().for_each(|camera| camera.reprojection_mm = error(40.0));
    assert_eq!(bad_throughout.judged().verdict, Verdict::Pass, "all cameras are alike");
    let mut two = OwnedInput::good();
    two.cameras.truncate(2);
    two.cameras[1].reprojection_mm = error(40.0);
    assert_eq!(two.judged().verdict, Verdict::Pass, "two cameras are not compared");
}

/// Lenses that were each 3 % off stayed as given, stated to 0.4 %, and the recording passed.
#[test]
fn names_lenses_that_others_explain_better() {
    assert_reason(Verdict::Warn, &["200 times likelier", "calibrate"], |input| input.lens_evidence = Some(200f64.ln()));
    let mut right = OwnedInput::good();
    right.lens_evidence = Some(2.0);
    assert_eq!(right.judged().verdict, Verdict::Pass);
}

/// A picture on the wall was taken for a camera that had moved, and for cameras that disagree.
#[test]
fn names_what_does_not_move() {
    assert_reason(Verdict::Warn, &["cam2", "(300, 400)", "picture", "mask"], |input| {
        let picture = StillDetections { n_detections: 600, first_frame: 100, last_frame: 399, pixel: [300.2, 400.4] };
        (input.cameras[2].n_detections, input.cameras[2].n_rejected_detections) = (1600, 610);
        input.cameras[2].still_detections.push(picture);
        input.explained = 0.75; // 0.86 without it
    });
}

#[test]
fn names_limbs_that_no_image_shows() {
    let words = ["left_wrist of person 1", "guess", "aim a camera"];
    assert_reason(Verdict::Warn, &words, |input| input.people[1].keypoints[1].n_observations = 10);
    let mut faces = OwnedInput::good();
    faces.people[1].keypoints[0].n_observations = 0;
    assert_eq!(faces.judged().verdict, Verdict::Pass, "limbs do not include noses");
}

#[test]
fn names_an_unplaced_camera() {
    assert_reason(Verdict::Warn, &["cam1", "synchronisation"], |input| {
        input.cameras[1] = CameraReport {
            solved: false,
            n_rejected_detections: 1000,
            reprojection_px: None,
            reprojection_mm: None,
            ..input.cameras[1].clone()
        };
    });
}

/// A camera whose files held no detection was said to disagree with the others.
#[test]
fn a_camera_without_detections_was_said_to_disagree() {
    assert_reason(Verdict::Warn, &["cam1", "no detections", "keypoint files"], |input| {
        input.cameras[1] = CameraReport {
            solved: false,
            n_detections: 0,
            n_rejected_detections: 0,
            reprojection_px: None,
            reprojection_mm: None,
            ..input.cameras[1].clone()
        };
    });
}

#[test]
fn a_suspicion_replaces_other_reasons_about_its_camera() {
    let suspicion = |code| Suspicion::new(code, vec!["cam2".to_owned()], "its frames are 7 frames late", "synchronise");
    assert_reason(Verdict::Warn, &["cam2", "7 frames", "synchronise"], |input| {
        input.suspicions.push(suspicion(SuspicionCode::TimeOffset));
        input.cameras[2].reprojection_mm = error(40.0);
    });
    assert_reason(Verdict::Reject, &["synchronise"], |input| input.suspicions.push(suspicion(SuspicionCode::YUpwards)));
}

#[test]
fn reports_weak_cameras() {
    assert_reason(Verdict::Warn, &["70 %", "synchronisation"], |input| input.explained = 0.7);
    assert_reason(Verdict::Reject, &["50 %", "synchronisation"], |input| {
        (input.explained, input.rival_explained) = (0.5, 0.2);
    });
    assert_reason(Verdict::Warn, &["1.0 degrees", "walk"], |input| input.sigma_angle_deg = Some(1.0));
    assert_reason(Verdict::Reject, &["3.0 degrees", "walk"], |input| input.sigma_angle_deg = Some(3.0));
    assert_reason(Verdict::Warn, &["uncertainty", "longer"], |input| input.sigma_angle_deg = None);
    assert_reason(Verdict::Warn, &["ambiguous", "independently"], |input| input.rival_explained = 0.96);
}

/// People on a mat before two cameras passed with the floor for a wall.
#[test]
fn a_way_up_that_is_uncertain_is_stated() {
    let rival = UpRival { ratio: 2.0, angle_deg: 90.0 };
    assert_reason(Verdict::Warn, &["90 degrees", "2.0 times", "upright"], |input| input.up_rival = Some(rival));
}

#[test]
fn reports_weak_geometry() {
    assert_reason(Verdict::Warn, &["0.05 m", "walk"], |input| input.geometry.people_spread_m = Some(0.05));
    assert_reason(Verdict::Warn, &["cam0, cam1", "15 degrees", "across"], |input| {
        input.geometry.ray_angle_deg = Some(15.0)
    });
    assert_reason(Verdict::Reject, &["3 degrees", "across"], |input| input.geometry.ray_angle_deg = Some(3.0));
    assert_reason(Verdict::Warn, &["metric scale", "22 %", "height"], |input| input.scale.interval95 = [1.6, 2.5]);
    assert_reason(Verdict::Warn, &["1.0 s", "longer"], |input| {
        input.people.iter_mut().for_each(|person| person.last_frame = person.first_frame + 14);
    });
}

#[test]
fn given_cameras_need_no_movement_of_people() {
    let mut input = OwnedInput { estimated: false, sigma_angle_deg: None, rival_explained: 1.0, ..OwnedInput::good() };
    input.geometry.people_spread_m = Some(0.01);
    assert_eq!(input.judged().verdict, Verdict::Pass);
}

/// A given pose that was 5 degrees off drew cameras 20 mm aside, five times their standard deviations, in a result that was a `pass`.
#[test]
fn names_a_given_pose_that_cameras_contradict() {
    let refined = |angle_deg: f64, distance_mm: f64| {
        move |input: &mut OwnedInput| {
            input.estimated = false;
            input.changes = vec![PoseChange { camera: "cam2".to_owned(), angle_deg, distance_mm }];
        }
    };
    assert_reason(Verdict::Warn, &["cam2", "4.8 degrees and 12 mm", "R and t"], refined(4.8, 12.0));
    assert_reason(Verdict::Warn, &["0.4 degrees and 120 mm", "estimate"], refined(0.4, 120.0));
    let mut near = OwnedInput::good();
    refined(0.6, 40.0)(&mut near);
    assert_eq!(near.judged().verdict, Verdict::Pass);
}

/// Poses in millimetres or of another camera were answered with advice about synchronisation and intrinsics.
#[test]
fn given_poses_are_among_the_things_to_check() {
    let words = ["R and t"];
    let given = |change: fn(&mut OwnedInput)| {
        move |input: &mut OwnedInput| {
            (input.estimated, input.sigma_angle_deg) = (false, None);
            change(input);
        }
    };
    assert_reason(Verdict::Warn, &words, given(|input| input.cameras[2].reprojection_mm = error(40.0)));
    assert_reason(Verdict::Reject, &words, given(|input| input.explained = 0.1));
    assert_reason(Verdict::Reject, &words, given(|input| input.people.clear()));
}

#[test]
fn names_a_person_seen_by_single_cameras() {
    let words = ["person 1", "100 to 399", "aim another camera"];
    assert_reason(Verdict::Warn, &words, |input| input.people[1].share_in_two_views = 0.4);
    assert_reason(Verdict::Warn, &words, |input| input.people[1].share_in_two_views = 0.1);
    assert_reason(Verdict::Reject, &words, |input| {
        input.people.remove(0);
        input.people[0].share_in_two_views = 0.1;
    });
}

/// A person at a table, whose hips no image showed, was missing from a result that was a `pass`; alone, they were said never to have
/// been seen by two cameras.
#[test]
fn names_people_that_have_no_body() {
    let followed = |last_frame| vec![FollowedPerson { id: 4, first_frame: 100, last_frame }];
    let words = ["person 4", "frames 100 to 160", "left out", "hips and shoulders", "aim the cameras"];
    assert_reason(Verdict::Warn, &words, |input| input.without_body = followed(160));
    assert_reason(Verdict::Reject, &["person 4", "hips", "aim"], |input| {
        (input.without_body, input.people) = (followed(110), Vec::new());
    });
    let mut passing = OwnedInput::good();
    passing.without_body = followed(110);
    assert_eq!(passing.judged().verdict, Verdict::Pass, "a moment");
}

/// A capture of three cameras had been a `pass` with a person 0.4 m off for the two seconds that one of them showed.
#[test]
fn names_frames_that_one_camera_alone_shows() {
    let stretch = |first_frame, last_frame, cameras: &[&str]| UncertainFrames {
        first_frame,
        last_frame,
        joint_sigma_mm: 143.2,
        cameras: cameras.iter().map(|id| (*id).to_owned()).collect(),
    };
    let words = ["person 1", "143 mm", "frames 202 to 255, where camera cam2 alone shows", "aim another camera"];
    assert_reason(Verdict::Warn, &words, |input| input.people[1].uncertain_frames = vec![stretch(202, 255, &["cam2"])]);
    let words = ["frames 150 to 180 (and in 1 other stretch), where no camera shows", "aim another camera"];
    assert_reason(Verdict::Warn, &words, |input| {
        input.people[0].uncertain_frames = vec![stretch(120, 139, &["cam0", "cam1"]), stretch(150, 180, &[])];
    });
    let mut short = OwnedInput::good();
    short.people[0].uncertain_frames = vec![stretch(120, 148, &["cam2"])];
    assert_eq!(short.judged().verdict, Verdict::Pass, "the report lists it");
}

/// Half detections of two people made a third one for half a second, 86 mm uncertain, at `pass`.
#[test]
fn names_a_person_who_is_uncertain_throughout() {
    let words = ["person 1", "frames 100 to 399", "86 mm", "exclude_person"];
    assert_reason(Verdict::Warn, &words, |input| {
        input.people[1].joint_sigma_mm = Some(SigmaSummary { median: 86.0, p95: 223.0 });
    });
}

#[test]
fn names_the_most_uncertain_keypoint() {
    let coarse = |input: &mut OwnedInput, median: f64| {
        input.people[1].sigma_mm = Some(SigmaSummary { median, p95: 2.0 * median });
        input.people[1].keypoints[1].sigma_mm = Some(SigmaSummary { median: 2.0 * median, p95: 4.0 * median });
    };
    assert_reason(Verdict::Warn, &["person 1", "left_wrist by 240 mm", "nearer"], |input| coarse(input, 120.0));
    assert_reason(Verdict::Reject, &["person 1", "300 mm", "from the side"], |input| {
        coarse(input, 300.0);
        input.people[1].ray_angle_deg = Some(12.0);
        input.people.remove(0);
    });
}

#[test]
fn names_contradicted_keypoints() {
    assert_reason(Verdict::Warn, &["left_wrist of person 0", "60 %", "keypoint_convention"], |input| {
        input.people[0].keypoints[1].rejected = 0.6;
    });
    let mut rare = OwnedInput::good();
    rare.people[0].keypoints[1] = KeypointReport { rejected: 0.9, n_observations: 20, ..keypoint("left_wrist") };
    assert_eq!(rare.judged().verdict, Verdict::Pass, "twenty detections are too few");
}

#[test]
fn names_people_with_implausible_motion() {
    let (bones, jitter) = (["person 1", "20 %", "identities"], ["person 0", "40 m/s^2", "fps"]);
    assert_reason(Verdict::Warn, &bones, |input| input.people[1].bone_length_spread = Some(0.2));
    assert_reason(Verdict::Warn, &jitter, |input| input.people[0].jitter_m_per_s2 = Some(40.0));
}

#[test]
fn names_frame_and_joints_of_a_deep_overlap() {
    let overlap =
        Overlap { depth_mm: 90.0, frame: 217, people: [0, 1], joints: ["left_elbow".to_owned(), "spine3".to_owned()] };
    let deep = |resolves_collisions: bool| {
        let penetration = PenetrationReport { deepest: Some(overlap.clone()), ..PenetrationReport::default() };
        move |input: &mut OwnedInput| {
            (input.penetration, input.resolves_collisions) = (penetration, resolves_collisions)
        }
    };
    assert_reason(Verdict::Warn, &["left_elbow", "90 mm", "frame 217", "two cameras"], deep(true));
    assert_reason(Verdict::Warn, &["spine3", "collision: true"], deep(false));
}

#[test]
fn a_single_camera_gives_one_warning() {
    let mut input = OwnedInput::good();
    input.cameras.truncate(1);
    input.geometry = GeometryReport::default();
    input.people.iter_mut().for_each(|person| person.share_in_two_views = 0.0);
    let found = input.judged();
    assert_eq!((found.verdict, found.reasons.len()), (Verdict::Warn, 1), "{:?}", found.reasons);
}

#[test]
fn rejects_a_result_without_people() {
    assert_reason(Verdict::Reject, &["no person", "overlap"], |input| input.people.clear());
}
