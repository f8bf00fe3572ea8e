//! The pinhole camera with OpenCV's distortion models. Pixel (0, 0) is the centre of the first pixel.

mod distortion;

pub use distortion::Distortion;

use distortion::Distorted;
use nalgebra::{Matrix2x3, Matrix3, Vector2, Vector3};

/// Image size, focal lengths, principal point (px) and the lens.
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
    /// Principal point along x, px.
    pub cx: f64,
    /// Principal point along y, px.
    pub cy: f64,
    /// Axis skew `K[0][1]`, px; zero for almost every camera.
    pub skew: f64,
    /// Distortion of the lens.
    pub dist: Distortion,
}

/// A point nearer to the camera plane than this (m) does not project.
pub const MIN_DEPTH: f64 = 1e-3;

#[cfg(test)]
impl Intrinsics {
    /// A camera with a horizontal field of view of 65 degrees, without distortion.
    pub(crate) const PLAIN: Self = Self {
        width: 1280,
        height: 720,
        fx: 1000.0,
        fy: 1000.0,
        cx: 640.0,
        cy: 360.0,
        skew: 0.0,
        dist: Distortion::None,
    };
}

impl Intrinsics {
    /// Mean focal length, px: converts a small angle (rad) to pixels.
    pub fn focal(&self) -> f64 {
        0.5 * (self.fx + self.fy)
    }

    /// The intrinsics with the matrix K, row by row, of images of `size` (width and height, px).
    pub fn from_matrix([width, height]: [u32; 2], k: &[[f64; 3]; 3], dist: Distortion) -> Self {
        Self { width, height, fx: k[0][0], fy: k[1][1], cx: k[0][2], cy: k[1][2], skew: k[0][1], dist }
    }

    /// Where nothing but the image size (px) is known: square pixels, the principal point in the middle, no distortion, and a
    /// focal length of the longer side, which is 53 degrees of view.
    pub fn guessed([width, height]: [u32; 2], dist: Distortion) -> Self {
        let focal = f64::from(width.max(height));
        let middle = |side: u32| 0.5 * (f64::from(side) - 1.0);
        Self { width, height, fx: focal, fy: focal, cx: middle(width), cy: middle(height), skew: 0.0, dist }
    }

    /// The pixel in the mirrored image.
    pub fn mirrored(&self, pixel: &Vector2<f64>) -> Vector2<f64> {
        Vector2::new(f64::from(self.width) - 1.0 - pixel.x, pixel.y)
    }

    /// The same intrinsics with `fx`, `fy` and the skew multiplied by `factor`.
    pub fn with_focal_factor(&self, factor: f64) -> Self {
        Self { fx: self.fx * factor, fy: self.fy * factor, skew: self.skew * factor, ..*self }
    }

    /// The same intrinsics with pixels of another shape: `fy / fx` multiplied by `factor`, and the product of the two as it is.
    pub fn with_aspect_factor(&self, factor: f64) -> Self {
        let root = factor.sqrt();
        Self { fx: self.fx / root, fy: self.fy * root, ..*self }
    }

    /// The same intrinsics with `change` added to the first radial coefficient of the lens.
    pub fn with_radial(&self, change: f64) -> Self {
        Self { dist: self.dist.with_radial(change), ..*self }
    }

    /// Derivative of the pixel of ideal normalised coordinates by the first radial coefficient, px.
    pub fn by_radial(&self, n: &Vector2<f64>) -> Vector2<f64> {
        let d = self.dist.by_radial(n);
        Vector2::new(self.fx * d.x + self.skew * d.y, self.fy * d.y)
    }

    /// The same lens with images `factor` times as large.
    pub fn resized(&self, factor: f64) -> Self {
        let size = |n: u32| (f64::from(n) * factor).round() as u32;
        let centre = |c: f64| (c + 0.5) * factor - 0.5;
        Self {
            width: size(self.width),
            height: size(self.height),
            cx: centre(self.cx),
            cy: centre(self.cy),
            ..self.with_focal_factor(factor)
        }
    }

    /// The intrinsics of the images turned clockwise by 90 degrees, of a camera turned likewise: pixel `(x, y)` becomes
    /// `(height - 1 - y, x)`. `None` with skew, which such a camera has not in the same form.
    pub fn turned_clockwise(&self) -> Option<Self> {
        let cx = f64::from(self.height) - 1.0 - self.cy;
        (self.skew == 0.0).then(|| {
            let (width, height, fx, fy) = (self.height, self.width, self.fy, self.fx);
            Self { width, height, fx, fy, cx, cy: self.cx, skew: 0.0, dist: self.dist.turned_clockwise() }
        })
    }

    /// The same counterclockwise: pixel `(x, y)` becomes `(y, width - 1 - x)`.
    pub fn turned_counterclockwise(&self) -> Option<Self> {
        self.turned_clockwise()?.turned_clockwise()?.turned_clockwise()
    }

    /// The 3x3 matrix K.
    pub fn matrix(&self) -> Matrix3<f64> {
        Matrix3::new(self.fx, self.skew, self.cx, 0.0, self.fy, self.cy, 0.0, 0.0, 1.0)
    }

    /// Projects a point in the camera frame; `None` behind or on the camera plane.
    #[inline]
    pub fn pixel_from_camera(&self, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        if point.z < MIN_DEPTH {
            return None;
        }
        Some(self.pixel_from_normalized(&Vector2::new(point.x / point.z, point.y / point.z)))
    }

    /// The pixel of ideal (undistorted) normalised coordinates.
    #[inline]
    pub fn pixel_from_normalized(&self, n: &Vector2<f64>) -> Vector2<f64> {
        let d = self.dist.distort_with_jacobian(n).point;
        Vector2::new(self.fx * d.x + self.skew * d.y + self.cx, self.fy * d.y + self.cy)
    }

    /// Projection with its derivative to the point in the camera frame (px per m).
    #[inline]
    pub fn project_with_jacobian(&self, point: &Vector3<f64>) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        if point.z < MIN_DEPTH {
            return None;
        }
        let iz = 1.0 / point.z;
        let n = Vector2::new(point.x * iz, point.y * iz);
        let Distorted { point: d, jacobian: [a, b, c, e] } = self.dist.distort_with_jacobian(&n);
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

    /// Ideal (undistorted) normalised coordinates of a pixel.
    ///
    /// Beyond the radius where the distortion folds over it has no inverse: what lies there has the ray of the edge of what the lens shows. The
    /// ray of a fisheye is kept below 89 degrees from the axis.
    pub fn normalized_from_pixel(&self, pixel: &Vector2<f64>) -> Vector2<f64> {
        let y = (pixel.y - self.cy) / self.fy;
        self.dist.undistort(&Vector2::new((pixel.x - self.cx - self.skew * y) / self.fx, y))
    }
}

#[cfg(test)]
mod tests;
