//! Checks of a camera: intrinsics and extrinsics as written.

use super::error::{Fault, UploadError, shown};
use super::json::{Numbers, Rows};
use super::raw::RawCamera;
use super::warnings::Warnings;
use crate::geometry::{Distortion, Intrinsics, Rigid};
use nalgebra::{Matrix3, Vector2, Vector3};

/// Largest entry of `R^T R - I`: rounding to three digits passes, a scaled or sheared matrix does not.
const ROTATION_TOLERANCE: f64 = 1e-3;
/// A rotation with smaller deviation is kept bit for bit.
const EXACT_ROTATION: f64 = 1e-9;
/// Range of focal length over image size, from 179 degrees of view to 0.06 degrees. Values outside come from normalised or
/// damaged matrices.
const FOCAL_RANGE: [f64; 2] = [0.01, 1000.0];
/// A camera farther than this from the world's origin, m, is probably given in millimetres.
const FAR: f64 = 100.0;

/// Checks and returns the intrinsics of a camera; without K those of an unknown lens, [`Intrinsics::guessed`].
///
/// # Errors
/// [`Fault::CameraInvalid`] or [`Fault::DistortionUnsupported`].
pub(super) fn checked_intrinsics(raw: &RawCamera, warnings: &mut Warnings) -> Result<Intrinsics, UploadError> {
    if raw.width == 0 || raw.height == 0 {
        return Err(invalid(format!("the image size is {}x{}, expected positive numbers", raw.width, raw.height)));
    }
    let Some(rows) = &raw.matrix else {
        return Ok(Intrinsics::guessed([raw.width, raw.height], checked_distortion(raw)?));
    };
    let k = matrix3(rows).ok_or_else(|| invalid(format!("K is {}, expected 3x3", shape(rows))))?;
    check_matrix(&k)?;
    let intrinsics =
        Intrinsics::from_matrix([raw.width, raw.height], &crate::session::formats::rows(&k), checked_distortion(raw)?);
    check_focal(&intrinsics)?;
    check_principal_point(&intrinsics, &raw.id, warnings)?;
    check_distortion_at_corner(&intrinsics)?;
    Ok(intrinsics)
}

/// Checks and returns `camera_from_world`, where the session gives it.
///
/// A matrix within [`ROTATION_TOLERANCE`] of a rotation is replaced by the nearest rotation.
///
/// # Errors
/// [`Fault::CameraInvalid`].
pub(super) fn checked_extrinsics(raw: &RawCamera, warnings: &mut Warnings) -> Result<Option<Rigid>, UploadError> {
    let (rows, t) = match (&raw.rotation, &raw.translation) {
        (None, None) => return Ok(None),
        (Some(_), None) => return Err(invalid("R is given without t")),
        (None, Some(_)) => return Err(invalid("t is given without R")),
        (Some(rows), Some(t)) => (rows, t),
    };
    let matrix = matrix3(rows).ok_or_else(|| invalid(format!("R is {}, expected 3x3", shape(rows))))?;
    let rotation = checked_rotation(&matrix)?;
    let translation = vector3(t).ok_or_else(|| invalid(format!("t has {} entries, expected 3", t.0.len())))?;
    let norm = translation.norm();
    Fault::NumberNotFinite.when(!norm.is_finite(), || format!("t is {:?}", t.0))?;
    if norm > FAR {
        warnings.add(format!(
            "camera {} has t of length {norm:.0} m, expected metres: is it in millimetres?",
            shown(&raw.id)
        ));
    }
    Ok(Some(Rigid { rotation, translation }))
}

fn invalid(detail: impl Into<String>) -> UploadError {
    Fault::CameraInvalid.with(detail)
}

fn check_matrix(k: &Matrix3<f64>) -> Result<(), UploadError> {
    if k.row(2) != nalgebra::RowVector3::new(0.0, 0.0, 1.0) {
        let hint = if k[(0, 2)] == 0.0 && k[(1, 2)] == 0.0 { "; is it transposed?" } else { "" };
        let [a, b, c] = [k[(2, 0)], k[(2, 1)], k[(2, 2)]];
        return Err(invalid(format!("the bottom row of K is [{a}, {b}, {c}], expected [0, 0, 1]{hint}")));
    }
    Fault::CameraInvalid.when(k[(1, 0)] != 0.0, || format!("K[1][0] is {}, expected 0", k[(1, 0)]))?;
    if !k[(0, 1)].is_finite() || k[(0, 1)].abs() > 0.5 * k[(0, 0)].abs() {
        return Err(invalid(format!("the skew K[0][1] is {} px, expected about 0", k[(0, 1)])));
    }
    Ok(())
}

fn check_focal(camera: &Intrinsics) -> Result<(), UploadError> {
    let size = f64::from(camera.width.max(camera.height));
    for (name, focal) in [("fx", camera.fx), ("fy", camera.fy)] {
        let [least, most] = FOCAL_RANGE.map(|factor| factor * size);
        if !(least..=most).contains(&focal) {
            return Err(invalid(format!("{name} is {focal} px, expected {least} to {most} px for this image size")));
        }
    }
    Ok(())
}

