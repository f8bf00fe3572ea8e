//! Lens distortion of ideal normalised coordinates: OpenCV's polynomial, rational and fisheye models.

use nalgebra::Vector2;

/// A lens model with its coefficients, each list in OpenCV's order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Distortion {
    /// An ideal pinhole.
    None,
    /// `k1 k2 p1 p2 k3`: radial polynomial and tangential terms.
    OpenCv5([f64; 5]),
    /// `k1 k2 p1 p2 k3 k4 k5 k6`: the radial factor is a quotient of two polynomials.
    Rational8([f64; 8]),
    /// `k1 k2 k3 k4`: a polynomial of the angle to the axis (Kannala and Brandt, PAMI 2006, Eq. (6)).
    ///
    /// Known limit: points are normalised coordinates, so a ray at 90 degrees or more from the axis does not exist.
    Fisheye4([f64; 4]),
}

/// Five coefficients in OpenCV's order; five zeros mean no distortion.
impl From<[f64; 5]> for Distortion {
    fn from(dist: [f64; 5]) -> Self {
        if dist == [0.0; 5] { Self::None } else { Self::OpenCv5(dist) }
    }
}

/// Distorted coordinates and their derivative to the ideal ones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Distorted {
    pub(super) point: Vector2<f64>,
    /// 2x2, row by row.
    pub(super) jacobian: [f64; 4],
}

/// Rays farther than this (rad) from the axis are not undistorted: an image of a body has no such rays.
const MAX_FISHEYE_ANGLE: f64 = 1.55;
/// Steps of the radius at which the edge of what a lens shows is sought, and their number: up to 84 degrees from the axis.
const RADIUS_STEP: f64 = 0.01;
const N_RADIUS_STEPS: u32 = 1000;
/// Below this squared radius the fisheye's quotients are replaced by their series: its next term is 1e-12 relative.
const SMALL_SQUARED_RADIUS: f64 = 1e-6;

