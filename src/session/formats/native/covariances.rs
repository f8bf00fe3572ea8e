//! Reader of what a detector states of its own errors: beside `keypoints` either `covariances`, `[[xx, xy, yy], …]` in px^2,
//! or `sigmas`, `[s, …]` in px; one entry per keypoint, `null` where it is unknown.

use crate::geometry::PixelCovariance;
use crate::session::recording::Keypoint;
use crate::session::upload::error::{Fault, UploadError};
use crate::session::upload::json::{Items, Numbers, Reading};
use crate::session::upload::limits::MAX_KEYPOINTS_PER_PERSON;
use serde::de::SeqAccess;

/// The part of a person's statements that has been read.
#[derive(Default)]
pub(super) struct Covariances {
    /// By keypoint, from `covariances` and from `sigmas`.
    lists: [Option<Vec<Option<PixelCovariance>>>; 2],
}

/// Keys of the lists.
const KEYS: [&str; 2] = ["covariances", "sigmas"];

impl Covariances {
    /// Reader of the list `covariances`.
    pub(super) fn of_entries(&mut self) -> EntryList<'_> {
        EntryList(self.lists[0].insert(Vec::new()))
    }

    /// Reader of the list `sigmas`.
    pub(super) fn of_sigmas(&mut self) -> SigmaList<'_> {
        SigmaList(self.lists[1].insert(Vec::new()))
    }

    /// Adds them to the keypoints that were detected.
    pub(super) fn add_to(self, keypoints: &mut [Keypoint]) -> Result<(), UploadError> {
        let (key, list) = match self.lists {
            [None, None] => return Ok(()),
            [Some(_), Some(_)] => {
                return Err(Fault::CovarianceInvalid.with("the person has both `covariances` and `sigmas`"));
            }
            [Some(list), None] => (KEYS[0], list),
            [None, Some(list)] => (KEYS[1], list),
        };
        Fault::CovarianceInvalid.when(list.len() != keypoints.len(), || {
            format!("the person has {} `{key}` of {} keypoints", list.len(), keypoints.len())
        })?;
        for (keypoint, covariance) in keypoints.iter_mut().zip(list) {
            keypoint.covariance = covariance.filter(|_| keypoint.is_present());
        }
        Ok(())
    }
}

/// Items of `covariances`.
pub(super) struct EntryList<'c>(&'c mut Vec<Option<PixelCovariance>>);

impl Items for EntryList<'_> {
    fn item<'d, S: SeqAccess<'d>>(&mut self, i: usize, seq: &mut S, reading: &mut Reading) -> Result<bool, S::Error> {
        let Some(entries) = seq.next_element::<Option<Numbers>>()? else { return Ok(false) };
        check_count(i, reading)?;
        let checked = entries.map(|entries| match entries.0[..] {
            [xx, xy, yy] => PixelCovariance::new([xx, xy, yy]).ok_or_else(|| {
                format!("the covariance of keypoint {i} is [{xx}, {xy}, {yy}] px^2, which is not positive definite")
            }),
            _ => Err(format!("the covariance of keypoint {i} has {} numbers, expected 3", entries.0.len())),
        });
        self.0.push(checked.transpose().map_err(|detail| reading.refuse(Fault::CovarianceInvalid.with(detail)))?);
        Ok(true)
    }
}

/// Items of `sigmas`.
pub(super) struct SigmaList<'c>(&'c mut Vec<Option<PixelCovariance>>);

impl Items for SigmaList<'_> {
    fn item<'d, S: SeqAccess<'d>>(&mut self, i: usize, seq: &mut S, reading: &mut Reading) -> Result<bool, S::Error> {
        let Some(sigma) = seq.next_element::<Option<f64>>()? else { return Ok(false) };
        check_count(i, reading)?;
        let checked = sigma.map(|sigma| {
            PixelCovariance::isotropic(sigma)
                .ok_or_else(|| format!("the sigma of keypoint {i} is {sigma} px, expected 0.001 to 10^6 px"))
        });
        self.0.push(checked.transpose().map_err(|detail| reading.refuse(Fault::CovarianceInvalid.with(detail)))?);
        Ok(true)
    }
}

