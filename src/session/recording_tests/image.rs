//! The keypoints against the image: size, orientation, principal point and unit of the coordinates.

use super::quarter_turn::quarter_turn;
use crate::body::detector_profile::DETECTOR;
use crate::body::skeleton::KeypointConvention;
use crate::geometry::{Intrinsics, Rigid};
use crate::session::recording::{Keypoint, Session, View};
use crate::session::suspicion::{Suspicion, SuspicionCode};
use nalgebra::{Vector2, Vector3};

/// Minimum number of points for a suspicion.
const MIN_POINTS: usize = 200;
/// Share of points that a detector may place outside its image.
const OUTSIDE: f64 = 0.05;
/// If all people stay within this share of the image's width and height, the image probably has half the size, unless they are nearer to
/// its middle than to that of its upper left quarter: cameras are aimed at people.
const NEAR_ORIGIN: f64 = 0.55;
/// Coordinates below this are no pixels of an image of at least [`LEAST_WIDTH`] px: people fill more than its corner.
const UNIT_RANGE: f64 = 2.0;
const LEAST_WIDTH: u32 = 64;
/// Distance of the principal point from the image's centre, as a share of the size, that only a wrong matrix K explains:
/// lenses are centred to some 3 %, shift lenses and crops to 10 %.
const OFF_CENTRE: f64 = 0.2;
/// The same distance under the interpretation that explains it.
const CENTRED: f64 = 0.1;
/// In nearly square images an exchange of `cx` and `cy` moves the principal point less: from beyond what shifted lenses have to
/// where most lenses are.
const SHIFTED: f64 = 0.12;
const WELL_CENTRED: f64 = 0.05;

/// Compares the keypoints and the principal point of every view with its image.
pub(super) fn suspicions(session: &Session) -> Vec<Suspicion> {
    let size = |view: &View| (view.intrinsics.width, view.intrinsics.height);
    let found: Vec<(&View, Found)> =
        session.views.iter().filter_map(|view| Some((view, found(session.convention, view)?))).collect();
    // Images that are stated alike were resized alike; people walk farther through some of them.
    let largest_alike = |view: &View| {
        let alike = found.iter().filter(|(other, _)| size(other) == size(view));
        alike.filter_map(|(_, found)| found.image_scale).reduce(f64::max)
    };
    let suspicion = |(view, found): &(&View, Found)| {
        let evidence = format!("images of {}x{}: {}", view.intrinsics.width, view.intrinsics.height, found.evidence);
        let suspicion = Suspicion::new(found.code, vec![view.id.clone()], evidence, found.remedy);
        Suspicion { image_scale: found.image_scale.and_then(|_| largest_alike(view)), ..suspicion }
    };
    found.iter().map(suspicion).collect()
}

/// A mistake in the files of a view.
struct Found {
    code: SuspicionCode,
    evidence: String,
    remedy: &'static str,
    /// Smallest usual size of images that hold all keypoints, over the stated one.
    image_scale: Option<f64>,
}

impl Found {
    fn new(code: SuspicionCode, evidence: String, remedy: &'static str) -> Self {
        Self { code, evidence, remedy, image_scale: None }
    }

    /// The same, or images that were turned after the calibration, where people lie in them and say which way.
    fn or_turned(self, convention: KeypointConvention, view: &View) -> Self {
        let Some(turn) = quarter_turn(convention, view) else { return self };
        let evidence =
            format!("{}; people lie on their sides, as after a turn of the images {}", self.evidence, turn.name());
        let remedy = "turn K with the images, or detect people in the unturned video";
        Self::new(SuspicionCode::Rotated, evidence, remedy)
    }
}

fn found(convention: KeypointConvention, view: &View) -> Option<Found> {
    let size = Vector2::new(f64::from(view.intrinsics.width), f64::from(view.intrinsics.height));
    of_keypoints(convention, view, size).or_else(|| of_principal_point(convention, view))
}

fn of_keypoints(convention: KeypointConvention, view: &View, size: Vector2<f64>) -> Option<Found> {
    let keypoints = view.frames.iter().flatten().flat_map(|detection| &detection.keypoints);
    let is_certain = |keypoint: &&Keypoint| keypoint.confidence >= DETECTOR.judged;
    let pixels: Vec<Vector2<f64>> = keypoints.filter(is_certain).map(|keypoint| keypoint.pixel).collect();
    let n = pixels.len();
    if n < MIN_POINTS {
        return None;
    }
    let share_outside = |size: Vector2<f64>| {
        let outside = |p: &&Vector2<f64>| p.x < -1.0 || p.y < -1.0 || p.x > size.x || p.y > size.y;
        pixels.iter().filter(outside).count() as f64 / n as f64
    };
    let holds_all = |size: Vector2<f64>| share_outside(size) < 0.2 * OUTSIDE;
    if view.intrinsics.width >= LEAST_WIDTH && holds_all(Vector2::repeat(UNIT_RANGE)) {
        let evidence = format!("all its keypoints lie between 0 and {UNIT_RANGE}: they are shares of the image's size");
        let remedy = "multiply them by the image's width and height";
        return Some(Found::new(SuspicionCode::NormalizedCoordinates, evidence, remedy));
    }
    let image_scale = SIZES.into_iter().find(|scale| holds_all(*scale * size));
    let outside = share_outside(size);
    if outside > OUTSIDE {
        let turned = size.yx();
        if turned != size && holds_all(turned) {
            let evidence = "its keypoints fit an image with width and height exchanged".to_owned();
            let remedy = "was the video rotated by 90 degrees? calibrate it as it is";
            return Some(Found::new(SuspicionCode::Rotated, evidence, remedy).or_turned(convention, view));
        }
        let evidence = format!("its keypoints lie outside the image ({:.0} % of them)", 100.0 * outside);
        let remedy = "does the calibration belong to another resolution?";
        return Some(Found { image_scale, ..Found::new(SuspicionCode::Resolution, evidence, remedy) });
    }
    // Halfway, along the diagonal, between the middles of the quarter and of the image.
    let middle = pixels.iter().sum::<Vector2<f64>>().component_div(&size) / n as f64;
    (holds_all(NEAR_ORIGIN * size) && middle.sum() < 0.75).then(|| {
        let evidence = "all its keypoints lie in the upper left quarter".to_owned();
        let remedy = "were they detected at half the calibration's resolution?";
        Found { image_scale, ..Found::new(SuspicionCode::Resolution, evidence, remedy) }
    })
}

