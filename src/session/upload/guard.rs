//! Limits on the bytes of a JSON document, applied before the parser allocates memory for them.

use super::error::{Fault, UploadError};
use super::limits::UploadLimits;
use std::io::{self, Read};

/// Largest length of a number; writers of doubles produce at most about 25 characters.
const MAX_NUMBER_BYTES: u64 = 400;

/// A reader that passes bytes on and stops at the first one that breaks a limit.
///
/// All bytes before the offending one are delivered first, so that the parser is at the right place when the error reaches
/// it. The error is an [`io::Error`] around an [`UploadError`].
pub(super) struct JsonGuard<'a, R> {
    inner: R,
    limits: &'a UploadLimits,
    lexer: Lexer,
    stopped: Option<UploadError>,
}

/// State of the lexer at the next byte of the document.
#[derive(Debug, Default, PartialEq)]
struct Lexer {
    offset: u64,
    depth: usize,
    in_string: bool,
    escaped: bool,
    token_bytes: u64,
}

impl<'a, R: Read> JsonGuard<'a, R> {
    pub(super) fn new(inner: R, limits: &'a UploadLimits) -> Self {
        Self { inner, limits, lexer: Lexer::default(), stopped: None }
    }
}

impl<R: Read> Read for JsonGuard<'_, R> {
    fn read(&mut self, buf: &mut [u8]) -> io::Result<usize> {
        if let Some(error) = &self.stopped {
            return Err(io::Error::other(error.clone()));
        }
        let n = self.inner.read(buf)?;
        let Err((i, error)) = self.lexer.pass(&buf[..n], self.limits) else { return Ok(n) };
        self.stopped = Some(error.clone());
        if i > 0 { Ok(i) } else { Err(io::Error::other(error)) }
    }
}

/// Bytes that are looked at together.
const BLOCK: usize = 64;

impl Lexer {
    /// Passes over `bytes`; the position of the first that breaks a limit, and the error.
    fn pass(&mut self, bytes: &[u8], limits: &UploadLimits) -> Result<(), (usize, UploadError)> {
        let (blocks, rest) = bytes.as_chunks::<BLOCK>();
        for (b, block) in blocks.iter().enumerate() {
            if !self.pass_numbers(block, limits) {
                self.step_through(block, limits).map_err(|(i, error)| (b * BLOCK + i, error))?;
            }
        }
        self.step_through(rest, limits).map_err(|(i, error)| (bytes.len() - rest.len() + i, error))
    }

    fn step_through(&mut self, bytes: &[u8], limits: &UploadLimits) -> Result<(), (usize, UploadError)> {
        bytes.iter().enumerate().try_for_each(|(i, &byte)| self.step(byte, limits).map_err(|error| (i, error)))
    }

    /// Passes over a block of nothing but numbers, brackets, commas and spaces that comes nowhere near a limit: most of a pose
    /// file, at a tenth of the time of single steps. False, with nothing passed, for any other block.
    fn pass_numbers(&mut self, block: &[u8; BLOCK], limits: &UploadLimits) -> bool {
        let (mut n_other, mut n_opened, mut n_closed) = (0u8, 0u8, 0u8);
        for &byte in block {
            let is_plain = is_in_number(byte) | matches!(byte, b',' | b' ' | b'\n' | b'[' | b']');
            n_other += u8::from(!is_plain);
            n_opened += u8::from(byte == b'[');
            n_closed += u8::from(byte == b']');
        }
        let (opened, closed, size) = (usize::from(n_opened), usize::from(n_closed), BLOCK as u64);
        let is_within = self.depth + opened <= limits.max_json_depth
            && self.token_bytes + size <= MAX_NUMBER_BYTES
            && self.offset + size <= limits.max_unpacked_bytes;
        if self.in_string || n_other > 0 || self.depth < closed || !is_within {
            return false;
        }
        let last_number = block.iter().rev().take_while(|byte| is_in_number(**byte)).count() as u64;
        self.token_bytes = if last_number == size { self.token_bytes + size } else { last_number };
        self.depth = self.depth + opened - closed;
        self.offset += size;
        true
    }

    fn step(&mut self, byte: u8, limits: &UploadLimits) -> Result<(), UploadError> {
        self.offset += 1;
        if self.offset > limits.max_unpacked_bytes {
            return Err(Fault::TooLarge.with(format!("the document has more than {} bytes", limits.max_unpacked_bytes)));
        }
        if self.in_string { self.step_in_string(byte, limits) } else { self.step_outside(byte, limits) }
    }

    fn step_in_string(&mut self, byte: u8, limits: &UploadLimits) -> Result<(), UploadError> {
        self.token_bytes += 1;
        match byte {
            _ if self.escaped => self.escaped = false,
            b'\\' => self.escaped = true,
            b'"' => (self.in_string, self.token_bytes) = (false, 0),
            _ => {}
        }
        if self.token_bytes > limits.max_string_bytes {
            return Err(Fault::TokenTooLong.with(format!("a string has more than {} bytes", limits.max_string_bytes)));
        }
        Ok(())
    }

