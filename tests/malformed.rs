//! Damaged and hostile sessions: each is refused with its code, its kind and the location of the problem, within two seconds.

#![allow(clippy::unwrap_used)] // a test may

use serde_json::{Value, json};
use std::fs;
use std::io::{Cursor, Write};
use std::path::Path;
use std::time::{Duration, Instant};
use wandless::session::upload::UploadErrorKind::{self, Impossible, Malformed, TooLarge, Unsupported};
use wandless::session::upload::{LoadedSession, UploadError, UploadLimits, read_path, read_upload};
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

/// Largest time for a refusal.
const MAX_TIME: Duration = Duration::from_secs(2);
/// Largest growth of memory for a refusal, KiB, independent of the decompressed size.
const MAX_GROWTH_KIB: u64 = 64 * 1024;

/// One upload and the expected error.
struct Case {
    upload: Vec<u8>,
    code: &'static str,
    kind: UploadErrorKind,
    /// Parts of the expected message: the location and the value found.
    says: &'static [&'static str],
}

fn case(upload: impl Into<Vec<u8>>, code: &'static str, kind: UploadErrorKind, says: &'static [&'static str]) -> Case {
    Case { upload: upload.into(), code, kind, says }
}

/// A valid session of two cameras, one person and two frames.
fn session() -> Value {
    let camera = |id: &str| {
        json!({
            "id": id, "width": 640, "height": 480,
            "K": [[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]], "dist": [0, 0, 0, 0, 0],
            "R": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], "t": [0.0, 0.0, 3.0]
        })
    };
    let frame = |n: i64| json!({"frame": n, "people": [{"track_id": null, "keypoints": vec![[1.5, 2.5, 0.5]; 17]}]});
    let poses = json!({"frames": [frame(0), frame(1)]});
    json!({
        "name": "s", "fps": 30, "n_frames": 2, "keypoint_convention": "coco17",
        "cameras": [camera("left"), camera("right")], "poses": {"left": poses, "right": poses}
    })
}

/// The valid session with one value replaced.
fn with(pointer: &str, value: Value) -> Vec<u8> {
    let mut session = session();
    *session.pointer_mut(pointer).unwrap_or_else(|| panic!("{pointer}")) = value;
    session.to_string().into_bytes()
}

/// The valid session without one value.
fn without(parent: &str, key: &str) -> Vec<u8> {
    let mut session = session();
    session.pointer_mut(parent).unwrap().as_object_mut().unwrap().remove(key).unwrap();
    session.to_string().into_bytes()
}

/// The valid session's text with one part replaced.
fn replaced(from: &str, to: &str) -> Vec<u8> {
    let text = session().to_string();
    assert!(text.contains(from), "{from}");
    text.replacen(from, to, 1).into_bytes()
}

/// The members of the valid session's zip.
fn members() -> Vec<(String, Vec<u8>)> {
    let mut header = session();
    let poses = header.as_object_mut().unwrap().remove("poses").unwrap();
    let member = |id: &str| (format!("poses/{id}.json"), poses[id].to_string().into_bytes());
    vec![("session.json".to_owned(), header.to_string().into_bytes()), member("left"), member("right")]
}

fn zip_with(members: &[(String, Vec<u8>)], more: impl FnOnce(&mut ZipWriter<Cursor<Vec<u8>>>)) -> Vec<u8> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, content) in members {
        zip.start_file(name, SimpleFileOptions::default()).unwrap();
        zip.write_all(content).unwrap();
    }
    more(&mut zip);
    zip.finish().unwrap().into_inner()
}

fn valid_zip() -> Vec<u8> {
    zip_with(&members(), |_| {})
}

/// A valid zip with an additional member whose name no archiver would write.
fn zip_with_name(name: &str) -> Vec<u8> {
    let placeholder = "#".repeat(name.len());
    let zip = zip_with(&members(), |zip| zip.start_file(&placeholder, SimpleFileOptions::default()).unwrap());
    substituted(zip, placeholder.as_bytes(), name.as_bytes())
}

fn substituted(mut bytes: Vec<u8>, from: &[u8], to: &[u8]) -> Vec<u8> {
    assert_eq!(from.len(), to.len());
    let places: Vec<usize> = (0..=bytes.len() - from.len()).filter(|&i| bytes[i..].starts_with(from)).collect();
    assert!(!places.is_empty());
    for at in places {
        bytes[at..at + to.len()].copy_from_slice(to);
    }
    bytes
}