/// Usual sizes of images over each other, and how far a principal point that is off the centre moves their ratio.
const SIZES: [f64; 10] = [0.25, 1.0 / 3.0, 0.5, 2.0 / 3.0, 0.75, 4.0 / 3.0, 1.5, 2.0, 3.0, 4.0];
const NEAR_SIZE: f64 = 0.05;

/// What explains a principal point that is far from the centre.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Centre {
    Exchanged,
    OtherSize(f64),
    Unexplained,
}

fn of_principal_point(convention: KeypointConvention, view: &View) -> Option<Found> {
    let (cx, cy) = (view.intrinsics.cx + 0.5, view.intrinsics.cy + 0.5);
    let off = format!("the principal point ({cx:.0}, {cy:.0}) is far from the centre");
    Some(match centre(&view.intrinsics)? {
        Centre::Exchanged => {
            let evidence = format!("{off}, and near it with cx and cy exchanged");
            let remedy = "exchange cx and cy, or calibrate the video in the orientation of its keypoints";
            Found::new(SuspicionCode::PrincipalPoint, evidence, remedy).or_turned(convention, view)
        }
        Centre::OtherSize(factor) => {
            let evidence = format!("{off}: K belongs to images {factor:.2} times as large");
            Found::new(SuspicionCode::Resolution, evidence, "give K for the resolution of the keypoints")
        }
        Centre::Unexplained => {
            Found::new(SuspicionCode::PrincipalPoint, off, "check the matrix K, and whether the images were cropped")
        }
    })
}

/// `None` where the principal point is as usual.
fn centre(intrinsics: &Intrinsics) -> Option<Centre> {
    let size = Vector2::new(f64::from(intrinsics.width), f64::from(intrinsics.height));
    let (cx, cy) = (intrinsics.cx + 0.5, intrinsics.cy + 0.5);
    let distance = |x: f64, y: f64| (x / size.x - 0.5).abs().max((y / size.y - 0.5).abs());
    let (given, exchanged) = (distance(cx, cy), distance(cy, cx));
    let is_exchanged = given > SHIFTED && exchanged < WELL_CENTRED;
    if given < OFF_CENTRE && !is_exchanged {
        return None;
    }
    if is_exchanged || exchanged < CENTRED {
        return Some(Centre::Exchanged);
    }
    let factor = cx / size.x + cy / size.y;
    let is_of_other_size = factor > 0.0 && distance(cx / factor, cy / factor) < CENTRED;
    Some(if is_of_other_size { Centre::OtherSize(factor) } else { Centre::Unexplained })
}

/// The intrinsics with the principal point near the centre, where that has one explanation.
pub fn centred(intrinsics: &Intrinsics) -> Option<Intrinsics> {
    match centre(intrinsics)? {
        Centre::Exchanged => Some(Intrinsics { cx: intrinsics.cy, cy: intrinsics.cx, ..*intrinsics }),
        Centre::OtherSize(factor) => {
            let (width, height) = (intrinsics.width, intrinsics.height);
            let usual = SIZES.into_iter().find(|usual| (factor / usual).ln().abs() < NEAR_SIZE);
            let factor = usual.unwrap_or(factor);
            Some(Intrinsics { width, height, ..intrinsics.resized(1.0 / factor) })
        }
        Centre::Unexplained => None,
    }
}

/// Lens and given pose of the camera turned with its images, where people say which way those were turned after its calibration.
pub fn turned_with_images(convention: KeypointConvention, view: &View) -> Option<(Intrinsics, Option<Rigid>)> {
    let turn = quarter_turn(convention, view)?;
    let stated = view.intrinsics;
    let calibrated = match centre(&stated) {
        Some(Centre::Exchanged) => Intrinsics { width: stated.height, height: stated.width, ..stated },
        _ => stated,
    };
    let turned_from_calibrated = Rigid { rotation: turn.rotation(), translation: Vector3::zeros() };
    let turned_from_world = view.camera_from_world.map(|from_world| turned_from_calibrated * from_world);
    Some((turn.of_lens(&calibrated)?, turned_from_world))
}
