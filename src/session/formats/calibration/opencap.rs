//! OpenCap's camera pickle: `intrinsicMat`, `distortion`, `imageSize` (height first), and with extrinsics `rotation` and
//! `translation` in millimetres. No code of the pickle is executed (see the reader of body files).

use super::values::{camera_of_image, invalid, rows_of, size};
use crate::body::loader::arrays_of_pickle;
use crate::session::upload::error::UploadError;
use crate::session::upload::json::ShortList;
use crate::session::upload::raw::RawCamera;

const FIELDS: [&str; 5] = ["intrinsicMat", "distortion", "imageSize", "rotation", "translation"];

/// Whether a file's first bytes are a binary pickle with the name of the intrinsics.
pub(crate) fn recognise(head: &[u8]) -> bool {
    let names_intrinsics = head.windows(FIELDS[0].len()).any(|window| window == FIELDS[0].as_bytes());
    matches!(head, [0x80, 2..=5, ..]) && names_intrinsics
}

/// The camera of the file, named after its folder, or after the file where it is in none.
pub(super) fn read(file: &str, bytes: &[u8]) -> Result<RawCamera, UploadError> {
    let arrays = arrays_of_pickle(bytes, &FIELDS).map_err(|e| invalid(e.to_string()))?;
    if let Some((field, _)) = arrays.iter().find(|(_, array)| array.values.iter().any(|value| !value.is_finite())) {
        return Err(invalid(format!("`{field}` contains a value that is not finite")));
    }
    let numbers = |field: &str| arrays.get(field).map(|array| array.values.as_slice());
    let matrix = numbers(FIELDS[0]).and_then(rows_of);
    let image: Vec<f64> = numbers("imageSize").unwrap_or_default().to_vec();
    let whole = |i: usize| image.get(i).copied().and_then(size).unwrap_or(0);
    let name = camera_of_image(file);
    Ok(RawCamera {
        id: name.to_owned(),
        width: whole(1),
        height: whole(0),
        matrix: Some(matrix.ok_or_else(|| invalid("`intrinsicMat` does not have 9 entries"))?),
        distortion: numbers("distortion").map(|dist| ShortList(dist.to_vec())),
        rotation: numbers("rotation").and_then(rows_of),
        translation: numbers("translation").map(|t| ShortList(t.iter().map(|mm| 1e-3 * mm).collect())),
        ..RawCamera::default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `pickle.dumps(dict(intrinsicMat=…, distortion=…, imageSize=…, rotation=…, translation=…), protocol=2)` of numpy,
    /// written opcode by opcode.
    fn pickled(fields: &[(&str, &[usize], &[f64])]) -> Vec<u8> {
        let mut bytes = b"\x80\x02}(".to_vec();
        let text = |bytes: &mut Vec<u8>, text: &[u8]| {
            bytes.push(b'X');
            bytes.extend((text.len() as u32).to_le_bytes());
            bytes.extend(text);
        };
        for (name, shape, values) in fields {
            text(&mut bytes, name.as_bytes());
            bytes.extend(b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\nK\x00\x85U\x01btR(K\x01(");
            shape.iter().for_each(|n| bytes.extend([b'K', *n as u8]));
            bytes.extend(
                b"tcnumpy\ndtype\n(U\x02f8K\x00K\x01tR(K\x03U\x01<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb\x89",
            );
            bytes.push(b'T');
            bytes.extend((8 * values.len() as u32).to_le_bytes());
            values.iter().for_each(|v| bytes.extend(v.to_le_bytes()));
            bytes.extend(b"tb");
        }
        bytes.extend(b"u.");
        bytes
    }

    #[test]
    fn reads_millimetres_and_height_before_width() {
        let k = [1000.0, 0.0, 360.0, 0.0, 1001.0, 640.0, 0.0, 0.0, 1.0];
        let r = [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        let bytes = pickled(&[
            ("intrinsicMat", &[3, 3], &k),
            ("distortion", &[1, 5], &[0.1, -0.2, 0.001, 0.002, 0.03]),
            ("imageSize", &[2, 1], &[1280.0, 720.0]),
            ("rotation", &[3, 3], &r),
            ("translation", &[3, 1], &[100.0, -200.0, 3000.0]),
        ]);
        assert!(recognise(&bytes) && !recognise(b"\x80\x04K\x01."));
        let camera = read("Videos/Cam1/cameraIntrinsicsExtrinsics.pickle", &bytes).unwrap();
        assert_eq!((camera.id.as_str(), camera.width, camera.height), ("Cam1", 720, 1280));
        assert_eq!(camera.matrix.unwrap().0[1].0, [0.0, 1001.0, 640.0]);
        assert_eq!(camera.distortion.unwrap().0.len(), 5);
        assert_eq!(camera.rotation.unwrap().0[0].0, [0.0, -1.0, 0.0]);
        assert_eq!(camera.translation.unwrap().0, [0.1, -0.2, 3.0]);
        assert!(read("a.pickle", &bytes[..bytes.len() - 3]).is_err());
        let holed = pickled(&[("intrinsicMat", &[3, 3], &k.map(|v| if v == 640.0 { f64::NAN } else { v }))]);
        let refusal = read("a.pickle", &holed).unwrap_err().to_string();
        assert!(refusal.contains("`intrinsicMat` contains a value that is not finite"), "{refusal}");
    }
}
