//! Frame numbers in file names.

/// Frame number and stem of a file name: `cam_000012_keypoints.json` is frame 12 of `cam`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct FrameName {
    /// The part before the number, without separators at its end.
    pub(crate) stem: String,
    pub(crate) frame: i64,
}

/// Splits a file name (without folder); `None` where it does not end in digits.
pub(crate) fn frame_name(file_name: &str) -> Option<FrameName> {
    let stem = file_name.rsplit_once('.').map_or(file_name, |(stem, _)| stem);
    let stem = ["_keypoints", "_poses", "_pose"].iter().find_map(|end| stem.strip_suffix(end)).unwrap_or(stem);
    let start = stem.trim_end_matches(|c: char| c.is_ascii_digit()).len();
    let frame = stem[start..].parse().ok().filter(|frame: &i64| *frame < 1 << 53)?;
    Some(FrameName { stem: stem[..start].trim_end_matches(['_', '-', '.']).to_owned(), frame })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_frame_numbers_at_the_end_of_names() {
        let name = |text: &str| frame_name(text).map(|name| (name.stem, name.frame));
        assert_eq!(name("cam_1_000000000012_keypoints.json"), Some(("cam_1".to_owned(), 12)));
        assert_eq!(name("000123.json"), Some((String::new(), 123)));
        assert_eq!((name("intri.yml"), name("99999999999999999999.json")), (None, None));
    }
}
