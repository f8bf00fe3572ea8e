//! Cameras that change during the recording: one that was moved, one that zoomed, one whose frames slip against the others.
//!
//! What changed moves the points as well, and with them the other cameras a little, whose steps may be the more certain since their
//! own errors are smaller. So the largest of the likely steps are measured again against people as the other cameras alone
//! locate them, and of the certain ones the largest counts.

use super::parameters::{drifting_clocks, of_drift};
use super::solved::Solved;
use crate::pipeline::calibration::TrackedPeople;
use crate::pipeline::config::Sync;
use crate::pipeline::stages::joint_trajectories::joint_trajectories;
use crate::pipeline::stages::recording_check::block_step::Step;
use crate::pipeline::stages::recording_check::clock::slip;
use crate::pipeline::stages::recording_check::movement::{turn, zoom};
use crate::progress::{Canceled, Progress};
use crate::session::{JointTrajectory, Suspicion, SuspicionCode as Code};
use rayon::prelude::*;

/// A step of a camera's rotation counts from this angle, rad: 0.25 degrees move a person at 4 m by 17 mm, a detector's noise. Slow
/// errors of two people turned a still camera by 0.17 degrees at 5 standard errors.
const MIN_TURN: f64 = 0.0044;
/// The same beside one or two people: their slow errors turn with them, and with few to average them still cameras seem to turn by up
/// to 0.3 degrees at 10 standard errors (4 of 30 recordings of one person, 1 of 80 of two). Knocks of 0.5 degrees show as 0.34 and more.
const MIN_TURN_OF_FEW: f64 = 0.0054;
/// People seen at a time, on average, below which they are few.
const FEW: f64 = 2.5;
/// A step of a camera's focal length counts from this difference of logarithms: refocusing changes it by 1 to 2 %, right
/// recordings seem to zoom by up to 2.9 % (below), and zooms of 10 % show as 5 % and more.
const MIN_ZOOM: f64 = 0.04;
/// A step of a camera's clock counts from this size, frames: the smallest that a dropped frame leaves is one.
const MIN_SLIP: f64 = 0.6;
/// The same, s: with the slow errors of the detector, clocks of 2 of 24 right recordings at 100 and 120 Hz seemed to slip by 10 ms at 5
/// standard errors.
const MIN_SLIP_SECS: f64 = 0.0125;
/// Standard errors from which a step is certain, against people as the others locate them.
const CERTAIN: f64 = 5.0;
/// Against all cameras' people a third of a step is left: from here on the largest ones are measured against the others.
const LIKELY: f64 = 3.5;
/// Against all cameras' people a sixth of a zoom is left at least, where the smallest certain one has 3 %.
const LIKELY_ZOOM_SIZE: f64 = 0.005;
const N_LIKELY: usize = 2;
/// Cameras from which the others locate people well enough: with two others, whose slow errors move every point, one still camera
/// of ten seemed to turn by 0.3 degrees at 6 standard errors.
const MIN_CAMERAS: usize = 4;
/// The same for focal lengths: slow errors change the size of people less than their place, in 115 right recordings of 3 to 8 cameras by
/// 2.9 % at most with certainty.
const MIN_CAMERAS_OF_ZOOM: usize = 3;

/// The camera that was moved.
pub(super) fn moved_camera(solved: &Solved, found: &mut Vec<Suspicion>, progress: &Progress) -> Result<(), Canceled> {
    let min_turn = if n_people(&solved.people()) < FEW { MIN_TURN_OF_FEW } else { MIN_TURN };
    let test = StepTest { step: turn, likely_size: 0.0, min_size: min_turn, min_cameras: MIN_CAMERAS };
    let Some((view, frame, step)) = largest_step(solved, steps_of(solved, found, &test), &test, progress)? else {
        return Ok(());
    };
    let evidence = format!(
        "it moved during the recording: it turns by {:.2} degrees near frame {frame} ({:.0} standard errors)",
        step.size.to_degrees(),
        step.sigmas
    );
    let remedy = "solve the frames before and after as two sessions, or leave the camera out";
    found.push(Suspicion::new(Code::CameraMoved, solved.ids(&[view]), evidence, remedy));
    Ok(())
}

/// The camera that zoomed.
pub(super) fn zoomed_camera(solved: &Solved, found: &mut Vec<Suspicion>, progress: &Progress) -> Result<(), Canceled> {
    let test =
        StepTest { step: zoom, likely_size: LIKELY_ZOOM_SIZE, min_size: MIN_ZOOM, min_cameras: MIN_CAMERAS_OF_ZOOM };
    let Some((view, frame, step)) = largest_step(solved, steps_of(solved, found, &test), &test, progress)? else {
        return Ok(());
    };
    let evidence = format!(
        "it zoomed during the recording: its focal length changes by {:.0} % near frame {frame} ({:.0} standard errors)",
        100.0 * step.size.exp_m1(),
        step.sigmas
    );
    let remedy = "solve the frames before and after as two sessions, each with its own K, or leave the camera out";
    found.push(Suspicion::new(Code::CameraZoomed, solved.ids(&[view]), evidence, remedy));
    Ok(())
}

/// Cameras whose clocks drift, or the one whose frames slip against the others.
pub(super) fn other_clocks(solved: &Solved, found: &mut Vec<Suspicion>, progress: &Progress) -> Result<(), Canceled> {
    let test = slips_at(solved.session().fps);
    let slips = steps_of(solved, found, &test);
    let drifting = clocks_that_drift(solved, &test, &slips, progress)?;
    found.extend(match drifting.is_empty() {
        true => slipping_clock(solved, &test, slips, progress)?.into_iter().collect(),
        false => drifting,
    });
    Ok(())
}

