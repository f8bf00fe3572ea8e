//! The essential matrix from five point pairs.
//!
//! Nistér, "An efficient solution to the five-point relative pose problem", PAMI 26(6), 2004: the null space of the
//! five epipolar constraints (Sec. 3.1), ten cubic constraints eliminated to a 3x3 matrix of polynomials in one
//! unknown (Sec. 3.2), its determinant's real roots, and a few Gauss-Newton steps that undo the elimination's rounding.

use super::polynomial;
use nalgebra::{Matrix3, Matrix4, SMatrix, SVector, Vector2, Vector3, Vector4};

/// Coefficients of a linear form in (x, y, z, w).
type Linear = [f64; 4];
/// Coefficients of a quadratic form: xx xy xz xw yy yz yw zz zw ww.
type Quadratic = [f64; 10];
/// Coefficients of a cubic form: x3 y3 x2y xy2 x2z x2w y2z y2w xyz xyw | xz2 xzw xw2 yz2 yzw yw2 z3 z2w zw2 w3.
///
/// In this order eliminating the first ten leaves polynomials in z (with w = 1) times x, y and 1.
type Cubic = [f64; 20];

/// Index in a [`Quadratic`] of the product of two variables.
const QUADRATIC_INDEX: [[usize; 4]; 4] = [[0, 1, 2, 3], [1, 4, 5, 6], [2, 5, 7, 8], [3, 6, 8, 9]];

/// Index in a [`Cubic`] of the product of a quadratic monomial and a variable.
const CUBIC_INDEX: [[usize; 4]; 10] = [
    [0, 2, 4, 5],
    [2, 3, 8, 9],
    [4, 8, 10, 11],
    [5, 9, 11, 12],
    [3, 1, 6, 7],
    [8, 6, 13, 14],
    [9, 7, 14, 15],
    [10, 13, 16, 17],
    [11, 14, 17, 18],
    [12, 15, 18, 19],
];

/// The essential matrices (Frobenius norm sqrt 2, arbitrary sign) of five pairs of normalised points: at most ten.
///
/// `pairs`: (first, second) in ideal normalised coordinates; every result satisfies `second^T E first = 0` for all five
/// and is a true essential matrix. Empty where the elimination is singular (coinciding points). Five pairs of a pure
/// rotation have a family of solutions, of which arbitrary members are returned.
pub fn five_point(pairs: &[(Vector2<f64>, Vector2<f64>); 5]) -> Vec<Matrix3<f64>> {
    let basis = null_space(pairs);
    let Some(reduced) = eliminate(constraints(&basis)) else {
        return Vec::new();
    };
    let rows = [polynomial_row(&reduced, 4), polynomial_row(&reduced, 6), polynomial_row(&reduced, 8)];
    let determinant = determinant(&rows);
    let mut essentials = Vec::with_capacity(polynomial::MAX_DEGREE);
    for &z in polynomial::real_roots(&determinant).as_slice() {
        if let Some(solution) = solution_at(&rows, z).and_then(|start| polish(&basis, start)) {
            essentials.push(combine(&basis, &solution) * std::f64::consts::SQRT_2);
        }
    }
    essentials
}

