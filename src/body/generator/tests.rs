//! Tests of the generator's parts; `tests/body` tests the embedded body.

use super::tubes::{body_distance, body_gradient};
use super::*;

/// The figure's distance is exact to first order: steps along the gradient end on the surface.
#[test]
fn a_step_by_the_distance_ends_on_the_surface() {
    let tubes = figure::figure(&Population::ansur2());
    for k in 0..200 {
        let (u, v, w) = (f64::from(k * 37 % 100) / 100.0, f64::from(k * 61 % 100) / 100.0, f64::from(k % 10) / 10.0);
        let mut point = Vector3::new(u * 0.8, v * 1.7, w * 0.3 - 0.15);
        if body_distance(&tubes, &point).abs() > 0.03 {
            continue;
        }
        for _ in 0..6 {
            let gradient = body_gradient(&tubes, &point);
            point -= gradient * (body_distance(&tubes, &point) / gradient.norm_squared());
        }
        assert!(body_distance(&tubes, &point).abs() < 2e-4, "{point:?}: {}", body_distance(&tubes, &point));
    }
}

/// The crown moves by the standard deviation of stature per unit of beta 0, the sole does not move.
#[test]
fn crown_and_sole_move_with_stature() {
    let tubes = figure::figure(&Population::ansur2());
    let crown = surface_directions(&tubes, &Vector3::new(0.0, 1.692, 0.005));
    assert!((crown[(1, 0)] - 0.09214).abs() < 1e-6);
    assert!((1..10).all(|k| crown[(1, k)].abs() < 1e-9));
    let sole = surface_directions(&tubes, &Vector3::new(0.09, 0.0, 0.12));
    assert!((0..10).all(|k| sole[(1, k)].abs() < 1e-9));
}
