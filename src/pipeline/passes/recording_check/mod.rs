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

use crate::pipeline::stages::recording_check::takes::groups;
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
    let groups = groups(&solved.people());
    tracing::debug!(?groups, "cameras that see the same people");
    whole::separate_takes(solved, &groups, &mut found, &step)?;
    if found.is_empty() {
        cameras::other_readings(solved, &mut found, &step)?;
        let has_strangers = groups.len() > 1 || solved.calibration.cameras.contains(&None);
        if found.is_empty() && has_strangers {
            found.extend(late_cameras(solved.given, &groups, &step)?);
        }
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
