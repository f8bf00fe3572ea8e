//! Recognition of a dialect by the beginning of a file: the keys of its outermost object, or of its first item.

/// A dialect of 2D poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum PoseDialect {
    /// `{"people": [...]}`, one file per frame; also AlphaPose's `open` and DMMR's layout.
    OpenPose,
    /// `{"bodies": [{"joints": [...]}]}`, one file per frame.
    AlphaPoseCmu,
    /// `{"annots": [...]}` or its list alone, one file per frame.
    EasyMocap,
    /// A list of instances, one file per frame.
    MmposeFrame,
    /// A list of people whose `image_id` is a text.
    AlphaPose,
    /// A list of people whose `image_id` is a number.
    CocoResults,
    /// `{"images": [...], "annotations": [...]}`: the table that numbers images, with or without people.
    CocoImages,
    /// `{"meta_info": ..., "instance_info": [...]}` or its list alone.
    Mmpose,
    /// `sync_index, cam_id, ..., img_loc_x, img_loc_y`.
    CaliscopeCsv,
    /// `cam_id, frame_time`.
    CaliscopeTimestamps,
    /// `scorer`, `bodyparts`, `coords`.
    DeepLabCutCsv,
    /// A numpy array `[cameras, frames, points, x y]`.
    MediaPipeArray,
    /// `{"frames": [...]}`: a camera's poses in the native layout.
    Native,
}

impl PoseDialect {
    /// The name in the response to an upload.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::OpenPose => "openpose",
            Self::AlphaPoseCmu => "alphapose_cmu",
            Self::EasyMocap => "easymocap",
            Self::MmposeFrame | Self::Mmpose => "mmpose",
            Self::AlphaPose => "alphapose",
            Self::CocoResults | Self::CocoImages => "coco",
            Self::CaliscopeCsv | Self::CaliscopeTimestamps => "caliscope",
            Self::DeepLabCutCsv => "deeplabcut",
            Self::MediaPipeArray => "mediapipe",
            Self::Native => "native",
        }
    }

    /// Whether the dialect has one file per frame.
    pub(crate) fn is_file_per_frame(self) -> bool {
        matches!(self, Self::OpenPose | Self::AlphaPoseCmu | Self::EasyMocap | Self::MmposeFrame)
    }
}

/// Recognises a dialect by a file's first bytes; `None` for anything else, such as an empty list.
pub(crate) fn recognise(head: &str) -> Option<PoseDialect> {
    use PoseDialect as P;
    let start = head.trim_start();
    if start.starts_with('{') {
        let keys = keys_at(start, 1);
        let has = |key: &str| keys.iter().any(|(own, _)| *own == key);
        let known = [
            ("people", P::OpenPose),
            ("bodies", P::AlphaPoseCmu),
            ("annots", P::EasyMocap),
            ("instance_info", P::Mmpose),
            ("meta_info", P::Mmpose),
            ("frames", P::Native),
            ("annotations", P::CocoImages),
            ("images", P::CocoImages),
        ];
        return known.iter().find(|(key, _)| has(key)).map(|(_, dialect)| *dialect);
    }
    if start.starts_with('[') {
        let keys = keys_at(start, 2);
        let first = |key: &str| keys.iter().find(|(own, _)| *own == key).map(|(_, value)| *value);
        return match first("image_id") {
            Some(b'"') => Some(P::AlphaPose),
            Some(_) => Some(P::CocoResults),
            None if first("instances").is_some() => Some(P::Mmpose),
            None if first("keypoint_scores").is_some() => Some(P::MmposeFrame),
            None if first("keypoints").is_some() || first("keypoints2d").is_some() => Some(P::EasyMocap),
            None => None,
        };
    }
    let line = start.lines().next().unwrap_or_default();
    let columns: Vec<&str> = line.split(',').map(str::trim).collect();
    let has = |column: &str| columns.contains(&column);
    match () {
        () if has("sync_index") && has("img_loc_x") => Some(P::CaliscopeCsv),
        () if has("frame_time") => Some(P::CaliscopeTimestamps),
        () if columns.first() == Some(&"scorer") => Some(P::DeepLabCutCsv),
        () => None,
    }
}

/// Keys of the first object at a level of nesting, each with the first byte of its value.
fn keys_at(text: &str, level: usize) -> Vec<(&str, u8)> {
    let bytes = text.as_bytes();
    let (mut keys, mut depth, mut at) = (Vec::new(), 0usize, 0);
    while at < bytes.len() {
        match bytes[at] {
            b'{' | b'[' => depth += 1,
            b'}' | b']' => {
                if depth == level && !keys.is_empty() {
                    break;
                }
                depth = depth.saturating_sub(1);
            }
            b'"' => {
                let Some(end) = end_of_string(bytes, at + 1) else { break };
                let mut after = bytes[end + 1..].iter().filter(|b| !b.is_ascii_whitespace());
                if depth == level && after.next() == Some(&b':') {
                    keys.push((&text[at + 1..end], after.next().copied().unwrap_or(0)));
                }
                at = end;
            }
            _ => {}
        }
        at += 1;
    }
    keys
}

fn end_of_string(bytes: &[u8], start: usize) -> Option<usize> {
    let mut at = start;
    while *bytes.get(at)? != b'"' {
        at += if bytes[at] == b'\\' { 2 } else { 1 };
    }
    Some(at)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recognises_dialects_by_content() {
        let cases = [
            (r#"{"version": 1.3, "people": []}"#, Some(PoseDialect::OpenPose)),
            (r#"{"version":0.1,"bodies":[{"joints":[1,2"#, Some(PoseDialect::AlphaPoseCmu)),
            (r#"{"filename":"people","annots":[]}"#, Some(PoseDialect::EasyMocap)),
            (r#"[{"personID":0,"bbox":[1,2,3,4,1],"keypoints":[[1,"#, Some(PoseDialect::EasyMocap)),
            (r#"[{"keypoints":[1,2,3],"image_id" : "a\"b.jpg"}]"#, Some(PoseDialect::AlphaPose)),
            (r#"[{"image_id": 12,"keypoints":[1,2,3]}]"#, Some(PoseDialect::CocoResults)),
            (r#"{"meta_info":{"people":1},"instance_info":[]}"#, Some(PoseDialect::Mmpose)),
            (r#"[{"frame_id":0,"instances":[{"keypoints":[[1,2]]}]}]"#, Some(PoseDialect::Mmpose)),
            (r#"[{"keypoints":[[1,2]],"keypoint_scores":[1]}]"#, Some(PoseDialect::MmposeFrame)),
            (r#"{"frames":[]}"#, Some(PoseDialect::Native)),
            ("scorer,net,net,net\nbodyparts,a,a,a", Some(PoseDialect::DeepLabCutCsv)),
            ("cam_id,frame_time\n0,1.5", Some(PoseDialect::CaliscopeTimestamps)),
            ("[]", None),
            ("{}", None),
            ("{\"", None),
            ("", None),
        ];
        for (text, dialect) in cases {
            assert_eq!(recognise(text), dialect, "{text}");
        }
    }
}
