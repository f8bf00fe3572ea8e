//! The recording as a whole: several takes, a mirrored world, a wrong frame rate.

use super::cameras::{self, MOST};
use super::solved::Solved;
use super::start_times::late_cameras;
use crate::pipeline::capture::Capture;
use crate::pipeline::config::{Extrinsics, Options};
use crate::pipeline::stages::camera_init::initial_rigs;
use crate::pipeline::stages::recording_check::frame_rate::{
    MIN_STEPS_ALONE, POSSIBLE_RATIOS, Steps, USUAL_RATIO, steps,
};
use crate::pipeline::stages::recording_check::handedness::{handedness, upside_down};
use crate::pipeline::stages::recording_check::motion_rate::{MotionRate, motion_rate};
use crate::pipeline::up_direction::up_direction;
use crate::progress::{Canceled, Progress};
use crate::session::{Session, Suspicion, SuspicionCode as Code};

/// Groups of cameras that see different people: mirrored or late ones agree with each other, as those of another take.
pub(super) fn separate_takes(
    solved: &Solved,
    groups: &[Vec<usize>],
    found: &mut Vec<Suspicion>,
    progress: &Progress,
) -> Result<(), Canceled> {
    if groups.iter().filter(|group| group.len() >= 2).count() >= 2 {
        let read_otherwise = cameras::readings_of_groups(solved, groups, progress)?;
        if !read_otherwise.is_empty() {
            found.extend(read_otherwise);
            return Ok(());
        }
        if let Some(late) = late_cameras(solved.given, groups, progress)? {
            found.push(late);
            return Ok(());
        }
        let listed: Vec<String> = groups.iter().map(|group| solved.ids(group).join(", ")).collect();
        let evidence = format!(
            "no person is seen, or moves alike, in two of these groups of cameras at one time: {}",
            listed.join("; ")
        );
        let remedy = "give the files of one take, and check whether some cameras started much later";
        found.push(Suspicion::new(Code::SeveralTakes, Vec::new(), evidence, remedy));
    }
    Ok(())
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

/// People beyond the given number, seen as well as those of the result.
pub(super) fn too_few_people(solved: &Solved, found: &mut Vec<Suspicion>) {
    let n_left_out = solved.calibration.association.n_left_out;
    let Some(n) = solved.given.options.people.filter(|_| n_left_out > 0) else { return };
    let evidence = format!(
        "{} people are followed by two cameras and more for about as long as those kept, but {n} {} to be found",
        n + n_left_out,
        if n == 1 { "is" } else { "are" }
    );
    let remedy = "give the number of all people that the cameras see, or leave it open";
    let suggested_option = Some(r#"{"people": null}"#.to_owned());
    found.push(Suspicion { suggested_option, ..Suspicion::new(Code::PeopleLimit, Vec::new(), evidence, remedy) });
}

/// Movements and steps that are too quick or too slow for people.
pub(super) fn wrong_frame_rate(solved: &Solved, found: &mut Vec<Suspicion>) {
    let session = solved.session();
    let up = up_direction(session.convention, &solved.calibration.cameras, solved.paths).direction;
    let shown = steps(session.convention, solved.paths, &up, session.fps);
    // Runners are faster than the people of the statistics.
    let runs = shown.is_some_and(|shown| shown.is_running);
    let moved = if runs { None } else { motion_rate(session.convention, solved.paths, &up, session.fps, shown) };
    tracing::debug!(?shown, ?moved, "steps and movements of people");
    let evidence = match moved {
        Some(moved) => moved.is_wrong().then(|| of_movements(session.fps, moved)),
        None => of_steps(session.fps, shown),
    };
    let remedy = "give the frame rate of the videos (fps)";
    found.extend(evidence.map(|evidence| Suspicion::new(Code::FrameRate, Vec::new(), evidence, remedy)));
}

fn of_steps(fps: f64, shown: Option<Steps>) -> Option<String> {
    let [least, most] = POSSIBLE_RATIOS;
    let shown = shown.filter(|shown| shown.n >= MIN_STEPS_ALONE && !(least..most).contains(&shown.ratio))?;
    let factor = shown.ratio / USUAL_RATIO;
    Some(format!(
        "{} steps of people are {:.1} times too {} for their length, which suits some {:.0} frames per second",
        shown.n,
        factor.max(1.0 / factor),
        if factor > 1.0 { "slow" } else { "quick" },
        fps * factor
    ))
}

fn of_movements(fps: f64, moved: MotionRate) -> String {
    format!(
        "people move too {} for people: their speeds and accelerations suit {:.0} to {:.0} frames per second",
        if moved.factor > 1.0 { "slowly" } else { "fast" },
        fps * moved.range[0],
        fps * moved.range[1]
    )
}
