//! Bounds on the bytes of a JSON document, before any parser allocates for them.

use super::error::{Fault, UploadError};
use super::limits::UploadLimits;
use std::io::{self, Read};

/// The longest number that any writer of doubles produces has some 25 characters.
const MAX_NUMBER_BYTES: u64 = 400;

/// Hands bytes on and stops at the first that breaks a limit.
///
/// All bytes before the offending one are delivered first, so that the parser behind stands at the right place when
/// the error reaches it. The error is an [`io::Error`] around an [`UploadError`].
pub(super) struct JsonGuard<'a, R> {
    inner: R,
    limits: &'a UploadLimits,
    lexer: Lexer,
    stopped: Option<UploadError>,
}

/// Where in the document the next byte stands.
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
            return Err(Fault::TooLarge.with(format!("more than {} bytes unpacked", limits.max_unpacked_bytes)));
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
            return Err(Fault::TokenTooLong.with(format!("a string of more than {} bytes", limits.max_string_bytes)));
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
            // JSON has no such literal: `NaN` and `Infinity` are what careless writers leave.
            b'N' | b'I' => return Err(Fault::NumberNotFinite.with(format!("NaN or Infinity at byte {}", self.offset))),
            0 | 0x80.. => return Err(Fault::Encoding.with(format!("byte {byte:#04x} at byte {}", self.offset))),
            _ => {}
        }
        if self.depth > limits.max_json_depth {
            return Err(Fault::JsonTooDeep.with(format!("more than {} levels of nesting", limits.max_json_depth)));
        }
        if self.token_bytes > MAX_NUMBER_BYTES {
            return Err(Fault::TokenTooLong.with(format!("a number of more than {MAX_NUMBER_BYTES} digits")));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn verdict(text: &[u8]) -> Result<usize, &'static str> {
        let limits = UploadLimits { max_json_depth: 3, max_string_bytes: 10, ..UploadLimits::default() };
        let mut out = Vec::new();
        match JsonGuard::new(text, &limits).read_to_end(&mut out) {
            Ok(n) => Ok(n),
            Err(e) => Err(e.downcast::<UploadError>().map_or("other", |e| e.code)),
        }
    }

    #[test]
    fn limits_hold_outside_strings_only() {
        assert_eq!(verdict(br#"{"a":["NaN\"[[ [[ [[",1]}"#), Err("token_too_long"));
        assert_eq!(verdict(br#"{"a":["NaN\"[[",-1.5e5]}"#), Ok(24));
        assert_eq!(verdict(b"[[[[1]]]]"), Err("json_too_deep"));
        assert_eq!(verdict(b"[1, NaN]"), Err("number_not_finite"));
        assert_eq!(verdict(b"[-Infinity]"), Err("number_not_finite"));
        assert_eq!(verdict(b"\xef\xbb\xbf{}"), Err("encoding"));
        assert_eq!(verdict(b"\xff\xfe{\0"), Err("encoding"));
        assert_eq!(verdict(&[b'1'; 500]), Err("token_too_long"));
    }

    #[test]
    fn what_precedes_the_fault_is_delivered() {
        let limits = UploadLimits::default();
        let mut guard = JsonGuard::new(&b"[1, NaN]"[..], &limits);
        let mut buf = [0; 64];
        assert_eq!(guard.read(&mut buf).unwrap(), 4);
        assert!(guard.read(&mut buf).is_err());
        assert!(guard.read(&mut buf).is_err(), "a stopped guard stays stopped");
    }
}
