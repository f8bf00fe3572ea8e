//! The pose of a camera from three known points.
//!
//! First the depths, then the pose: the law of cosines in the three triangles (centre, point i, point j) gives the
//! depths' ratios (Grunert's system; Haralick et al., IJCV 13(3), 1994, Eqs. (1) to (3)), reduced here to one quartic.

use super::polynomial;
use super::rigid::Rigid;
use nalgebra::{Matrix3, Vector2, Vector3};

/// A point in the world and the ideal normalised coordinates of its image.
pub type PointCorrespondence = (Vector3<f64>, Vector2<f64>);

/// The camera poses (`camera_from_world`) consistent with three points: at most four, all depths positive.
///
/// Empty where the points lie on a line, or two of them on one ray. For cameras on the danger cylinder (through the
/// points, perpendicular to their plane) solutions coincide and may be lost to rounding.
pub fn p3p(points: &[PointCorrespondence; 3]) -> Vec<Rigid> {
    let Some(triangles) = Triangles::new(points) else {
        return Vec::new();
    };
    let mut poses = Vec::with_capacity(4);
    for depths in triangles.approximate_depths() {
        let Some(depths) = triangles.polish(depths) else {
            continue;
        };
        if let Some(pose) = pose_from_depths(points, &triangles.directions, &depths) {
            poses.push(pose);
        }
    }
    poses
}

/// The three triangles at the camera's centre; entry k belongs to the side opposite to point k.
struct Triangles {
    /// Unit vectors towards the points.
    directions: [Vector3<f64>; 3],
    /// Cosines of the angles at the centre: of points (1, 2), (2, 0), (0, 1).
    cosines: Vector3<f64>,
    /// Squared lengths of the sides (1, 2), (2, 0), (0, 1).
    sides2: Vector3<f64>,
}

/// Divisors of the elimination below this count as zero: their root is double and known to half the digits.
const SMALL_DIVISOR: f64 = 1e-4;

impl Triangles {
    fn new(points: &[PointCorrespondence; 3]) -> Option<Self> {
        let directions = points.map(|(_, n)| n.push(1.0).normalize());
        let side = |k: usize| ((k + 1) % 3, (k + 2) % 3);
        let cosines = Vector3::from_fn(|k, _| directions[side(k).0].dot(&directions[side(k).1]));
        let sides2 = Vector3::from_fn(|k, _| (points[side(k).0].0 - points[side(k).1].0).norm_squared());
        (sides2.min() > 0.0).then_some(Self { directions, cosines, sides2 })
    }

    /// Depths from the quartic in `v = d_2 / d_0`, with `u = d_1 / d_0`.
    ///
    /// With `T = 1 - 2 v c_02 + v^2`, `a = s_12 / s_02`, `b = s_01 / s_02` the law of cosines gives
    /// (i) `u^2 + v^2 - 2 u v c_12 = a T` and (ii) `1 + u^2 - 2 u c_01 = b T`. Their difference is linear in u:
    /// `u = N / D`, `N = (a - b) T - v^2 + 1`, `D = 2 (c_01 - v c_12)`; inserted in (ii):
    /// `D^2 + N^2 - 2 c_01 N D - b T D^2 = 0`.
    fn approximate_depths(&self) -> Vec<Vector3<f64>> {
        let (c12, c02, c01) = (self.cosines[0], self.cosines[1], self.cosines[2]);
        let (a, b) = (self.sides2[0] / self.sides2[1], self.sides2[2] / self.sides2[1]);
        let t = [1.0, -2.0 * c02, 1.0];
        let n = [(a - b) * t[0] + 1.0, (a - b) * t[1], (a - b) * t[2] - 1.0];
        let d = [2.0 * c01, -2.0 * c12];
        let d2 = [d[0] * d[0], 2.0 * d[0] * d[1], d[1] * d[1]];
        let mut quartic = [0.0; 5];
        for i in 0..3 {
            quartic[i] += d2[i];
            for j in 0..3 {
                quartic[i + j] += n[i] * n[j] - b * t[i] * d2[j];
            }
            for j in 0..2 {
                quartic[i + j] -= 2.0 * c01 * n[i] * d[j];
            }
        }
        let mut depths = Vec::with_capacity(4);
        for &v in polynomial::real_roots(&quartic).as_slice() {
            let t_at = t[0] + v * (t[1] + v * t[2]);
            let d_at = d[0] + v * d[1];
            let nearest = (self.sides2[1] / t_at).sqrt();
            let mut push = |u: f64| depths.push(Vector3::new(1.0, u, v) * nearest);
            if d_at.abs() > SMALL_DIVISOR {
                push((n[0] + v * (n[1] + v * n[2])) / d_at);
            } else {
                // (i) and (ii) are the same equation in u: both roots of (ii) are solutions.
                let root = (c01 * c01 - 1.0 + b * t_at).max(0.0).sqrt();
                push(c01 + root);
                push(c01 - root);
            }
        }
        depths
    }