/// A principal point outside the image is possible for a cropped image; farther than a whole image size outside it is not.
fn check_principal_point(camera: &Intrinsics, id: &str, warnings: &mut Warnings) -> Result<(), UploadError> {
    let (x, y) = (camera.cx / f64::from(camera.width), camera.cy / f64::from(camera.height));
    let found = format!(
        "the principal point is ({}, {}) px in an image of {}x{}",
        camera.cx, camera.cy, camera.width, camera.height
    );
    if ![x, y].iter().all(|c| (-1.0..=2.0).contains(c)) {
        return Err(invalid(found));
    }
    if ![x, y].iter().all(|c| (0.0..=1.0).contains(c)) {
        warnings.add(format!("camera {}: {found}: is the image cropped?", shown(id)));
    }
    Ok(())
}

fn checked_distortion(raw: &RawCamera) -> Result<Distortion, UploadError> {
    let given = raw.distortion.as_ref().map_or(&[][..], |d| &d.0);
    let model = raw.distortion_model.as_deref().unwrap_or_default();
    let plain = model.to_ascii_lowercase().replace(['_', '-', ' '], "");
    match plain.as_str() {
        "none" | "pinhole" if given.iter().all(|k| *k == 0.0) => Ok(Distortion::None),
        "" | "none" | "pinhole" | "opencv" | "plumbbob" | "brown" | "brownconrady" | "radtan" | "rational"
        | "rationalpolynomial" => polynomial_distortion(given),
        "fisheye" | "equidistant" | "opencvfisheye" | "kannalabrandt" => fisheye_distortion(given),
        _ => Err(Fault::DistortionUnsupported
            .with(format!("the distortion model is {}, expected opencv, rational, fisheye or none", shown(model)))),
    }
}

fn polynomial_distortion(given: &[f64]) -> Result<Distortion, UploadError> {
    Distortion::from_opencv(given).ok_or_else(|| {
        let n = given.len();
        let has_more = [12, 14].contains(&n);
        let why = if has_more { "including thin prism or tilt terms" } else { "given, expected 0, 4, 5 or 8" };
        Fault::DistortionUnsupported.with(format!("{n} distortion coefficients {why}"))
    })
}

fn fisheye_distortion(given: &[f64]) -> Result<Distortion, UploadError> {
    Distortion::from_fisheye(given).ok_or_else(|| {
        Fault::DistortionUnsupported.with(format!("{} fisheye coefficients given, expected k1 k2 k3 k4", given.len()))
    })
}

/// Refuses coefficients that move the farthest image corner tenfold or through the centre, as no lens does.
fn check_distortion_at_corner(camera: &Intrinsics) -> Result<(), UploadError> {
    let x = camera.cx.abs().max((f64::from(camera.width) - camera.cx).abs()) / camera.fx;
    let y = camera.cy.abs().max((f64::from(camera.height) - camera.cy).abs()) / camera.fy;
    // A fisheye measures the angle of the corner, not its slope; rays beyond 80 degrees are not needed.
    let slope = match camera.dist {
        Distortion::Fisheye4(_) => x.hypot(y).min(1.4).tan() / x.hypot(y),
        Distortion::None | Distortion::OpenCv5(_) | Distortion::Rational8(_) => 1.0,
    };
    let corner = Vector2::new(x, y) * slope;
    let bent = camera.dist.distorted(&corner);
    // Extreme coefficients overflow; NaN lies outside every range.
    let factor = bent.dot(&corner) / corner.norm_squared();
    let sideways = (bent - corner * factor).norm() / corner.norm();
    if !(0.1..=10.0).contains(&factor) || sideways.is_nan() || sideways > 1.0 {
        let dist = camera.dist.coefficients();
        return Err(invalid(format!(
            "dist {dist:?} moves the image corner by a factor of {factor:.3}, expected 0.1 to 10"
        )));
    }
    Ok(())
}

fn checked_rotation(matrix: &Matrix3<f64>) -> Result<Matrix3<f64>, UploadError> {
    let deviation = (matrix.transpose() * matrix - Matrix3::identity()).abs().max();
    if !deviation.is_finite() || deviation > ROTATION_TOLERANCE {
        return Err(invalid(format!(
            "R is not orthonormal: R^T R differs from the identity by {deviation:.2e}, expected at most {ROTATION_TOLERANCE:e}"
        )));
    }
    Fault::CameraInvalid.when(matrix.determinant() < 0.0, || "R is a reflection: its determinant is -1")?;
    if deviation <= EXACT_ROTATION {
        return Ok(*matrix);
    }
    // The nearest rotation in the Frobenius norm is U V^T (Higham 1989, Section 2).
    let svd = matrix.svd(true, true);
    match (svd.u, svd.v_t) {
        (Some(u), Some(v_t)) => Ok(u * v_t),
        _ => Err(invalid("R has no nearest rotation")),
    }
}

fn matrix3(rows: &Rows) -> Option<Matrix3<f64>> {
    let [a, b, c] = rows.0.as_slice() else { return None };
    Some(Matrix3::from_rows(&[vector3(a)?.transpose(), vector3(b)?.transpose(), vector3(c)?.transpose()]))
}

fn vector3(numbers: &Numbers) -> Option<Vector3<f64>> {
    let [x, y, z] = *numbers.0.as_slice() else { return None };
    Some(Vector3::new(x, y, z))
}

fn shape(rows: &Rows) -> String {
    format!("{}x{}", rows.0.len(), rows.0.first().map_or(0, |row| row.0.len()))
}