/// The valid zip with bytes changed in the two headers of the first member (offsets in the local and the central one).
fn zip_with_header(local: usize, central: usize, value: [u8; 2]) -> Vec<u8> {
    let mut zip = valid_zip();
    let directory = zip.windows(4).position(|w| w == b"PK\x01\x02").unwrap();
    zip[local..local + 2].copy_from_slice(&value);
    zip[directory + central..directory + central + 2].copy_from_slice(&value);
    zip
}

/// A zip of about five megabytes with one member that decompresses to five gibibytes of zeros.
fn zip_of_zeros() -> Vec<u8> {
    zip_with(&[], |zip| {
        let options = SimpleFileOptions::default().large_file(true);
        zip.start_file("session.json", options).unwrap();
        let zeros = vec![0; 1 << 20];
        for _ in 0..5 << 10 {
            zip.write_all(&zeros).unwrap();
        }
    })
}

fn containers() -> Vec<Case> {
    let zip = valid_zip();
    let trailing = [&zip[..], b"and more"].concat();
    let prepended = [b"PK\x03\x04 and ", &zip[..]].concat();
    let twins = zip_with(&members(), |zip| zip.start_file("poses/lefX.json", SimpleFileOptions::default()).unwrap());
    let link =
        zip_with(&members(), |zip| zip.add_symlink("poses/x.json", "/etc", SimpleFileOptions::default()).unwrap());
    let overlap = zip_with(&members(), |zip| zip.shallow_copy_file("poses/left.json", "copy").unwrap());
    let two = zip_with(&[("a/session.json".to_owned(), Vec::new()), ("b/session.json".to_owned(), Vec::new())], |_| {});
    let mut no_poses = members();
    no_poses.pop();
    let mut corrupt = members();
    corrupt[1].1.push(b'x');
    vec![
        case(&zip[..zip.len() / 2], "zip_invalid", Malformed, &["\"upload\""]),
        case(trailing, "zip_invalid", Malformed, &["\"upload\""]),
        case(prepended, "zip_invalid", Malformed, &["\"upload\""]),
        case(zip_with_name("../x"), "zip_name_unsafe", Malformed, &["\"../x\""]),
        case(zip_with_name("a/../../b"), "zip_name_unsafe", Malformed, &["\"a/../../b\""]),
        case(zip_with_name("/etc/passwd"), "zip_name_unsafe", Malformed, &["\"/etc/passwd\"", "absolute"]),
        case(zip_with_name("C:/x"), "zip_name_unsafe", Malformed, &["\"C:/x\"", "absolute"]),
        case(zip_with_name("..\\x"), "zip_name_unsafe", Malformed, &["backslash"]),
        case(zip_with_name("a\0b"), "zip_name_unsafe", Malformed, &["\"a\\0b\"", "NUL"]),
        case(link, "zip_symlink", Malformed, &["\"poses/x.json\""]),
        case(substituted(twins, b"lefX", b"left"), "zip_duplicate_member", Malformed, &["\"upload\""]),
        case(overlap, "zip_overlap", Malformed, &["share bytes"]),
        case(zip_with_header(6, 8, [1, 0]), "zip_encrypted", Unsupported, &["\"session.json\""]),
        case(zip_with_header(8, 10, [12, 0]), "zip_method", Unsupported, &["\"session.json\""]),
        case(zip_with_header(14, 16, [1, 2]), "zip_corrupt", Malformed, &["\"session.json\""]),
        case(zip_with_header(22, 24, [5, 0]), "zip_corrupt", Malformed, &["\"session.json\""]),
        case(zip_of_zeros(), "zip_ratio", TooLarge, &["\"session.json\"", "5368709120"]),
        case(two, "session_ambiguous", Malformed, &["\"a\", \"b\""]),
        case(zip_with(&[], |_| {}), "format_unknown", Unsupported, &["no session.json"]),
        case(zip_with(&no_poses, |_| {}), "poses_missing", Malformed, &["\"right\"", "poses/right.json"]),
        case(zip_with(&corrupt, |_| {}), "trailing_data", Malformed, &["\"poses/left.json\""]),
        case(Vec::new(), "format_unknown", Unsupported, &["empty"]),
        case(*b"%YAML:1.0", "format_unknown", Unsupported, &["25594"]),
    ]
}

