//! The recording as a whole: several takes, a mirrored world, a wrong frame rate.

use super::cameras::MOST;
use super::solved::Solved;
use crate::pipeline::capture::Capture;
use crate::pipeline::config::{Extrinsics, Options};
use crate::pipeline::stages::camera_init::initial_rigs;
use crate::pipeline::stages::recording_check::frame_rate::{MIN_STEPS, POSSIBLE_RATIOS, USUAL_RATIO, steps};
use crate::pipeline::stages::recording_check::handedness::{handedness, upside_down};
use crate::pipeline::stages::recording_check::takes::groups;
use crate::progress::{Canceled, Progress};
use crate::session::{Session, Suspicion, SuspicionCode as Code};

/// Groups of cameras that see different people.
pub(super) fn separate_takes(solved: &Solved, found: &mut Vec<Suspicion>) {
    let (cameras, tracks) = (&solved.calibration.cameras, &solved.calibration.association.tracks);
    let groups = groups(solved.session(), cameras, tracks);
    tracing::debug!(?groups, "cameras that see the same people");
    if groups.iter().filter(|group| group.len() >= 2).count() >= 2 {
        let listed: Vec<String> = groups.iter().map(|group| solved.ids(group).join(", ")).collect();
        let evidence =
            format!("no person is seen from two of these groups of cameras at one time: {}", listed.join("; "));
        let remedy = "give the files of one take, and check whether some cameras started much later";
        found.push(Suspicion::new(Code::SeveralTakes, Vec::new(), evidence, remedy));
    }
}

/// A rig of the cameras without a pose counts where its pairs agree this much of those of the solved ones: chance agreements have
/// a tenth.
const AGREEING: f64 = 0.4;

/// Cameras without a pose that agree among themselves.
pub(super) fn other_take(solved: &Solved, found: &mut Vec<Suspicion>, progress: &Progress) -> Result<(), Canceled> {
    let session = solved.session();
    let cameras = &solved.calibration.cameras;
    let left: Vec<usize> = (0..cameras.len()).filter(|&v| cameras[v].is_none() && !solved.is_named(v, found)).collect();
    if left.len() < 2 {
        return Ok(());
    }
    let part = Session { views: left.iter().map(|&v| session.views[v].clone()).collect(), ..session.clone() };
    let options = Options { extrinsics: Extrinsics::Estimate, ..solved.given.options.clone() };
    let capture = Capture::new(&part, &options);
    let (rigs, _) = initial_rigs(&capture, &capture.tracklets(), progress)?;
    let agreement = |quality: f64, n_placed: usize| quality / (n_placed * n_placed.saturating_sub(1)).max(1) as f64;
    let of_rig = rigs.first().map_or(0.0, |rig| agreement(rig.quality, rig.cameras.iter().flatten().count()));
    let init = solved.calibration.stages.iter().find(|stage| stage.stage == "camera_init");
    let metric = |name: &str| init.and_then(|stage| stage.metrics.get(name)).copied();
    let usual = metric("best_quality").zip(metric("cameras_placed")).map(|(quality, n)| agreement(quality, n as usize));
    tracing::debug!(?left, of_rig, usual, "agreement of the cameras without a pose");
    if usual.is_some_and(|usual| of_rig > AGREEING * usual) {
        let evidence = format!(
            "cameras {} agree with each other, but see none of the people of the others",
            solved.ids(&left).join(", ")
        );
        let remedy = "give the files of one take, and check whether some cameras started much later";
        found.push(Suspicion::new(Code::SeveralTakes, Vec::new(), evidence, remedy));
    }
    Ok(())
}

/// People who look and bend backwards.
pub(super) fn mirrored_world(solved: &Solved, found: &mut Vec<Suspicion>) {
    let session = solved.session();
    let Some(shown) = handedness(session.convention, solved.paths, session.fps) else { return };
    tracing::debug!(?shown, "handedness of people");
    if !shown.is_mirrored() {
        return;
    }
    let down = session.views.iter().filter_map(|view| upside_down(session.convention, view));
    let (n, n_down) = down.fold((0, 0), |(n, n_down), share| (n + 1, n_down + usize::from(share > MOST)));
    let share = format!("people look or bend backwards in {:.0} % of {} cases", 100.0 * shown.backwards, shown.n);
    found.push(if 2 * n_down > n {
        let evidence = format!("{share}, and they are upside down in the images: y is counted from the lower edge");
        Suspicion::new(Code::YUpwards, Vec::new(), evidence, "give y = height - 1 - y")
    } else {
        let evidence = format!("{share}: left and right are exchanged, or all images are mirrored");
        let remedy = "exchange left and right keypoints, or give x = width - 1 - x";
        Suspicion::new(Code::Handedness, Vec::new(), evidence, remedy)
    });
}

/// Steps that are too quick or too slow for their length.
pub(super) fn wrong_frame_rate(solved: &Solved, found: &mut Vec<Suspicion>) {
    let session = solved.session();
    let Some(shown) = steps(session.convention, solved.paths, session.fps) else { return };
    tracing::debug!(?shown, "steps of people");
    let factor = shown.ratio / USUAL_RATIO;
    let [least, most] = POSSIBLE_RATIOS;
    if shown.n < MIN_STEPS || (least..most).contains(&shown.ratio) {
        return;
    }
    let evidence = format!(
        "{} steps of people are {:.1} times too {} for their length, which suits some {:.0} frames per second",
        shown.n,
        factor.max(1.0 / factor),
        if factor > 1.0 { "slow" } else { "quick" },
        session.fps * factor
    );
    found.push(Suspicion::new(Code::FrameRate, Vec::new(), evidence, "give the frame rate of the videos (fps)"));
}