    /// Newton's method on the law of cosines; `None` where it does not converge to positive depths.
    fn polish(&self, start: Vector3<f64>) -> Option<Vector3<f64>> {
        const STEPS: usize = 5;
        let tolerance = 1e-10 * self.sides2.max();
        let mut d = start;
        for _ in 0..STEPS {
            let mut residual = Vector3::zeros();
            let mut jacobian = Matrix3::zeros();
            for k in 0..3 {
                let (i, j) = ((k + 1) % 3, (k + 2) % 3);
                residual[k] = d[i] * d[i] + d[j] * d[j] - 2.0 * d[i] * d[j] * self.cosines[k] - self.sides2[k];
                jacobian[(k, i)] = 2.0 * (d[i] - d[j] * self.cosines[k]);
                jacobian[(k, j)] = 2.0 * (d[j] - d[i] * self.cosines[k]);
            }
            if residual.amax() < 1e-3 * tolerance {
                break;
            }
            d -= jacobian.try_inverse()? * residual;
        }
        let closed = |k: usize| {
            let (i, j) = ((k + 1) % 3, (k + 2) % 3);
            let side2 = d[i] * d[i] + d[j] * d[j] - 2.0 * d[i] * d[j] * self.cosines[k];
            (side2 - self.sides2[k]).abs() < tolerance
        };
        (d.min() > 0.0 && (0..3).all(closed)).then_some(d)
    }
}

/// The rigid motion from the world's triangle to the camera's, from the frames that both span.
fn pose_from_depths(
    points: &[PointCorrespondence; 3],
    directions: &[Vector3<f64>; 3],
    depths: &Vector3<f64>,
) -> Option<Rigid> {
    let seen = [directions[0] * depths[0], directions[1] * depths[1], directions[2] * depths[2]];
    let known = [points[0].0, points[1].0, points[2].0];
    let rotation = triangle_frame(&seen)? * triangle_frame(&known)?.transpose();
    Some(Rigid { rotation, translation: seen[0] - rotation * known[0] })
}

/// Axes: along the first side, across it in the plane, across the plane; `None` for points on a line.
fn triangle_frame(corners: &[Vector3<f64>; 3]) -> Option<Matrix3<f64>> {
    let along = (corners[1] - corners[0]).try_normalize(0.0)?;
    let other = corners[2] - corners[0];
    let across_plane = along.cross(&other).try_normalize(1e-9 * other.norm())?;
    Some(Matrix3::from_columns(&[along, across_plane.cross(&along), across_plane]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::rotation;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn observe(pose: &Rigid, point: Vector3<f64>) -> PointCorrespondence {
        let seen = pose.transform(&point);
        (point, seen.xy() / seen.z)
    }

    #[test]
    fn three_exact_points_give_the_true_pose() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut found = 0;
        for _ in 0..1000 {
            let mut random = || Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0));
            let pose = Rigid { rotation: rotation::exp(&(random() * 2.0)), translation: random() + Vector3::z() * 4.0 };
            let points = [observe(&pose, random()), observe(&pose, random()), observe(&pose, random())];
            let poses = p3p(&points);
            for candidate in &poses {
                for (x, n) in &points {
                    let seen = candidate.transform(x);
                    assert!(seen.z > 0.0 && (seen.xy() / seen.z - n).norm() < 1e-6);
                }
            }
            let near = |p: &Rigid| (p.rotation - pose.rotation).norm() + (p.translation - pose.translation).norm();
            found += poses.iter().any(|p| near(p) < 1e-6) as usize;
        }
        assert!(found >= 998, "{found} of 1000");
    }

    #[test]
    fn solves_an_equilateral_triangle_seen_along_its_axis() {
        // Every ratio is 1 and the elimination's divisor vanishes.
        let pose = Rigid { rotation: Matrix3::identity(), translation: Vector3::z() * 3.0 };
        let corner = |k: usize| {
            let (sine, cosine) = (k as f64 * std::f64::consts::TAU / 3.0).sin_cos();
            observe(&pose, Vector3::new(cosine, sine, 0.0))
        };
        let poses = p3p(&[corner(0), corner(1), corner(2)]);
        assert!(poses.iter().any(|p| (p.translation - pose.translation).norm() < 1e-6), "{poses:?}");
    }

    #[test]
    fn degenerate_triangles_have_no_pose() {
        let pose = Rigid { rotation: Matrix3::identity(), translation: Vector3::z() * 3.0 };
        let on_line = [0.0, 0.5, 1.0].map(|x| observe(&pose, Vector3::x() * x));
        assert!(p3p(&on_line).is_empty());
        assert!(p3p(&[on_line[0]; 3]).is_empty());
        assert!(p3p(&[(Vector3::repeat(f64::NAN), Vector2::zeros()); 3]).is_empty());
    }
}
