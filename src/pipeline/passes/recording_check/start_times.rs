//! Cameras that were started earlier or later than the others.

use crate::pipeline::capture::Capture;
use crate::pipeline::config::Sync;
use crate::pipeline::stages::time_offsets::whole_frames::{Apart, whole_offsets};
use crate::progress::{Canceled, Progress};
use crate::session::{Session, Suspicion, SuspicionCode as Code};

/// What helps against offsets in time.
pub(super) const REMEDY: &str = "let the time offsets be estimated";

/// The option that applies [`REMEDY`].
pub(super) fn suggested_option() -> Option<String> {
    Some(r#"{"sync": "estimate"}"#.to_owned())
}

/// Cameras that were started at another time; the recording as a whole without any.
pub(super) fn time_offset(cameras: Vec<String>, evidence: impl Into<String>) -> Suspicion {
    let suspicion = Suspicion::new(Code::TimeOffset, cameras, evidence, REMEDY);
    Suspicion { suggested_option: suggested_option(), ..suspicion }
}

/// How frame numbers that are `frames` too high are to be changed.
pub(super) fn change(frames: i64) -> String {
    format!("{} {}", frames.abs(), if frames > 0 { "lower" } else { "higher" })
}

/// Cameras whose people agree with those of the others at other frame numbers than given. Those of one group see the same people.
pub(super) fn late_cameras(
    given: &Capture,
    groups: &[Vec<usize>],
    progress: &Progress,
) -> Result<Option<Suspicion>, Canceled> {
    let Capture { session, options, .. } = *given;
    if options.sync == Sync::Estimate {
        return Ok(None);
    }
    let apart = whole_offsets(given, groups, progress)?.apart(session.fps);
    tracing::debug!(?apart, "start times of the cameras");
    Ok(apart.map(|apart| of_cameras(session, &apart)))
}

fn of_cameras(session: &Session, Apart { late, agreement: [before, after] }: &Apart) -> Suspicion {
    let ids: Vec<String> = late.iter().map(|&(view, _)| session.views[view].id.clone()).collect();
    let changes = late.iter().zip(&ids).map(|(&(_, frames), id)| format!("{} in {id}", change(frames)));
    let evidence = format!(
        "the cameras agree with the others to {:.0} %, but to {:.0} % with frame numbers that are {}",
        100.0 * before,
        100.0 * after,
        changes.collect::<Vec<_>>().join(", ")
    );
    time_offset(ids, evidence)
}
