//! Factors on the cameras' focal lengths.

use crate::geometry::Intrinsics;
use crate::pipeline::calibration::{AdjustedCamera, Calibration};
use crate::session::reconstruction::{FocalFactor, StageReport};
use crate::session::{Reconstruction, Session};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// Factors on the focal lengths that a session gives.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FocalLengths {
    /// Per view; `None`: the given focal length is kept.
    pub factors: Vec<Option<FocalFactor>>,
    /// Report of their first estimate; `None` where there was none.
    pub report: Option<StageReport>,
}

/// Standard deviation of the logarithm of a focal length that no adjustment has determined: 0.6 to 2 image widths are within two.
const UNKNOWN_SIGMA: f64 = 0.4;

/// Standard deviation per axis of a principal point that is taken to be the middle of the image, as a share of the longer side:
/// those of simulated sessions lie 0.3 % away, those of the Shelf recording 2.5 %.
const PRINCIPAL_POINT_SIGMA: f64 = 0.01;

/// Standard deviation, rad, of the orientation of a camera whose K is unknown beside that of its pose under the lens assumed: each pixel
/// by which the principal point is off turns the camera by `1 / f`, about either axis. People stay where they are.
///
/// It is not estimated: with principal points as unknowns of the joint problem (prior 1 %) those of the Shelf recording stayed within 15 px
/// where they are 11 to 53 px off, and cameras of simulated sessions turned by 1.1 to 1.5 times as much as without.
pub fn sigma_angle_by_principal_point(lens: &Intrinsics) -> f64 {
    let longer = f64::from(lens.width.max(lens.height));
    std::f64::consts::SQRT_2 * PRINCIPAL_POINT_SIGMA * longer / lens.focal()
}

impl FocalLengths {
    /// The session's own focal lengths.
    pub fn given(session: &Session) -> Self {
        Self { factors: vec![None; session.views.len()], report: None }
    }

    /// One factor on the focal lengths of all views, of which nothing else is known.
    pub fn all(session: &Session, factor: f64) -> Self {
        let unknown = Some(FocalFactor { value: factor, sigma: factor });
        Self { factors: vec![unknown; session.views.len()], report: None }
    }

    /// The factor of a view.
    pub fn factor(&self, view: usize) -> f64 {
        self.factors[view].map_or(1.0, |factor| factor.value)
    }

    /// The session with these focal lengths.
    pub fn applied_to<'s>(&self, session: &'s Session) -> Cow<'s, Session> {
        if self.factors.iter().all(Option::is_none) {
            return Cow::Borrowed(session);
        }
        let mut refined = session.clone();
        for (view, factor) in refined.views.iter_mut().zip(&self.factors) {
            if let Some(factor) = factor {
                view.intrinsics = view.intrinsics.with_focal_factor(factor.value);
            }
        }
        Cow::Owned(refined)
    }

    /// Replaces the factors of some views; returns `session`, to which these were applied, with the new ones.
    pub fn replace(&mut self, new: impl Iterator<Item = (usize, FocalFactor)>, session: &Session) -> Session {
        let mut session = session.clone();
        for (view, factor) in new {
            let intrinsics = &mut session.views[view].intrinsics;
            *intrinsics = intrinsics.with_focal_factor(factor.value / self.factor(view));
            self.factors[view] = Some(factor);
        }
        session
    }

    /// Multiplies the focal lengths by what an adjustment under them found; the largest change of a logarithm.
    pub fn take_over(&mut self, after: &Calibration) -> f64 {
        let Some(adjusted) = &after.adjusted else { return 0.0 };
        let mut largest = 0.0f64;
        let sigma_of = |view: usize| {
            let focal = adjusted.focal.as_ref()?;
            let k = focal.views.iter().position(|v| *v == view)?;
            Some(focal.covariance[k][k].max(0.0).sqrt())
        };
        let is_placed = |camera: &AdjustedCamera| camera.camera_from_world.is_some();
        for (view, camera) in adjusted.cameras.iter().enumerate().filter(|(_, camera)| is_placed(camera)) {
            let value = self.factor(view) * camera.focal_factor;
            let sigma = value * sigma_of(view).unwrap_or(UNKNOWN_SIGMA);
            self.factors[view] = Some(FocalFactor { value, sigma });
            largest = largest.max(camera.focal_factor.ln().abs());
        }
        largest
    }

    /// Adds the factors and the report to a result.
    pub fn add_to(&self, reconstruction: &mut Reconstruction) {
        for (camera, factor) in reconstruction.cameras.iter_mut().zip(&self.factors) {
            camera.focal_factor = *factor;
        }
        if let Some(report) = &self.report {
            reconstruction.report.stages.insert(0, report.clone());
        }
    }
}
