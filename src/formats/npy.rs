//! Arrays of numbers in NumPy's `.npy` format. Every claimed size is checked before memory is reserved for it.

use std::io::{self, Read};

/// Longest header, bytes: numpy itself refuses to evaluate more than 10,000 characters.
const MAX_HEADER_BYTES: usize = 10_000;
/// Numbers reserved at once, whatever the header claims; longer arrays grow as they are read.
const MAX_RESERVED: usize = 1 << 20;
/// Bytes decoded at a time; a multiple of every number's size.
const CHUNK_BYTES: usize = 1 << 16;

/// Why an array cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum NpyError {
    /// The file cannot be read.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// The archive cannot be read.
    #[error(transparent)]
    Archive(#[from] zip::result::ZipError),
    /// The header is missing or damaged, or too large to be parsed.
    #[error("not a numpy array: {0}")]
    Header(io::Error),
    /// The elements are not numbers of a known type.
    #[error("numbers expected, found type {found}")]
    NotNumbers {
        /// Type as numpy spells it.
        found: String,
    },
    /// The array is larger than its reader allows.
    #[error("shape {shape:?}: at most {limit} numbers expected")]
    TooLarge {
        /// The array's shape.
        shape: Vec<usize>,
        /// Most numbers that the reader allows.
        limit: usize,
    },
    /// The contents do not have as many bytes as the shape requires.
    #[error("shape {shape:?}: the contents have another length")]
    Length {
        /// The array's shape.
        shape: Vec<usize>,
    },
}

/// A dense array in C order.
#[derive(Debug, Clone, PartialEq)]
pub struct Array {
    /// Lengths of its axes.
    pub shape: Vec<usize>,
    /// All elements, the last axis running fastest.
    pub values: Vec<f64>,
}

/// How numbers are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NumberType {
    /// `f`, `i`, `u` or `b`.
    pub kind: u8,
    /// Bytes of one number.
    pub size: usize,
    /// Most significant byte first.
    pub is_big_endian: bool,
}

/// How many numbers an array may have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// In the file.
    pub read: usize,
    /// In memory.
    pub kept: usize,
}

/// What the header of a `.npy` file says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Header {
    /// Lengths of the axes.
    pub shape: Vec<usize>,
    /// Type of the elements.
    pub number: NumberType,
    /// Whether the first axis runs fastest.
    pub is_fortran: bool,
}

impl NumberType {
    /// Reads numpy's name of a type without its byte order: `f8`, `i4`, `u4`, `b1`.
    pub fn parse(code: &str, is_big_endian: bool) -> Option<Self> {
        let (kind, size) = (*code.as_bytes().first()?, code.get(1..)?.parse().ok()?);
        let is_known = matches!((kind, size), (b'f', 4 | 8) | (b'i' | b'u', 1 | 2 | 4 | 8) | (b'b', 1));
        is_known.then_some(Self { kind, size, is_big_endian })
    }