/// An orthonormal basis of the 3x3 matrices that satisfy all five epipolar constraints: the last four columns of the
/// orthogonal factor of the constraints' QR decomposition, by Householder reflections.
fn null_space(pairs: &[(Vector2<f64>, Vector2<f64>); 5]) -> [Matrix3<f64>; 4] {
    let mut columns = SMatrix::<f64, 9, 5>::zeros();
    for (k, (a, b)) in pairs.iter().enumerate() {
        // Entries of E row by row: second^T E first.
        columns.set_column(k, &SVector::from([b.x * a.x, b.x * a.y, b.x, b.y * a.x, b.y * a.y, b.y, a.x, a.y, 1.0]));
    }
    let mut mirrors = SMatrix::<f64, 9, 5>::zeros();
    for k in 0..5 {
        let mut mirror: SVector<f64, 9> = columns.column(k).into_owned();
        (0..k).for_each(|i| mirror[i] = 0.0);
        let length = mirror.norm();
        mirror[k] += if mirror[k] < 0.0 { -length } else { length };
        let length = mirror.norm();
        if length > 0.0 {
            mirror /= length;
        }
        for j in k..5 {
            let reflected = columns.column(j) - mirror * (2.0 * mirror.dot(&columns.column(j)));
            columns.set_column(j, &reflected);
        }
        mirrors.set_column(k, &mirror);
    }
    [5, 6, 7, 8].map(|axis| {
        let mut e = SVector::<f64, 9>::zeros();
        e[axis] = 1.0;
        for k in (0..5).rev() {
            let mirror = mirrors.column(k);
            e -= mirror * (2.0 * mirror.dot(&e));
        }
        Matrix3::from_row_slice(e.as_slice())
    })
}

/// `x X + y Y + z Z + w W`.
fn combine(basis: &[Matrix3<f64>; 4], c: &Vector4<f64>) -> Matrix3<f64> {
    basis[0] * c[0] + basis[1] * c[1] + basis[2] * c[2] + basis[3] * c[3]
}

/// The ten cubic equations of an essential matrix: `2 E E^T E - tr(E E^T) E = 0` and `det E = 0`.
fn constraints(basis: &[Matrix3<f64>; 4]) -> [Cubic; 10] {
    let e = |row: usize, column: usize| -> Linear { basis.map(|m| m[(row, column)]) };
    let mut gram = [[[0.0; 10]; 3]; 3]; // E E^T
    for i in 0..3 {
        for j in i..3 {
            for k in 0..3 {
                add_product(&mut gram[i][j], &e(i, k), &e(j, k), 1.0);
            }
            gram[j][i] = gram[i][j];
        }
    }
    let half_trace: Quadratic = std::array::from_fn(|m| 0.5 * (gram[0][0][m] + gram[1][1][m] + gram[2][2][m]));
    for i in 0..3 {
        (0..10).for_each(|m| gram[i][i][m] -= half_trace[m]);
    }
    let mut cubics = [[0.0; 20]; 10];
    for i in 0..3 {
        for j in 0..3 {
            for k in 0..3 {
                add_cubic_product(&mut cubics[3 * i + j], &gram[i][k], &e(k, j));
            }
        }
    }
    for k in 0..3 {
        let (p, q) = ((k + 1) % 3, (k + 2) % 3);
        let mut minor = [0.0; 10];
        add_product(&mut minor, &e(1, p), &e(2, q), 1.0);
        add_product(&mut minor, &e(1, q), &e(2, p), -1.0);
        add_cubic_product(&mut cubics[9], &minor, &e(0, k));
    }
    cubics
}

fn add_product(sum: &mut Quadratic, a: &Linear, b: &Linear, sign: f64) {
    for i in 0..4 {
        for j in 0..4 {
            sum[QUADRATIC_INDEX[i][j]] += sign * a[i] * b[j];
        }
    }
}

fn add_cubic_product(sum: &mut Cubic, a: &Quadratic, b: &Linear) {
    for i in 0..10 {
        for j in 0..4 {
            sum[CUBIC_INDEX[i][j]] += a[i] * b[j];
        }
    }
}

/// Gauss-Jordan elimination of the first ten monomials with row pivoting; `None` where these are linearly dependent.
fn eliminate(mut rows: [Cubic; 10]) -> Option<[Cubic; 10]> {
    for k in 0..10 {
        let pivot = (k..10).max_by(|&i, &j| rows[i][k].abs().total_cmp(&rows[j][k].abs()))?;
        rows.swap(k, pivot);
        let inverse = 1.0 / rows[k][k];
        if !inverse.is_finite() {
            return None;
        }
        (k..20).for_each(|m| rows[k][m] *= inverse);
        let source = rows[k];
        for (i, row) in rows.iter_mut().enumerate() {
            // Rows above the fifth serve as pivots only; later steps do not read them.
            if i > k || (i >= 4 && i < k) {
                let factor = row[k];
                (k..20).for_each(|m| row[m] -= factor * source[m]);
            }
        }
    }
    Some(rows)
}