fn documents() -> Vec<Case> {
    let person = "/poses/left/frames/1/people/0/keypoints";
    let deep = "[".repeat(100_000);
    let utf16: Vec<u8> = session().to_string().encode_utf16().flat_map(u16::to_le_bytes).collect();
    let text = session().to_string();
    let valid = text.as_bytes();
    let at_keypoint = &["\"left\"", "frame 0", "person 0", "/poses/left/frames/0/people/0/keypoints/0"];
    vec![
        case(&valid[..valid.len() - 9], "json_invalid", Malformed, &["\"upload\"", "EOF"]),
        case([valid, b" {}"].concat(), "trailing_data", Malformed, &["\"upload\""]),
        case([b"\xef\xbb\xbf", valid].concat(), "encoding", Malformed, &["byte order mark"]),
        case([b"\xff\xfe", &utf16[..]].concat(), "encoding", Malformed, &["UTF-16"]),
        case(utf16, "encoding", Malformed, &["UTF-16"]),
        case(replaced("[1.5,2.5,0.5]", "[NaN,2.5,0.5]"), "number_not_finite", Malformed, at_keypoint),
        case(replaced("[1.5,2.5,0.5]", "[1.5,-Infinity,0.5]"), "number_not_finite", Malformed, at_keypoint),
        case(replaced("[1.5,2.5,0.5]", "[1e400,2.5,0.5]"), "number_not_finite", Malformed, at_keypoint),
        case(replaced("[1.5,2.5,0.5]", "[1.5,\"2\",0.5]"), "json_type", Malformed, at_keypoint),
        case(replaced("[1.5,2.5,0.5]", "[1.5,2.5]"), "keypoint_invalid", Impossible, at_keypoint),
        case(replaced("[1.5,2.5,0.5]", "[1e9,2.5,0.5]"), "keypoint_invalid", Impossible, at_keypoint),
        case(replaced("[1.5,2.5,0.5]", "[1.5,2.5,-0.5]"), "keypoint_invalid", Impossible, at_keypoint),
        case(
            replaced("[1.5,2.5,0.5]", &format!("[{},2,1]", "1".repeat(10_000))),
            "token_too_long",
            TooLarge,
            at_keypoint,
        ),
        case(with("/name", json!("x".repeat(2 << 20))), "token_too_long", TooLarge, &["/name"]),
        case(format!("{{\"lens\":{deep}"), "json_too_deep", Malformed, &["32 levels"]),
        case(replaced("\"fps\":30", "\"fps\":30,\"fps\":25"), "duplicate_key", Malformed, &["\"fps\"", "the session"]),
        case(replaced("\"left\":{\"frames\"", "\"right\":{\"frames\""), "duplicate_key", Malformed, &["\"right\""]),
        case(without("", "fps"), "missing_field", Malformed, &["`fps`"]),
        case(without("", "poses"), "poses_missing", Malformed, &["`poses`"]),
        case(without("/poses", "right"), "poses_missing", Malformed, &["\"right\""]),
        case(
            with(person, json!(vec![[1, 2, 1]; 25])),
            "keypoint_count",
            Impossible,
            &["\"left\"", "frame 1", "person 0", "17 keypoints of coco17 expected, found 25"],
        ),
        case(
            with(person, json!(vec![[1, 2, 1]; 2000])),
            "keypoint_count",
            Impossible,
            &["\"left\"", "frame 1", "person 0"],
        ),
        case(
            with("/poses/left/frames/1/people", json!(vec![json!({"keypoints": []}); 300])),
            "too_many_people",
            TooLarge,
            &["\"left\"", "frame 1", "200"],
        ),
        case(with("/poses/left/frames/1/frame", json!(0)), "frame_duplicate", Impossible, &["\"left\"", "frame 0"]),
        case(with("/poses/left/frames/1/frame", json!(2)), "frame_out_of_range", Impossible, &["\"left\"", "frame 2"]),
        case(
            with("/poses/left/frames/1/frame", json!(-1)),
            "frame_out_of_range",
            Impossible,
            &["\"left\"", "frame -1"],
        ),
        case(
            with("/poses/left/frames/1/frame", json!(i64::MAX)),
            "frame_invalid",
            Impossible,
            &["\"left\"", "/frames/1/frame"],
        ),
        case(with("/n_frames", json!(1)), "frame_out_of_range", Impossible, &["\"left\"", "frame 1", "n_frames 1"]),
        case(with("/n_frames", json!(0)), "no_frames", Impossible, &["n_frames is 0"]),
        case(with("/n_frames", json!(2_000_000)), "too_many_frames", TooLarge, &["2000000"]),
        case(
            replaced("\"fps\"", "\"first_frame\":1,\"fps\""),
            "frame_out_of_range",
            Impossible,
            &["\"left\"", "frame 0"],
        ),
        case(with("/fps", json!(0)), "fps_invalid", Impossible, &["fps is 0"]),
        case(with("/fps", json!(-30)), "fps_invalid", Impossible, &["fps is -30"]),
        case(with("/fps", json!(1e9)), "fps_invalid", Impossible, &["fps is 1000000000"]),
        case(
            with("/keypoint_convention", json!("body99")),
            "convention_unknown",
            Impossible,
            &["\"body99\"", "coco17"],
        ),
        case(with("/cameras", json!([])), "no_cameras", Impossible, &["\"upload\""]),
        case(with("/cameras", json!(vec![session()["cameras"][0].clone(); 65])), "too_many_cameras", TooLarge, &["64"]),
        case(with("/cameras/1/id", json!("left")), "camera_duplicate", Impossible, &["\"left\"", "/cameras/1/id"]),
        case(with("/cameras/1/id", json!("")), "camera_id_invalid", Impossible, &["/cameras/1/id"]),
    ]
}

