//! The second likeliest way up.

/// Another way up than that of the result's world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UpRival {
    /// How many times less likely it is.
    pub ratio: f64,
    /// Between the two, degrees.
    pub angle_deg: f64,
}