    fn step_outside(&mut self, byte: u8, limits: &UploadLimits) -> Result<(), UploadError> {
        self.token_bytes = if is_in_number(byte) { self.token_bytes + 1 } else { 0 };
        match byte {
            b'"' => self.in_string = true,
            b'{' | b'[' => self.depth += 1,
            b'}' | b']' => self.depth = self.depth.saturating_sub(1),
            // JSON has no literals `NaN` and `Infinity`, but many writers produce them.
            b'N' | b'I' => {
                return Err(Fault::NumberNotFinite
                    .with(format!("NaN or Infinity at byte {}, expected a finite number", self.offset)));
            }
            0 | 0x80.. => {
                return Err(Fault::Encoding.with(format!("invalid byte {byte:#04x} at offset {}", self.offset)));
            }
            _ => {}
        }
        if self.depth > limits.max_json_depth {
            return Err(Fault::JsonTooDeep
                .with(format!("the document has more than {} levels of nesting", limits.max_json_depth)));
        }
        if self.token_bytes > MAX_NUMBER_BYTES {
            return Err(Fault::TokenTooLong.with(format!("a number has more than {MAX_NUMBER_BYTES} digits")));
        }
        Ok(())
    }
}

fn is_in_number(byte: u8) -> bool {
    matches!(byte, b'0'..=b'9' | b'+' | b'-' | b'.' | b'e' | b'E')
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn code_of(text: &[u8]) -> Result<usize, &'static str> {
        let limits = UploadLimits { max_json_depth: 3, max_string_bytes: 10, ..UploadLimits::default() };
        let mut out = Vec::new();
        match JsonGuard::new(text, &limits).read_to_end(&mut out) {
            Ok(n) => Ok(n),
            Err(e) => Err(e.downcast::<UploadError>().map_or("other", |e| e.code)),
        }
    }

    #[test]
    fn applies_limits_outside_strings_only() {
        assert_eq!(code_of(br#"{"a":["NaN\"[[ [[ [[",1]}"#), Err("token_too_long"));
        assert_eq!(code_of(br#"{"a":["NaN\"[[",-1.5e5]}"#), Ok(24));
        assert_eq!(code_of(b"[[[[1]]]]"), Err("json_too_deep"));
        assert_eq!(code_of(b"[1, NaN]"), Err("number_not_finite"));
        assert_eq!(code_of(b"[-Infinity]"), Err("number_not_finite"));
        assert_eq!(code_of(b"\xef\xbb\xbf{}"), Err("encoding"));
        assert_eq!(code_of(b"\xff\xfe{\0"), Err("encoding"));
        assert_eq!(code_of(&[b'1'; 500]), Err("token_too_long"));
    }

    /// Texts of numbers and brackets with now and then a string, a deep list, a long number or a wrong byte.
    #[test]
    fn blocks_pass_what_single_steps_pass() {
        let limits = UploadLimits {
            max_json_depth: 6,
            max_string_bytes: 100,
            max_unpacked_bytes: 3000,
            ..UploadLimits::default()
        };
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut n_faults = 0;
        for _ in 0..2000 {
            let usual = b"0123456789.,[]-e ]] \n";
            let (n, strange) = (rng.random_range(0..4000), rng.random_range(0.0..0.004));
            let other = [&b"\"ab{}:"[..], b"]", b"[[[[", b"N", b"\0", &[b'7'; 300], b"\"\\\"[\""];
            let mut text: Vec<u8> = Vec::new();
            while text.len() < n {
                match rng.random_bool(strange) {
                    true => text.extend_from_slice(other[rng.random_range(0..other.len())]),
                    false => text.push(usual[rng.random_range(0..usual.len())]),
                }
            }
            let (mut by_blocks, mut by_steps) = (Lexer::default(), Lexer::default());
            let (passed, stepped) = (by_blocks.pass(&text, &limits), by_steps.step_through(&text, &limits));
            n_faults += usize::from(stepped.is_err());
            assert_eq!(passed, stepped);
            assert_eq!(by_blocks, by_steps);
        }
        assert!((200..1900).contains(&n_faults), "{n_faults}");
    }

    #[test]
    fn delivers_bytes_before_the_fault() {
        let limits = UploadLimits::default();
        let mut guard = JsonGuard::new(&b"[1, NaN]"[..], &limits);
        let mut buf = [0; 64];
        assert_eq!(guard.read(&mut buf).unwrap(), 4);
        assert!(guard.read(&mut buf).is_err());
        assert!(guard.read(&mut buf).is_err(), "a stopped guard stays stopped");
    }
}