/// Cameras whose clocks drift against the others, where the one that drifts most slips gradually: dropped frames are steps.
fn clocks_that_drift(
    solved: &Solved,
    test: &StepTest,
    slips: &[(usize, Step)],
    progress: &Progress,
) -> Result<Vec<Suspicion>, Canceled> {
    let is_likely = slips.iter().any(|(_, slip)| slip.slope_sigmas >= LIKELY);
    if solved.given.options.sync != Sync::Given || !is_likely {
        return Ok(Vec::new());
    }
    let drifting = drifting_clocks(solved, progress)?;
    let most = drifting.iter().max_by(|a, b| a.frames.abs().total_cmp(&b.frames.abs()));
    let course = most.map(|most| step_against_others(solved, test, most.view, progress)).transpose()?.flatten();
    let is_gradual = course.is_some_and(|course| course.is_gradual);
    Ok(drifting.iter().filter(|_| is_gradual).map(|drift| of_drift(solved, drift)).collect())
}

fn slipping_clock(
    solved: &Solved,
    test: &StepTest,
    slips: Vec<(usize, Step)>,
    progress: &Progress,
) -> Result<Option<Suspicion>, Canceled> {
    let Some((view, frame, step)) = largest_step(solved, slips, test, progress)? else { return Ok(None) };
    let evidence = format!(
        "its frames slip against those of the others, by {:.1} frames near frame {frame} ({:.0} standard errors): frames were \
         dropped or doubled, or its frame rate differs",
        step.size, step.sigmas
    );
    let remedy = "give every frame the number of its time, or solve the parts before and after as two sessions; where the frame \
                  rate differs, let the time offsets be estimated";
    Ok(Some(Suspicion::new(Code::DroppedFrames, solved.ids(&[view]), evidence, remedy)))
}

/// People at a time, averaged over the frames with any.
fn n_people(people: &TrackedPeople) -> f64 {
    let mut n_at = vec![0.0f64; people.session.n_frames];
    for track in people.tracks {
        n_at[track.first.0..][..track.detections.len()].iter_mut().for_each(|n| *n += 1.0);
    }
    let n_frames = n_at.iter().filter(|n| **n > 0.0).count();
    n_at.iter().sum::<f64>() / n_frames.max(1) as f64
}

/// What may change during a recording.
struct StepTest {
    /// The most certain step of a view.
    step: fn(&TrackedPeople, usize) -> Option<Step>,
    /// Size from which a likely one is measured again.
    likely_size: f64,
    /// Size from which it counts.
    min_size: f64,
    /// Cameras from which it is tested.
    min_cameras: usize,
}

/// Slips of clocks.
fn slips_at(fps: f64) -> StepTest {
    StepTest { step: slip, likely_size: 0.0, min_size: MIN_SLIP.max(MIN_SLIP_SECS * fps), min_cameras: MIN_CAMERAS }
}

/// Steps of the cameras that no suspicion names so far; none with too few cameras, and beside a mistake that spoils cameras.
fn steps_of(solved: &Solved, found: &[Suspicion], test: &StepTest) -> Vec<(usize, Step)> {
    let spoils_cameras = |suspicion: &Suspicion| suspicion.code.affects_cameras();
    if solved.calibration.n_placed() < test.min_cameras || found.iter().chain(solved.known).any(spoils_cameras) {
        return Vec::new();
    }
    let people = solved.people();
    let steps = solved.unnamed(found).into_par_iter().filter_map(|view| Some((view, (test.step)(&people, view)?)));
    let steps = steps.collect();
    tracing::debug!(?steps, "steps of cameras");
    steps
}

/// The camera with the largest of the certain steps, and the number of the frame.
fn largest_step(
    solved: &Solved,
    mut steps: Vec<(usize, Step)>,
    test: &StepTest,
    progress: &Progress,
) -> Result<Option<(usize, i64, Step)>, Canceled> {
    steps.retain(|(_, step)| step.sigmas >= LIKELY && step.size >= test.likely_size);
    steps.sort_by(|a, b| b.1.size.total_cmp(&a.1.size));
    steps.truncate(N_LIKELY);
    let measured_again = |&(view, _): &(usize, Step)| Ok((view, step_against_others(solved, test, view, progress)?));
    let measured: Vec<(usize, Option<Step>)> = steps.par_iter().map(measured_again).collect::<Result<_, Canceled>>()?;
    tracing::debug!(?measured, "steps of cameras against the people of the others");
    let measured = measured.into_iter().filter_map(|(view, step)| Some((view, step?)));
    let certain = measured.filter(|(_, step)| step.sigmas >= CERTAIN && step.size >= test.min_size);
    let largest = certain.max_by(|a, b| a.1.size.total_cmp(&b.1.size));
    Ok(largest.map(|(view, step)| (view, solved.session().first_frame + step.frame as i64, step)))
}

/// The step of a camera against people as the other cameras alone have located them: its own detections would hide most of it.
fn step_against_others(
    solved: &Solved,
    test: &StepTest,
    view: usize,
    progress: &Progress,
) -> Result<Option<Step>, Canceled> {
    let people = solved.people();
    let mut others = people.cameras.to_vec();
    others[view] = None;
    let mut points = joint_trajectories(&TrackedPeople { cameras: &others, ..people }, progress)?;
    for JointTrajectory { points, n_views, .. } in &mut points {
        let located = points.iter_mut().flatten().zip(n_views.iter().flatten());
        located.filter(|(_, n)| **n < 2).for_each(|(point, _)| *point = None);
    }
    Ok((test.step)(&TrackedPeople { points: &points, ..people }, view))
}
