//! Reads SQLite's write-ahead log to verify its checksums: which pages it holds, and whether a byte of it has changed.
//!
//! SQLite silently treats the first invalid frame as the end of the log, so that later commits are lost without an error;
//! no pragma or API reports this. Format: sqlite.org/fileformat2.html, section 4.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;

/// Content of a write-ahead log.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct Log {
    /// Numbers of the pages with a committed frame; their copies in the database file may be outdated.
    pub(crate) pages: BTreeSet<u32>,
    /// Description of the damage, if any.
    pub(crate) damage: Option<String>,
}

const HEADER_BYTES: usize = 32;
const FRAME_HEADER_BYTES: usize = 24;

/// First four bytes; the lowest bit gives the byte order of the checksums (1: big-endian).
const MAGIC: u32 = 0x377f_0682;

impl Log {
    /// Reads the log at `path`; a missing file is an empty log.
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
        match fill(&mut reader, &mut header)? {
            true => Self::frames(&mut reader, &header),
            false => Ok(Self::default()), // nothing was written yet
        }
    }

    fn frames(reader: &mut impl Read, header: &[u8; HEADER_BYTES]) -> io::Result<Self> {
        let mut log = Self::default();
        let is_big_endian = word(header, 0) & 1 == 1;
        let mut sum = checksum([0, 0], &header[..24], is_big_endian);
        let page_bytes = word(header, 8);
        let is_header = word(header, 0) & !1 == MAGIC && sum == [word(header, 24), word(header, 28)];
        if !is_header || !(512..=65536).contains(&page_bytes) {
            log.damage = Some("the header is damaged".to_owned());
            return Ok(log);
        }
        let salts = [word(header, 16), word(header, 20)];
        let mut frame = vec![0; FRAME_HEADER_BYTES + page_bytes as usize];
        let mut uncommitted = BTreeSet::new();
        for n in 1.. {
            if !fill(reader, &mut frame)? {
                break;
            }
            let own = [word(&frame, 8), word(&frame, 12)];
            if own[0] != salts[0] && own[1] != salts[1] {
                break; // left over from before the last restart of the log
            }
            sum = checksum(sum, &frame[..8], is_big_endian);
            sum = checksum(sum, &frame[FRAME_HEADER_BYTES..], is_big_endian);
            if own != salts || sum != [word(&frame, 16), word(&frame, 20)] {
                log.damage = Some(format!("frame {n} is damaged; commits from there on are lost"));
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

/// Fills the buffer; false at the end of the file.
fn fill(reader: &mut impl Read, buffer: &mut [u8]) -> io::Result<bool> {
    match reader.read_exact(buffer) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Ok(false),
        Err(error) => Err(error),
    }
}

fn word(bytes: &[u8], at: usize) -> u32 {
    u32::from_be_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

/// Checksum of section 4.2: over pairs of words, each sum is added to the other.
fn checksum([mut a, mut b]: [u32; 2], bytes: &[u8], is_big_endian: bool) -> [u32; 2] {
    for pair in bytes.chunks_exact(8) {
        let words = [word(pair, 0), word(pair, 4)].map(|word| if is_big_endian { word } else { word.swap_bytes() });
        a = a.wrapping_add(words[0]).wrapping_add(b);
        b = b.wrapping_add(words[1]).wrapping_add(a);
    }
    [a, b]
}
