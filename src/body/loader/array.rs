//! Numeric arrays from raw bytes, and the fields of a body file.

use super::error::BodyFileError;
use std::collections::BTreeMap;

/// More elements than any field has: 300 components of 8,300 vertices. A hostile file that is small itself costs at most
/// 60 MB an array, of which three live at once.
pub(super) const MAX_ELEMENTS: usize = 7_500_000;

/// A dense array in C order.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Array {
    /// Lengths of its axes.
    pub shape: Vec<usize>,
    /// All elements, the last axis running fastest.
    pub values: Vec<f64>,
}

/// Arrays by field name.
pub(crate) type Fields = BTreeMap<String, Array>;

/// The fields that are read; all others are skipped unseen. The weights come first: they tell the models apart.
pub(super) const FIELDS: [&str; 10] = [
    "weights",
    "v_template",
    "shapedirs",
    "posedirs",
    "J_regressor",
    "kintree_table",
    "f",
    "landmark_names",
    "landmark_vertices",
    "landmark_weights",
];

/// More elements than a field of a body may have.
pub(super) fn max_elements(field: &str) -> usize {
    match field {
        "shapedirs" | "posedirs" => MAX_ELEMENTS,
        _ => MAX_ELEMENTS / 5, // 20,000 vertices by 55 joints
    }
}

/// How numbers are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct NumberType {
    /// `f`, `i`, `u` or `b`.
    pub kind: u8,
    /// Bytes of one number.
    pub size: usize,
    /// Most significant byte first.
    pub is_big_endian: bool,
}

impl NumberType {
    /// Reads numpy's spelling without its byte order: `f8`, `i4`, `u4`, `b1`.
    pub(super) fn parse(code: &str, is_big_endian: bool) -> Option<Self> {
        let (kind, size) = (*code.as_bytes().first()?, code.get(1..)?.parse().ok()?);
        let is_known = matches!((kind, size), (b'f', 4 | 8) | (b'i' | b'u', 1 | 2 | 4 | 8) | (b'b', 1));
        is_known.then_some(Self { kind, size, is_big_endian })
    }

    fn number(self, bytes: &[u8]) -> f64 {
        let mut buffer = [0; 8];
        let word = &mut buffer[8 - self.size..];
        word.copy_from_slice(bytes);
        if !self.is_big_endian {
            word.reverse();
        }
        let bits = u64::from_be_bytes(buffer);
        let unused = 64 - 8 * self.size as u32;
        match (self.kind, self.size) {
            (b'f', 4) => f64::from(f32::from_bits(bits as u32)),
            (b'f', _) => f64::from_bits(bits),
            (b'i', _) => (((bits << unused) as i64) >> unused) as f64,
            _ => bits as f64,
        }
    }
}

/// Product of the axes' lengths, `None` beyond [`MAX_ELEMENTS`].
pub(super) fn n_elements(shape: &[usize]) -> Option<usize> {
    let product = shape.iter().try_fold(1_usize, |product, n| product.checked_mul(*n))?;
    (product <= MAX_ELEMENTS).then_some(product)
}

impl Array {
    /// Decodes raw numbers; the length is checked before anything is allocated.
    pub(super) fn decode(
        field: &str,
        shape: Vec<usize>,
        number: NumberType,
        is_fortran: bool,
        bytes: &[u8],
    ) -> Result<Self, BodyFileError> {
        let too_large = BodyFileError::TooLarge { what: "an array", limit: MAX_ELEMENTS as u64 };
        let count = n_elements(&shape).ok_or(too_large)?;
        if bytes.len() != count * number.size {
            return Err(BodyFileError::NotAnArray {
                field: field.to_owned(),
                expected: "as many bytes as the shape says",
            });
        }
        let words = bytes.chunks_exact(number.size).map(|word| number.number(word));
        let values = if is_fortran { in_c_order(&shape, words) } else { words.collect() };
        Ok(Self { shape, values })
    }
}

/// Elements that come with the first axis running fastest, in the order where the last one does.
fn in_c_order(shape: &[usize], elements: impl ExactSizeIterator<Item = f64>) -> Vec<f64> {
    let mut values = vec![0.0; elements.len()];
    let mut index = vec![0; shape.len()];
    for value in elements {
        let place = index.iter().zip(shape).fold(0, |place, (i, n)| place * n + i);
        values[place] = value;
        for (i, n) in index.iter_mut().zip(shape) {
            *i += 1;
            if *i < *n {
                break;
            }
            *i = 0;
        }
    }
    values
}
