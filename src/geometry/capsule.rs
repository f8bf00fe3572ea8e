//! Tapered capsules: unions of balls whose centre moves along a segment while the radius changes linearly.
//!
//! `d(p) = min over s in [0, 1] of |p - c(s)| - r(s)`, `c(s) = (1 - s) e_0 + s e_1`, `r(s) = (1 - s) r_0 + s r_1`. The term
//! under the minimum is convex, so every local minimum is global; by the envelope theorem the derivative is that of the
//! nearest ball alone: `dd = n . dp - n . dc - dr`.

use super::rotation::any_perpendicular;
use nalgebra::Vector3;

/// A tapered capsule: the union of all balls between two end balls.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TaperedCapsule {
    /// Centres of the balls at the ends, m.
    pub ends: [Vector3<f64>; 2],
    /// Radii of these balls, m.
    pub radii: [f64; 2],
}

/// Signed distance of a point to a capsule, and the nearest ball.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointDistance {
    /// Negative inside, m.
    pub distance: f64,
    /// Position of the nearest ball's centre between the ends, 0 to 1.
    pub share: f64,
    /// Unit vector from that centre to the point: the derivative of the distance to the point.
    pub normal: Vector3<f64>,
}

/// Signed distance of two capsules `a` and `b`, and their two nearest balls.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CapsuleDistance {
    /// Distance of the two nearest balls, m; negative where they overlap.
    pub distance: f64,
    /// Positions of the balls' centres between the ends of `a` and of `b`, 0 to 1.
    pub shares: [f64; 2],
    /// Unit vector from the centre in `a` to that in `b`: the derivative of the distance by the centre in `b`, and its
    /// negative by the centre in `a`.
    pub normal: Vector3<f64>,
}

impl TaperedCapsule {
    /// Centre of the ball at `share` of the way.
    pub fn centre(&self, share: f64) -> Vector3<f64> {
        self.ends[0].lerp(&self.ends[1], share)
    }

    /// Radius of the ball at `share` of the way, m.
    pub fn radius(&self, share: f64) -> f64 {
        self.radii[0] + share * (self.radii[1] - self.radii[0])
    }

    fn along(&self) -> Vector3<f64> {
        self.ends[1] - self.ends[0]
    }

    fn taper(&self) -> f64 {
        self.radii[1] - self.radii[0]
    }

    /// The signed distance of a point.
    ///
    /// The stationary share lies `h g / (L sqrt(L^2 - g^2))` beyond the foot of the perpendicular, with the length L, the
    /// taper `g = r_1 - r_0` and the distance h from the axis. Where one end ball contains the other it is the capsule. On
    /// the axis the normal is any vector perpendicular to it.
    pub fn distance_to(&self, point: &Vector3<f64>) -> PointDistance {
        let (along, taper) = (self.along(), self.taper());
        let length_squared = along.norm_squared();
        let share = if length_squared <= taper * taper {
            if taper > 0.0 { 1.0 } else { 0.0 }
        } else {
            let offset = point - self.ends[0];
            let foot = offset.dot(&along) / length_squared;
            let height = (offset - along * foot).norm();
            (foot + height * taper / (length_squared * (length_squared - taper * taper)).sqrt()).clamp(0.0, 1.0)
        };
        let from_centre = point - self.centre(share);
        let normal = from_centre.try_normalize(TOUCHING).unwrap_or_else(|| across(&along));
        PointDistance { distance: from_centre.norm() - self.radius(share), share, normal }
    }

    /// The signed distance of another capsule: the minimum over the square of shares. It lies at a stationary point
    /// inside or on one of the four sides, where an end ball is nearest to the other capsule.
    pub fn distance_to_capsule(&self, other: &Self) -> CapsuleDistance {
        if let Some(found) = self.stationary_distance(other) {
            return found;
        }
        let of_own_end = |end: usize| {
            let found = other.distance_to(&self.ends[end]);
            let (distance, shares) = (found.distance - self.radii[end], [end as f64, found.share]);
            CapsuleDistance { distance, shares, normal: -found.normal }
        };
        let of_other_end = |end: usize| {
            let PointDistance { distance, share, normal } = self.distance_to(&other.ends[end]);
            CapsuleDistance { distance: distance - other.radii[end], shares: [share, end as f64], normal }
        };
        let sides = [of_own_end(1), of_other_end(0), of_other_end(1)];
        sides.into_iter().fold(of_own_end(0), |best, found| if found.distance < best.distance { found } else { best })
    }

    /// The minimum where neither ball is at an end. With the axes `a`, `b`, their tapers and the unit vector n between the centres,
    /// `n . a = -g_a` and `n . b = g_b`: these give n up to its side, and n gives the centres.
    fn stationary_distance(&self, other: &Self) -> Option<CapsuleDistance> {
        let (a, b, between) = (self.along(), other.along(), other.ends[0] - self.ends[0]);
        let (aa, ab, bb) = (a.norm_squared(), a.dot(&b), b.norm_squared());
        let determinant = aa * bb - ab * ab;
        if determinant <= PARALLEL * aa * bb {
            return None; // along a common direction a side has the same minimum
        }
        let in_plane =
            |by_a: f64, by_b: f64| [(bb * by_a - ab * by_b) / determinant, (aa * by_b - ab * by_a) / determinant];
        let [u, v] = in_plane(-self.taper(), other.taper());
        let flat = a * u + b * v;
        let upright = 1.0 - flat.norm_squared();
        if upright <= PARALLEL {
            return None;
        }
        let across = a.cross(&b) / determinant.sqrt();
        let apart = between.dot(&across);
        let upright = upright.sqrt();
        let normal = flat + across * upright.copysign(apart);
        let rest = normal * (apart.abs() / upright) - between;
        let [minus_s, t] = in_plane(rest.dot(&a), rest.dot(&b));
        let s = -minus_s;
        let is_inside = (0.0..=1.0).contains(&s) && (0.0..=1.0).contains(&t);
        let distance = apart.abs() / upright - self.radius(s) - other.radius(t);
        is_inside.then_some(CapsuleDistance { distance, shares: [s, t], normal })
    }
}

