//! Given poses of the cameras: people seen by two cameras must lie on each other's epipolar lines. Where another
//! interpretation of the calibration explains the people much better, a suspicion names it.
//!
//! Known limits: already undistorted points are only noticed where poses are given, and errors below the detector's noise are
//! not noticed; they do not affect the result either.

use crate::body::detector_profile::DETECTOR;
use crate::geometry::{Distortion, Intrinsics, Rigid, epipolar};
use crate::session::recording::{Keypoint, Session, View};
use crate::session::suspicion::{Suspicion, SuspicionCode};
use nalgebra::{Matrix3, Vector2, Vector3};

/// Number of frames and of pairs of cameras that are examined.
const MAX_FRAMES: usize = 30;
const MAX_PAIRS: usize = 60;
/// Minimum number of people seen by both cameras of a pair for a warning.
const MIN_PEOPLE: usize = 20;
/// Minimum number of common points for comparing two detections.
const MIN_SHARED: usize = 5;
/// Error below which a calibration is accepted, px; every detector's noise is larger.
const GOOD_PX: f64 = 0.5;
/// Another interpretation must lower the error to this share.
const BETTER: f64 = 0.6;

/// An interpretation of all cameras.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Hypothesis {
    AsGiven,
    AlreadyUndistorted,
    OtherResolution(f64),
    QuarterTurn,
    ThreeQuarterTurn,
    HalfTurn,
    WorldFromCamera,
    TransposedRotation,
    OpenGlAxes,
}

use Hypothesis as H;

impl Hypothesis {
    const OTHERS: [Self; 9] = [
        H::AlreadyUndistorted,
        H::OtherResolution(0.5),
        H::OtherResolution(2.0),
        H::QuarterTurn,
        H::ThreeQuarterTurn,
        H::HalfTurn,
        H::WorldFromCamera,
        H::TransposedRotation,
        H::OpenGlAxes,
    ];

    fn sentence(self) -> String {
        match self {
            H::AsGiven => String::new(),
            H::AlreadyUndistorted => {
                "the keypoints are already undistorted (then remove the distortion from the cameras)".to_owned()
            }
            H::OtherResolution(factor) => {
                format!("the keypoints were detected in images {factor} times as large as the calibrated ones")
            }
            H::QuarterTurn => "the videos were rotated by 90 degrees clockwise".to_owned(),
            H::ThreeQuarterTurn => "the videos were rotated by 90 degrees counter-clockwise".to_owned(),
            H::HalfTurn => "the videos were rotated by 180 degrees".to_owned(),
            H::WorldFromCamera => "R and t map camera to world (they must map world to camera)".to_owned(),
            H::TransposedRotation => "R is transposed (it must map world to camera)".to_owned(),
            H::OpenGlAxes => {
                "the cameras look along -z with y up, as in OpenGL (they must look along +z with y down)".to_owned()
            }
        }
    }

    /// Ideal normalised coordinates of a pixel of the view.
    fn normalized(self, view: &View, pixel: &Vector2<f64>) -> Vector2<f64> {
        let camera = &view.intrinsics;
        let (last_x, last_y) = (f64::from(camera.width) - 1.0, f64::from(camera.height) - 1.0);
        match self {
            H::AlreadyUndistorted => Intrinsics { dist: Distortion::None, ..*camera }.normalized_from_pixel(pixel),
            H::OtherResolution(factor) => camera.normalized_from_pixel(&pixel.map(|c| (c + 0.5) / factor - 0.5)),
            // Undoes the rotation of the image: the position of the pixel in the calibrated image.
            H::QuarterTurn => camera.normalized_from_pixel(&Vector2::new(pixel.y, last_y - pixel.x)),
            H::ThreeQuarterTurn => camera.normalized_from_pixel(&Vector2::new(last_x - pixel.y, pixel.x)),
            H::HalfTurn => camera.normalized_from_pixel(&Vector2::new(last_x - pixel.x, last_y - pixel.y)),
            H::AsGiven | H::WorldFromCamera | H::TransposedRotation | H::OpenGlAxes => {
                camera.normalized_from_pixel(pixel)
            }
        }
    }

    /// Whether it reads the pixels otherwise, and not the poses.
    fn is_about_pixels(self) -> bool {
        !matches!(self, H::AsGiven | H::WorldFromCamera | H::TransposedRotation | H::OpenGlAxes)
    }

    fn pose(self, given: &Rigid) -> Rigid {
        match self {
            H::WorldFromCamera => given.inverse(),
            H::TransposedRotation => Rigid { rotation: given.rotation.transpose(), ..*given },
            H::OpenGlAxes => {
                let flip = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
                Rigid { rotation: flip * given.rotation, translation: flip * given.translation }
            }
            _ => *given,
        }
    }
}

