//! Repairs: the recording and the options with a probable mistake undone (`options.repair: auto`; double detections always).
//!
//! Only what has one remedy is repaired. A mirrored world has two, exchanged labels and mirrored images, and a wrong frame rate is
//! known to some ten per cent only: those are left to the user.

use super::config::{Extrinsics, Options};
use crate::geometry::{Distortion, Intrinsics, Rigid};
use crate::session::recording_tests::{
    best_confidence, centred, likelier_convention, suspicions, suspicions_beside_poses, turned_with_images,
    without_doubles,
};
use crate::session::{Session, Suspicion, SuspicionCode as Code, View};
use nalgebra::Vector2;
use serde_json::Value;
use std::borrow::Cow;

/// Most repairs one after another, each of one kind of mistake: a recording with more needs a look.
pub const MAX_REPAIRS: usize = 2;

/// The confidence that 95 % of the keypoints of common detectors do not exceed.
const USUAL_BEST: f64 = 0.95;

/// Probable mistakes that the files show before a solve with these options.
pub fn known_mistakes(session: &Session, options: &Options) -> Vec<Suspicion> {
    match options.extrinsics {
        Extrinsics::Estimate => suspicions_beside_poses(session),
        Extrinsics::Fixed | Extrinsics::Refine => suspicions(session),
    }
}

/// Recording and options without the mistake; `None` where it has no single remedy.
pub fn repaired(session: &Session, options: &Options, suspicion: &Suspicion) -> Option<(Session, Options)> {
    let read_anew = |change: fn(&Intrinsics, Vector2<f64>) -> Vector2<f64>| {
        Some((with_pixels(session, suspicion, change), options.clone()))
    };
    let with_cameras =
        |camera: &dyn Fn(&View) -> Option<Camera>| Some((with_cameras(session, suspicion, camera)?, options.clone()));
    let with_lenses = |lens: &dyn Fn(&Intrinsics) -> Option<Intrinsics>| {
        with_cameras(&|view| Some((lens(&view.intrinsics)?, view.camera_from_world)))
    };
    match suspicion.code {
        Code::Mirrored => read_anew(|lens, p| lens.mirrored(&p)),
        Code::YUpwards => read_anew(|lens, p| Vector2::new(p.x, f64::from(lens.height) - 1.0 - p.y)),
        Code::NormalizedCoordinates => {
            read_anew(|lens, p| Vector2::new(p.x * f64::from(lens.width), p.y * f64::from(lens.height)))
        }
        Code::LabelsExchanged => Some((with_labels_exchanged(session, suspicion), options.clone())),
        Code::CamerasExchanged => Some((with_keypoints_exchanged(session, suspicion)?, options.clone())),
        Code::PrincipalPoint | Code::Resolution => with_lenses(&|lens| match suspicion.image_scale {
            Some(scale) => Some(lens.resized(scale)),
            // Where one change of K explains why principal points are far from the centres of the images.
            None => centred(lens),
        }),
        Code::Rotated => with_cameras(&|view| turned_with_images(session.convention, view)),
        Code::LensDistortion => with_lenses(&|lens| match suspicion.radial_change {
            Some(change) => Some(lens.with_radial(change)),
            None => Some(Intrinsics { dist: Distortion::None, ..*lens }),
        }),
        Code::Convention => {
            let convention = likelier_convention(session)?;
            Some((Session { convention, ..session.clone() }, options.clone()))
        }
        Code::DoubleDetections => Some((without_doubles(session), options.clone())),
        Code::LowConfidence => Some((with_usual_confidences(session)?, options.clone())),
        Code::TimeOffset | Code::FocalLength | Code::GivenPoses => {
            Some((session.clone(), with_option(options, suspicion.suggested_option.as_deref()?)?))
        }
        _ => None,
    }
}

/// Recording and options without the mistakes `repairs`, one after the other.
pub fn with_repairs<'s>(session: &'s Session, options: &Options, repairs: &[Suspicion]) -> (Cow<'s, Session>, Options) {
    let (mut session, mut options) = (Cow::Borrowed(session), options.clone());
    for suspicion in repairs {
        if let Some((next, changed)) = repaired(&session, &options, suspicion) {
            (session, options) = (Cow::Owned(next), changed);
        }
    }
    (session, options)
}

