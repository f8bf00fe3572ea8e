//! What the spread of a motion costs in the images.

use super::super::camera_unknowns::{FOCAL, POSE};
use super::scores::Movements;
use super::{Channel, PosedCamera, Positions, WhitenedPixels};
use crate::residuals::reprojection::Reprojection;
use nalgebra::{DVector, Matrix2x3, Matrix3, Matrix3x2, SVector, Vector3};
use rayon::prelude::*;

/// Covariance of a landmark's positions, m^2: of a frame, and of one and two frames later (rows) with it (columns).
pub(crate) type Spread = [Matrix3<f64>; 3];

impl WhitenedPixels {
    /// Derivatives by the unknowns of `movements` of `sum_i w_i trace(V_i) / 2` over the innovations i, with `V_i` the covariance that
    /// `spreads`, which stay, give their residuals. `[frame][observed landmark]`
    pub(crate) fn spread_gradient(
        &self,
        cameras: &[PosedCamera],
        positions: &Positions,
        spreads: &[Vec<Spread>],
        movements: &Movements,
    ) -> DVector<f64> {
        let n = movements.cameras.ncols();
        let of_landmark = |landmark: usize| {
            let mut gradient = DVector::zeros(n);
            for channel in &self.channels[landmark] {
                self.add_spread(channel, landmark, (cameras, positions, spreads), movements, &mut gradient);
            }
            gradient
        };
        let of_landmarks: Vec<DVector<f64>> = (0..self.landmarks.len()).into_par_iter().map(of_landmark).collect();
        of_landmarks.iter().fold(DVector::zeros(n), |sum, gradient| sum + gradient)
    }

    fn add_spread(
        &self,
        channel: &Channel,
        landmark: usize,
        (cameras, positions, spreads): (&[PosedCamera], &Positions, &[Vec<Spread>]),
        movements: &Movements,
        gradient: &mut DVector<f64>,
    ) {
        let linear = channel.linearised(landmark, cameras, positions);
        let camera = &cameras[channel.camera];
        let rotation = &camera.camera_from_world.rotation;
        let n = movements.of_camera.len();
        let mut of_positions = vec![Vector3::zeros(); channel.seen.len()];
        let mut of_camera = SVector::<f64, { POSE + 1 }>::zeros();
        for innovation in self.linear_innovations(channel, &linear) {
            for (i, own, factor) in innovation.parts() {
                // Covariance of the position with the innovation.
                let mut with_innovation = Matrix3x2::zeros();
                for (k, l, other) in innovation.parts() {
                    let of_both = between(spreads, landmark, channel.seen[i].frame, channel.seen[k].frame);
                    with_innovation += of_both * l.by_point.transpose() * other;
                }
                let in_camera = rotation * with_innovation * (innovation.weight * factor);
                let p = camera.camera_from_world.transform(&positions[channel.seen[i].frame][landmark]);
                let by_camera = asked(own, rotation, &p, &in_camera);
                of_positions[i] += rotation.tr_mul(&by_camera.fixed_rows::<3>(0));
                of_camera += by_camera;
            }
        }
        let unknowns = of_camera.rows(0, n);
        gradient.gemv_tr(1.0, &movements.cameras.rows(n * channel.camera, n), &unknowns, 1.0);
        for (seen, asked) in channel.seen.iter().zip(&of_positions) {
            gradient.gemv_tr(1.0, &movements.landmarks[seen.frame][landmark], asked, 1.0);
        }
    }
}

/// Covariance of a landmark's positions in two frames, at most two apart.
fn between(spreads: &[Vec<Spread>], landmark: usize, row: usize, column: usize) -> Matrix3<f64> {
    if row >= column {
        spreads[column][landmark][row - column]
    } else {
        spreads[row][landmark][column - row].transpose()
    }
}

/// Derivatives of `trace(P M)`, with `P = J R` the projection's derivative, `M` the matrix `R^T m` and `m` constant but for its turn with the
/// camera: by the left increment (rho, phi) of the camera, and by the logarithm of the focal length. Of the lens's distortion
/// only the scale at the point counts.
fn asked(
    linear: &Reprojection,
    rotation: &Matrix3<f64>,
    p: &Vector3<f64>,
    m: &Matrix3x2<f64>,
) -> SVector<f64, { POSE + 1 }> {
    let j: Matrix2x3<f64> = linear.by_point * rotation.transpose();
    // `J` of a pinhole is `[a b] [I | -(u, v)]`, a and b the focal lengths over depth and standard deviation.
    let axes = j.fixed_columns::<2>(0).into_owned();
    let (u, v) = (p.x / p.z, p.y / p.z);
    let of_trace = (j * m).trace();
    let by_z = -(axes.transpose() * m.row(2).transpose()) / p.z;
    let by_p = Vector3::new(by_z.x, by_z.y, -of_trace / p.z - by_z.x * u - by_z.y * v);
    let b = m * j;
    let turned = Vector3::new(b[(1, 2)] - b[(2, 1)], b[(2, 0)] - b[(0, 2)], b[(0, 1)] - b[(1, 0)]);
    let by_turn = p.cross(&by_p) + turned;
    let mut derivatives = SVector::<f64, { POSE + 1 }>::zeros();
    derivatives.fixed_rows_mut::<3>(0).copy_from(&by_p);
    derivatives.fixed_rows_mut::<3>(3).copy_from(&by_turn);
    derivatives[FOCAL] = of_trace;
    derivatives
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Intrinsics, Rigid, rotation};
    use crate::residuals::derivative_check::assert_gradient;
    use crate::residuals::reprojection::linearize;
    use nalgebra::Vector2;

    #[test]
    fn derivatives_match_central_differences() {
        let lens = Intrinsics { fx: 900.0, fy: 910.0, cy: 350.0, ..Intrinsics::PLAIN };
        let camera =
            Rigid { rotation: rotation::exp(&Vector3::new(0.3, -0.8, 0.2)), translation: Vector3::new(0.2, -0.4, 4.0) };
        let (point, pixel) = (Vector3::new(0.5, -0.3, 0.6), Vector2::new(500.0, 300.0));
        let in_world = Matrix3x2::new(0.02, 0.01, -0.03, 0.04, 0.05, 0.02);
        let linear = linearize(&lens, &camera, &point, &pixel, 250.0).unwrap();
        let p = camera.transform(&point);
        let found = asked(&linear, &camera.rotation, &p, &(camera.rotation * in_world));
        assert_gradient(found.as_slice(), |d| {
            let moved = camera.perturbed_left(&Vector3::new(d[0], d[1], d[2]), &Vector3::new(d[3], d[4], d[5]));
            let lens = lens.with_focal_factor(d[6].exp());
            (linearize(&lens, &moved, &point, &pixel, 250.0).unwrap().by_point * in_world).trace()
        });
    }
}