/// One row of Nistér's matrix B: polynomials in z, ascending, that multiply x, y and 1.
struct PolynomialRow {
    x: [f64; 4],
    y: [f64; 4],
    one: [f64; 5],
}

/// Row `k` (monomial m z) minus z times row `k + 1` (monomial m): the leading monomials cancel.
fn polynomial_row(reduced: &[Cubic; 10], k: usize) -> PolynomialRow {
    let (a, b) = (&reduced[k][10..], &reduced[k + 1][10..]);
    PolynomialRow {
        x: [a[2], a[1] - b[2], a[0] - b[1], -b[0]],
        y: [a[5], a[4] - b[5], a[3] - b[4], -b[3]],
        one: [a[9], a[8] - b[9], a[7] - b[8], a[6] - b[7], -b[6]],
    }
}

/// The determinant of the three rows: a polynomial of degree ten in z.
fn determinant(rows: &[PolynomialRow; 3]) -> [f64; 11] {
    let mut sum = [0.0; 11];
    for k in 0..3 {
        let (p, q) = (&rows[(k + 1) % 3], &rows[(k + 2) % 3]);
        let mut minor = [0.0; 7];
        for i in 0..4 {
            for j in 0..4 {
                minor[i + j] += p.x[i] * q.y[j] - q.x[i] * p.y[j];
            }
        }
        for (i, one) in rows[k].one.iter().enumerate() {
            (0..7).for_each(|j| sum[i + j] += one * minor[j]);
        }
    }
    sum
}

/// (x, y, z, w), normalised, at a root z: the null vector of B(z) by the largest cross product of two rows.
fn solution_at(rows: &[PolynomialRow; 3], z: f64) -> Option<Vector4<f64>> {
    let value = |coefficients: &[f64]| coefficients.iter().rev().fold(0.0, |sum, c| sum * z + c);
    let [r0, r1, r2] = [0, 1, 2].map(|k| Vector3::new(value(&rows[k].x), value(&rows[k].y), value(&rows[k].one)));
    let crosses = [r0.cross(&r1), r1.cross(&r2), r2.cross(&r0)];
    let null = crosses.into_iter().max_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()))?;
    Vector4::new(null.x, null.y, z * null.z, null.z).try_normalize(0.0).filter(|c| c.iter().all(|v| v.is_finite()))
}

/// Gauss-Newton on all ten constraints over the unit sphere of (x, y, z, w).
///
/// `None` where it does not converge to an essential matrix: the root was a rounding error.
fn polish(basis: &[Matrix3<f64>; 4], start: Vector4<f64>) -> Option<Vector4<f64>> {
    const STEPS: usize = 4;
    const SOLVED: f64 = 1e-20; // squared; rounding of the ten constraints is some 1e-32
    let mut c = start;
    for _ in 0..STEPS {
        let e = combine(basis, &c);
        let (gram, trace) = (e * e.transpose(), e.norm_squared());
        let residual = gram * e * 2.0 - e * trace;
        if residual.norm_squared() < 1e-30 {
            return Some(c);
        }
        let right = e.transpose() * e;
        let derivative = basis.map(|d| {
            let cross = e * d.transpose() * e;
            (d * right + cross + gram * d) * 2.0 - e * (2.0 * e.dot(&d)) - d * trace
        });
        // The term c c^T fixes the scale: the step stays tangent to the sphere.
        let normal = Matrix4::from_fn(|i, j| derivative[i].dot(&derivative[j]) + c[i] * c[j]);
        let gradient = Vector4::from_fn(|i, _| derivative[i].dot(&residual));
        c = (c - normal.cholesky()?.solve(&gradient)).try_normalize(0.0)?;
    }
    let e = combine(basis, &c);
    ((e * e.transpose() * e * 2.0 - e * e.norm_squared()).norm_squared() < SOLVED).then_some(c)
}
