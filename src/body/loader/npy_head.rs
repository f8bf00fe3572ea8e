//! The head of an `.npy` file, looked at before it is parsed: the parser tries every bracket in two ways, so that its work
//! doubles with each that nests, and a kilobyte could keep it busy for ever.

use std::io::{self, Cursor, Read};

/// Brackets within brackets: the dictionary, a list of fields, a field, its shape.
const MAX_DEPTH: usize = 4;

/// Longest head: numpy itself refuses to evaluate more than 10,000 characters.
const MAX_BYTES: usize = 10_000;

/// The same bytes again, once their head was found fit to be parsed.
///
/// # Errors
/// `InvalidData` where it is not, and whatever reading gives.
pub(crate) fn with_flat_head<R: Read>(mut file: R) -> io::Result<impl Read> {
    let mut head = vec![0; 10];
    file.read_exact(&mut head)?;
    let is_long = head[6] > 1; // from version 2 on its length takes four bytes
    if is_long {
        head.resize(12, 0);
        file.read_exact(&mut head[10..])?;
    }
    let length = match is_long {
        true => u32::from_le_bytes([head[8], head[9], head[10], head[11]]) as usize,
        false => usize::from(u16::from_le_bytes([head[8], head[9]])),
    };
    if length > MAX_BYTES {
        return Err(unfit("its head is too long"));
    }
    let start = head.len();
    head.resize(start + length, 0);
    file.read_exact(&mut head[start..])?;
    if depth(&head[start..]) > MAX_DEPTH {
        return Err(unfit("its head nests too deeply"));
    }
    Ok(Cursor::new(head).chain(file))
}

fn unfit(what: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, what)
}

/// Most brackets that are open at the same time; those in texts count, too.
fn depth(head: &[u8]) -> usize {
    let (mut open, mut most) = (0_usize, 0);
    for byte in head {
        match byte {
            b'(' | b'[' | b'{' => open += 1,
            b')' | b']' | b'}' => open = open.saturating_sub(1),
            _ => {}
        }
        most = most.max(open);
    }
    most
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(shape: &str) -> Vec<u8> {
        let head = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}\n");
        let mut file = b"\x93NUMPY\x01\x00".to_vec();
        file.extend_from_slice(&(head.len() as u16).to_le_bytes());
        file.extend_from_slice(head.as_bytes());
        file
    }

    #[test]
    fn what_nests_without_need_is_refused_before_it_is_parsed() {
        let read = |bytes: &[u8]| with_flat_head(bytes).and_then(io::read_to_string);
        let fine = [file("(2, 3)"), b"12345678".to_vec()].concat();
        let again = with_flat_head(fine.as_slice()).map(|mut file| {
            let mut bytes = Vec::new();
            file.read_to_end(&mut bytes).map(|_| bytes)
        });
        assert_eq!(again.unwrap().unwrap(), fine);
        assert!(read(&file(&"(1,".repeat(60))).is_err());
        assert!(read(&file(&"1,".repeat(6000))).is_err());
        assert!(read(&fine[..30]).is_err());
        let mut long = fine.clone();
        long[6] = 2; // the length is then read from the text that follows: far too long
        assert!(read(&long).is_err());
    }
}