/// The views that a suspicion names; all where it names none.
fn concerned<'a>(session: &'a mut Session, suspicion: &'a Suspicion) -> impl Iterator<Item = &'a mut View> {
    let is_concerned = |view: &&mut View| suspicion.cameras.is_empty() || suspicion.cameras.contains(&view.id);
    session.views.iter_mut().filter(is_concerned)
}

fn with_pixels(
    session: &Session,
    suspicion: &Suspicion,
    change: fn(&Intrinsics, Vector2<f64>) -> Vector2<f64>,
) -> Session {
    let mut repaired = session.clone();
    for View { intrinsics, frames, .. } in concerned(&mut repaired, suspicion) {
        let keypoints = frames.iter_mut().flatten().flat_map(|detection| &mut detection.keypoints);
        keypoints.filter(|k| k.is_present()).for_each(|k| *k = k.mapped(|pixel| change(intrinsics, pixel)));
    }
    repaired
}

fn with_labels_exchanged(session: &Session, suspicion: &Suspicion) -> Session {
    let twins = session.mirror();
    let mut repaired = session.clone();
    for detection in concerned(&mut repaired, suspicion).flat_map(|view| view.frames.iter_mut().flatten()) {
        *detection = detection.with_sides_exchanged(&twins);
    }
    repaired
}

/// Two cameras with the keypoints of each other.
fn with_keypoints_exchanged(session: &Session, suspicion: &Suspicion) -> Option<Session> {
    let position = |id: &String| session.views.iter().position(|view| view.id == *id);
    let [a, b] = suspicion.cameras.as_slice() else { return None };
    Some(session.with_keypoints_exchanged(position(a)?, position(b)?))
}

/// Lens and given pose (`camera_from_world`) of a camera.
type Camera = (Intrinsics, Option<Rigid>);

fn with_cameras(session: &Session, suspicion: &Suspicion, camera: &dyn Fn(&View) -> Option<Camera>) -> Option<Session> {
    let mut repaired = session.clone();
    for view in concerned(&mut repaired, suspicion) {
        (view.intrinsics, view.camera_from_world) = camera(view)?;
    }
    Some(repaired)
}

/// Confidences whose best are as usual.
fn with_usual_confidences(session: &Session) -> Option<Session> {
    let factor = USUAL_BEST / best_confidence(session).filter(|best| *best > 0.0)?;
    let mut repaired = session.clone();
    let detections = repaired.views.iter_mut().flat_map(|view| view.frames.iter_mut().flatten());
    detections
        .flat_map(|detection| &mut detection.keypoints)
        .for_each(|k| k.confidence = (factor * k.confidence).min(1.0));
    Some(repaired)
}

