//! Tests of the loader: every layout reproduces the body, and hostile files are rejected without side effects.

use std::io::Write;
use std::path::Path;
use std::process::Command;
use wandless::body::loader::{BodyFileError, LandmarkTable, body_from_bytes, body_npz, load_body};
use wandless::body::surface::{JointWeight, Surface, VertexWeight};
use wandless::body::{BodyModel, default_body};

fn read(bytes: &[u8]) -> Result<BodyModel, BodyFileError> {
    body_from_bytes("test".to_owned(), bytes, &LandmarkTable::default())
}

fn assert_same(found: &BodyModel, name: &str) {
    let body = default_body();
    let (a, b) = (&found.surface, &body.surface);
    assert_eq!(a.faces, b.faces, "{name}");
    for i in 0..b.vertices.len() {
        assert!((a.vertices[i] - b.vertices[i]).norm() < 1e-6, "{name}");
        assert!((a.shape_directions[i] - b.shape_directions[i]).norm() < 1e-6, "{name}");
        assert!(
            a.skin[i].iter().zip(&b.skin[i]).all(|(s, t)| s.joint == t.joint && (s.weight - t.weight).abs() < 1e-6)
        );
    }
    for j in 0..24 {
        assert!((found.rest_joints[j] - body.rest_joints[j]).norm() < 1e-6, "{name}");
        assert!((found.shape_directions[j] - body.shape_directions[j]).norm() < 1e-6, "{name}");
    }
    assert_eq!(found.landmarks.len(), body.landmarks.len(), "{name}");
}

#[test]
fn every_layout_reproduces_the_default_body() {
    let folder = tempfile::tempdir().unwrap();
    let source = folder.path().join("source.npz");
    std::fs::write(&source, body_npz(&default_body().surface, true).unwrap()).unwrap();
    assert_same(&load_body(&source, &LandmarkTable::default()).unwrap(), "our own layout with posedirs");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/body/write_layouts.py");
    let has_numpy = Command::new("python3").args(["-c", "import numpy, scipy.sparse"]).status();
    if !has_numpy.is_ok_and(|status| status.success()) {
        eprintln!("SKIPPED: python3 with numpy and scipy is not installed; other programs' layouts are not tested");
        return;
    }
    let layouts = folder.path().join("layouts");
    std::fs::create_dir(&layouts).unwrap();
    let status = Command::new("python3").arg(script).arg(&source).arg(&layouts).status().unwrap();
    assert!(status.success());
    let mut paths: Vec<_> = std::fs::read_dir(&layouts).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    assert_eq!(paths.len(), 14);
    for path in paths {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let found = load_body(&path, &LandmarkTable::default()).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_same(&found, &name);
        std::fs::remove_file(&path).unwrap(); // the largest have 60 MB
    }
}

/// A block of eight vertices, all attached to the pelvis: the smallest valid body.
fn small_body() -> Surface {
    let corner = |i: usize| nalgebra::Vector3::new((i & 1) as f64, (i >> 1 & 1) as f64 * 1.7, (i >> 2) as f64);
    Surface {
        vertices: (0..8).map(corner).collect(),
        shape_directions: vec![wandless::body::model::ShapeDirections::repeat(0.1); 8],
        faces: vec![[0, 1, 2], [4, 5, 6], [1, 3, 7]],
        skin: vec![vec![JointWeight { joint: 0, weight: 1.0 }]; 8],
        regressor: std::array::from_fn(|_| vec![VertexWeight { vertex: 3, weight: 1.0 }]),
        pose_directions: Vec::new(),
        points: Vec::new(),
    }
}

/// A pickle writer: protocol 2, arrays as numpy writes them.
#[derive(Default)]
struct Pickler(Vec<u8>);

impl Pickler {
    fn text(&mut self, text: &str) {
        self.0.push(b'X');
        self.0.extend((text.len() as u32).to_le_bytes());
        self.0.extend(text.as_bytes());
    }

