//! A self-describing binary file: a JSON header followed by plain arrays. The layout of the viewer's `stages/*.bin`.
//!
//! | bytes | content |
//! | 0..8 | `WANDLESS` |
//! | 8..12 | `L`: length of the header, u32 little endian, a multiple of 4 |
//! | 12..12 + L | the header, JSON in UTF-8, blanks at its end |
//! | 12 + L.. | the payload: arrays one after another, each padded with zeros to a multiple of 4 bytes |
//!
//! An array is described in the header as `{type: "f32" | "u8" | "i16" | "u16" | "u32", offset, shape}`: little endian, row
//! by row, `offset` in bytes from the start of the payload. Every part has a length of a multiple of 4 bytes, so that a
//! browser can use typed arrays on the file without a copy. An unknown number is NaN in an `f32` array.

use serde::Serialize;

/// First bytes of every such file.
const MAGIC: &[u8; 8] = b"WANDLESS";

/// Type, position and shape of an array, as the header describes it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(super) struct Array {
    #[serde(rename = "type")]
    kind: &'static str,
    offset: usize,
    shape: Vec<usize>,
}

/// The payload that is being collected.
#[derive(Debug, Default)]
pub(super) struct Payload(Vec<u8>);

impl Payload {
    /// Appends 32-bit floats; values that are not finite become NaN.
    pub(super) fn f32(&mut self, shape: &[usize], values: impl IntoIterator<Item = f64>) -> Array {
        let written = |value: f64| if value.is_finite() { value as f32 } else { f32::NAN };
        self.array("f32", shape, values.into_iter().map(|value| written(value).to_le_bytes()))
    }

    fn array<const N: usize>(
        &mut self,
        kind: &'static str,
        shape: &[usize],
        values: impl Iterator<Item = [u8; N]>,
    ) -> Array {
        let offset = self.0.len();
        values.for_each(|value| self.0.extend_from_slice(&value));
        debug_assert_eq!(
            self.0.len() - offset,
            N * shape.iter().product::<usize>(),
            "the shape matches the number of values"
        );
        self.0.resize(self.0.len().next_multiple_of(4), 0);
        Array { kind, offset, shape: shape.to_vec() }
    }

    /// The whole file.
    ///
    /// # Errors
    /// Where the header cannot be written as JSON, or is longer than 4 GiB.
    pub(super) fn file(self, header: &impl Serialize) -> std::io::Result<Vec<u8>> {
        let mut header = serde_json::to_vec(header)?;
        header.resize(header.len().next_multiple_of(4), b' ');
        let length = u32::try_from(header.len()).map_err(std::io::Error::other)?;
        Ok([MAGIC.as_slice(), &length.to_le_bytes(), &header, &self.0].concat())
    }
}

/// A method of [`Payload`] for each integer type.
macro_rules! integers {
    ($($integer:ident)*) => {
        impl Payload {$(
            /// Appends integers.
            pub(super) fn $integer(&mut self, shape: &[usize], values: impl IntoIterator<Item = $integer>) -> Array {
                self.array(stringify!($integer), shape, values.into_iter().map($integer::to_le_bytes))
            }
        )*}
    };
}

integers! { u8 i16 u16 u32 }

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn writes_the_documented_layout() {
        let mut payload = Payload::default();
        let bytes = payload.u8(&[3], [1, 2, 3]);
        let floats = payload.f32(&[1, 2], [0.5, f64::INFINITY]);
        let shorts = payload.i16(&[1], [-2]);
        assert_eq!((bytes.offset, floats.offset, shorts.offset), (0, 4, 12));
        let file = payload.file(&json!({ "a": floats })).unwrap();
        let length = u32::from_le_bytes(file[8..12].try_into().unwrap()) as usize;
        assert_eq!((&file[..8], length % 4, file.len() % 4), (&b"WANDLESS"[..], 0, 0));
        let header: serde_json::Value = serde_json::from_slice(&file[12..12 + length]).unwrap();
        assert_eq!(header, json!({ "a": { "type": "f32", "offset": 4, "shape": [1, 2] } }));
        let payload = &file[12 + length..];
        assert_eq!(&payload[..8], [1, 2, 3, 0, 0, 0, 0, 0x3f]);
        assert!(f32::from_le_bytes(payload[8..12].try_into().unwrap()).is_nan());
        assert_eq!(&payload[12..], [0xfe, 0xff, 0, 0]);
    }
}