/// Longer lists are refused while they are read.
fn check_count<E: serde::de::Error>(i: usize, reading: &mut Reading) -> Result<(), E> {
    if i < MAX_KEYPOINTS_PER_PERSON {
        return Ok(());
    }
    Err(reading.refuse(Fault::KeypointCount.with(format!("a person has more than {i} covariances"))))
}

#[cfg(test)]
mod tests {
    use crate::geometry::PixelCovariance;
    use crate::session::formats::native::to_json;
    use crate::session::recording::Session;
    use crate::session::upload::{UploadError, UploadLimits, read_upload};
    use std::io::Cursor;

    /// One camera, one person of 17 points, the third of which is missing; `stated` stands beside the keypoints.
    fn read(stated: &str) -> Result<Session, UploadError> {
        let point = |k| if k == 2 { "[0, 0, 0]".to_owned() } else { format!("[{}, 300, 1]", 100 + k) };
        let points: Vec<String> = (0..17).map(point).collect();
        let document = format!(
            r#"{{"fps": 25, "n_frames": 8, "keypoint_convention": "coco17",
                "cameras": [{{"id": "left", "width": 1280, "height": 720, "K": [[900, 0, 640], [0, 900, 360], [0, 0, 1]]}}],
                "poses": {{"left": {{"frames": [{{"frame": 7, "people": [{{{stated}, "keypoints": [{}]}}]}}]}}}}}}"#,
            points.join(", ")
        );
        read_upload(Cursor::new(document), "upload", &UploadLimits::default()).map(|loaded| loaded.session)
    }

    fn list(first: &str, rest: &str) -> String {
        std::iter::once(first).chain([rest; 16]).collect::<Vec<_>>().join(", ")
    }

    #[test]
    fn covariances_and_sigmas_are_read_and_written() {
        let session = read(&format!(r#""covariances": [{}]"#, list("[4.5, -1, 2]", "null"))).unwrap();
        let keypoints = &session.views[0].frames[7][0].keypoints;
        assert_eq!(keypoints[0].covariance, PixelCovariance::new([4.5, -1.0, 2.0]));
        assert!(keypoints[1..].iter().all(|keypoint| keypoint.covariance.is_none()));
        let again = read_upload(Cursor::new(to_json(&session).unwrap()), "upload", &UploadLimits::default()).unwrap();
        assert_eq!(again.session, session);

        let session = read(&format!(r#""sigmas": [{}]"#, list("3", "1.5"))).unwrap();
        let keypoints = &session.views[0].frames[7][0].keypoints;
        assert_eq!(keypoints[0].covariance, PixelCovariance::isotropic(3.0));
        assert_eq!(keypoints[2].covariance, None, "a missing keypoint has no error");
    }

    #[test]
    fn an_error_names_camera_frame_person_keypoint_and_value() {
        let error = read(&format!(r#""covariances": [{}]"#, list("[1, 3, 1]", "null"))).unwrap_err();
        assert_eq!((error.code, error.camera.as_deref(), error.frame), ("covariance_invalid", Some("left"), Some(7)));
        assert_eq!(error.person, Some(0));
        assert!(error.detail.contains("keypoint 0 is [1, 3, 1] px^2"), "{error}");
        assert!(error.remedy.contains("null where unknown"), "{error}");

        for (stated, part) in [
            (format!(r#""sigmas": [{}]"#, list("-1", "2")), "sigma of keypoint 0 is -1 px"),
            (r#""sigmas": [1, 2]"#.to_owned(), "2 `sigmas` of 17 keypoints"),
            (format!(r#""covariances": [{}]"#, list("[1, 2]", "null")), "has 2 numbers"),
            (format!(r#""sigmas": [{0}], "covariances": [{1}]"#, list("1", "2"), list("null", "null")), "both"),
        ] {
            let error = read(&stated).unwrap_err();
            assert_eq!(error.code, "covariance_invalid", "{error}");
            assert!(error.detail.contains(part), "{error}");
        }
        let endless = vec!["1"; 1001].join(", ");
        assert_eq!(read(&format!(r#""sigmas": [{endless}]"#)).unwrap_err().code, "keypoint_count");
    }
}
