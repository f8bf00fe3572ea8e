//! Matching of pose files to cameras: by name, by number, or else by order.

use crate::session::upload::error::{Fault, UploadError, shown};
use crate::session::upload::warnings::Warnings;

/// For every source the index of its camera; `None` without a match.
///
/// `sources`: possible camera names of each source, the most likely first. Names are compared exactly, then without case and
/// without tools' suffixes, then by the number in them. Where no name matches and there are as many sources as cameras, they
/// are matched in order, with a warning.
///
/// # Errors
/// [`Fault::SessionAmbiguous`] where two sources match one camera.
pub(super) fn match_cameras(
    sources: &[Vec<String>],
    cameras: &[&str],
    warnings: &mut Warnings,
) -> Result<Vec<Option<usize>>, UploadError> {
    let mut matched: Vec<Option<usize>> = vec![None; sources.len()];
    let levels: [fn(&str) -> Option<String>; 3] = [|name| Some(name.to_owned()), plain, number];
    for level in levels {
        let keys: Vec<Option<String>> = cameras.iter().map(|camera| level(camera)).collect();
        for (source, names) in sources.iter().enumerate() {
            if matched[source].is_some() {
                continue;
            }
            let camera_of = |name: &String| {
                let key = level(name)?;
                let mut fitting = (0..cameras.len()).filter(|c| keys[*c].as_ref() == Some(&key));
                fitting.next().filter(|_| fitting.next().is_none())
            };
            let found = names.iter().find_map(camera_of);
            matched[source] = found.filter(|camera| keys[*camera].is_some());
        }
    }
    check_unique(&matched, sources, cameras)?;
    if matched.iter().all(Option::is_none) && sources.len() == cameras.len() {
        let pairs = sources
            .iter()
            .zip(cameras)
            .map(|(names, camera)| format!("{} to {}", shown(names.first().map_or("", String::as_str)), shown(camera)));
        let pairs: Vec<String> = pairs.collect();
        warnings.add(format!("no pose file has the name of a camera: they are matched in order, {}", pairs.join(", ")));
        return Ok((0..sources.len()).map(Some).collect());
    }
    Ok(matched)
}

/// Whether one of a source's names is a camera's, apart from case and tools' suffixes.
pub(super) fn is_named(source: &[String], camera: &str) -> bool {
    source.iter().any(|name| name == camera || plain(name).is_some_and(|name| plain(camera) == Some(name)))
}

fn check_unique(matched: &[Option<usize>], sources: &[Vec<String>], cameras: &[&str]) -> Result<(), UploadError> {
    for (source, camera) in matched.iter().enumerate() {
        let twin = (0..source).find(|other| camera.is_some() && matched[*other] == *camera);
        if let (Some(camera), Some(twin)) = (camera, twin) {
            let name = |source: usize| shown(sources[source].first().map_or("", String::as_str));
            let detail = format!("poses {} and {} both match this camera", name(twin), name(source));
            let error = Fault::SessionAmbiguous.with(detail);
            return Err(UploadError { camera: Some(cameras[*camera].to_owned()), ..error });
        }
    }
    Ok(())
}

/// A name without case, file ending and tools' suffixes.
fn plain(name: &str) -> Option<String> {
    let lower = name.to_ascii_lowercase();
    let stem = lower.rsplit_once('.').map_or(lower.as_str(), |(stem, _)| stem);
    let parts = stem.split(['_', '-', ' ', '.']).filter(|part| !TOOLS.contains(part) && !part.is_empty());
    let plain: String = parts.collect();
    (!plain.is_empty()).then_some(plain)
}

/// Words that pose tools add to a camera's name.
const TOOLS: [&str; 14] = [
    "json", "keypoints", "keypoint", "pose", "poses", "results", "result", "alphapose", "openpose", "predictions",
    "2d", "int", "intrinsics", "calib",
];

/// The last number in a name.
fn number(name: &str) -> Option<String> {
    let end = name.rfind(|c: char| c.is_ascii_digit())? + 1;
    let start = name[..end].trim_end_matches(|c: char| c.is_ascii_digit()).len();
    let digits = name[start..end].trim_start_matches('0');
    Some(if digits.is_empty() { "0".to_owned() } else { digits.to_owned() })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn matched(sources: &[&[&str]], cameras: &[&str]) -> Result<Vec<Option<usize>>, &'static str> {
        let sources: Vec<Vec<String>> =
            sources.iter().map(|names| names.iter().map(|name| (*name).to_owned()).collect()).collect();
        match_cameras(&sources, cameras, &mut Warnings::default()).map_err(|e| e.code)
    }

    #[test]
    fn matches_cameras_by_name_number_and_order() {
        assert_eq!(matched(&[&["b"], &["a"]], &["a", "b"]), Ok(vec![Some(1), Some(0)]));
        assert_eq!(matched(&[&["Cam01_json"], &["cam02.mp4"]], &["cam01", "cam02"]), Ok(vec![Some(0), Some(1)]));
        assert_eq!(matched(&[&["keypoints", "camera_3"], &["cam2"]], &["02", "03"]), Ok(vec![Some(1), Some(0)]));
        assert_eq!(matched(&[&["left"], &["right"]], &["a", "b"]), Ok(vec![Some(0), Some(1)]));
        assert_eq!(matched(&[&["left"], &["a"]], &["a", "b"]), Ok(vec![None, Some(0)]));
        assert_eq!(matched(&[&["a"], &["a_json"]], &["a", "b"]), Err("session_ambiguous"));
        assert_eq!(matched(&[&["1"]], &["a1", "b1"]), Ok(vec![None]), "the number of two cameras is ambiguous");
    }
}
