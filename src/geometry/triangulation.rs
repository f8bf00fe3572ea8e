//! Linear triangulation of points from two or more views.

use super::rigid::Rigid;
use nalgebra::{Matrix3, Vector2, Vector3};

/// The observation of a point in one of the views.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointObservation<'a> {
    /// The view's pose.
    pub camera_from_world: &'a Rigid,
    /// Ideal normalised coordinates.
    pub normalized: Vector2<f64>,
    /// Weight, not negative; observations of weight zero are ignored.
    pub weight: f64,
}

/// Normal matrices with a determinant below this share of that of an isotropic matrix are singular: for two rays, an
/// angle of some 0.06 degrees.
const MIN_DETERMINANT: f64 = 1e-6;

/// What a ray asks of a point x: `P (x - C)` is to vanish, with `P = I - n n^T` for the ray's direction n and the camera's centre C.
#[derive(Debug, Clone, Copy)]
pub struct RayConstraint {
    /// `P`.
    across: Matrix3<f64>,
    /// `P C`.
    right: Vector3<f64>,
}

impl RayConstraint {
    /// Of the ray that an observation shows.
    pub fn of(observation: &PointObservation<'_>) -> Self {
        let camera = observation.camera_from_world;
        let direction = camera.rotation.tr_mul(&observation.normalized.push(1.0)).normalize();
        let across = Matrix3::identity() - direction * direction.transpose();
        Self { across, right: across * camera.center() }
    }
}

/// The point nearest to all rays: `min_x sum w |(I - n n^T)(x - C)|^2`, metres in the world.
///
/// `None` with fewer than two rays, with nearly parallel rays, or where the point is behind one of the cameras. Errors
/// are metric, not angular: distant cameras weigh as much as near ones.
pub fn triangulate_linear(observations: &[PointObservation<'_>]) -> Option<Vector3<f64>> {
    let seen = || observations.iter().filter(|s| s.weight > 0.0);
    let point = nearest_point(seen().map(|s| (RayConstraint::of(s), s.weight)))?;
    seen().all(|s| s.camera_from_world.transform(&point).z > 0.0).then_some(point)
}

/// The point nearest to all rays with their weights; `None` where they do not determine one.
pub fn nearest_point(rays: impl Iterator<Item = (RayConstraint, f64)>) -> Option<Vector3<f64>> {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (ray, weight) in rays {
        normal += ray.across * weight;
        right += ray.right * weight;
    }
    // Cramer's rule: the rows of the adjugate of a symmetric matrix are cross products of its columns.
    let [a, b, c] = [0, 1, 2].map(|i| normal.column(i).into_owned());
    let (bc, mean) = (b.cross(&c), normal.trace() / 3.0);
    let determinant = a.dot(&bc);
    let is_solvable = determinant > MIN_DETERMINANT * mean * mean * mean;
    let products = Vector3::new(bc.dot(&right), c.cross(&a).dot(&right), a.cross(&b).dot(&right));
    is_solvable.then(|| products / determinant)
}

/// The midpoint of the shortest segment between two rays (first camera's frame), and whether it is in front of both cameras.
///
/// Minimises `|s u - (c + t v)|^2` over the depths s, t: a 2x2 system. `None` for rays at less than 0.06 degrees.
pub fn midpoint(second_from_first: &Rigid, a: &Vector2<f64>, b: &Vector2<f64>) -> Option<(Vector3<f64>, bool)> {
    let center = second_from_first.center();
    let u = Vector3::new(a.x, a.y, 1.0);
    let v = second_from_first.rotation.transpose() * Vector3::new(b.x, b.y, 1.0);
    let (uu, vv, uv) = (u.dot(&u), v.dot(&v), u.dot(&v));
    let det = uu * vv - uv * uv;
    if det < MIN_DETERMINANT * uu * vv {
        return None;
    }
    let (uc, vc) = (u.dot(&center), v.dot(&center));
    let s = (uc * vv - vc * uv) / det;
    let t = (uc * uv - vc * uu) / det;
    Some(((u * s + center + v * t) * 0.5, s > 0.0 && t > 0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::rotation;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Cameras on a circle of 5 m that look at its middle.
    fn ring(n: usize) -> Vec<Rigid> {
        let turn = |i: usize| rotation::exp(&(Vector3::y() * (i as f64 * 0.9)));
        (0..n).map(|i| Rigid { rotation: turn(i), translation: Vector3::z() * 5.0 }).collect()
    }

    fn observations<'a>(cameras: &'a [Rigid], point: &Vector3<f64>) -> Vec<PointObservation<'a>> {
        let see = |camera: &'a Rigid| {
            let p = camera.transform(point);
            PointObservation { camera_from_world: camera, normalized: p.xy() / p.z, weight: 1.0 }
        };
        cameras.iter().map(see).collect()
    }

    #[test]
    fn exact_rays_give_the_exact_point() {
        let cameras = ring(5);
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for _ in 0..100 {
            let point = Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0));
            let mut seen = observations(&cameras, &point);
            assert!((triangulate_linear(&seen).unwrap() - point).norm() < 1e-13);
            assert!((triangulate_linear(&seen[1..3]).unwrap() - point).norm() < 1e-13);
            seen[0].normalized.x += 1.0;
            seen[0].weight = 0.0;
            assert!((triangulate_linear(&seen).unwrap() - point).norm() < 1e-13, "weight zero");
        }
    }

    #[test]
    fn undetermined_points_are_none() {
        let cameras = ring(3);
        let seen = observations(&cameras, &Vector3::zeros());
        assert_eq!(triangulate_linear(&[]), None);
        assert_eq!(triangulate_linear(&seen[..1]), None);
        assert_eq!(triangulate_linear(&[seen[0], seen[0]]), None, "parallel");
        // Rays that diverge in front of two cameras side by side meet behind them.
        let side = Rigid { translation: Vector3::x() * -1.0, ..Rigid::identity() };
        let apart =
            |camera, x| PointObservation { camera_from_world: camera, normalized: Vector2::new(x, 0.0), weight: 1.0 };
        let origin = Rigid::identity();
        assert_eq!(triangulate_linear(&[apart(&origin, -0.2), apart(&side, 0.2)]), None);
        assert!(triangulate_linear(&[apart(&origin, 0.2), apart(&side, -0.2)]).is_some());
        assert_eq!(triangulate_linear(&[apart(&origin, f64::NAN), apart(&side, 0.2)]), None);
    }
}
