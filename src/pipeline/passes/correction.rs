//! Cameras and people after corrections, from those of the solve without them.
//!
//! Identities alone leave the cameras as they are: the same detections of a frame show one person. Where detections are left
//! out, the cameras are adjusted again, from where they are: together with the bodies, or here where the options forbid that. Their
//! cross-validation is repeated where a camera is left out.

use crate::pipeline::calibration::{Calibration, CameraFreedom};
use crate::pipeline::capture::Capture;
use crate::pipeline::continuation::{Continuation, Placed};
use crate::pipeline::corrections::CorrectedPeople;
use crate::pipeline::passes::adjustment::{ALL_FRAMES, Effort, adjusted};
use crate::pipeline::passes::denoising::{DenoisedCapture, corrected_capture};
use crate::pipeline::passes::held_out_check::heldout_px;
use crate::pipeline::stages::association::from_tracks;
use crate::pipeline::stages::joint_trajectories::joint_trajectories;
use crate::progress::{Canceled, Progress};
use crate::session::{JointTrajectory, Suspicion};
use serde::{Deserialize, Serialize};

/// Cameras and people after corrections, in the form of a checkpoint.
#[derive(Debug, Serialize, Deserialize)]
pub struct Corrected {
    solution: Solution,
    heldout_px: Option<f64>,
    paths: Vec<JointTrajectory>,
    found: Vec<Suspicion>,
}

/// Cameras and people under the detections as given, or as repaired.
#[derive(Debug, Serialize, Deserialize)]
enum Solution {
    Given(Box<Calibration>),
    Repaired(Box<DenoisedCapture>),
}

/// Applies corrections. `given`: the recording without the detections that they leave out.
///
/// Mistakes in the files stay those that the solve without corrections has shown, except for those of cameras that are left out.
pub fn corrected(
    given: &Capture,
    continuation: &Continuation,
    people: &CorrectedPeople,
    freedom: CameraFreedom,
    progress: &Progress,
) -> Result<Corrected, Canceled> {
    let (excludes, excludes_cameras) = (!people.excluded.is_empty(), !people.excluded_views.is_empty());
    let mut steps = progress.steps(if excludes_cameras { [0.4, 0.4, 0.2] } else { [0.7, 0.0, 0.3] });
    let start = start(given, continuation.calibration(), people);
    let adjusts = excludes && !given.options.adjust_with_bodies && freedom == CameraFreedom::Adjusted;
    let step = steps.begin("repairing detections of the corrected people");
    let solution = if given.options.denoise {
        Solution::Repaired(Box::new(corrected_capture(
            given,
            start,
            if adjusts { CameraFreedom::Adjusted } else { CameraFreedom::Held },
            &step,
        )?))
    } else if adjusts {
        let after = adjusted(given, &start, Effort::FINAL, ALL_FRAMES, &step)?;
        Solution::Given(Box::new(with_points_anew(given, after)))
    } else {
        Solution::Given(Box::new(start))
    };
    let (calibration, observed) = match &solution {
        Solution::Given(calibration) => (&**calibration, None),
        Solution::Repaired(denoised) => (denoised.calibration(), Some(denoised.session(given.session))),
    };
    let of_observed = observed.as_ref().map(|observed| Capture::new(observed, given.options));
    let capture = of_observed.as_ref().unwrap_or(given);
    let step = steps.begin("cross-validating cameras");
    let heldout_px = match excludes_cameras {
        true => heldout_px(capture, calibration, freedom, &step)?,
        false => continuation.heldout_px(),
    };
    let step = steps.begin("smoothing trajectories of the corrected people");
    let points = calibration.people(capture.session, &calibration.association.points);
    let paths = joint_trajectories(&points, &step)?;
    let is_left = |id: &String| people.excluded_views.iter().all(|view| given.session.views[*view].id != *id);
    let concerns = |suspicion: &&Suspicion| suspicion.cameras.is_empty() || suspicion.cameras.iter().any(is_left);
    let found = continuation.found().iter().filter(concerns).cloned().collect();
    Ok(Corrected { solution, heldout_px, paths, found })
}

impl Corrected {
    /// The solution; `given`: as in [`corrected`].
    pub fn placed(self, given: &Capture, continuation: &Continuation) -> Placed {
        let (calibration, observed, repairs) = match self.solution {
            Solution::Given(calibration) => (*calibration, given.session.clone(), None),
            Solution::Repaired(denoised) => {
                let (calibration, repaired) = denoised.applied_to(given.session);
                (calibration, repaired.session, Some((repaired.report, repaired.repairs)))
            }
        };
        Placed {
            timing: continuation.timing().clone(),
            focal_lengths: continuation.focal_lengths().clone(),
            calibration,
            observed: Some(observed),
            repairs,
            heldout_px: self.heldout_px,
            paths: self.paths,
            found: self.found,
        }
    }
}

/// The corrected people under the cameras of the solve without corrections.
fn start(given: &Capture, before: &Calibration, people: &CorrectedPeople) -> Calibration {
    let mut start = before.clone();
    start.association.tracks.clone_from(&people.tracks);
    for &view in &people.excluded_views {
        start.cameras[view] = None;
    }
    if !people.excluded.is_empty() {
        start.with_other_bodies = start.with_bodies.take().is_some();
    }
    start.excluded = people.excluded_views.iter().copied().collect();
    with_points_anew(given, start)
}

/// The points of the people, triangulated under the cameras.
fn with_points_anew(given: &Capture, calibration: Calibration) -> Calibration {
    let before = &calibration.association;
    let mut association = from_tracks(&given.scene(&calibration.cameras), before.tracks.clone());
    association.n_left_out = before.n_left_out;
    Calibration { association, ..calibration }
}
