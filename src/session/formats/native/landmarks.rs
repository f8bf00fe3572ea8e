//! `keypoint_convention`: the name of a convention, or a table of landmarks
//! `{"name", "landmarks": [{"name", "terms": [{"joint", "weight", "offset": [x, y, z]}]}]}`, which may also be the file
//! `landmarks.json`.

use crate::body::dense_landmarks::{MAX_LANDMARKS, StatedLandmark};
use crate::body::model::{Landmark, LandmarkTerm};
use crate::body::skeleton::JOINT_NAMES;
use crate::session::recording::Session;
use crate::session::upload::error::{Fault, UploadError};
use crate::session::upload::json::{Fields, Items, JsonStream, List, Object, Reading, ShortList};
use crate::session::upload::limits::UploadLimits;
use crate::session::upload::warnings::Warnings;
use serde::de::{DeserializeSeed, Deserializer, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Serialize};
use std::fmt;

/// The part that has been read.
#[derive(Default)]
pub(super) struct PointsFields {
    /// Name of the convention or of the table.
    pub(super) name: Option<String>,
    /// In the order of the keypoints.
    pub(super) landmarks: Option<Vec<StatedLandmark>>,
}

impl Fields for PointsFields {
    const WHAT: &'static str = "the table of landmarks";

    fn field<'d, M: MapAccess<'d>>(&mut self, key: &str, map: &mut M, reading: &mut Reading) -> Result<bool, M::Error> {
        match key {
            "name" => self.name = Some(map.next_value()?),
            "landmarks" => map.next_value_seed(List(&mut Landmarks(self.landmarks.insert(Vec::new())), reading))?,
            _ => return Ok(false),
        }
        Ok(true)
    }
}

struct Landmarks<'l>(&'l mut Vec<StatedLandmark>);

impl Items for Landmarks<'_> {
    fn item<'d, S: SeqAccess<'d>>(&mut self, i: usize, seq: &mut S, reading: &mut Reading) -> Result<bool, S::Error> {
        let Some(Entry { name, terms }) = seq.next_element::<Entry>()? else { return Ok(false) };
        if i == MAX_LANDMARKS {
            let detail = format!("the table has more than {MAX_LANDMARKS} landmarks");
            return Err(reading.refuse(Fault::LandmarksInvalid.with(detail)));
        }
        let terms = terms.map_or_else(Vec::new, |terms| terms.0);
        let term = |Term { joint, weight, offset }: Term| (joint, weight, offset);
        self.0.push(StatedLandmark { name, terms: terms.into_iter().map(term).collect() });
        Ok(true)
    }
}

#[derive(Serialize, Deserialize)]
struct Entry {
    name: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    terms: Option<ShortList<Term>>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Term {
    joint: String,
    weight: f64,
    offset: [f64; 3],
}

/// Reads a name or a table.
pub(super) struct NameOrTable<'f, 'r, 'a>(pub(super) &'f mut PointsFields, pub(super) &'r mut Reading<'a>);

impl<'de> DeserializeSeed<'de> for NameOrTable<'_, '_, '_> {
    type Value = ();
    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for NameOrTable<'_, '_, '_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the name of a keypoint convention or a table of landmarks")
    }

    fn visit_str<E: serde::de::Error>(self, name: &str) -> Result<(), E> {
        self.0.name = Some(name.to_owned());
        Ok(())
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<(), A::Error> {
        Object(self.0, self.1).visit_map(map)
    }
}

/// As written: a name, or a table.
#[derive(Serialize)]
#[serde(untagged)]
pub(super) enum Points<'a> {
    Name(&'static str),
    Table(Table<'a>),
}

/// A table of landmarks.
#[derive(Serialize)]
pub(super) struct Table<'a> {
    name: &'a str,
    landmarks: Vec<Entry>,
}

/// The points of a session, in the order of its detections.
pub(super) fn points_of(session: &Session) -> Points<'_> {
    let Some(dense) = &session.dense else { return Points::Name(session.convention.name()) };
    let names = session.convention.names().iter().map(|name| Entry { name: (*name).to_owned(), terms: None });
    Points::Table(Table { name: &dense.name, landmarks: names.chain(dense.landmarks.iter().map(entry)).collect() })
}

fn entry(landmark: &Landmark) -> Entry {
    let term = |term: &LandmarkTerm| Term {
        joint: JOINT_NAMES[term.joint].to_owned(),
        weight: term.weight,
        offset: if term.weight == 0.0 { [0.0; 3] } else { (term.offset / term.weight).into() },
    };
    Entry { name: landmark.name.clone(), terms: Some(ShortList(landmark.terms.iter().map(term).collect())) }
}