/// The options with those of a JSON object; `None` where they do not change.
pub fn with_option(options: &Options, changes: &str) -> Option<Options> {
    let mut merged = serde_json::to_value(options).ok()?;
    let Value::Object(changes) = serde_json::from_str(changes).ok()? else { return None };
    changes.into_iter().for_each(|(name, value)| merged[name] = value);
    let changed: Options = serde_json::from_value(merged).ok()?;
    let changed = Options { adjust_with_bodies: options.adjust_with_bodies, ..changed };
    (changed != *options).then_some(changed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::skeleton::KeypointConvention;
    use crate::pipeline::config::Sync;
    use crate::simulation::mistakes::MISTAKES;
    use crate::simulation::{Preset, SimulationConfig, simulate};

    fn suspicion(code: Code, cameras: &[&str]) -> Suspicion {
        let cameras = cameras.iter().map(|id| (*id).to_owned()).collect();
        let suggested_option = (code == Code::TimeOffset).then(|| r#"{"sync": "estimate"}"#.to_owned());
        Suspicion { suggested_option, ..Suspicion::new(code, cameras, "", "") }
    }

    #[test]
    fn a_repair_undoes_its_mistake() {
        let config = SimulationConfig { frames: 20, ..SimulationConfig::preset(Preset::Paper) };
        let right = simulate(&config).unwrap().session;
        let id = right.views[1].id.as_str();
        let cases = [
            ("images mirrored in one camera", Code::Mirrored, vec![id]),
            ("y counted upwards in one camera", Code::YUpwards, vec![id]),
            ("y counted upwards", Code::YUpwards, vec![]),
            ("left and right exchanged in one camera", Code::LabelsExchanged, vec![id]),
            ("coordinates from 0 to 1", Code::NormalizedCoordinates, vec![]),
            ("keypoints of two cameras exchanged", Code::CamerasExchanged, vec![id, right.views[2].id.as_str()]),
        ];
        for (name, code, cameras) in cases {
            let mistake = MISTAKES.iter().find(|mistake| mistake.name == name).unwrap();
            let wrong = (mistake.inject)(&right).unwrap();
            let (found, _) = repaired(&wrong, &Options::default(), &suspicion(code, &cameras)).unwrap();
            let pixels = |session: &Session| -> Vec<Vector2<f64>> {
                let views = session.views.iter().flat_map(|view| view.frames.iter().flatten());
                views.flat_map(|d| &d.keypoints).filter(|k| k.is_present()).map(|k| k.pixel).collect()
            };
            let off = pixels(&found).iter().zip(pixels(&right)).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
            assert!(off < 1e-9, "{name}: {off} px");
        }
    }

    #[test]
    fn a_repair_undoes_what_the_files_state() {
        let preset = SimulationConfig::preset(Preset::Paper);
        let config = SimulationConfig { frames: 60, convention: KeypointConvention::Body25, ..preset };
        let right = simulate(&config).unwrap().session;
        for name in ["cx and cy exchanged", "K x 1.5", "body25 declared as body25b", "confidences x 0.1"] {
            let mistake = MISTAKES.iter().find(|mistake| mistake.name == name).unwrap();
            let wrong = (mistake.inject)(&right).unwrap();
            let named = suspicions(&wrong).into_iter().find(|s| mistake.codes.contains(&s.code)).unwrap();
            let (found, _) = repaired(&wrong, &Options::default(), &named).unwrap();
            assert_eq!(suspicions(&found).iter().filter(|s| s.code == named.code).count(), 0, "{name}");
            assert_eq!(found.convention, right.convention, "{name}");
            let lens = |session: &Session| session.views[1].intrinsics;
            let ratio = lens(&found).focal() / lens(&right).focal();
            let centre = (lens(&found).cx - lens(&right).cx).hypot(lens(&found).cy - lens(&right).cy);
            assert!((ratio - 1.0).abs() < 1e-9 && centre < 1e-6, "{name}: {ratio} {centre}");
        }
    }

    /// Wrong poses in the files voided the standard deviations of all cameras of a solve that does not read them.
    #[test]
    fn poses_that_a_solve_does_not_read_were_held_against_it() {
        let config = SimulationConfig { frames: 60, ..SimulationConfig::preset(Preset::Paper) };
        let simulated = simulate(&config).unwrap();
        let (mut right, poses) = (simulated.session, simulated.truth.cameras);
        right.views.iter_mut().zip(poses).for_each(|(view, pose)| view.camera_from_world = Some(pose));
        let mistake = MISTAKES.iter().find(|mistake| mistake.codes == [Code::GivenPoses]).unwrap();
        let wrong = (mistake.inject)(&right).unwrap();
        let known = |session: &Session, extrinsics: Extrinsics| {
            known_mistakes(session, &Options { extrinsics, ..Options::default() })
        };
        let refined = known(&wrong, Extrinsics::Refine);
        assert_eq!(refined.iter().map(|s| s.code).collect::<Vec<_>>(), [Code::GivenPoses]);
        assert_eq!(known(&wrong, Extrinsics::Estimate), []);
        // Keypoints of images that were turned by 180 degrees: that spoils an estimate as well.
        let mut turned = right;
        for View { intrinsics: lens, frames, .. } in &mut turned.views {
            let last = Vector2::new(f64::from(lens.width) - 1.0, f64::from(lens.height) - 1.0);
            frames.iter_mut().flatten().flat_map(|d| &mut d.keypoints).for_each(|k| *k = k.mapped(|p| last - p));
        }
        let found = known(&turned, Extrinsics::Estimate).into_iter().find(|s| s.code == Code::GivenPoses).unwrap();
        assert!(found.suggested_option.is_none() && found.evidence.contains("180 degrees"), "{found}");
    }

    #[test]
    fn a_repair_by_an_option_is_made_once() {
        let session =
            simulate(&SimulationConfig { frames: 5, ..SimulationConfig::preset(Preset::Easy) }).unwrap().session;
        let late = suspicion(Code::TimeOffset, &["cam01"]);
        let (_, options) = repaired(&session, &Options::default(), &late).unwrap();
        assert_eq!(options.sync, Sync::Estimate);
        assert!(repaired(&session, &options, &late).is_none(), "nothing is left to change");
        assert!(repaired(&session, &options, &suspicion(Code::Handedness, &[])).is_none(), "two remedies");
    }
}