fn cameras() -> Vec<Case> {
    let k = |row: usize, column: usize, value: f64| with(&format!("/cameras/1/K/{row}/{column}"), json!(value));
    let transposed = json!([[500.0, 0.0, 0.0], [0.0, 500.0, 0.0], [320.0, 240.0, 1.0]]);
    let wide = json!([[500.0, 0.0, 320.0, 0.0], [0.0, 500.0, 240.0, 0.0], [0.0, 0.0, 1.0, 0.0]]);
    vec![
        case(k(0, 0, 0.0), "camera_invalid", Impossible, &["\"right\"", "fx is 0"]),
        case(k(1, 1, -500.0), "camera_invalid", Impossible, &["\"right\"", "fy is -500"]),
        case(k(0, 0, 1.2), "camera_invalid", Impossible, &["\"right\"", "fx is 1.2"]),
        case(k(2, 0, 1.0), "camera_invalid", Impossible, &["\"right\"", "bottom row of K is [1, 0, 1]"]),
        case(k(0, 2, 5000.0), "camera_invalid", Impossible, &["\"right\"", "principal point is (5000, 240)"]),
        case(with("/cameras/1/K", transposed), "camera_invalid", Impossible, &["\"right\"", "transposed"]),
        case(with("/cameras/1/K", wide), "camera_invalid", Impossible, &["\"right\"", "K is 3x4"]),
        case(with("/cameras/1/width", json!(0)), "camera_invalid", Impossible, &["\"right\"", "image size is 0x480"]),
        case(without("/cameras/1", "height"), "missing_field", Malformed, &["\"right\"", "`height`"]),
        case(
            with("/cameras/1/dist", json!(vec![1; 12])),
            "distortion_unsupported",
            Impossible,
            &["\"right\"", "thin prism"],
        ),
        case(
            with("/cameras/1/dist", json!(vec![0; 3])),
            "distortion_unsupported",
            Impossible,
            &["\"right\"", "3 distortion"],
        ),
        case(with("/cameras/1/dist", json!([1e6, 0, 0, 0])), "camera_invalid", Impossible, &["\"right\"", "corner"]),
        case(
            replaced("\"height\"", "\"dist_model\":\"fov\",\"height\""),
            "distortion_unsupported",
            Impossible,
            &["\"fov\""],
        ),
        case(with("/cameras/1/R/0/0", json!(-1.0)), "camera_invalid", Impossible, &["\"right\"", "reflection"]),
        case(with("/cameras/1/R/0/0", json!(1.1)), "camera_invalid", Impossible, &["\"right\"", "not orthonormal"]),
        case(without("/cameras/1", "t"), "camera_invalid", Impossible, &["\"right\"", "R is given without t"]),
        case(without("/cameras/1", "R"), "camera_invalid", Impossible, &["\"right\"", "t is given without R"]),
    ]
}

fn read(upload: &[u8]) -> Result<LoadedSession, UploadError> {
    read_upload(Cursor::new(upload), "upload", &UploadLimits::default())
}

/// Peak memory of this process, KiB; `None` where the system does not report it.
fn peak_kib() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?.trim().strip_suffix(" kB")?.parse().ok()
}

