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
#[derive(Default)]
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
        for (i, &byte) in buf[..n].iter().enumerate() {
            if let Err(error) = self.lexer.step(byte, self.limits) {
                self.stopped = Some(error.clone());
                return if i > 0 { Ok(i) } else { Err(io::Error::other(error)) };
            }
        }
        Ok(n)
    }
}

impl Lexer {
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
        let is_number = matches!(byte, b'0'..=b'9' | b'+' | b'-' | b'.' | b'e' | b'E');
        self.token_bytes = if is_number { self.token_bytes + 1 } else { 0 };
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

#[cfg(test)]
mod tests {
    use super::*;

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
