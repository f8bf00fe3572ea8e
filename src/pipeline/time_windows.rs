//! Windows of time: takes of any length are solved window by window.

use std::ops::Range;

/// Runs of at most `length` frames, their lengths as equal as possible.
pub(crate) fn windows(n_frames: usize, length: usize) -> Vec<Range<usize>> {
    let count = n_frames.div_ceil(length);
    (0..count).map(|i| i * n_frames / count..(i + 1) * n_frames / count).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_cover_all_frames_and_differ_by_one() {
        assert_eq!(windows(10, 4), [0..3, 3..6, 6..10]);
        assert_eq!(windows(8, 8), [Range { start: 0, end: 8 }]);
        assert!(windows(0, 4).is_empty());
    }
}
