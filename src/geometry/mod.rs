//! Geometry of points, rotations and cameras: nalgebra only, f64, metres, radians, pixels.

pub mod camera;
pub mod capsule;
pub mod epipolar;
pub mod euler;
pub mod five_point;
pub mod free_network;
pub mod p3p;
pub mod pixel_covariance;
pub mod polynomial;
pub mod projection;
pub mod rigid;
pub mod rotation;
pub mod similarity;
pub mod svd;
pub mod triangulation;

pub use camera::{Distortion, Intrinsics};
pub use pixel_covariance::PixelCovariance;
pub use rigid::Rigid;
pub use similarity::Similarity;
