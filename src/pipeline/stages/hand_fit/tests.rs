//! Derivatives of the fit against differences, and a hand that is found again.

use super::observations::HandPixel;
use super::problem::{Hand, HandProblem, HandState};
use super::state::{FIRST_ANGLE, FramedHand, N_UNKNOWNS, Unknowns, Wrist};
use super::terms::{FrameSystem, Known, add_pixels};
use crate::body::hand::{HandShape, Side, hand_points, hinge_ranges};
use crate::geometry::rotation::exp;
use crate::geometry::{Intrinsics, Rigid};
use crate::optim::levenberg_marquardt::{Stopping, minimize};
use crate::pipeline::calibration::PosedCamera;
use crate::progress::Progress;
use crate::residuals::derivative_check::assert_gradient;
use nalgebra::{Vector2, Vector3};

fn cameras() -> Vec<PosedCamera> {
    let turned = |angle: f64| Rigid {
        rotation: exp(&(Vector3::y() * angle)),
        translation: Vector3::new(0.1 * angle, -1.2, 3.0),
    };
    [-1.0, 0.2, 1.3]
        .map(|angle| PosedCamera { intrinsics: Intrinsics::PLAIN, camera_from_world: turned(angle) })
        .to_vec()
}

fn wrist(t: usize) -> Wrist {
    let w = Vector3::new(0.3, 1.1, 0.1) + Vector3::x() * 0.01 * t as f64;
    Wrist { place: w, rotation: exp(&Vector3::new(0.4, -0.3, 0.02 * t as f64)) }
}

fn bent(t: usize) -> Unknowns {
    let ranges = hinge_ranges();
    Unknowns::from_fn(|column, _| match column.checked_sub(FIRST_ANGLE) {
        Some(h) => ranges[h].rest + 0.8 * ranges[h].spread * (0.1 * t as f64 + h as f64).sin(),
        None => 0.0,
    })
}

fn pixels(t: usize, unknowns: &Unknowns, size: f64, cameras: &[PosedCamera]) -> Vec<HandPixel> {
    let framed = FramedHand::new(&HandShape::average(Side::Left), &wrist(t), size, unknowns);
    let mut pixels = Vec::new();
    for (camera, placed) in cameras.iter().enumerate() {
        for point in hand_points() {
            let in_camera = placed.camera_from_world.transform(&framed.hand.point(point));
            let pixel = placed.intrinsics.pixel_from_camera(&in_camera).unwrap();
            pixels.push(HandPixel { camera, point, pixel, size_px: placed.intrinsics.focal() * 0.187 / in_camera.z });
        }
    }
    pixels
}

#[test]
fn derivatives_match_differences() {
    let (cameras, shape, known) = (cameras(), HandShape::average(Side::Left), Known::new());
    let seen: Vec<HandPixel> = pixels(0, &bent(0), 1.05, &cameras)
        .into_iter()
        .map(|pixel| HandPixel { pixel: pixel.pixel + Vector2::new(1.0, -2.0), ..pixel })
        .collect();
    let start = bent(4) + Unknowns::from_fn(|column, _| 0.01 * (column as f64).cos());
    let system = |d: &[f64]| {
        let unknowns = start + Unknowns::from_column_slice(&d[..N_UNKNOWNS]);
        let framed = FramedHand::new(&shape, &wrist(0), d[N_UNKNOWNS].exp(), &unknowns);
        let mut system = FrameSystem::zeros();
        add_pixels(&mut system, &framed, &seen, &cameras, 0.2, true);
        known.add(&mut system, &unknowns);
        system
    };
    let at = system(&[0.0; N_UNKNOWNS + 1]);
    let gradient: Vec<f64> = at.gradient.iter().copied().chain([at.size[0]]).collect();
    assert_gradient(&gradient, |d| system(d).cost);
}

#[test]
fn finds_a_moving_hand_and_its_size_again() {
    let (cameras, n) = (cameras(), 12);
    let truth: Vec<Unknowns> = (0..n).map(bent).collect();
    let seen: Vec<Vec<HandPixel>> = (0..n).map(|t| pixels(t, &truth[t], 1.06, &cameras)).collect();
    let hands = [Hand { shape: HandShape::average(Side::Left), wrists: (0..n).map(wrist).collect(), pixels: &seen }];
    let mut problem = HandProblem {
        hands: &hands,
        cameras: &cameras,
        share: 0.2,
        frame_interval: 1.0 / 30.0,
        log_size_of_body: Some(0.0),
        known: Known::new(),
    };
    let rest = Unknowns::from_fn(|column, _| column.checked_sub(FIRST_ANGLE).map_or(0.0, |h| hinge_ranges()[h].rest));
    let mut state = HandState { frames: vec![vec![rest; n]], log_size: 0.0 };
    let stopping = Stopping { max_iterations: 15, relative_decrease: 1e-6 };
    for share in [0.2, 0.05, 0.01] {
        problem.share = share;
        state = minimize(&problem, state, &stopping, &Progress::silent()).unwrap().state;
    }
    let place = |unknowns: &Unknowns, t: usize, size: f64| {
        FramedHand::new(&hands[0].shape, &wrist(t), size, unknowns).hand.joints()
    };
    let mut worst: f64 = 0.0;
    for t in 0..n {
        let (found, expected) = (place(&state.frames[0][t], t, state.log_size.exp()), place(&truth[t], t, 1.06));
        worst = found.iter().zip(&expected).map(|(a, b)| (a - b).norm()).fold(worst, f64::max);
    }
    assert!(worst < 0.003, "{worst} m"); // priors draw exact observations by 1 to 2 mm
    assert!((state.log_size - 1.06_f64.ln()).abs() < 0.01, "{}", state.log_size);
}
