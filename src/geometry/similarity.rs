//! Sim(3): similarity transforms and their least-squares estimate from points.

use super::rigid::Rigid;
use super::svd;
use nalgebra::{Matrix3, Vector3};
use std::ops::Mul;

/// `x_target = scale * rotation * x_source + translation`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Similarity {
    /// Target units per source unit, positive.
    pub scale: f64,
    /// Rotation matrix of determinant +1.
    pub rotation: Matrix3<f64>,
    /// In target units.
    pub translation: Vector3<f64>,
}

impl Similarity {
    /// The identity.
    pub fn identity() -> Self {
        Self { scale: 1.0, rotation: Matrix3::identity(), translation: Vector3::zeros() }
    }

    /// From the target frame to the source frame.
    pub fn inverse(&self) -> Self {
        let (scale, rotation) = (1.0 / self.scale, self.rotation.transpose());
        Self { scale, rotation, translation: -(rotation * self.translation * scale) }
    }

    /// Maps a point of the source frame to the target frame.
    pub fn transform(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point * self.scale + self.translation
    }

    /// The pose of the same camera in the target world: `camera_from_source` becomes `camera_from_target`.
    ///
    /// Images do not change: the camera frame takes the target's unit of length.
    pub fn move_camera(&self, camera_from_source: &Rigid) -> Rigid {
        let center = self.transform(&camera_from_source.center());
        let rotation = camera_from_source.rotation * self.rotation.transpose();
        Rigid { rotation, translation: -(rotation * center) }
    }
}

impl Mul for Similarity {
    type Output = Similarity;
    fn mul(self, b: Similarity) -> Similarity {
        Similarity {
            scale: self.scale * b.scale,
            rotation: self.rotation * b.rotation,
            translation: self.transform(&b.translation),
        }
    }
}

/// Whether an alignment estimates the scale.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ScaleMode {
    /// The scale is estimated.
    Free,
    /// The scale is 1: a rigid alignment.
    Unit,
}

/// Why two point sets cannot be aligned.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum AlignError {
    /// Points do not come in pairs.
    #[error("{n_source} source points for {n_target} target points")]
    UnequalCounts {
        /// Points in the source.
        n_source: usize,
        /// Points in the target.
        n_target: usize,
    },
    /// Fewer than three pairs.
    #[error("at least 3 points expected, found {n_points}")]
    TooFewPoints {
        /// Pairs given.
        n_points: usize,
    },
    /// A coordinate is infinite or not a number.
    #[error("the points of pair {index} are not finite")]
    NotFinite {
        /// The first such pair.
        index: usize,
    },
    /// The points of one set lie on a line or coincide: the rotation is not determined.
    #[error("the points lie on a line: at least 3 points that span a plane expected")]
    Degenerate,
}

/// Points lie on a line where the second singular value is below this share of the first. Rounding errors of positions
/// 1e6 times as far away as the points are apart stay below it.
const LINE_TOLERANCE: f64 = 1e-9;

/// Aligns two point sets by the least-squares similarity transform.
///
/// `min sum_i |y_i - (c R x_i + t)|^2`: Umeyama, PAMI 13(4), 1991, Eqs. (38) to (43).
///
/// `source` (x), `target` (y): n pairs, n >= 3, any two frames. Returns `target_from_source`. Reflections are excluded
/// (the sign matrix of Eq. (43)): a mirrored set gets its best proper rotation. Coplanar points suffice.
///
/// # Errors
/// [`AlignError`]: see its variants.
pub fn similarity_from_points(
    source: &[Vector3<f64>],
    target: &[Vector3<f64>],
    scale_mode: ScaleMode,
) -> Result<Similarity, AlignError> {
    check_points(source, target)?;
    let n = source.len() as f64;
    let (source_mean, target_mean) = (mean(source), mean(target)); // Eqs. (34), (35)
    let variance = source.iter().map(|x| (x - source_mean).norm_squared()).sum::<f64>() / n; // Eq. (36)
    let pairs = source.iter().zip(target);
    let covariance =
        pairs.fold(Matrix3::zeros(), |sum, (x, y)| sum + (y - target_mean) * (x - source_mean).transpose()) / n; // Eq. (38)
    let svd = svd::decompose(&covariance);
    // `<=` and not `<`: both singular values are zero for coinciding points.
    if svd.singular[1] <= LINE_TOLERANCE * svd.singular[0] {
        return Err(AlignError::Degenerate);
    }
    let sign = (svd.u.determinant() * svd.v.determinant()).signum(); // S = diag(1, 1, sign), Eqs. (39), (43)
    let signs = Vector3::new(1.0, 1.0, sign);
    let rotation = svd.u * Matrix3::from_diagonal(&signs) * svd.v.transpose(); // Eq. (40)
    let scale = match scale_mode {
        ScaleMode::Free => svd.singular.dot(&signs) / variance, // Eq. (42)
        ScaleMode::Unit => 1.0,
    };
    Ok(Similarity { scale, rotation, translation: target_mean - rotation * source_mean * scale }) // Eq. (41)
}

/// Length of the arms that stand for a camera's orientation in [`similarity_from_cameras`], as a share of the rig's radius:
/// centres decide, and orientations settle what centres on a line or of two cameras leave open.
const ARM: f64 = 0.1;

/// Aligns the same cameras in two worlds by the least-squares similarity of their centres and of the ends of three arms along
/// their axes.
///
/// `source`, `target`: `camera_from_world` of n cameras, n >= 2. Returns `target_from_source`.
///
/// # Errors
/// [`AlignError::Degenerate`] where the centres of either coincide.
pub fn similarity_from_cameras(source: &[Rigid], target: &[Rigid]) -> Result<Similarity, AlignError> {
    similarity_from_points(&arms(source), &arms(target), ScaleMode::Free)
}

/// Each camera's centre, and the ends of its arms.
fn arms(cameras: &[Rigid]) -> Vec<Vector3<f64>> {
    let centers: Vec<Vector3<f64>> = cameras.iter().map(Rigid::center).collect();
    let middle = mean(&centers);
    let length = ARM * (centers.iter().map(|c| (c - middle).norm_squared()).sum::<f64>() / centers.len() as f64).sqrt();
    let points = |(camera, center): (&Rigid, &Vector3<f64>)| {
        let axes = camera.rotation.transpose() * length;
        [*center, center + axes.column(0), center + axes.column(1), center + axes.column(2)]
    };
    cameras.iter().zip(&centers).flat_map(points).collect()
}

fn check_points(source: &[Vector3<f64>], target: &[Vector3<f64>]) -> Result<(), AlignError> {
    if source.len() != target.len() {
        return Err(AlignError::UnequalCounts { n_source: source.len(), n_target: target.len() });
    }
    if source.len() < 3 {
        return Err(AlignError::TooFewPoints { n_points: source.len() });
    }
    let finite = |p: &Vector3<f64>| p.iter().all(|c| c.is_finite());
    match source.iter().zip(target).position(|(x, y)| !finite(x) || !finite(y)) {
        Some(index) => Err(AlignError::NotFinite { index }),
        None => Ok(()),
    }
}

fn mean(points: &[Vector3<f64>]) -> Vector3<f64> {
    points.iter().sum::<Vector3<f64>>() / points.len() as f64
}

#[cfg(test)]
mod tests;
