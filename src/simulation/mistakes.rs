//! Mistakes that users make with the files of a recording, injected into sessions with truth.
//!
//! Each leaves the truth of the recording as it is and changes what its files state. Cameras are chosen by position: most
//! mistakes affect the second one.

use crate::body::skeleton::KeypointConvention;
use crate::geometry::{Intrinsics, rotation};
use crate::session::recording::{Detection, FrameIndex, Keypoint, Session, View};
use crate::session::suspicion::SuspicionCode as Code;
use nalgebra::{Matrix3, Vector2, Vector3};

/// One mistake.
#[derive(Debug, Clone, Copy)]
pub struct Mistake {
    /// Its name, in words.
    pub name: &'static str,
    /// The codes that name it rightly.
    pub codes: &'static [Code],
    /// The cameras concerned, by position; empty where all are.
    pub cameras: &'static [usize],
    /// Options of the job that has it, JSON.
    pub options: &'static str,
    /// Angle, rad, by which it turns the images of the cameras, about the optical axis: the poses that suit them are turned as well.
    pub image_turn: f64,
    /// Makes it; `None` where the session cannot have it.
    pub inject: fn(&Session) -> Option<Session>,
}

/// Two mistakes at once, by their names: of different cameras, or of one and all.
pub const COMBINATIONS: [[&str; 2]; 5] = [
    ["left and right exchanged", "7 frames late"],
    ["focal lengths +20 %", "2 frames late"],
    ["images mirrored in one camera", "coordinates from 0 to 1"],
    ["every second frame missing", "focal length +20 %"],
    ["body25 declared as body25b", "images mirrored in one camera"],
];

/// The camera of most mistakes, and its partner where there are two.
const ODD: usize = 1;
const PARTNER: usize = 2;

/// Rotation of a knocked camera, rad.
const KNOCK: f64 = 0.5 * std::f64::consts::PI / 180.0;

