//! Single cameras: files that need another reading, exchanged labels.

use super::solved::Solved;
use super::start_times;
use crate::matching::tracklets::Tracklet;
use crate::optim::robust::median;
use crate::pipeline::config::Sync;
use crate::pipeline::stages::recording_check::agreement::explained_share;
use crate::pipeline::stages::recording_check::handedness::upside_down;
use crate::pipeline::stages::recording_check::labels::exchange;
use crate::pipeline::stages::recording_check::reading::{Judged, Question, Reading};
use crate::progress::{Canceled, Progress};
use crate::session::{JointTrajectory, PersonTrack, Suspicion, SuspicionCode as Code};
use rayon::prelude::*;

/// A camera is read in other ways where its people explain this much less of its detections than is usual.
const LOW_SHARE: f64 = 0.75;
/// Or where they leave this share unexplained, and this many times as much as is usual: seen from afar, mirrored people look much like
/// people from behind the image, and a mirrored camera found a place that explained 88 % where the others had 99.8 %.
const MIN_UNEXPLAINED: f64 = 0.05;
const UNUSUAL: f64 = 4.0;
/// Another reading is right where it explains this share of what is usual, and this much more than the files as they are.
const RIGHT_SHARE: f64 = 0.7;
const MIN_GAIN: f64 = 0.15;
/// Or, but for factors on focal lengths, where it leaves at most this share of what they leave unexplained: the second best reading of a
/// right camera leaves more than the first.
const MAX_LEFT: f64 = 0.33;
/// The same of a factor on the focal length, which fits some of anything: 86 % of a camera that was moved.
const RIGHT_SHARE_OF_FACTOR: f64 = 0.9;

/// A factor on the focal length comes before other readings where it explains this much more.
const MIN_LEAD: f64 = 0.02;

/// Most of the people in an image are upside down.
pub(super) const MOST: f64 = 0.5;

/// Detections that decide on exchanged labels, and the share of them that fit the other way round.
const MIN_DECIDING: usize = 30;
const EXCHANGED: f64 = 0.8;

/// Cameras of whose detections the people of the others explain little.
pub(super) fn other_readings(solved: &Solved, found: &mut Vec<Suspicion>, progress: &Progress) -> Result<(), Canceled> {
    let (views, cameras) = (&solved.given.views, &solved.calibration.cameras);
    let share =
        |v: usize| cameras[v].as_ref().map_or(0.0, |camera| explained_share(&views[v], camera, solved.paths, 0));
    let shares: Vec<f64> = (0..views.len()).map(share).collect();
    let placed = (0..views.len()).filter(|&v| cameras[v].is_some());
    let Some(usual) = median(&mut placed.map(|v| shares[v]).collect::<Vec<_>>()) else { return Ok(()) };
    tracing::debug!(?shares, usual, "shares of explained keypoints");
    let is_low = |share: f64| share < LOW_SHARE * usual || 1.0 - share > MIN_UNEXPLAINED.max(UNUSUAL * (1.0 - usual));
    let is_doubtful = |v: &usize| is_low(shares[*v]) && !solved.is_named(*v, found);
    let doubtful: Vec<usize> = (0..views.len()).filter(is_doubtful).collect();
    if doubtful.is_empty() {
        return Ok(());
    }
    let tracklets = solved.given.tracklets();
    for view in doubtful {
        progress.check()?;
        let [given, other, factor] = judged(solved, view, &tracklets[view], solved.paths);
        tracing::debug!(view, ?given, ?other, ?factor, usual, "readings of a camera's files");
        // A factor fits some of anything: it has to explain clearly more than what has no free parameter.
        let order = if factor.explained > other.explained + MIN_LEAD { [factor, other] } else { [other, factor] };
        if let Some(right) = order.into_iter().find(|reading| is_right(*reading, given, usual)) {
            found.extend(of_reading(solved, view, given, right));
        }
    }
    Ok(())
}

/// Readings of all cameras beside the largest of `groups` under which they see its people; empty where one of these cameras has none.
pub(super) fn readings_of_groups(
    solved: &Solved,
    groups: &[Vec<usize>],
    progress: &Progress,
) -> Result<Vec<Suspicion>, Canceled> {
    let [largest, others @ ..] = groups else { return Ok(Vec::new()) };
    let is_seen = |track: &PersonTrack| {
        let n_in =
            |views: &[usize]| views.iter().map(|&v| track.detections.iter().filter(|d| d[v].is_some()).count()).sum();
        let (in_largest, in_others): (usize, usize) = (n_in(largest), others.iter().map(|group| n_in(group)).sum());
        in_largest > in_others
    };
    let tracks = solved.calibration.association.tracks.iter().zip(solved.paths);
    let people: Vec<JointTrajectory> =
        tracks.filter(|(track, _)| is_seen(track)).map(|(_, path)| path.clone()).collect();
    let (views, cameras) = (&solved.given.views, &solved.calibration.cameras);
    let share = |&v: &usize| Some(explained_share(&views[v], cameras[v].as_ref()?, &people, 0));
    let Some(usual) = median(&mut largest.iter().filter_map(share).collect::<Vec<_>>()) else { return Ok(Vec::new()) };
    let tracklets = solved.given.tracklets();
    let mut found = Vec::new();
    for &view in others.iter().flatten() {
        progress.check()?;
        let [given, other, _] = judged(solved, view, &tracklets[view], &people);
        tracing::debug!(view, ?given, ?other, usual, "readings of a camera that sees other people");
        let suspicion = is_right(other, given, usual).then(|| of_reading(solved, view, given, other)).flatten();
        let Some(suspicion) = suspicion else { return Ok(Vec::new()) };
        found.push(suspicion);
    }
    Ok(found)
}

