//! Given poses of the cameras: people seen by two cameras must lie on each other's epipolar lines. Where another
//! interpretation of the calibration explains the people much better, or the exchange of two poses, a suspicion names it.
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
/// The poses of two cameras are exchanged for one another where that lowers the error to this share: of many pairs one may be better by
/// chance.
const BETTER_EXCHANGED: f64 = 0.4;
/// Cameras with the largest errors, of which two may be exchanged, and other cameras that each is compared with.
const MAX_CANDIDATES: usize = 6;
const MAX_PARTNERS: usize = 8;

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
    let of_all = likeliest(session).map(|(_, found)| (Vec::new(), "correct the calibration file", found));
    let of_two = exchanged(session)
        .map(|(cameras, found)| (cameras, "exchange R and t of the two cameras, or their keypoint files", found));
    let better = of_all.into_iter().chain(of_two).min_by(|(.., a), (.., b)| a.share().total_cmp(&b.share()));
    let (cameras, correct, found) = better?;
    let remedy = format!("{correct}, or estimate the cameras from the people");
    let suggested_option = Some(r#"{"extrinsics": "estimate"}"#.to_owned());
    Some(Suspicion { suggested_option, ..Suspicion::new(SuspicionCode::GivenPoses, cameras, found.evidence(), remedy) })
}

/// What another interpretation changes.
struct Improvement {
    /// Error as given and in the other way, px.
    errors: [f64; 2],
    /// The cameras, and what is changed, in words.
    of: &'static str,
    what: String,
}

impl Improvement {
    /// What it leaves of the error.
    fn share(&self) -> f64 {
        self.errors[1] / self.errors[0]
    }

    fn evidence(&self) -> String {
        let Self { errors: [given, error], of, what } = self;
        format!("people lie {given:.1} px off the epipolar lines of {of}, but only {error:.1} px if {what}")
    }
}

/// The same where the poses are estimated from the people: another reading of the poses changes nothing then, another reading of
/// the pixels does.
pub(super) fn suspicion_of_pixels(session: &Session) -> Option<Suspicion> {
    let (_, found) = likeliest(session).filter(|(hypothesis, _)| hypothesis.is_about_pixels())?;
    let remedy = "correct the calibration file";
    Some(Suspicion::new(SuspicionCode::GivenPoses, Vec::new(), found.evidence(), remedy))
}

/// The likeliest other interpretation of all cameras, where it is much better.
fn likeliest(session: &Session) -> Option<(Hypothesis, Improvement)> {
    let given = epipolar_error_px(session, H::AsGiven).filter(|error| *error > GOOD_PX)?;
    let has_lens = session.views.iter().any(|view| view.intrinsics.dist != Distortion::None);
    let others = H::OTHERS.into_iter().filter(|other| has_lens || *other != H::AlreadyUndistorted);
    let errors = others.filter_map(|other| Some((epipolar_error_px(session, other)?, other)));
    let (error, best) = errors.min_by(|(a, _), (b, _)| a.total_cmp(b))?;
    let found = Improvement { errors: [given, error], of: "the given cameras", what: best.sentence() };
    (found.share() <= BETTER).then_some((best, found))
}

/// Two cameras that have the pose of each other, by their names.
fn exchanged(session: &Session) -> Option<(Vec<String>, Improvement)> {
    let posed = posed(session, H::AsGiven);
    let error_with = |poses: &[Rigid], involved: &[usize]| {
        let concerned = pairs(posed.len()).filter(|(a, b)| involved.contains(a) || involved.contains(b));
        let errors = |(a, b): (usize, usize)| {
            let [one, other] = [a, b].map(|v| (posed[v].0, poses[v]));
            distances_px(session, H::AsGiven, one, other)
        };
        middle(concerned.take(MAX_PARTNERS * involved.len()).flat_map(errors).collect())
    };
    let given: Vec<Rigid> = posed.iter().map(|(_, pose)| *pose).collect();
    let mut worst: Vec<(f64, usize)> = (0..posed.len()).filter_map(|v| Some((error_with(&given, &[v])?, v))).collect();
    worst.sort_by(|(a, _), (b, _)| b.total_cmp(a));
    worst.truncate(MAX_CANDIDATES);
    let judged = pairs(worst.len()).filter_map(|(i, k)| {
        let (a, b) = (worst[i].1.min(worst[k].1), worst[i].1.max(worst[k].1));
        let as_given = error_with(&given, &[a, b]).filter(|error| *error > GOOD_PX)?;
        let mut poses = given.clone();
        poses.swap(a, b);
        Some((error_with(&poses, &[a, b])?, as_given, [a, b]))
    });
    let (error, as_given, exchanged) = judged.min_by(|(a, ..), (b, ..)| a.total_cmp(b))?;
    tracing::debug!(error, as_given, ?exchanged, "poses of two cameras exchanged");
    let what = "their poses are exchanged".to_owned();
    let found = Improvement { errors: [as_given, error], of: "these cameras", what };
    (found.share() < BETTER_EXCHANGED).then(|| (exchanged.map(|v| posed[v].0.id.clone()).to_vec(), found))
}

/// The views with a pose under a hypothesis.
fn posed(session: &Session, hypothesis: Hypothesis) -> Vec<(&View, Rigid)> {
    session.views.iter().filter_map(|view| Some((view, hypothesis.pose(&view.camera_from_world?)))).collect()
}

fn pairs(n: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..n).flat_map(move |a| (a + 1..n).map(move |b| (a, b)))
}

/// Median distance of people to the epipolar lines of the best matching person in another camera, px.
fn epipolar_error_px(session: &Session, hypothesis: Hypothesis) -> Option<f64> {
    let posed = posed(session, hypothesis);
    let of_pair = |(a, b): (usize, usize)| distances_px(session, hypothesis, posed[a], posed[b]);
    middle(pairs(posed.len()).take(MAX_PAIRS).flat_map(of_pair).collect())
}

/// The median; `None` with fewer than [`MIN_PEOPLE`].
fn middle(mut errors: Vec<f64>) -> Option<f64> {
    errors.sort_unstable_by(f64::total_cmp);
    (errors.len() >= MIN_PEOPLE).then(|| errors[errors.len() / 2])
}

/// Distances of the people of one camera to the epipolar lines of the best matching person in another one, px.
fn distances_px(
    session: &Session,
    hypothesis: Hypothesis,
    (one, one_from_world): (&View, Rigid),
    (other, other_from_world): (&View, Rigid),
) -> Vec<f64> {
    let other_from_one = other_from_world * one_from_world.inverse();
    if other_from_one.translation.norm() < 1e-9 {
        return Vec::new();
    }
    let essential = epipolar::essential_from_pose(&other_from_one);
    let focal = 0.5 * (one.intrinsics.focal() + other.intrinsics.focal());
    let rays = |view: &View, frame: usize| -> Vec<Vec<Option<Vector2<f64>>>> {
        let ray = |keypoint: &Keypoint| {
            let is_certain = keypoint.confidence >= DETECTOR.judged;
            is_certain.then(|| hypothesis.normalized(view, &keypoint.pixel))
        };
        view.frames[frame].iter().map(|person| person.keypoints.iter().map(ray).collect()).collect()
    };
    let mut errors = Vec::new();
    for frame in (0..session.n_frames).step_by(session.n_frames.div_ceil(MAX_FRAMES).max(1)) {
        let others = rays(other, frame);
        for person in rays(one, frame) {
            let fits = others.iter().filter_map(|candidate| person_distance(&essential, &person, candidate));
            errors.extend(fits.min_by(f64::total_cmp).map(|distance| distance * focal));
        }
    }
    errors
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
