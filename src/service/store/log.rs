//! SQLite's write-ahead log, read for its checksums: which pages wait in it, and whether a byte of it has changed.
//!
//! SQLite takes the first frame that is not whole for the end of the log, without a word: what was committed behind it is
//! lost. Whoever compares wants to be told. Format: sqlite.org/fileformat2.html, section 4.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;

/// What a log holds.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct Log {
    /// Pages with a committed frame; their place in the database file may hold anything.
    pub(crate) pages: BTreeSet<u32>,
    /// What is wrong with it.
    pub(crate) damage: Option<String>,
}

const HEADER_BYTES: usize = 32;
const FRAME_HEADER_BYTES: usize = 24;

/// First four bytes; the last bit says in which order of bytes the checksums are made.
const MAGIC: u32 = 0x377f_0682;

impl Log {
    /// Reads the log at `path`; none is an empty one.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub(crate) fn read(path: &Path) -> io::Result<Self> {
        let file = match File::open(path) {
            Ok(file) => file,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Self::default()),
            Err(error) => return Err(error),
        };
        let mut reader = BufReader::with_capacity(1 << 16, file);
        let mut header = [0; HEADER_BYTES];
        match read_whole(&mut reader, &mut header)? {
            true => Self::frames(&mut reader, &header),
            false => Ok(Self::default()), // nothing was ever written
        }
    }

    fn frames(reader: &mut impl Read, header: &[u8; HEADER_BYTES]) -> io::Result<Self> {
        let mut log = Self::default();
        let is_big_endian = word(header, 0) & 1 == 1;
        let mut sum = checksum([0, 0], &header[..24], is_big_endian);
        let page_bytes = word(header, 8);
        let is_header = word(header, 0) & !1 == MAGIC && sum == [word(header, 24), word(header, 28)];
        if !is_header || !(512..=65536).contains(&page_bytes) {
            log.damage = Some("its header is not whole".to_owned());
            return Ok(log);
        }
        let salts = [word(header, 16), word(header, 20)];
        let mut frame = vec![0; FRAME_HEADER_BYTES + page_bytes as usize];
        let mut uncommitted = BTreeSet::new();
        for n in 1.. {
            if !read_whole(reader, &mut frame)? {
                break;
            }
            let own = [word(&frame, 8), word(&frame, 12)];
            if own[0] != salts[0] && own[1] != salts[1] {
                break; // left over from before the log began anew
            }
            sum = checksum(sum, &frame[..8], is_big_endian);
            sum = checksum(sum, &frame[FRAME_HEADER_BYTES..], is_big_endian);
            if own != salts || sum != [word(&frame, 16), word(&frame, 20)] {
                log.damage = Some(format!("frame {n} is not whole; what was committed from there on is lost"));
                break;
            }
            uncommitted.insert(word(&frame, 0));
            if word(&frame, 4) != 0 {
                log.pages.append(&mut uncommitted);
            }
        }
        Ok(log)
    }
}

/// Whether the buffer could be filled.
fn read_whole(reader: &mut impl Read, buffer: &mut [u8]) -> io::Result<bool> {
    match reader.read_exact(buffer) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Ok(false),
        Err(error) => Err(error),
    }
}

fn word(bytes: &[u8], at: usize) -> u32 {
    u32::from_be_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

/// Section 4.2: over pairs of words, each sum added to the other.
fn checksum([mut a, mut b]: [u32; 2], bytes: &[u8], is_big_endian: bool) -> [u32; 2] {
    for pair in bytes.chunks_exact(8) {
        let words = [word(pair, 0), word(pair, 4)].map(|word| if is_big_endian { word } else { word.swap_bytes() });
        a = a.wrapping_add(words[0]).wrapping_add(b);
        b = b.wrapping_add(words[1]).wrapping_add(a);
    }
    [a, b]
}
