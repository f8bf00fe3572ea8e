//! Mistakes in a recording whose cameras cannot be placed, or that has but two: readings of its files under which they agree.

use super::cameras::MOST;
use super::solved::Solved;
use super::start_times::time_offset;
use crate::pipeline::capture::Capture;
use crate::pipeline::config::{IntrinsicsMode, Options, Sync};
use crate::pipeline::passes::cameras::{FinalAdjustment, first_arrangement};
use crate::pipeline::passes::synchronisation::estimated_timing;
use crate::pipeline::repair::repaired;
use crate::pipeline::stages::recording_check::handedness::{handedness, upside_down};
use crate::progress::{Canceled, Progress};
use crate::session::{Session, Suspicion, SuspicionCode as Code};

/// With more cameras, one that is read wrongly leaves enough others that can be placed.
const MAX_CAMERAS: usize = 4;

/// Readings of all cameras take minutes for more.
const MAX_CAMERAS_AT_ONCE: usize = 16;

/// Common factors on the focal lengths: images of another resolution, or a guessed angle of view.
const FOCAL_FACTORS: [f64; 4] = [0.5, 0.67, 1.5, 2.0];

/// A reading is right where it places all but one of the cameras, two at least, and people explain this share of the keypoints of
/// these: right recordings have 0.85 and more, chance arrangements a third.
const RIGHT_SHARE: f64 = 0.7;

/// A reading, and what is wrong if it is right.
struct Reading {
    suspicion: Suspicion,
    session: Session,
    options: Options,
}

/// Two cameras that are placed are doubtful below this share: no third one judges them, and right ones have 0.99. Another reading
/// must explain so much more.
const DOUBTFUL: f64 = 0.9;
const MIN_GAIN: f64 = 0.1;

/// The mistake under whose repair the cameras can be placed, the one that explains most; `None` where none can.
pub fn mistake_of_unsolved(given: &Capture, progress: &Progress) -> Result<Option<Suspicion>, Canceled> {
    better_reading(given, 0.0, progress)
}

/// The mistake under whose repair a pair of cameras explains much more of its people.
pub(super) fn mistake_of_pair(solved: &Solved, progress: &Progress) -> Result<Option<Suspicion>, Canceled> {
    let explained = solved.calibration.association.explained;
    let is_doubtful = solved.given.views.len() == 2 && explained < DOUBTFUL;
    if is_doubtful { better_reading(solved.given, explained, progress) } else { Ok(None) }
}

/// The reading of the files that explains most, and more than is `explained` as they are.
fn better_reading(
    given: &Capture,
    explained_as_given: f64,
    progress: &Progress,
) -> Result<Option<Suspicion>, Canceled> {
    let n_cameras = given.views.len();
    if !given.estimates_extrinsics() || !(2..=MAX_CAMERAS_AT_ONCE).contains(&n_cameras) {
        return Ok(None);
    }
    let mut best: Option<(f64, Suspicion)> = None;
    for Reading { suspicion, session, options } in readings(given) {
        let placed = match suspicion.code {
            Code::TimeOffset => {
                let timing = estimated_timing(&session, &options, FinalAdjustment::Elsewhere, progress)?;
                first_arrangement(&Capture::new(&timing.applied_to(&session), &options), progress)?
            }
            _ => first_arrangement(&Capture::new(&session, &options), progress)?,
        };
        let (n_placed, explained) = (placed.n_placed(), placed.association.explained);
        tracing::debug!(?suspicion.code, ?suspicion.cameras, n_placed, explained, "another reading of the files");
        // Of two cameras the one is mirrored against the other; people who look backwards tell which.
        let shown = handedness(session.convention, &placed.association.points, session.fps);
        let is_right = n_placed >= (n_cameras - 1).max(2)
            && explained > RIGHT_SHARE.max(explained_as_given + MIN_GAIN)
            && !shown.is_some_and(|shown| shown.is_mirrored());
        if is_right && best.as_ref().is_none_or(|(most, _)| explained > *most) {
            let evidence = format!(
                "{}: then {n_placed} of {n_cameras} cameras fit together, and people explain {:.0} % of their keypoints",
                suspicion.evidence,
                100.0 * explained
            );
            best = Some((explained, Suspicion { evidence, ..suspicion }));
        }
    }
    Ok(best.map(|(_, suspicion)| suspicion))
}

fn readings(given: &Capture) -> Vec<Reading> {
    let Capture { session, options, .. } = *given;
    let read_alone = if session.views.len() > MAX_CAMERAS { &[] } else { session.views.as_slice() };
    let of_files = read_alone.iter().flat_map(|view| {
        let is_down = upside_down(session.convention, view).is_some_and(|share| share > MOST);
        let (code, evidence, remedy) = match is_down {
            true => (Code::YUpwards, "y is counted from the lower edge", "give y = height - 1 - y"),
            false => (Code::Mirrored, "its images are mirrored", "give x = width - 1 - x"),
        };
        let labels = (Code::LabelsExchanged, "left and right are exchanged", "exchange them back");
        [(code, evidence, remedy), labels]
            .map(|(code, evidence, remedy)| Suspicion::new(code, vec![view.id.clone()], evidence, remedy))
    });
    let of_time =
        (options.sync == Sync::Given).then(|| time_offset(Vec::new(), "the cameras did not start at the same time"));
    let read = |suspicion: Suspicion| {
        let (session, options) = repaired(session, options, &suspicion)?;
        Some(Reading { suspicion, session, options })
    };
    let mut readings: Vec<Reading> = of_files.chain(of_time).filter_map(read).collect();
    if options.intrinsics_of(session) == IntrinsicsMode::Fixed {
        readings.extend(FOCAL_FACTORS.map(|factor| of_focal_length(session, options, factor)));
    }
    readings
}

fn of_focal_length(session: &Session, options: &Options, factor: f64) -> Reading {
    let evidence = format!("the focal lengths are about {factor} times as long");
    let remedy = "check the matrices K, or let focal lengths be estimated";
    let mut changed = session.clone();
    changed.views.iter_mut().for_each(|view| view.intrinsics = view.intrinsics.with_focal_factor(factor));
    let suspicion = Suspicion {
        suggested_option: Some(r#"{"intrinsics": "estimate"}"#.to_owned()),
        ..Suspicion::new(Code::FocalLength, Vec::new(), evidence, remedy)
    };
    Reading { suspicion, session: changed, options: options.clone() }
}