/// A table as a document, as it may be written into `landmarks.json`.
///
/// # Errors
/// None for finite numbers; writing JSON is fallible in general.
pub fn landmarks_json(name: &str, stated: &[StatedLandmark]) -> serde_json::Result<String> {
    let term = |(joint, weight, offset): &(String, f64, [f64; 3])| Term {
        joint: joint.clone(),
        weight: *weight,
        offset: *offset,
    };
    let entry = |landmark: &StatedLandmark| Entry {
        name: landmark.name.clone(),
        terms: (!landmark.terms.is_empty()).then(|| ShortList(landmark.terms.iter().map(term).collect())),
    };
    serde_json::to_string(&Table { name, landmarks: stated.iter().map(entry).collect() })
}

/// Name and landmarks of a document that [`landmarks_json`] wrote; to be checked as of an upload.
///
/// # Errors
/// [`UploadError`] where the text differs from such a document.
pub fn landmarks_from_json(text: &[u8]) -> Result<(String, Vec<StatedLandmark>), UploadError> {
    let (limits, mut warnings) = (UploadLimits::default(), Warnings::default());
    let (mut reading, mut points) = (Reading::new(&limits, &mut warnings), PointsFields::default());
    let mut stream = JsonStream::new(text, &limits);
    stream.next(&mut points, &mut reading)?;
    stream.expect_end(&mut reading)?;
    Ok((points.name.unwrap_or_default(), points.landmarks.unwrap_or_default()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::default_body;
    use crate::body::dense_landmarks::spread_over_skin;
    use crate::body::skeleton::KeypointConvention;
    use crate::session::formats::native::to_json;
    use crate::session::upload::{LoadedSession, read_path, read_upload};
    use std::io::Cursor;

    fn table() -> Vec<StatedLandmark> {
        let mut table = spread_over_skin(&default_body(), KeypointConvention::Coco17, 4, 0);
        table.swap(0, 18);
        table
    }

    /// Point k of the files lies at x = 100 + k.
    fn poses() -> String {
        let points: Vec<String> = (0..21).map(|k| format!("[{}, 300, 0.5]", 100 + k)).collect();
        format!(r#"{{"frames": [{{"frame": 0, "people": [{{"keypoints": [{}]}}]}}]}}"#, points.join(", "))
    }

    fn header(points: &str, poses: &str) -> String {
        format!(
            r#"{{"fps": 25, "n_frames": 1, {points}
                "cameras": [{{"id": "left", "width": 1280, "height": 720, "K": [[900, 0, 640], [0, 900, 360], [0, 0, 1]]}}]{poses}}}"#
        )
    }

    fn read(table: &str) -> Result<LoadedSession, UploadError> {
        let inline = format!(r#", "poses": {{"left": {}}}"#, poses());
        let document = header(&format!(r#""keypoint_convention": {table},"#), &inline);
        read_upload(Cursor::new(document), "upload", &UploadLimits::default())
    }

    #[test]
    fn a_table_orders_the_points_and_reads_back() {
        let session = read(&landmarks_json("skin", &table()).unwrap()).unwrap().session;
        let keypoints = &session.views[0].frames[0][0].keypoints;
        assert_eq!((session.convention, keypoints.len(), session.n_points()), (KeypointConvention::Coco17, 21, 21));
        // The nose came as the nineteenth point.
        assert_eq!((keypoints[0].pixel.x, keypoints[1].pixel.x, keypoints[17].pixel.x), (118.0, 101.0, 100.0));
        let again = read_upload(Cursor::new(to_json(&session).unwrap()), "upload", &UploadLimits::default()).unwrap();
        assert_eq!(again.session.views, session.views);
        let names = |session: &Session| session.dense.as_ref().unwrap().names().map(str::to_owned).collect::<Vec<_>>();
        assert_eq!(names(&again.session), names(&session));
    }

    #[test]
    fn a_table_beside_the_session_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
        std::fs::create_dir(folder.path().join("poses")).unwrap();
        write("session.json", &header("", ""));
        write("poses/left.json", &poses());
        write("landmarks.json", &landmarks_json("skin", &table()).unwrap());
        let loaded = read_path(folder.path(), &UploadLimits::default()).unwrap();
        assert_eq!(loaded.session.dense.as_ref().unwrap().name, "skin");
        write("landmarks.json", &landmarks_json("other", &table()).unwrap());
        let other = read_path(folder.path(), &UploadLimits::default()).unwrap();
        assert_ne!(other.sha256, loaded.sha256, "the table is part of the digest");
    }

    #[test]
    fn faults_of_a_table_are_named() {
        let mut unknown = table();
        unknown[20].terms[0].0 = "tail".to_owned();
        let error = read(&landmarks_json("skin", &unknown).unwrap()).unwrap_err();
        assert_eq!((error.code, error.detail.contains("\"tail\"")), ("landmarks_invalid", true), "{error}");
        let error = read(r#"{"name": "x", "landmarks": []}"#).unwrap_err();
        assert_eq!(error.code, "landmarks_invalid", "{error}");
        assert_eq!(read("17").unwrap_err().code, "json_type");
        let many = vec![r#"{"name": "a"}"#; 1001].join(", ");
        assert_eq!(read(&format!(r#"{{"name": "x", "landmarks": [{many}]}}"#)).unwrap_err().code, "landmarks_invalid");
    }
}
