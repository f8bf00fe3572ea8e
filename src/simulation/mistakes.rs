//! Mistakes that users make with the files of a recording, injected into sessions with truth.
//!
//! Each leaves the truth of the recording as it is and changes what its files state. Cameras are chosen by position: most
//! mistakes affect the second one.

mod changes;

use crate::body::skeleton::KeypointConvention;
use crate::geometry::Intrinsics;
use crate::session::recording::{Keypoint, Session};
use crate::session::suspicion::SuspicionCode as Code;
use changes::{
    ODD, PARTNER, crowded, doubled, dropped, everywhere, exchanged, frozen, halved, knocked, labels_exchanged, last,
    late, lens_changed, mapped, moved, opengl, portrait, poses_exchanged, slowed, two_takes, upwards, zoomed,
};
use nalgebra::Vector2;

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
    odd("images stretched by 10 %", &[Code::PixelAspect], |s| {
        lens_changed(s, &[ODD], |lens, _| Intrinsics { fy: 1.1 * lens.fy, ..*lens })
    }),
    all("distortion of the lenses left out", &[Code::LensDistortion], |s| {
        Some(moved(s, &everywhere(s), |lens, p| {
            lens.with_radial(ACTION_CAMERA).pixel_from_normalized(&lens.normalized_from_pixel(&p))
        }))
    }),
    odd("distortion of a lens left for undistorted images", &[Code::LensDistortion], |s| {
        lens_changed(s, &[ODD], |lens, _| lens.with_radial(ACTION_CAMERA))
    }),
    two("keypoints of a second camera", &[Code::DuplicateCamera], |s| {
        let mut copied = s.clone();
        copied.views.get_mut(PARTNER)?.frames.clone_from(&s.views[ODD].frames);
        Some(copied)
    }),
    odd("one frame repeated", &[Code::RepeatedFrames], frozen),
    all("people detected twice", &[Code::DoubleDetections], |s| Some(doubled(s))),
    odd("7 frames late", &[Code::TimeOffset], |s| late(s, ODD, 7)),
    odd("2 frames late", &[Code::TimeOffset], |s| late(s, ODD, 2)),
    odd("2 s late", &[Code::TimeOffset], |s| late(s, ODD, (2.0 * s.fps).round() as usize)),
    odd("clock 2 % slow", &[Code::TimeOffset], |s| slowed(s, ODD, 0.02)),
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
    two("images mirrored in two cameras", &[Code::Mirrored], |s| {
        // Of four cameras each half may be the mirrored one.
        let mirrored = || moved(s, &[ODD, PARTNER], |lens, p| Vector2::new(last(lens.width) - p.x, p.y));
        (s.views.len() >= 5).then(mirrored)
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
    odd("camera zoomed by 10 %", &[Code::CameraZoomed], |s| zoomed(s, ODD)),
    Mistake { options: r#"{"people": 1}"#, ..all("one of several people wanted", &[Code::PeopleLimit], crowded) },
    Mistake {
        options: r#"{"extrinsics": "refine"}"#,
        ..all("given poses in the axes of OpenGL", &[Code::GivenPoses], opengl)
    },
    Mistake {
        options: r#"{"extrinsics": "fixed"}"#,
        ..two("given poses of two cameras exchanged", &[Code::GivenPoses], poses_exchanged)
    },
];

/// First radial coefficient of action cameras.
const ACTION_CAMERA: f64 = -0.3;

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::recording_tests::suspicions;
    use crate::simulation::{Preset, SimulationConfig, simulate};

    fn session() -> Session {
        let preset = SimulationConfig::preset(Preset::Hard);
        let config = SimulationConfig { frames: 120, convention: KeypointConvention::Body25, ..preset };
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
            "people detected twice",
            "body25 declared as body25b",
            "calibration of half the resolution",
            "coordinates from 0 to 1",
            "confidences x 0.1",
            "every second frame missing",
            "given poses in the axes of OpenGL",
            "given poses of two cameras exchanged",
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
