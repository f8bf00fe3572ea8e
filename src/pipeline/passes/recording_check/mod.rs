//! Mistakes in the recording's files that the solution shows: tests of `stages::recording_check`, from single cameras whose files
//! need another reading to the recording as a whole.
//!
//! Cameras that are named once are left to that name: their errors spill over to the others, and one mistake has one name.

mod cameras;
mod distortion;
mod free_adjustment;
mod lenses;
mod parameters;
pub mod solved;
mod start_times;
mod steps;
mod unsolved;
mod whole;

use crate::pipeline::stages::recording_check::takes::{Groups, groups};
use crate::progress::{Canceled, Progress};
use crate::session::{Suspicion, SuspicionCode as Code};
use solved::Solved;
use start_times::late_cameras;
pub use unsolved::mistake_of_unsolved;

/// Every suspicion that the solution raises.
pub fn checked(solved: &Solved, progress: &Progress) -> Result<Vec<Suspicion>, Canceled> {
    // Cameras at wrong given places spoil the people that all others are judged by.
    let spoils_all = |s: &Suspicion| s.code.affects_cameras() && (s.cameras.is_empty() || s.code == Code::GivenPoses);
    if solved.unnamed(&[]).len() < 2 || solved.known.iter().any(spoils_all) {
        return Ok(Vec::new());
    }
    let mut weighted = progress.steps([1.0, 0.5, 1.0, 0.5]);
    let mut found = Vec::new();
    let step = weighted.begin("reading the files of cameras in other ways");
    let Groups { connected, close } = groups(&solved.people());
    tracing::debug!(?connected, ?close, "cameras that see the same people");
    whole::separate_takes(solved, &connected, &mut found, &step)?;
    if found.is_empty() {
        cameras::other_readings(solved, &mut found, &step)?;
        late_strangers(solved, &close, &mut found, &step)?;
        whole::other_take(solved, &mut found, &step)?;
        if found.is_empty() {
            found.extend(unsolved::mistake_of_pair(solved, &step)?);
        }
    }
    let step = weighted.begin("testing clocks of cameras");
    steps::other_clocks(solved, &mut found, &step)?;
    let step = weighted.begin("testing delays and lenses");
    if found.is_empty() {
        parameters::other_parameters(solved, &mut found, &step)?;
    }
    let step = weighted.begin("testing movements of cameras");
    cameras::exchanged_labels(solved, &mut found);
    // People who walk through images that are bent in all cameras are seen as if cameras turned.
    if !found.iter().any(|suspicion| suspicion.code == Code::LensDistortion && suspicion.cameras.is_empty()) {
        changing_camera(solved, &mut found, &step)?;
    }
    // One wrong camera of two turns the people between them around.
    let turns_people = |s: &Suspicion| matches!(s.code, Code::LabelsExchanged | Code::Mirrored | Code::YUpwards);
    if !found.iter().any(turns_people) {
        whole::mirrored_world(solved, &mut found);
    }
    whole::too_few_people(solved, &mut found);
    whole::wrong_frame_rate(solved, &mut found);
    Ok(found)
}

/// Cameras that see other people than those of the largest of `groups`, because they were started at another time; some may be
/// named already, by what they see.
fn late_strangers(
    solved: &Solved,
    groups: &[Vec<usize>],
    found: &mut Vec<Suspicion>,
    progress: &Progress,
) -> Result<(), Canceled> {
    let largest = groups.first().map_or(&[][..], Vec::as_slice);
    let is_stranger = |view: &usize| !largest.contains(view) && !solved.is_named(*view, found);
    let has_strangers = (0..solved.calibration.cameras.len()).any(|view| is_stranger(&view));
    let has_other_mistakes = found.iter().any(|suspicion| suspicion.code != Code::TimeOffset);
    if !has_strangers || has_other_mistakes {
        return Ok(());
    }
    if let Some(late) = late_cameras(solved.given, groups, progress)? {
        found.retain(|suspicion| !suspicion.cameras.iter().all(|id| late.cameras.contains(id)));
        found.push(late);
    }
    Ok(())
}

/// A camera that zoomed or was moved: the mean of two poses or focal lengths may look like another shape of its images.
fn changing_camera(solved: &Solved, found: &mut Vec<Suspicion>, progress: &Progress) -> Result<(), Canceled> {
    let is_of_shape = |suspicion: &mut Suspicion| matches!(suspicion.code, Code::PixelAspect | Code::LensDistortion);
    let of_shape: Vec<Suspicion> = found.extract_if(.., is_of_shape).collect();
    // Where people stand beside the middle of the image, a camera that zooms turns as well.
    steps::zoomed_camera(solved, found, progress)?;
    steps::moved_camera(solved, found, progress)?;
    if found.is_empty() {
        found.extend(of_shape);
    }
    Ok(())
}
