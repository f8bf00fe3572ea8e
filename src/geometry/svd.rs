//! Singular value decomposition of 3x3 matrices by one-sided Jacobi rotations, and the nearest rotation.
//!
//! Why not nalgebra's: its 3x3 case uses the eigenvectors of `m^T m` and loses half the digits where singular values are far
//! apart, as for rotations near pi and for nearly collinear points.

use super::rotation;
use nalgebra::{Matrix3, Vector3};

/// `m = u * diag(singular) * v^T`; `u` and `v` are orthonormal, of determinant +1 or -1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Svd {
    /// Left singular vectors in the columns.
    pub u: Matrix3<f64>,
    /// Singular values, not negative, descending.
    pub singular: Vector3<f64>,
    /// Right singular vectors in the columns.
    pub v: Matrix3<f64>,
}

/// Limit of sweeps, far above the some 5 of quadratic convergence; bounds the work on non-finite input.
const MAX_SWEEPS: usize = 30;

/// A column shorter than this share of the longest one is rounding error: its direction is replaced, not normalised.
const RANK_TOLERANCE: f64 = 1e-14;

/// Decomposes a matrix by Hestenes' method: rotates columns of `m v` until they are orthogonal.
///
/// `u` and `v` are orthonormal for rank-deficient input too. Non-finite input gives non-finite output.
pub fn decompose(m: &Matrix3<f64>) -> Svd {
    let (mut b, mut v) = (*m, Matrix3::identity());
    for _ in 0..MAX_SWEEPS {
        let rotated = [(0, 1), (0, 2), (1, 2)].map(|(p, q)| orthogonalize_columns(&mut b, &mut v, p, q));
        if rotated == [false; 3] {
            break;
        }
    }
    let norms = [b.column(0).norm(), b.column(1).norm(), b.column(2).norm()];
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| norms[j].total_cmp(&norms[i]));
    let b = Matrix3::from_columns(&order.map(|i| b.column(i).into_owned()));
    let v = Matrix3::from_columns(&order.map(|i| v.column(i).into_owned()));
    let singular = Vector3::from_iterator(order.map(|i| norms[i]));
    Svd { u: left_vectors(&b, &singular), singular, v }
}

/// Rotates columns `p` and `q` of `b` (and of `v`) so that those of `b` become orthogonal; false where they were already.
fn orthogonalize_columns(b: &mut Matrix3<f64>, v: &mut Matrix3<f64>, p: usize, q: usize) -> bool {
    let (pp, qq) = (b.column(p).norm_squared(), b.column(q).norm_squared());
    let pq = b.column(p).dot(&b.column(q));
    if pq * pq <= f64::EPSILON * f64::EPSILON * pp * qq {
        return false;
    }
    // The smaller root of t^2 + 2 zeta t - 1: the tangent of the angle, at most 45 degrees.
    let zeta = (qq - pp) / (2.0 * pq);
    let tangent = zeta.signum() / (zeta.abs() + zeta.hypot(1.0));
    let cosine = 1.0 / tangent.hypot(1.0);
    let sine = cosine * tangent;
    for m in [b, v] {
        for row in 0..3 {
            let (x, y) = (m[(row, p)], m[(row, q)]);
            m[(row, p)] = cosine * x - sine * y;
            m[(row, q)] = sine * x + cosine * y;
        }
    }
    true
}

/// Normalised columns of `b`; vanishing ones are completed to an orthonormal basis.
fn left_vectors(b: &Matrix3<f64>, singular: &Vector3<f64>) -> Matrix3<f64> {
    if singular[0] == 0.0 {
        return Matrix3::identity();
    }
    let first = b.column(0) / singular[0];
    let second = if singular[1] > RANK_TOLERANCE * singular[0] {
        b.column(1) / singular[1]
    } else {
        rotation::any_perpendicular(&first)
    };
    let third = first.cross(&second);
    let third = if third.dot(&b.column(2)) < 0.0 { -third } else { third };
    Matrix3::from_columns(&[first, second, third])
}

/// The rotation nearest to a matrix in Frobenius norm: `U diag(1, 1, det U V^T) V^T` (Umeyama 1991, Lemma).
///
/// One of the nearest where it is not unique: rank below 2, or a reflection with two equal smallest singular values.
/// Non-finite input gives non-finite output.
pub fn nearest_rotation(m: &Matrix3<f64>) -> Matrix3<f64> {
    let Svd { mut u, v, .. } = decompose(m);
    if u.determinant() * v.determinant() < 0.0 {
        u.column_mut(2).neg_mut();
    }
    u * v.transpose()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    fn assert_decomposes(m: &Matrix3<f64>) {
        let svd = decompose(m);
        let scale = m.norm().max(1e-300);
        assert!((svd.u * Matrix3::from_diagonal(&svd.singular) * svd.v.transpose() - m).norm() < 1e-14 * scale, "{m}");
        assert!((svd.u.transpose() * svd.u - Matrix3::identity()).norm() < 1e-14, "{m}");
        assert!((svd.v.transpose() * svd.v - Matrix3::identity()).norm() < 1e-14, "{m}");
        assert!(svd.singular[0] >= svd.singular[1] && svd.singular[1] >= svd.singular[2] && svd.singular[2] >= 0.0);
    }

    #[test]
    fn matrices_of_every_rank_are_decomposed() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        assert_decomposes(&Matrix3::zeros());
        for _ in 0..200 {
            let random = Matrix3::from_fn(|_, _| rng.random_range(-1.0..1.0));
            assert_decomposes(&random);
            for diagonal in [[1.0, 1e-9, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 1e-13], [2.0, 2.0, 2.0]] {
                let orthonormal = decompose(&random);
                assert_decomposes(
                    &(orthonormal.u * Matrix3::from_diagonal(&diagonal.into()) * orthonormal.v.transpose()),
                );
            }
        }
    }

    #[test]
    fn no_rotation_is_nearer_than_the_nearest_rotation() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(2);
        for _ in 0..100 {
            let m = Matrix3::from_fn(|_, _| rng.random_range(-1.0..1.0));
            let nearest = nearest_rotation(&m);
            assert!((nearest.transpose() * nearest - Matrix3::identity()).norm() < 1e-14);
            assert!((nearest.determinant() - 1.0).abs() < 1e-14);
            for _ in 0..20 {
                let turn = Vector3::from_fn(|_, _| rng.random_range(-0.05..0.05));
                assert!((rotation::exp(&turn) * nearest - m).norm() >= (nearest - m).norm() - 1e-14);
            }
        }
        let r = rotation::exp(&Vector3::new(1.0, 2.0, -0.5));
        assert!((nearest_rotation(&(r * 3.0)) - r).norm() < 1e-14);
    }

    #[test]
    fn known_singular_values_are_found() {
        let svd = decompose(&Matrix3::new(0.0, 0.0, -2.0, 0.5, 0.0, 0.0, 0.0, 3.0, 0.0));
        assert_eq!(svd.singular, Vector3::new(3.0, 2.0, 0.5));
    }
}
