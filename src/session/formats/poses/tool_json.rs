//! JSON as pose tools write it: Python's writer leaves the bare word `NaN` for points that were not found, .NET and PowerShell
//! begin a file with a byte order mark.
//!
//! Only pose files of other tools are read this way: a NaN in a calibration or in the native layout is a mistake of its writer.

use std::borrow::Cow;
use std::io::{self, Read};

/// UTF-8's byte order mark.
const MARK: &[u8] = b"\xef\xbb\xbf";
const NAN: &[u8] = b"NaN";
const NULL: &[u8] = b"null";
/// Bytes that are read at a time.
const CHUNK: usize = 1 << 16;

/// The document in standard JSON: without a byte order mark, with `null` in place of `NaN` outside of strings.
pub(super) fn standard_json(bytes: &[u8]) -> Cow<'_, [u8]> {
    let bytes = without_mark(bytes);
    if !bytes.contains(&NAN[0]) {
        return Cow::Borrowed(bytes);
    }
    let (mut translation, mut standard) = (Translation::default(), Vec::with_capacity(bytes.len() + bytes.len() / 3));
    translation.add(bytes, &mut standard);
    translation.finish(&mut standard);
    Cow::Owned(standard)
}

/// The bytes of a text after its byte order mark.
pub(crate) fn without_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(MARK).unwrap_or(bytes)
}

/// A reader of the document in standard JSON.
pub(super) struct ToolJson<R> {
    inner: R,
    translation: Translation,
    standard: Vec<u8>,
    /// Number of bytes of `standard` that were passed on.
    n_passed: usize,
    is_at_start: bool,
    is_at_end: bool,
}

impl<R: Read> ToolJson<R> {
    pub(super) fn new(inner: R) -> Self {
        let (translation, standard) = Default::default();
        Self { inner, translation, standard, n_passed: 0, is_at_start: true, is_at_end: false }
    }

    fn translate_next(&mut self) -> io::Result<()> {
        let mut chunk = Vec::with_capacity(CHUNK);
        self.inner.by_ref().take(CHUNK as u64).read_to_end(&mut chunk)?;
        (self.n_passed, self.is_at_end) = (0, chunk.is_empty());
        self.standard.clear();
        let part = if self.is_at_start { without_mark(&chunk) } else { &chunk };
        self.is_at_start = false;
        self.translation.add(part, &mut self.standard);
        if self.is_at_end {
            self.translation.finish(&mut self.standard);
        }
        Ok(())
    }
}

impl<R: Read> Read for ToolJson<R> {
    fn read(&mut self, buf: &mut [u8]) -> io::Result<usize> {
        while self.n_passed == self.standard.len() && !self.is_at_end {
            self.translate_next()?;
        }
        let n = (&self.standard[self.n_passed..]).read(buf)?;
        self.n_passed += n;
        Ok(n)
    }
}

/// State between two parts of a document.
#[derive(Debug, Default)]
struct Translation {
    in_string: bool,
    escaped: bool,
    /// Number of bytes of `NaN` that the part before ended with; they are still to be written.
    n_begun: usize,
}

impl Translation {
    fn add(&mut self, bytes: &[u8], standard: &mut Vec<u8>) {
        for &byte in bytes {
            if self.n_begun > 0 && byte == NAN[self.n_begun] {
                self.n_begun += 1;
                if self.n_begun == NAN.len() {
                    standard.extend_from_slice(NULL);
                    self.n_begun = 0;
                }
                continue;
            }
            self.finish(standard);
            match byte {
                _ if self.escaped => self.escaped = false,
                b'\\' if self.in_string => self.escaped = true,
                b'"' => self.in_string = !self.in_string,
                b'N' if !self.in_string => {
                    self.n_begun = 1;
                    continue;
                }
                _ => {}
            }
            standard.push(byte);
        }
    }

    /// Writes what began like `NaN` and was something else.
    fn finish(&mut self, standard: &mut Vec<u8>) {
        standard.extend_from_slice(&NAN[..self.n_begun]);
        self.n_begun = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn replaces_nan_outside_of_strings_only() {
        let cases = [
            (r#"[NaN, 1, "NaN", "a\"NaN"]"#, r#"[null, 1, "NaN", "a\"NaN"]"#),
            (r#"{"N":[NaN,NaN],"x":-Infinity}"#, r#"{"N":[null,null],"x":-Infinity}"#),
            ("[NNaN, Na", "[Nnull, Na"),
            ("\u{feff}[1]", "[1]"),
        ];
        for (written, standard) in cases {
            assert_eq!(standard_json(written.as_bytes()), standard.as_bytes());
            let mut read = String::new();
            ToolJson::new(written.as_bytes()).read_to_string(&mut read).unwrap();
            assert_eq!(read, standard);
        }
    }

    #[test]
    fn replaces_nan_across_the_border_of_two_chunks() {
        for n_before in CHUNK - 4..CHUNK + 2 {
            let written = format!("{}NaN]", " ".repeat(n_before));
            let mut read = String::new();
            ToolJson::new(written.as_bytes()).read_to_string(&mut read).unwrap();
            assert_eq!(read, written.replace("NaN", "null"), "{n_before}");
        }
    }
}