impl Distortion {
    /// The model's name, as in the field `distortion_model` of a session.
    pub fn name(&self) -> &'static str {
        match self {
            Self::None => "none",
            Self::OpenCv5(_) => "opencv",
            Self::Rational8(_) => "rational",
            Self::Fisheye4(_) => "fisheye",
        }
    }

    /// The coefficients in OpenCV's order; five zeros without distortion, as most readers expect.
    pub fn coefficients(&self) -> &[f64] {
        match self {
            Self::None => &[0.0; 5],
            Self::OpenCv5(dist) => dist,
            Self::Rational8(dist) => dist,
            Self::Fisheye4(dist) => dist,
        }
    }

    /// The model of an OpenCV list of coefficients: 0, 4, 5 or 8 of them, or 12 or 14 with thin prism and tilt terms of
    /// zero; `None` for any other list.
    pub fn from_opencv(coefficients: &[f64]) -> Option<Self> {
        match *coefficients {
            [] => Some(Self::None),
            [k1, k2, p1, p2] => Some([k1, k2, p1, p2, 0.0].into()),
            [k1, k2, p1, p2, k3] | [k1, k2, p1, p2, k3, 0.0, 0.0, 0.0] => Some([k1, k2, p1, p2, k3].into()),
            [k1, k2, p1, p2, k3, k4, k5, k6] => Some(Self::Rational8([k1, k2, p1, p2, k3, k4, k5, k6])),
            _ => {
                let (known, rest) = coefficients.split_at_checked(8)?;
                let is_supported = [4, 6].contains(&rest.len()) && rest.iter().all(|k| *k == 0.0);
                if is_supported { Self::from_opencv(known) } else { None }
            }
        }
    }

    /// A fisheye model from `k1 k2 k3 k4`, possibly followed by the zero that some writers append; `None` for other lists.
    pub fn from_fisheye(coefficients: &[f64]) -> Option<Self> {
        match *coefficients {
            [k1, k2, k3, k4] | [k1, k2, k3, k4, 0.0] => Some(Self::Fisheye4([k1, k2, k3, k4])),
            _ => None,
        }
    }

    /// Distorted normalised coordinates of ideal ones.
    pub fn distorted(&self, n: &Vector2<f64>) -> Vector2<f64> {
        self.distort_with_jacobian(n).point
    }

    /// Distorted coordinates with their derivative.
    #[inline(always)]
    pub(super) fn distort_with_jacobian(&self, n: &Vector2<f64>) -> Distorted {
        // Most lenses are given without distortion: only this case is worth a place in every caller's loop.
        match self {
            Self::None => Distorted { point: *n, jacobian: [1.0, 0.0, 0.0, 1.0] },
            lens => lens.distort_by_model(n),
        }
    }

    fn distort_by_model(&self, n: &Vector2<f64>) -> Distorted {
        match *self {
            Self::None => Distorted { point: *n, jacobian: [1.0, 0.0, 0.0, 1.0] },
            Self::OpenCv5([k1, k2, p1, p2, k3]) => {
                let r2 = n.norm_squared();
                let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
                let slope = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3);
                distort_brown(n, radial, slope, [p1, p2])
            }
            Self::Rational8([k1, k2, p1, p2, k3, k4, k5, k6]) => {
                let r2 = n.norm_squared();
                let above = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
                let below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6));
                let above_slope = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3);
                let below_slope = k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6);
                let radial = above / below;
                distort_brown(n, radial, (above_slope - radial * below_slope) / below, [p1, p2])
            }
            Self::Fisheye4(k) => distort_fisheye(n, &k),
        }
    }

    /// The lens with `change` added to its first radial coefficient.
    pub fn with_radial(self, change: f64) -> Self {
        match self {
            Self::None => [change, 0.0, 0.0, 0.0, 0.0].into(),
            Self::OpenCv5(mut k) => {
                k[0] += change;
                k.into()
            }
            Self::Rational8(mut k) => {
                k[0] += change;
                Self::Rational8(k)
            }
            Self::Fisheye4(mut k) => {
                k[0] += change;
                Self::Fisheye4(k)
            }
        }
    }

    /// The lens of a camera turned so that its images turn clockwise by 90 degrees, `(x, y)` to `(-y, x)`: radial terms are the same,
    /// `p1` becomes `p2` and `p2` becomes `-p1`.
    pub(super) fn turned_clockwise(self) -> Self {
        match self {
            Self::None | Self::Fisheye4(_) => self,
            Self::OpenCv5([k1, k2, p1, p2, k3]) => Self::OpenCv5([k1, k2, p2, -p1, k3]),
            Self::Rational8([k1, k2, p1, p2, k3, k4, k5, k6]) => Self::Rational8([k1, k2, p2, -p1, k3, k4, k5, k6]),
        }
    }

    /// Derivative of the distorted coordinates by the first radial coefficient: `n r^2`, over the lower polynomial of a rational lens;
    /// of a fisheye `n theta^3 / r`.
    pub(super) fn by_radial(&self, n: &Vector2<f64>) -> Vector2<f64> {
        let r2 = n.norm_squared();
        match *self {
            Self::None | Self::OpenCv5(_) => n * r2,
            Self::Rational8([_, _, _, _, _, k4, k5, k6]) => n * (r2 / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))),
            Self::Fisheye4(_) if r2 < SMALL_SQUARED_RADIUS => n * r2,
            Self::Fisheye4(_) => n * (r2.sqrt().atan().powi(3) / r2.sqrt()),
        }
    }

    /// Ideal normalised coordinates of distorted ones.
    ///
    /// Beyond the radius where the polynomial folds over, which shows nothing, the image has no inverse: those of a point there are of the
    /// edge of what the lens shows, in its direction.
    pub(super) fn undistort(&self, distorted: &Vector2<f64>) -> Vector2<f64> {
        match self {
            Self::None => *distorted,
            Self::Fisheye4(k) => undistort_fisheye(distorted, k),
            Self::OpenCv5(_) | Self::Rational8(_) => {
                let found = self.undistort_by_newton(distorted);
                if self.shows(&found, distorted) { found } else { self.nearest_shown(distorted) }
            }
        }
    }

    /// Whether the image of `n` is `distorted`, and the polynomial rises from the axis to there: beyond its fold, Newton's method finds points
    /// on other branches, most of them on the opposite side.
    fn shows(&self, n: &Vector2<f64>, distorted: &Vector2<f64>) -> bool {
        let Distorted { point, jacobian: [a, b, c, e] } = self.distort_with_jacobian(n);
        let rises_at = |k: u32| self.radial_slope(n.norm() * f64::from(k) / 8.0) > 0.0;
        (point - distorted).norm_squared() < 1e-12 && a * e > b * c && a + e > 0.0 && (1..=8).all(rises_at)
    }

    /// Ideal coordinates in the direction of a point of the image, as far from the axis as the lens shows of it. Tangential terms are left
    /// out.
    fn nearest_shown(&self, distorted: &Vector2<f64>) -> Vector2<f64> {
        let Some(direction) = distorted.try_normalize(f64::MIN_POSITIVE) else { return *distorted };
        let is_short =
            |radius: f64| self.distorted_radius(radius) < distorted.norm() && self.radial_slope(radius) > 0.0;
        let n_steps = (1..N_RADIUS_STEPS).take_while(|&k| is_short(f64::from(k) * RADIUS_STEP)).count();
        direction * (RADIUS_STEP * n_steps as f64)
    }

    /// Radius of the image of ideal radius `r`, without tangential terms.
    fn distorted_radius(&self, r: f64) -> f64 {
        self.without_tangential().distort_with_jacobian(&Vector2::new(r, 0.0)).point.x
    }

    /// Its derivative.
    fn radial_slope(&self, r: f64) -> f64 {
        self.without_tangential().distort_with_jacobian(&Vector2::new(r, 0.0)).jacobian[0]
    }

    fn without_tangential(&self) -> Self {
        match *self {
            Self::None | Self::Fisheye4(_) => *self,
            Self::OpenCv5([k1, k2, _, _, k3]) => Self::OpenCv5([k1, k2, 0.0, 0.0, k3]),
            Self::Rational8([k1, k2, _, _, k3, k4, k5, k6]) => Self::Rational8([k1, k2, 0.0, 0.0, k3, k4, k5, k6]),
        }
    }

    fn undistort_by_newton(&self, target: &Vector2<f64>) -> Vector2<f64> {
        let mut n = *target;
        for _ in 0..20 {
            let Distorted { point, jacobian: [a, b, c, e] } = self.distort_with_jacobian(&n);
            let r = target - point;
            let det = a * e - b * c;
            if det.abs() < 1e-9 {
                break;
            }
            let step = Vector2::new((e * r.x - b * r.y) / det, (a * r.y - c * r.x) / det);
            n += step;
            if step.norm_squared() < 1e-24 {
                break;
            }
        }
        n
    }
}