/// Every mistake.
pub const MISTAKES: &[Mistake] = &[
    all("left and right exchanged", &[Code::Handedness], |s| Some(labels_exchanged(s, &everywhere(s)))),
    all("images mirrored", &[Code::Handedness], |s| {
        Some(moved(s, &everywhere(s), |lens, p| Vector2::new(last(lens.width) - p.x, p.y)))
    }),
    all("y counted upwards", &[Code::YUpwards], |s| Some(moved(s, &everywhere(s), upwards))),
    odd("K x 1.5", &[Code::Resolution], |s| {
        lens_changed(s, &[ODD], |lens, _| Intrinsics { width: lens.width, height: lens.height, ..lens.resized(1.5) })
    }),
    odd("calibration of 1.5 times the resolution", &[Code::Resolution], |s| {
        lens_changed(s, &[ODD], |lens, _| lens.resized(1.5))
    }),
    odd("focal length +20 %", &[Code::FocalLength], |s| lens_changed(s, &[ODD], |lens, _| lens.with_focal_factor(1.2))),
    all("focal lengths +20 %", &[Code::FocalLength], |s| {
        lens_changed(s, &everywhere(s), |lens, _| lens.with_focal_factor(1.2))
    }),
    all("focal lengths +-10 %", &[Code::FocalLength], |s| {
        lens_changed(s, &everywhere(s), |lens, v| lens.with_focal_factor(if v % 2 == 0 { 1.1 } else { 0.9 }))
    }),
    Mistake {
        image_turn: -std::f64::consts::FRAC_PI_2,
        ..odd("portrait pixels with landscape K", &[Code::PrincipalPoint, Code::Rotated], |s| Some(portrait(s, ODD)))
    },
    odd("cx and cy exchanged", &[Code::PrincipalPoint], |s| {
        lens_changed(s, &[ODD], |lens, _| Intrinsics { cx: lens.cy, cy: lens.cx, ..*lens })
    }),
    two("keypoints of a second camera", &[Code::DuplicateCamera], |s| {
        let mut copied = s.clone();
        copied.views.get_mut(PARTNER)?.frames.clone_from(&s.views[ODD].frames);
        Some(copied)
    }),
    odd("one frame repeated", &[Code::RepeatedFrames], frozen),
    odd("7 frames late", &[Code::TimeOffset], |s| late(s, ODD, 7)),
    odd("2 frames late", &[Code::TimeOffset], |s| late(s, ODD, 2)),
    odd("2 frames dropped halfway", &[Code::DroppedFrames], |s| dropped(s, ODD, 2)),
    two("keypoints of two cameras exchanged", &[Code::CamerasExchanged], exchanged),
    all("fps 10", &[Code::FrameRate], |s| Some(Session { fps: 0.4 * s.fps, ..s.clone() })),
    all("fps 60", &[Code::FrameRate], |s| Some(Session { fps: 2.4 * s.fps, ..s.clone() })),
    all("fps 100", &[Code::FrameRate], |s| Some(Session { fps: 4.0 * s.fps, ..s.clone() })),
    all("body25 declared as body25b", &[Code::Convention], |s| {
        let is_possible = s.convention == KeypointConvention::Body25;
        is_possible.then(|| Session { convention: KeypointConvention::Body25b, ..s.clone() })
    }),
    odd("images mirrored in one camera", &[Code::Mirrored], |s| {
        Some(moved(s, &[ODD], |lens, p| Vector2::new(last(lens.width) - p.x, p.y)))
    }),
    odd("y counted upwards in one camera", &[Code::YUpwards], |s| Some(moved(s, &[ODD], upwards))),
    odd("left and right exchanged in one camera", &[Code::LabelsExchanged], |s| Some(labels_exchanged(s, &[ODD]))),
    all("calibration of half the resolution", &[Code::Resolution], |s| {
        lens_changed(s, &everywhere(s), |lens, _| lens.resized(0.5))
    }),
    all("coordinates from 0 to 1", &[Code::NormalizedCoordinates], |s| {
        let share = |lens: &Intrinsics, p: Vector2<f64>| {
            Vector2::new(p.x / f64::from(lens.width), p.y / f64::from(lens.height))
        };
        Some(moved(s, &everywhere(s), share))
    }),
    all("two takes mixed", &[Code::SeveralTakes], two_takes),
    all("confidences x 0.1", &[Code::LowConfidence], |s| {
        Some(mapped(s, &everywhere(s), |_, k| Keypoint { confidence: 0.1 * k.confidence, ..k }))
    }),
    all("every second frame missing", &[Code::PeriodicGaps], |s| Some(halved(s))),
    odd("camera knocked by 0.5 degrees", &[Code::CameraMoved], |s| knocked(s, ODD)),
    Mistake { options: r#"{"people": 1}"#, ..all("one of several people wanted", &[Code::PeopleLimit], crowded) },
    Mistake {
        options: r#"{"extrinsics": "refine"}"#,
        ..all("given poses in the axes of OpenGL", &[Code::GivenPoses], opengl)
    },
];

type Inject = fn(&Session) -> Option<Session>;

const fn all(name: &'static str, codes: &'static [Code], inject: Inject) -> Mistake {
    Mistake { name, codes, cameras: &[], options: "{}", image_turn: 0.0, inject }
}

const fn odd(name: &'static str, codes: &'static [Code], inject: Inject) -> Mistake {
    Mistake { name, codes, cameras: &[ODD], options: "{}", image_turn: 0.0, inject }
}

const fn two(name: &'static str, codes: &'static [Code], inject: Inject) -> Mistake {
    Mistake { name, codes, cameras: &[ODD, PARTNER], options: "{}", image_turn: 0.0, inject }
}

fn everywhere(session: &Session) -> Vec<usize> {
    (0..session.views.len()).collect()
}

/// Coordinate of the last pixel of a row of `n`.
fn last(n: u32) -> f64 {
    f64::from(n) - 1.0
}

fn upwards(lens: &Intrinsics, pixel: Vector2<f64>) -> Vector2<f64> {
    Vector2::new(pixel.x, last(lens.height) - pixel.y)
}

/// The session with every present keypoint of some views changed.
fn mapped(session: &Session, views: &[usize], change: impl Fn(&Intrinsics, Keypoint) -> Keypoint) -> Session {
    let mut changed = session.clone();
    for &v in views {
        let Some(View { intrinsics, frames, .. }) = changed.views.get_mut(v) else { continue };
        let keypoints = frames.iter_mut().flatten().flat_map(|detection| &mut detection.keypoints);
        keypoints.filter(|k| k.is_present()).for_each(|k| *k = change(intrinsics, *k));
    }
    changed
}

fn moved(session: &Session, views: &[usize], pixel: fn(&Intrinsics, Vector2<f64>) -> Vector2<f64>) -> Session {
    mapped(session, views, |lens, k| k.mapped(|at| pixel(lens, at)))
}

fn labels_exchanged(session: &Session, views: &[usize]) -> Session {
    let twins = session.mirror();
    let mut changed = session.clone();
    for &v in views {
        let Some(View { frames, .. }) = changed.views.get_mut(v) else { continue };
        for detection in frames.iter_mut().flatten() {
            *detection = detection.with_sides_exchanged(&twins);
        }
    }
    changed
}

fn lens_changed(session: &Session, views: &[usize], lens: fn(&Intrinsics, usize) -> Intrinsics) -> Option<Session> {
    let mut changed = session.clone();
    for &v in views {
        let intrinsics = &mut changed.views.get_mut(v)?.intrinsics;
        *intrinsics = lens(intrinsics, v);
    }
    Some(changed)
}

/// A video turned by 90 degrees after its camera was calibrated.
fn portrait(session: &Session, view: usize) -> Session {
    let mut turned = moved(session, &[view], |lens, p| Vector2::new(p.y, last(lens.width) - p.x));
    if let Some(View { intrinsics: Intrinsics { width, height, .. }, .. }) = turned.views.get_mut(view) {
        std::mem::swap(width, height);
    }
    turned
}

/// One camera shows its middle frame all the time.
fn frozen(session: &Session) -> Option<Session> {
    let mut changed = session.clone();
    let frames = &mut changed.views.get_mut(ODD)?.frames;
    let seeing: Vec<usize> = (0..frames.len()).filter(|&f| !frames[f].is_empty()).collect();
    let shown = frames[*seeing.get(seeing.len() / 2)?].clone();
    frames.iter_mut().for_each(|frame| frame.clone_from(&shown));
    Some(changed)
}

/// The frames of a camera are numbered `n` too high.
fn late(session: &Session, view: usize, n: usize) -> Option<Session> {
    let mut changed = session.clone();
    let frames = &mut changed.views.get_mut(view)?.frames;
    frames.rotate_right(n.min(session.n_frames));
    frames.iter_mut().take(n).for_each(Vec::clear);
    Some(changed)
}

/// A camera drops `n` frames halfway: what follows is numbered `n` too low.
fn dropped(session: &Session, view: usize, n: usize) -> Option<Session> {
    let mut changed = session.clone();
    let frames = &mut changed.views.get_mut(view)?.frames;
    let halfway = frames.len() / 2;
    if halfway <= n {
        return None;
    }
    frames.drain(halfway..halfway + n);
    frames.extend(std::iter::repeat_n(Vec::new(), n));
    Some(changed)
}

/// Smallest difference between the focal lengths of two cameras whose files are exchanged: with equal calibrations the result is
/// right but for their names, which nothing in the files shows. Two people in ten seconds leave a focal length open to 2 to 3 %.
const OTHER_FOCAL: f64 = 0.05;

fn exchanged(session: &Session) -> Option<Session> {
    let focal = |view: usize| session.views.get(view).map(|view| view.intrinsics.focal());
    let difference = (focal(ODD)? / focal(PARTNER)?).ln().abs();
    (difference >= OTHER_FOCAL).then(|| session.with_keypoints_exchanged(ODD, PARTNER))
}

/// The second half of the cameras shows another take: the same one backwards and half of its length later.
fn two_takes(session: &Session) -> Option<Session> {
    let mut changed = session.clone();
    for view in changed.views.iter_mut().skip(session.views.len().div_ceil(2)) {
        view.frames.reverse();
        view.frames.rotate_right(session.n_frames / 2);
    }
    (session.views.len() >= 4).then_some(changed)
}

fn halved(session: &Session) -> Session {
    let mut changed = session.clone();
    for View { frames, delivered, .. } in &mut changed.views {
        frames.iter_mut().skip(1).step_by(2).for_each(Vec::clear);
        delivered.retain(|FrameIndex(frame)| frame % 2 == 0);
    }
    changed
}

/// A camera turns about its vertical axis halfway through the recording.
fn knocked(session: &Session, view: usize) -> Option<Session> {
    let turn = rotation::exp(&Vector3::new(0.0, KNOCK, 0.0));
    let mut changed = session.clone();
    let View { intrinsics, frames, .. } = changed.views.get_mut(view)?;
    let after = frames.iter_mut().skip(session.n_frames / 2).flatten();
    for keypoint in after.flat_map(|Detection { keypoints, .. }| keypoints).filter(|k| k.is_present()) {
        let ray = turn * intrinsics.normalized_from_pixel(&keypoint.pixel).push(1.0);
        keypoint.pixel = intrinsics.pixel_from_camera(&ray).unwrap_or(keypoint.pixel);
    }
    Some(changed)
}

/// The session as it is where two people and more are seen in most frames.
fn crowded(session: &Session) -> Option<Session> {
    let n_people = |frame: usize| session.views.iter().map(|view| view.frames[frame].len()).max().unwrap_or(0);
    let n_crowded = (0..session.n_frames).filter(|&frame| n_people(frame) > 1).count();
    (2 * n_crowded > session.n_frames).then(|| session.clone())
}

/// Given poses of cameras that look along -z with y up.
fn opengl(session: &Session) -> Option<Session> {
    let flip = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
    let mut changed = session.clone();
    for view in &mut changed.views {
        let pose = view.camera_from_world.as_mut()?;
        (pose.rotation, pose.translation) = (flip * pose.rotation, flip * pose.translation);
    }
    Some(changed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::recording_tests::suspicions;
    use crate::simulation::{Preset, SimulationConfig, simulate};

    fn session() -> Session {
        let preset = SimulationConfig::preset(Preset::Hard);
        let config = SimulationConfig { frames: 60, convention: KeypointConvention::Body25, ..preset };
        let simulated = simulate(&config).unwrap();
        let mut session = simulated.session;
        let poses = simulated.truth.cameras.into_iter().map(Some);
        session.views.iter_mut().zip(poses).for_each(|(view, pose)| view.camera_from_world = pose);
        session
    }

    #[test]
    fn combinations_name_mistakes_of_different_cameras() {
        let find = |name: &str| MISTAKES.iter().find(|mistake| mistake.name == name).unwrap();
        for [first, second] in COMBINATIONS {
            let (first, second) = (find(first), find(second));
            assert!(first.cameras.is_empty() || second.cameras.is_empty(), "{} {}", first.name, second.name);
            let session = session();
            assert!((first.inject)(&session).and_then(|changed| (second.inject)(&changed)).is_some());
        }
    }

    #[test]
    fn every_mistake_changes_the_session() {
        let session = session();
        for mistake in MISTAKES {
            let changed = (mistake.inject)(&session).unwrap();
            assert!(changed != session || mistake.options != "{}", "{}", mistake.name);
            assert_eq!(changed.views.len(), session.views.len());
        }
    }

    #[test]
    fn mistakes_of_the_files_alone_are_named() {
        let session = session();
        assert_eq!(suspicions(&session), []);
        let names = [
            "K x 1.5",
            "portrait pixels with landscape K",
            "cx and cy exchanged",
            "keypoints of a second camera",
            "one frame repeated",
            "body25 declared as body25b",
            "calibration of half the resolution",
            "coordinates from 0 to 1",
            "confidences x 0.1",
            "every second frame missing",
            "given poses in the axes of OpenGL",
        ];
        for name in names {
            let mistake = MISTAKES.iter().find(|mistake| mistake.name == name).unwrap();
            let found = suspicions(&(mistake.inject)(&session).unwrap());
            let expected: Vec<&str> = mistake.cameras.iter().map(|&v| session.views[v].id.as_str()).collect();
            let is_named = found.iter().any(|suspicion| {
                mistake.codes.contains(&suspicion.code) && (expected.is_empty() || suspicion.cameras == expected)
            });
            assert!(is_named, "{name}: {found:?}");
        }
    }
}
