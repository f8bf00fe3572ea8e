//! Result of comparing an object with its row.

/// What became of an object that was checked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Checked {
    /// It has the bytes that its row states.
    Whole,
    /// It was missing or damaged, and an earlier version has taken its place.
    Restored,
    /// It is missing or damaged.
    Damaged,
}