    /// The number that `bytes` store; there must be as many as the type has.
    pub fn number(self, bytes: &[u8]) -> f64 {
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

impl Header {
    /// Reads the header; `reader` then stands at the first element.
    ///
    /// # Errors
    /// [`NpyError::Header`], and [`NpyError::NotNumbers`] for elements of another type.
    pub fn read(reader: &mut impl Read) -> Result<Self, NpyError> {
        let text = header_text(reader).map_err(NpyError::Header)?;
        let descr = value_of(&text, "descr").ok_or_else(|| NpyError::Header(invalid("its type is missing")))?;
        let name = descr.strip_prefix('\'').and_then(|rest| rest.split_once('\'')).map(|(name, _)| name);
        let number = name.and_then(|name| match name.split_at_checked(1)? {
            (order @ ("<" | ">" | "|" | "="), code) => NumberType::parse(code, order == ">"),
            _ => None,
        });
        let found = || name.map_or_else(|| descr.chars().take(40).collect(), |name| format!("'{name}'"));
        let number = number.ok_or_else(|| NpyError::NotNumbers { found: found() })?;
        let shape = value_of(&text, "shape").and_then(shape_of);
        let shape = shape.ok_or_else(|| NpyError::Header(invalid("its shape is missing or too large")))?;
        let is_fortran = match value_of(&text, "fortran_order") {
            Some(value) if value.starts_with("False") => false,
            Some(value) if value.starts_with("True") => true,
            _ => return Err(NpyError::Header(invalid("its order is missing"))),
        };
        Ok(Self { shape, number, is_fortran })
    }
}

impl Array {
    /// Reads a `.npy` file of at most `limit` numbers.
    ///
    /// # Errors
    /// [`NpyError`].
    pub fn read(reader: &mut impl Read, limit: usize) -> Result<Self, NpyError> {
        Self::read_contents(Header::read(reader)?, reader, limit)
    }

    /// Decodes the elements that follow a header.
    ///
    /// # Errors
    /// [`NpyError::TooLarge`] before anything is read, [`NpyError::Length`] where the reader ends early.
    pub fn read_contents(header: Header, reader: &mut impl Read, limit: usize) -> Result<Self, NpyError> {
        Self::read_leading_contents(header, reader, usize::MAX, Limits { read: limit, kept: limit })
    }

    /// Reads a `.npy` file and keeps the first `n_leading` entries of its last axis, or all where there are fewer. The others are
    /// never in memory.
    ///
    /// # Errors
    /// As [`Self::read_contents`].
    pub fn read_leading(reader: &mut impl Read, n_leading: usize, limits: Limits) -> Result<Self, NpyError> {
        Self::read_leading_contents(Header::read(reader)?, reader, n_leading, limits)
    }

    fn read_leading_contents(
        header: Header,
        reader: &mut impl Read,
        n_leading: usize,
        limits: Limits,
    ) -> Result<Self, NpyError> {
        let Header { mut shape, number, is_fortran } = header;
        let too_large = |shape: &[usize], limit| NpyError::TooLarge { shape: shape.to_vec(), limit };
        let count = n_elements(&shape, limits.read).ok_or_else(|| too_large(&shape, limits.read))?;
        let n_last = shape.last().copied().unwrap_or(1).max(1);
        let n_kept = n_leading.min(n_last);
        let n_values = count / n_last * n_kept;
        if n_values > limits.kept {
            return Err(too_large(&shape, limits.kept));
        }
        let is_kept = |element: usize| match is_fortran {
            _ if n_kept == n_last => true,
            true => element < n_values,
            false => element % n_last < n_kept,
        };
        let mut values = Vec::with_capacity(n_values.min(MAX_RESERVED));
        let (mut chunk, mut n_read) = (vec![0; CHUNK_BYTES], 0);
        while n_read < count {
            let chunk = &mut chunk[..CHUNK_BYTES.min((count - n_read) * number.size)];
            match reader.read_exact(chunk) {
                Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => return Err(NpyError::Length { shape }),
                read => read?,
            }
            let words = chunk.chunks_exact(number.size).enumerate();
            let kept = words.filter(|(i, _)| is_kept(n_read + i));
            values.extend(kept.map(|(_, word)| number.number(word)));
            n_read += chunk.len() / number.size;
        }
        if let Some(last) = shape.last_mut() {
            *last = n_kept.min(*last);
        }
        let values = if is_fortran { in_c_order(&shape, &values) } else { values };
        Ok(Self { shape, values })
    }

    /// Decodes the raw elements of an array, all of `bytes`.
    ///
    /// # Errors
    /// [`NpyError::TooLarge`], [`NpyError::Length`].
    pub fn decode(header: Header, mut bytes: &[u8], limit: usize) -> Result<Self, NpyError> {
        let n_bytes = n_elements(&header.shape, limit).map(|count| count * header.number.size);
        if n_bytes.is_some_and(|n| n != bytes.len()) {
            return Err(NpyError::Length { shape: header.shape });
        }
        Self::read_contents(header, &mut bytes, limit)
    }
}

/// Product of the axes' lengths, `None` above `limit`.
pub fn n_elements(shape: &[usize], limit: usize) -> Option<usize> {
    let product = shape.iter().try_fold(1_usize, |product, n| product.checked_mul(*n))?;
    (product <= limit).then_some(product)
}

/// Elements given with the first axis running fastest, in the order where the last one does.
fn in_c_order(shape: &[usize], elements: &[f64]) -> Vec<f64> {
    let mut values = vec![0.0; elements.len()];
    let mut index = vec![0; shape.len()];
    for value in elements {
        let place = index.iter().zip(shape).fold(0, |place, (i, n)| place * n + i);
        values[place] = *value;
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

/// The header's dictionary as text, with single quotes.
fn header_text(reader: &mut impl Read) -> io::Result<String> {
    let mut start = [0; 8];
    reader.read_exact(&mut start)?;
    let mut length = [0; 4];
    match start {
        [0x93, b'N', b'U', b'M', b'P', b'Y', 1, _] => reader.read_exact(&mut length[..2])?,
        [0x93, b'N', b'U', b'M', b'P', b'Y', 2 | 3, _] => reader.read_exact(&mut length)?,
        _ => return Err(invalid("it does not start with a known version of the format")),
    }
    let length = u32::from_le_bytes(length) as usize;
    if length > MAX_HEADER_BYTES {
        return Err(invalid("its header is too long"));
    }
    let mut text = vec![0; length];
    reader.read_exact(&mut text)?;
    Ok(String::from_utf8_lossy(&text).replace('"', "'"))
}

/// The text after `'key':` in a dictionary.
fn value_of<'a>(text: &'a str, key: &str) -> Option<&'a str> {
    let (_, rest) = text.split_once(&format!("'{key}'"))?;
    Some(rest.trim_start().strip_prefix(':')?.trim_start())
}

/// Lengths in a tuple such as `(2, 3)`, `(7,)` or `()`. Python 2 wrote `(7L,)`.
fn shape_of(tuple: &str) -> Option<Vec<usize>> {
    let (lengths, _) = tuple.strip_prefix('(')?.split_once(')')?;
    let lengths = lengths.split(',').map(|length| length.trim().trim_end_matches('L'));
    lengths.filter(|length| !length.is_empty()).map(|length| length.parse().ok()).collect()
}

fn invalid(what: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, what)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(shape: &str, order: &str) -> Vec<u8> {
        let header = format!("{{'descr': '<f4', 'fortran_order': {order}, 'shape': {shape}, }}\n");
        let mut file = b"\x93NUMPY\x01\x00".to_vec();
        file.extend_from_slice(&(header.len() as u16).to_le_bytes());
        file.extend_from_slice(header.as_bytes());
        file
    }

    #[test]
    fn rejects_nested_and_long_headers() {
        let header = |bytes: &[u8]| Header::read(&mut &*bytes);
        let fine = file("(2, 3)", "False");
        assert_eq!(header(&fine).unwrap().shape, [2, 3]);
        assert!(header(&file(&"(".repeat(2000), "False")).is_err());
        assert!(header(&fine[..20]).is_err());
        assert_eq!(header(&file("(7L,)", "True")).unwrap().shape, [7]);
        assert_eq!(header(&file("()", "False")).unwrap().shape, [0; 0]);
        let mut long = fine.clone();
        long[6] = 2; // the length is then read from the text that follows: far too long
        assert!(header(&long).is_err());
    }

    /// Of `[[0, 1, 2], [3, 4, 5]]` the first two columns.
    #[test]
    fn keeps_leading_entries_of_the_last_axis() {
        for (order, elements) in [("False", [0, 1, 2, 3, 4, 5]), ("True", [0, 3, 1, 4, 2, 5])] {
            let words = elements.into_iter().flat_map(|v| (v as f32).to_le_bytes());
            let bytes: Vec<u8> = file("(2, 3)", order).into_iter().chain(words).collect();
            let read = |n, kept| Array::read_leading(&mut bytes.as_slice(), n, Limits { read: 6, kept });
            assert_eq!(read(2, 4).unwrap(), Array { shape: vec![2, 2], values: vec![0.0, 1.0, 3.0, 4.0] }, "{order}");
            assert_eq!(read(9, 6).unwrap().shape, [2, 3]);
            assert!(matches!(read(2, 3), Err(NpyError::TooLarge { limit: 3, .. })));
            let short = &bytes[..bytes.len() - 1];
            let cut = Array::read_leading(&mut &*short, 2, Limits { read: 6, kept: 6 });
            assert!(matches!(cut, Err(NpyError::Length { .. })));
        }
    }

    #[test]
    fn reads_both_orders_and_rejects_wrong_sizes() {
        let bytes = |order: &str| {
            let values = (0..6).flat_map(|v| (v as f32).to_le_bytes());
            file("(2, 3)", order).into_iter().chain(values).collect::<Vec<u8>>()
        };
        let read = |bytes: &[u8], limit: usize| Array::read(&mut &*bytes, limit);
        assert_eq!(read(&bytes("False"), 6).unwrap().values, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
        assert_eq!(read(&bytes("True"), 6).unwrap().values, [0.0, 2.0, 4.0, 1.0, 3.0, 5.0]);
        assert!(matches!(read(&bytes("False"), 5), Err(NpyError::TooLarge { limit: 5, .. })));
        assert!(matches!(read(&bytes("False")[..70], 6), Err(NpyError::Length { .. })));
        let claimed = file("(4000000000, 4000000000, 4000000000)", "False");
        assert!(matches!(read(&claimed, usize::MAX), Err(NpyError::TooLarge { .. })));
    }
}
