//! The pinhole camera with OpenCV's five-parameter distortion. Pixel (0, 0) is the centre of the first pixel.

use nalgebra::{Matrix2x3, Matrix3, Vector2, Vector3};

/// Image size, focal lengths, principal point (px) and distortion `k1 k2 p1 p2 k3` (OpenCV's order).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Intrinsics {
    /// Image width, px.
    pub width: u32,
    /// Image height, px.
    pub height: u32,
    /// Focal length along x, px.
    pub fx: f64,
    /// Focal length along y, px.
    pub fy: f64,
    /// Principal point, px.
    pub cx: f64,
    /// Principal point, px.
    pub cy: f64,
    /// Axis skew `K[0][1]`, px; zero for almost every camera.
    pub skew: f64,
    /// `k1 k2 p1 p2 k3`.
    pub dist: [f64; 5],
}

/// A point nearer to the camera plane than this (m) does not project.
pub const MIN_DEPTH: f64 = 1e-3;

impl Intrinsics {
    /// Mean focal length, px: turns an angle (rad) into pixels.
    pub fn focal(&self) -> f64 {
        0.5 * (self.fx + self.fy)
    }

    /// The 3x3 matrix K.
    pub fn matrix(&self) -> Matrix3<f64> {
        Matrix3::new(self.fx, self.skew, self.cx, 0.0, self.fy, self.cy, 0.0, 0.0, 1.0)
    }

    /// Whether a pixel lies on the sensor.
    pub fn contains(&self, pixel: &Vector2<f64>) -> bool {
        pixel.x >= -0.5 && pixel.y >= -0.5 && pixel.x < self.width as f64 - 0.5 && pixel.y < self.height as f64 - 0.5
    }

    fn is_undistorted(&self) -> bool {
        self.dist == [0.0; 5]
    }

    /// Distorted normalised coordinates and the 2x2 derivative to the ideal ones (row-major).
    fn distort(&self, n: &Vector2<f64>) -> (Vector2<f64>, [f64; 4]) {
        let [k1, k2, p1, p2, k3] = self.dist;
        let (x, y) = (n.x, n.y);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3)); // d radial / d r2 * 2
        let distorted = Vector2::new(
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
        (distorted, jacobian)
    }

    /// Projects a point in the camera frame; `None` behind or on the camera plane.
    pub fn pixel_from_camera(&self, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        if point.z < MIN_DEPTH {
            return None;
        }
        Some(self.pixel_from_normalized(&Vector2::new(point.x / point.z, point.y / point.z)))
    }

    /// The pixel of ideal (undistorted) normalised coordinates.
    pub fn pixel_from_normalized(&self, n: &Vector2<f64>) -> Vector2<f64> {
        let d = if self.is_undistorted() { *n } else { self.distort(n).0 };
        Vector2::new(self.fx * d.x + self.skew * d.y + self.cx, self.fy * d.y + self.cy)
    }

    /// Projection with its derivative to the point in the camera frame (px per m).
    pub fn project_with_jacobian(&self, point: &Vector3<f64>) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        if point.z < MIN_DEPTH {
            return None;
        }
        let iz = 1.0 / point.z;
        let n = Vector2::new(point.x * iz, point.y * iz);
        let (d, [a, b, c, e]) = if self.is_undistorted() { (n, [1.0, 0.0, 0.0, 1.0]) } else { self.distort(&n) };
        // d pixel / d n = K2 * D; d n / d point = [1/z, 0, -x/z; 0, 1/z, -y/z].
        let (m00, m01) = (self.fx * a + self.skew * c, self.fx * b + self.skew * e);
        let (m10, m11) = (self.fy * c, self.fy * e);
        let jacobian = Matrix2x3::new(
            m00 * iz,
            m01 * iz,
            -(m00 * n.x + m01 * n.y) * iz,
            m10 * iz,
            m11 * iz,
            -(m10 * n.x + m11 * n.y) * iz,
        );
        Some((Vector2::new(self.fx * d.x + self.skew * d.y + self.cx, self.fy * d.y + self.cy), jacobian))
    }

    /// Ideal (undistorted) normalised coordinates of a pixel: Newton's method on the distortion.
    ///
    /// Known limit: beyond the radius where the polynomial folds over there is no inverse; the last iterate is returned.
    pub fn normalized_from_pixel(&self, pixel: &Vector2<f64>) -> Vector2<f64> {
        let y = (pixel.y - self.cy) / self.fy;
        let target = Vector2::new((pixel.x - self.cx - self.skew * y) / self.fx, y);
        if self.is_undistorted() {
            return target;
        }
        let mut n = target;
        for _ in 0..20 {
            let (d, [a, b, c, e]) = self.distort(&n);
            let r = target - d;
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

#[cfg(test)]
mod tests;