/// Brown's model: `n radial + (2 p1 x y + p2 (r^2 + 2 x^2), p1 (r^2 + 2 y^2) + 2 p2 x y)`, with the radial factor and
/// its derivative to `r^2` given.
fn distort_brown(n: &Vector2<f64>, radial: f64, radial_slope: f64, [p1, p2]: [f64; 2]) -> Distorted {
    let (x, y) = (n.x, n.y);
    let r2 = x * x + y * y;
    let slope = 2.0 * radial_slope;
    let point = Vector2::new(
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
    );
    let cross = x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y;
    let jacobian = [
        radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
        cross,
        cross,
        radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
    ];
    Distorted { point, jacobian }
}

/// `theta_d(theta) / theta` and the derivative of `theta_d` to theta.
fn fisheye_polynomial(theta2: f64, [k1, k2, k3, k4]: &[f64; 4]) -> [f64; 2] {
    let factor = 1.0 + theta2 * (k1 + theta2 * (k2 + theta2 * (k3 + theta2 * k4)));
    let slope = 1.0 + theta2 * (3.0 * k1 + theta2 * (5.0 * k2 + theta2 * (7.0 * k3 + theta2 * 9.0 * k4)));
    [factor, slope]
}

/// `n s(r)` with `s = theta_d / r`, `theta = atan r`; its derivative is `s I + (s' / r) n n^T`.
fn distort_fisheye(n: &Vector2<f64>, k: &[f64; 4]) -> Distorted {
    let r2 = n.norm_squared();
    let (scale, growth) = if r2 < SMALL_SQUARED_RADIUS {
        // theta_d / r = 1 + (k1 - 1/3) r^2 + O(r^4).
        (1.0 + (k[0] - 1.0 / 3.0) * r2, 2.0 * (k[0] - 1.0 / 3.0))
    } else {
        let r = r2.sqrt();
        let theta = r.atan();
        let [factor, slope] = fisheye_polynomial(theta * theta, k);
        let scale = theta * factor / r;
        (scale, (slope / (1.0 + r2) - scale) / r2)
    };
    let cross = growth * n.x * n.y;
    Distorted { point: n * scale, jacobian: [scale + growth * n.x * n.x, cross, cross, scale + growth * n.y * n.y] }
}

/// Newton's method on the angle alone: in normalised coordinates the tangent makes it overshoot.
fn undistort_fisheye(distorted: &Vector2<f64>, k: &[f64; 4]) -> Vector2<f64> {
    let distorted_angle = distorted.norm();
    if distorted_angle == 0.0 {
        return *distorted;
    }
    let mut theta = distorted_angle.min(MAX_FISHEYE_ANGLE);
    for _ in 0..30 {
        let [factor, slope] = fisheye_polynomial(theta * theta, k);
        if slope < 1e-9 {
            break;
        }
        let step = (distorted_angle - theta * factor) / slope;
        theta = (theta + step).clamp(0.0, MAX_FISHEYE_ANGLE);
        if step.abs() < 1e-15 {
            break;
        }
    }
    distorted * (theta.tan() / distorted_angle)
}
