//! Values as USD's text format has them.

use crate::export::files::micro;
use crate::session::formats::{entries, rounded};
use nalgebra::{Matrix3, Vector3};

/// A rigid motion as a matrix for row vectors, which USD uses: the axes are its rows.
pub(super) fn matrix(axes: &Matrix3<f64>, place: &Vector3<f64>) -> String {
    let row = |c: usize| {
        let [x, y, z] = [axes[(0, c)], axes[(1, c)], axes[(2, c)]].map(|c| rounded(c, 9));
        format!("({x:?}, {y:?}, {z:?}, 0)")
    };
    let [x, y, z] = entries(place).map(micro);
    format!("( {}, {}, {}, ({x:?}, {y:?}, {z:?}, 1) )", row(0), row(1), row(2))
}

/// A point or a vector, rounded to 1e-6.
pub(super) fn tuple(vector: &Vector3<f64>) -> String {
    let [x, y, z] = entries(vector).map(micro);
    format!("({x:?}, {y:?}, {z:?})")
}

/// A list in brackets.
pub(super) fn list(items: impl Iterator<Item = String>) -> String {
    format!("[{}]", items.collect::<Vec<_>>().join(", "))
}