#[test]
fn rejects_with_code_and_location_in_bounded_time_and_memory() {
    assert_eq!(read(&valid_zip()).unwrap().session.views.len(), 2, "the untouched session is accepted");
    assert_eq!(read(session().to_string().as_bytes()).unwrap().session.n_frames, 2);
    let cases: Vec<Case> = [containers(), documents(), cameras()].into_iter().flatten().collect();
    let long_list = format!("{{\"lens\":[{}1],{}", "1,".repeat(20_000_000), &session().to_string()[1..]);
    let before = peak_kib();
    assert!(read(long_list.as_bytes()).is_ok(), "an unknown key is ignored");
    for (i, Case { upload, code, kind, says }) in cases.iter().enumerate() {
        let start = Instant::now();
        let error = read(upload).expect_err(code);
        assert!(start.elapsed() < MAX_TIME, "case {i}, {code}: {:?}", start.elapsed());
        let message = error.to_string();
        assert_eq!((error.code, error.kind), (*code, *kind), "case {i}: {message}");
        for part in *says {
            assert!(message.contains(part), "case {i}: {message:?} does not contain {part:?}");
        }
        assert!(message.contains(&error.remedy) && !message.contains('\n'), "{message:?}");
    }
    if let (Some(before), Some(after)) = (before, peak_kib()) {
        assert!(after - before < MAX_GROWTH_KIB, "reading took {} KiB", after - before);
    }
}

#[test]
fn accepts_unusual_sessions_with_warnings() {
    let warnings = |upload: Vec<u8>| read(&upload).unwrap().warnings.join("; ");
    assert!(warnings(with("/cameras/1/K/0/2", json!(700.0))).contains("\"right\""));
    assert!(warnings(with("/cameras/1/t", json!([0.0, 0.0, 3000.0]))).contains("millimetres"));
    assert!(warnings(with("/poses/right/frames", json!([]))).contains("\"right\" has no frames"));
    assert!(warnings(without("", "n_frames")).contains("2 frames were found"));
}

#[test]
fn preserves_camera_names_byte_for_byte() {
    // Composed and decomposed, two cases, a parent folder, a device, a long one: all are different names and not paths.
    for (a, b) in
        [("caf\u{e9}", "cafe\u{301}"), ("A", "a"), ("..", "con"), ("\u{202e}x", "🎥"), (&"x".repeat(1000), "/etc")]
    {
        let mut session = session();
        let poses = session["poses"]["left"].clone();
        session["cameras"][0]["id"] = json!(a);
        session["cameras"][1]["id"] = json!(b);
        session["poses"] = json!({a: poses, b: poses});
        let views = read(session.to_string().as_bytes()).unwrap().session.views;
        assert_eq!((views[0].id.as_str(), views[1].id.as_str()), (a, b));
    }
}

#[test]
fn accepts_one_camera_and_negative_frame_numbers() {
    let mut session = session();
    session["cameras"].as_array_mut().unwrap().pop();
    session["first_frame"] = json!(-1);
    session["n_frames"] = json!(3);
    let read = read(session.to_string().as_bytes()).unwrap();
    assert_eq!((read.session.views.len(), read.session.first_frame), (1, -1));
    assert_eq!(read.session.views[0].delivered.iter().map(|f| f.0).collect::<Vec<_>>(), [1, 2]);
    assert!(read.warnings.iter().any(|w| w.contains("unknown camera \"right\"")));
}

#[test]
fn rejects_folders_without_session_and_missing_paths() {
    let dir = tempfile::tempdir().unwrap();
    let error = |path: &Path| read_path(path, &UploadLimits::default()).unwrap_err();
    assert_eq!(error(dir.path()).code, "format_unknown");
    assert_eq!(error(&dir.path().join("nowhere")).code, "file_unreadable");
    fs::write(dir.path().join("session.json"), replaced("\"fps\":30", "\"fps\":[]")).unwrap();
    let error = error(dir.path());
    assert_eq!(
        (error.code, error.file.as_deref(), error.pointer.as_deref()),
        ("json_type", Some("session.json"), Some("/fps"))
    );
}

#[test]
fn reports_the_line_number_of_ndjson() {
    let mut header = session();
    header.as_object_mut().unwrap().remove("poses");
    let line = |camera: &str, frame: i64| json!({"camera": camera, "frame": frame, "people": []});
    let text = format!("{header}\n{}\n{}\n", line("left", 0), line("left", 0));
    let error = read(text.as_bytes()).unwrap_err();
    assert_eq!((error.code, error.camera.as_deref(), error.frame), ("frame_duplicate", Some("left"), Some(0)));
    assert_eq!(error.pointer.as_deref(), Some("/2"));
}