/// How well each kind of reading of a camera's files lets it see people.
fn judged(solved: &Solved, view: usize, tracklets: &[Tracklet], people: &[JointTrajectory]) -> [Judged; 3] {
    let (session, camera) = (solved.session(), solved.calibration.cameras[view].as_ref());
    Question { session, view, tracklets, people, camera, seed: solved.given.options.seed }.judged()
}

/// Whether the files of a camera are to be read otherwise than given.
fn is_right(best: Judged, given: Judged, usual: f64) -> bool {
    let gains = best.explained > given.explained + MIN_GAIN;
    match best.reading {
        Reading::FocalFactor(_) => best.explained > RIGHT_SHARE_OF_FACTOR * usual && gains,
        _ => {
            let leaves_little = 1.0 - best.explained < MAX_LEFT * (1.0 - given.explained);
            best.explained > RIGHT_SHARE * usual && (gains || leaves_little)
        }
    }
}

fn of_reading(solved: &Solved, view: usize, given: Judged, best: Judged) -> Option<Suspicion> {
    let session = solved.session();
    let is_down = |v: usize| upside_down(session.convention, &session.views[v]).is_some_and(|share| share > MOST);
    let others_are_down = (0..session.views.len()).any(|v| v != view && is_down(v));
    let mut option = None;
    let (code, reading, remedy) = match best.reading {
        // Turned by 180 degrees, the one is the other: most cameras stand upright.
        Reading::Mirrored if is_down(view) && !others_are_down => {
            (Code::YUpwards, "y counted from the lower edge".to_owned(), "give y = height - 1 - y")
        }
        Reading::Mirrored => {
            let remedy = "give x = width - 1 - x, or detect people in the images as recorded";
            (Code::Mirrored, "mirrored images".to_owned(), remedy)
        }
        Reading::LabelsExchanged => {
            (Code::LabelsExchanged, "left and right exchanged".to_owned(), "exchange them back")
        }
        Reading::Late(frames) => {
            let is_estimated = solved.given.options.sync == Sync::Estimate;
            option = start_times::suggested_option().filter(|_| !is_estimated);
            let remedy = match is_estimated {
                true => "give its time_offset in the session, or files that begin at the time of the others'",
                false => start_times::REMEDY,
            };
            let reading = format!("frame numbers that are {}", start_times::change(frames));
            (Code::TimeOffset, reading, remedy)
        }
        Reading::FocalFactor(factor) => {
            option = Some(r#"{"intrinsics": "refine_focal"}"#.to_owned());
            let remedy = "check the matrix K, or let focal lengths be refined";
            (Code::FocalLength, format!("{factor} times its focal length"), remedy)
        }
        Reading::AsGiven => return None,
    };
    let evidence = format!(
        "the people of the other cameras explain {:.0} % of its keypoints, but {:.0} % with {reading}",
        100.0 * given.explained,
        100.0 * best.explained
    );
    Some(Suspicion { suggested_option: option, ..Suspicion::new(code, solved.ids(&[view]), evidence, remedy) })
}

/// Cameras in which left and right fit the other cameras better exchanged.
pub(super) fn exchanged_labels(solved: &Solved, found: &mut Vec<Suspicion>) {
    let convention = solved.session().convention;
    let tracks = &solved.calibration.association.tracks;
    let counted = |view: usize| {
        let camera = solved.calibration.cameras[view].as_ref()?;
        Some((view, exchange(convention, view, &solved.given.views[view], camera, tracks, solved.paths)))
    };
    let counted: Vec<_> = solved.unnamed(found).into_par_iter().filter_map(counted).collect();
    for (view, counted) in counted {
        tracing::debug!(view, ?counted, "left and right");
        if counted.n >= MIN_DECIDING && counted.exchanged > EXCHANGED {
            let evidence = format!(
                "left and right fit the other cameras better exchanged in {:.0} % of its detections",
                100.0 * counted.exchanged
            );
            found.push(Suspicion::new(Code::LabelsExchanged, solved.ids(&[view]), evidence, "exchange them back"));
        }
    }
}