    fn int(&mut self, value: i32) {
        self.0.push(b'J');
        self.0.extend(value.to_le_bytes());
    }

    fn array(&mut self, shape: &[i32], code: &str, bytes: &[u8]) {
        self.0.extend(b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85C\x01b\x87R(K\x01(");
        shape.iter().for_each(|n| self.int(*n));
        self.0.extend(b"tcnumpy\ndtype\n");
        self.text(code);
        self.0.extend(b"K\x00K\x01\x87R(K\x03");
        self.text("<");
        self.0.extend(b"NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb\x89B");
        self.0.extend((bytes.len() as u32).to_le_bytes());
        self.0.extend(bytes);
        self.0.extend(b"tb");
    }

    fn floats(&mut self, shape: &[i32], values: impl Iterator<Item = f64>) {
        let bytes: Vec<u8> = values.flat_map(f64::to_le_bytes).collect();
        self.array(shape, "f8", &bytes);
    }
}

/// A pickle of the small body; `write` writes the field `special`.
fn small_pickle(special: &str, write: &dyn Fn(&mut Pickler)) -> Vec<u8> {
    let surface = small_body();
    let mut pickle = Pickler(b"\x80\x02}(".to_vec());
    for field in ["v_template", "shapedirs", "weights", "J_regressor", "kintree_table", "f"] {
        pickle.text(field);
        match field {
            _ if field == special => write(&mut pickle),
            "v_template" => pickle.floats(&[8, 3], surface.vertices.iter().flat_map(|v| [v.x, v.y, v.z])),
            "shapedirs" => pickle.floats(&[8, 3, 2], (0..48).map(|k| f64::from(k) * 0.01)),
            "weights" => pickle.floats(&[8, 24], (0..192).map(|k| f64::from(k % 24 == 0))),
            "J_regressor" => pickle.floats(&[24, 8], (0..192).map(|k| f64::from(k % 8 == 3))),
            "kintree_table" => {
                let parents = wandless::body::skeleton::PARENTS.iter().map(|p| p.map_or(-1.0, |p| p as f64));
                pickle.floats(&[2, 24], parents.chain((0..24).map(f64::from)));
            }
            _ => pickle.floats(&[3, 3], surface.faces.iter().flatten().map(|v| *v as f64)),
        }
    }
    pickle.0.extend(b"u.");
    pickle.0
}

#[test]
fn reads_a_small_pickle() {
    let body = read(&small_pickle("", &|_| ())).unwrap();
    assert_eq!(body.surface.vertices, small_body().vertices);
    assert_eq!(body.rest_joints[5], body.surface.vertices[3]);
    assert_eq!(body.shape_directions[5][(2, 1)], 0.23);
}

#[test]
fn rejects_calls_by_name_without_executing_them() {
    let mark = std::env::temp_dir().join(format!("wandless-executed-{}", std::process::id()));
    let command = format!("touch {}", mark.display());
    for (module, name) in [("os", "system"), ("posix", "system"), ("builtins", "eval"), ("numpy", "load")] {
        let call = |pickle: &mut Pickler| {
            pickle.0.extend(format!("c{module}\n{name}\n").bytes());
            pickle.text(&command);
            pickle.0.extend(b"\x85R");
        };
        let error = read(&small_pickle("f", &call)).unwrap_err();
        assert!(matches!(&error, BodyFileError::ForbiddenGlobal { .. }), "{error}");
        assert!(error.to_string().contains(&format!("{module}.{name}")), "{error}");
    }
    assert!(!mark.exists());
}

/// The small body as SMPL-H (52 joints) or SMPL-X (55): every vertex is shared by the pelvis and the last finger joint, and
/// the first vertex by the joint 22 as well.
fn larger_npz(n_joints: usize, parents: &[i64], n_features: usize) -> Vec<u8> {
    use wandless::formats::npz::{CompressionMethod, NpzWriter};
    let surface = small_body();
    let mut file = NpzWriter::new(std::io::Cursor::new(Vec::new()), CompressionMethod::Deflated);
    file.array("v_template", &[8, 3], surface.vertices.iter().flat_map(|v| [v.x, v.y, v.z])).unwrap();
    file.array("shapedirs", &[8, 3, 12], (0..288).map(|k| f64::from(k) * 0.01)).unwrap();
    let weight = |vertex: usize, joint: usize| match (vertex, joint) {
        (0, 22) => 0.125,
        (0, 0) => 0.625,
        (_, 0) => 0.75,
        (_, joint) if joint == n_joints - 1 => 0.25,
        _ => 0.0,
    };
    let weights = (0..8 * n_joints).map(|k| weight(k / n_joints, k % n_joints));
    file.array("weights", &[8, n_joints], weights).unwrap();
    // Joint j lies at the vertex j % 8.
    let regressor = (0..n_joints * 8).map(|k| f64::from(u8::from(k / 8 % 8 == k % 8)));
    file.array("J_regressor", &[n_joints, 8], regressor).unwrap();
    let tree = parents.iter().copied().chain(0..n_joints as i64);
    file.array("kintree_table", &[2, n_joints], tree).unwrap();
    file.array("f", &[3, 3], surface.faces.iter().flatten().map(|v| *v as u32)).unwrap();
    let features = (0..8 * 3 * n_features).map(|k| (k % n_features) as f64);
    file.array("posedirs", &[8, 3, n_features], features).unwrap();
    file.finish().unwrap().into_inner()
}

/// Parents of SMPL's first 22 joints, `face` joints of the head, and 15 of each hand.
fn larger_parents(face: i64) -> Vec<i64> {
    let shared = wandless::body::skeleton::PARENTS[..22].iter().map(|p| p.map_or(-1, |p| p as i64));
    let finger = |first: i64, wrist: i64| (0..15).map(move |j| if j % 3 == 0 { wrist } else { first + j - 1 });
    let first = 22 + face;
    shared.chain((0..face).map(|_| 15)).chain(finger(first, 20)).chain(finger(first + 15, 21)).collect()
}

#[test]
fn reads_smplh_and_smplx_as_24_joints() {
    for (n_joints, face, n_features, carrier) in [(52, 0, 459, 22), (55, 3, 486, 15)] {
        let parents = larger_parents(face);
        let body = read(&larger_npz(n_joints, &parents, n_features)).unwrap();
        assert_eq!(body.surface.vertices, small_body().vertices);
        let share = |vertex: usize| -> Vec<(usize, f64)> {
            body.surface.skin[vertex].iter().map(|share| (share.joint, share.weight)).collect()
        };
        assert_eq!(share(1), [(0, 0.75), (23, 0.25)], "{n_joints}");
        assert_eq!(share(0), [(0, 0.625), (carrier, 0.125), (23, 0.25)], "{n_joints}");
        // The hands lie at the first joints of the middle fingers.
        let middle = [25, 40].map(|joint: usize| (joint + face as usize) % 8);
        assert_eq!([22, 23].map(|j| body.rest_joints[j]), middle.map(|v| body.surface.vertices[v]), "{n_joints}");
        assert_eq!(body.rest_joints[21], body.surface.vertices[5]);
        // Component 9 of axis 1 of vertex 2, of twelve.
        assert_eq!(body.surface.shape_directions[2][(1, 9)], f64::from(2 * 36 + 12 + 9) * 0.01);
        let directions = &body.surface.pose_directions;
        assert_eq!((directions.len(), directions[188], directions[189]), (8 * 3 * 207, 188.0, 0.0));
        let mut wrong = parents.clone();
        wrong[n_joints - 1] = 3;
        let error = read(&larger_npz(n_joints, &wrong, n_features)).unwrap_err().to_string();
        assert!(error.contains(&format!("kintree_table, row {}", n_joints - 1)), "{error}");
    }
}

/// Hostile files: name, bytes, a word of the expected error.
fn hostile_files() -> Vec<(&'static str, Vec<u8>, &'static str)> {
    let own_x = |p: &mut Pickler| {
        // A Ch whose x is itself, through the memo.
        p.0.extend(b"cchumpy.ch\nCh\n)\x81q\x07}");
        p.text("x");
        p.0.extend(b"h\x07sb");
    };
    // A sparse matrix of three numbers that claims as many as a field may have.
    let wide_sparse = |p: &mut Pickler| {
        p.0.extend(b"cscipy.sparse.csr\ncsr_matrix\n)\x81}(");
        for (member, n) in [("data", 1), ("indices", 1), ("indptr", 2)] {
            p.text(member);
            p.floats(&[n], (0..n).map(|_| 0.0));
        }
        p.text("_shape");
        p.0.extend(b"K\x01");
        p.int(7_500_000);
        p.0.extend(b"\x86ub");
    };
    // Choices of choices: each refers twice to the one before, so that the time doubled with every one.
    let doubling = |p: &mut Pickler| {
        p.floats(&[1], [0.0].into_iter());
        for level in 1..60 {
            p.0.extend([b'q', level - 1]);
            p.0.extend(b"0cchumpy.reordering\nSelect\n)\x81}(");
            for member in ["a", "idxs"] {
                p.text(member);
                p.0.extend([b'h', level - 1]);
            }
            p.0.extend(b"ub");
        }
    };
    type Write<'a> = &'a dyn Fn(&mut Pickler);
    let pickles: [(&str, &str, Write, &str); 14] = [
        ("a call", "f", &|p| p.0.extend(b"cos\nsystem\nX\x04\x00\x00\x00true\x85R"), "os.system"),
        ("recursive memo", "v_template", &own_x, "contain itself"),
        ("doubling choices", "v_template", &doubling, "arrays is larger"),
        ("2 GB claimed", "v_template", &|p| p.array(&[90_000_000, 3], "f8", &[]), "larger"),
        ("overflowing claim", "v_template", &|p| p.array(&[i32::MAX, i32::MAX, i32::MAX], "f8", &[]), "larger"),
        ("a wide sparse matrix", "J_regressor", &wide_sparse, "larger"),
        ("too few bytes", "v_template", &|p| p.array(&[8, 3], "f8", &[0; 8]), "as many bytes"),
        ("objects", "v_template", &|p| p.array(&[8, 3], "O", &[0; 24]), "numbers"),
        ("wrong shape", "v_template", &|p| p.floats(&[4, 6], (0..24).map(f64::from)), "shape (V, 3)"),
        ("a float", "shapedirs", &|p| p.0.extend(b"F1.5\n"), "array"),
        ("not a number", "weights", &|p| p.floats(&[8, 24], (0..192).map(|_| f64::NAN)), "finite"),
        ("SMPL-H", "weights", &|p| p.floats(&[8, 52], (0..416).map(|_| 0.0)), "SMPL-H"),
        ("SMPL-X", "weights", &|p| p.floats(&[8, 55], (0..440).map(|_| 0.0)), "SMPL-X"),
        ("far corner", "f", &|p| p.floats(&[1, 3], [0.0, 1.0, 8.0].into_iter()), "numbers of vertices"),
    ];
    let mut files: Vec<(&str, Vec<u8>, &str)> =
        pickles.into_iter().map(|(name, field, write, word)| (name, small_pickle(field, write), word)).collect();
    files.push(("a bomb", bomb(false, 1), "shape"));
    files.push(("a bomb in Fortran order", bomb(true, 1), "shape"));
    files.push(("a larger bomb", bomb(false, 40), "larger"));
    files.push(("half a file", small_pickle("", &|_| ())[..900].to_vec(), "expected"));
    files
}

/// Some kilobytes that unpack to arrays of zeros, as large as fields may be; the headers claim `factor` times as much. The
/// template is invalid, which is detected when all arrays are in memory.
fn bomb(is_fortran: bool, factor: usize) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    let sizes = [("weights", 1_500_000), ("shapedirs", 7_500_000), ("posedirs", 7_500_000), ("f", 1_500_000)];
    for (field, n) in sizes.into_iter().chain([("v_template", 1)]) {
        let order = if is_fortran { "True" } else { "False" };
        let header = format!("{{'descr': '<f8', 'fortran_order': {order}, 'shape': ({}, 1), }}", n * factor);
        let header = format!("{header:<117}\n");
        zip.start_file(format!("{field}.npy"), zip::write::SimpleFileOptions::default()).unwrap();
        zip.write_all(b"\x93NUMPY\x01\x00").unwrap();
        zip.write_all(&(header.len() as u16).to_le_bytes()).unwrap();
        zip.write_all(header.as_bytes()).unwrap();
        zip.write_all(&vec![0; 8 * n]).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

#[test]
fn hostile_files_give_one_clear_error() {
    for (name, bytes, expected) in hostile_files() {
        let error = read(&bytes).unwrap_err().to_string();
        assert!(error.contains(expected) && !error.contains('\n'), "{name}: {error}");
    }
    let table = LandmarkTable::from_json(br#"{"nose": [{"vertex": 8, "weight": 1.0}]}"#).unwrap();
    let bytes = small_pickle("", &|_| ());
    assert!(body_from_bytes("small".to_owned(), &bytes, &table).unwrap_err().to_string().contains("vertex 8"));
    assert!(LandmarkTable::from_json(br#"{"tail": [{"vertex": 8, "weight": 1.0}]}"#).is_err());
    assert!(LandmarkTable::from_json(br#"{"nose": [{"vertex": 8, "weight": 0.5}]}"#).is_err());
}

/// A child process with an address space of 256 MiB rejects each file with one line and exit code 2, and reads a good one.
#[cfg(all(target_os = "linux", feature = "cli"))]
#[test]
fn hostile_files_are_rejected_within_256_mib() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("body");
    let info = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        let limited = "ulimit -v 262144; exec \"$0\" body info \"$1\"";
        Command::new("sh").args(["-c", limited, env!("CARGO_BIN_EXE_wandless")]).arg(&path).output().unwrap()
    };
    let good = info(&body_npz(&default_body().surface, true).unwrap());
    assert!(good.status.success(), "{}", String::from_utf8_lossy(&good.stderr));
    for (name, bytes, expected) in hostile_files() {
        let output = info(&bytes);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{name}: {stderr}");
        assert!(stderr.contains(expected) && stderr.trim_end().lines().count() == 1, "{name}: {stderr}");
    }
}

#[test]
fn truncated_and_flipped_files_never_panic() {
    let (pickle, npz) = (small_pickle("", &|_| ()), body_npz(&small_body(), false).unwrap());
    for bytes in [&pickle, &npz] {
        for k in 0..100 {
            assert!(read(&bytes[..bytes.len() * k / 100]).is_err());
        }
    }
    let (mut refused, mut n) = (0, 0);
    for bytes in [pickle, npz] {
        for bit in 0..8 * bytes.len() {
            let mut flipped = bytes.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            // A flip in unused bytes or a last digit leaves a valid body; the test is that nothing panics.
            refused += usize::from(read(&flipped).is_err());
            n += 1;
        }
    }
    println!("{refused} of {n} flips rejected");
    assert!(refused > n / 20);
}

#[test]
fn a_landmark_table_overrides_the_file() {
    let table = LandmarkTable::from_json(br#"{"nose": [{"vertex": 5, "weight": 1.0}]}"#).unwrap();
    let bytes = body_npz(&default_body().surface, false).unwrap();
    let body = body_from_bytes("own".to_owned(), &bytes, &table).unwrap();
    let nose = &body.landmarks[body.landmark_index("nose").unwrap()];
    let at_rest =
        nose.terms.iter().map(|t| body.rest_joints[t.joint] * t.weight + t.offset).sum::<nalgebra::Vector3<f64>>();
    assert!((at_rest - body.surface.vertices[5]).norm() < 1e-9);
    assert_eq!(body.landmarks.len(), default_body().landmarks.len());
}
