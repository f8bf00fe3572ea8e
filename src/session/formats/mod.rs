//! The dialects that sessions are written in, one file each.

pub mod native;

/// `value` to that many decimal places, as it is written in a file; never a negative zero.
///
/// Values beyond 2^53 units of the last place come back unchanged to within rounding.
pub(crate) fn rounded(value: f64, decimals: i32) -> f64 {
    let unit = 10f64.powi(decimals);
    (value * unit).round() / unit + 0.0
}