/// Centres nearer than this have no direction between them, m.
const TOUCHING: f64 = 1e-12;
/// Squared sine of the angle between axes that count as parallel.
const PARALLEL: f64 = 1e-12;

fn across(along: &Vector3<f64>) -> Vector3<f64> {
    along.try_normalize(0.0).map_or_else(Vector3::y, |direction| any_perpendicular(&direction))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn random(rng: &mut ChaCha8Rng, size: f64) -> TaperedCapsule {
        let mut vector = || Vector3::from_fn(|_, _| rng.random_range(-size..size));
        let ends = [vector(), vector()];
        TaperedCapsule { ends, radii: [rng.random_range(0.02..0.2), rng.random_range(0.02..0.2)] }
    }

    /// Compares with the definition on a fine grid, whose error is at most half a step squared.
    #[test]
    fn distances_are_minima_over_all_balls() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let share = |i: usize| i as f64 / 200.0;
        for k in 0..300 {
            let (a, mut b) = (random(&mut rng, 0.5), random(&mut rng, 0.5));
            if k % 5 == 0 {
                b.ends[1] = b.ends[0] + a.along() * 0.7; // parallel
            }
            let point = b.ends[0];
            let on_grid = |i: usize| (point - a.centre(share(i))).norm() - a.radius(share(i));
            let least = (0..=200).map(on_grid).fold(f64::INFINITY, f64::min);
            let found = a.distance_to(&point).distance;
            assert!(found <= least + 1e-12 && least < found + 3e-3, "{found} {least}");
            let apart = |i: usize, j: usize| (b.centre(share(j)) - a.centre(share(i))).norm();
            let pairs = (0..=200).flat_map(|i| (0..=200).map(move |j| (i, j)));
            let least = pairs.map(|(i, j)| apart(i, j) - a.radius(share(i)) - b.radius(share(j)));
            let least = least.fold(f64::INFINITY, f64::min);
            let found = a.distance_to_capsule(&b);
            assert!(found.distance <= least + 1e-12 && least < found.distance + 8e-3, "{found:?} {least}");
            let again = b.distance_to_capsule(&a);
            assert!((again.distance - found.distance).abs() < 1e-12, "symmetric");
            let [s, t] = found.shares;
            let of_balls = (b.centre(t) - a.centre(s)).norm() - a.radius(s) - b.radius(t);
            assert!((of_balls - found.distance).abs() < 1e-9);
        }
    }

    #[test]
    fn known_distances() {
        let capsule = TaperedCapsule { ends: [Vector3::zeros(), Vector3::x()], radii: [0.1, 0.1] };
        assert!((capsule.distance_to(&Vector3::new(0.5, 0.4, 0.0)).distance - 0.3).abs() < 1e-15);
        assert!((capsule.distance_to(&Vector3::new(0.5, 0.0, 0.0)).distance + 0.1).abs() < 1e-15, "on the axis");
        assert!((capsule.distance_to(&Vector3::new(-0.3, 0.4, 0.0)).distance - 0.4).abs() < 1e-15);
        let contained = TaperedCapsule { ends: [Vector3::zeros(), Vector3::x() * 0.1], radii: [0.1, 0.5] };
        assert!((contained.distance_to(&Vector3::new(-1.0, 0.0, 0.0)).distance - 0.6).abs() < 1e-15);
        let ball = TaperedCapsule { ends: [Vector3::y(); 2], radii: [0.2; 2] };
        assert!((ball.distance_to_capsule(&capsule).distance - 0.7).abs() < 1e-15);
        assert!((ball.distance_to_capsule(&ball).distance + 0.4).abs() < 1e-15);
    }

    /// Moves every quantity that a distance depends on a little; second-order differences stay below 1e-8.
    #[test]
    fn derivatives_are_those_of_the_nearest_balls() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for _ in 0..200 {
            let (a, b, da, db) =
                (random(&mut rng, 0.5), random(&mut rng, 0.5), random(&mut rng, 1.0), random(&mut rng, 1.0));
            let moved = |c: &TaperedCapsule, by: &TaperedCapsule, h: f64| TaperedCapsule {
                ends: [0, 1].map(|i| c.ends[i] + by.ends[i] * h),
                radii: [0, 1].map(|i| c.radii[i] + by.radii[i] * h),
            };
            let CapsuleDistance { shares: [s, t], normal, .. } = a.distance_to_capsule(&b);
            let expected = normal.dot(&(db.centre(t) - da.centre(s))) - da.radius(s) - db.radius(t);
            let at = |h: f64| moved(&a, &da, h).distance_to_capsule(&moved(&b, &db, h)).distance;
            assert!(((at(1e-6) - at(-1e-6)) / 2e-6 - expected).abs() < 1e-5, "{expected}");
            let (point, by) = (b.ends[0], db.ends[0]);
            let PointDistance { share, normal, .. } = a.distance_to(&point);
            let expected = normal.dot(&(by - da.centre(share))) - da.radius(share);
            let at = |h: f64| moved(&a, &da, h).distance_to(&(point + by * h)).distance;
            assert!(((at(1e-6) - at(-1e-6)) / 2e-6 - expected).abs() < 1e-5, "{expected}");
        }
    }
}