/// The interpretation that explains the people much better than the given one.
pub(super) fn suspicion(session: &Session) -> Option<Suspicion> {
    let (_, evidence) = likeliest(session)?;
    let remedy = "correct the calibration file, or estimate the cameras from the people";
    let suggested_option = Some(r#"{"extrinsics": "estimate"}"#.to_owned());
    Some(Suspicion { suggested_option, ..Suspicion::new(SuspicionCode::GivenPoses, Vec::new(), evidence, remedy) })
}

/// The same where the poses are estimated from the people: another reading of the poses changes nothing then, another reading of
/// the pixels does.
pub(super) fn suspicion_of_pixels(session: &Session) -> Option<Suspicion> {
    let (_, evidence) = likeliest(session).filter(|(hypothesis, _)| hypothesis.is_about_pixels())?;
    let remedy = "correct the calibration file";
    Some(Suspicion::new(SuspicionCode::GivenPoses, Vec::new(), evidence, remedy))
}

/// The likeliest other interpretation, where it is much better, and what speaks for it.
fn likeliest(session: &Session) -> Option<(Hypothesis, String)> {
    let given = epipolar_error_px(session, H::AsGiven).filter(|error| *error > GOOD_PX)?;
    let has_lens = session.views.iter().any(|view| view.intrinsics.dist != Distortion::None);
    let others = H::OTHERS.into_iter().filter(|other| has_lens || *other != H::AlreadyUndistorted);
    let errors = others.filter_map(|other| Some((epipolar_error_px(session, other)?, other)));
    let (error, best) = errors.min_by(|(a, _), (b, _)| a.total_cmp(b))?;
    if error > BETTER * given {
        return None;
    }
    let sentence = best.sentence();
    let evidence = format!(
        "people lie {given:.1} px off the epipolar lines of the given cameras, but only {error:.1} px if {sentence}"
    );
    Some((best, evidence))
}

/// Median distance of people to the epipolar lines of the best matching person in another camera, px.
fn epipolar_error_px(session: &Session, hypothesis: Hypothesis) -> Option<f64> {
    let posed: Vec<(&View, Rigid)> =
        session.views.iter().filter_map(|v| Some((v, hypothesis.pose(&v.camera_from_world?)))).collect();
    let mut errors = Vec::new();
    let pairs = (0..posed.len()).flat_map(|a| (a + 1..posed.len()).map(move |b| (a, b)));
    let step = session.n_frames.div_ceil(MAX_FRAMES).max(1);
    for (a, b) in pairs.take(MAX_PAIRS) {
        let ((one, one_from_world), (other, other_from_world)) = (&posed[a], &posed[b]);
        let other_from_one = *other_from_world * one_from_world.inverse();
        if other_from_one.translation.norm() < 1e-9 {
            continue;
        }
        let essential = epipolar::essential_from_pose(&other_from_one);
        let focal = 0.5 * (one.intrinsics.focal() + other.intrinsics.focal());
        for frame in (0..session.n_frames).step_by(step) {
            let rays = |view: &View| -> Vec<Vec<Option<Vector2<f64>>>> {
                let ray = |keypoint: &Keypoint| {
                    let is_certain = keypoint.confidence >= DETECTOR.judged;
                    is_certain.then(|| hypothesis.normalized(view, &keypoint.pixel))
                };
                view.frames[frame].iter().map(|person| person.keypoints.iter().map(ray).collect()).collect()
            };
            let others = rays(other);
            for person in rays(one) {
                let fits = others.iter().filter_map(|candidate| person_distance(&essential, &person, candidate));
                errors.extend(fits.min_by(f64::total_cmp).map(|distance| distance * focal));
            }
        }
    }
    errors.sort_unstable_by(f64::total_cmp);
    (errors.len() >= MIN_PEOPLE).then(|| errors[errors.len() / 2])
}

/// Mean Sampson distance of the points that both detections have, normalised units.
fn person_distance(
    essential: &Matrix3<f64>,
    one: &[Option<Vector2<f64>>],
    other: &[Option<Vector2<f64>>],
) -> Option<f64> {
    let (mut sum, mut n) = (0.0, 0usize);
    for (a, b) in one.iter().zip(other) {
        if let (Some(a), Some(b)) = (a, b) {
            sum += epipolar::sampson_squared(essential, a, b).sqrt();
            n += 1;
        }
    }
    (n >= MIN_SHARED).then(|| sum / n as f64).filter(|mean| mean.is_finite())
}
