//! The two escapes by which protocol 0 writes strings within a line.

/// Decodes Python 2's `repr` of a string; `None` for an escape that it never writes.
pub(super) fn repr_unescaped(text: &[u8]) -> Option<Vec<u8>> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.iter();
    while let Some(&byte) = rest.next() {
        if byte != b'\\' {
            bytes.push(byte);
            continue;
        }
        bytes.push(match rest.next()? {
            b'n' => b'\n',
            b'r' => b'\r',
            b't' => b'\t',
            quoted @ (b'\\' | b'\'' | b'"') => *quoted,
            b'x' => {
                let digit = |byte: &u8| char::from(*byte).to_digit(16);
                (digit(rest.next()?)? * 16 + digit(rest.next()?)?) as u8
            }
            _ => return None,
        });
    }
    Some(bytes)
}

/// Python's raw-unicode-escape: bytes are Latin-1, but for `\uXXXX` and `\UXXXXXXXX`.
pub(super) fn raw_unicode_unescaped(line: &[u8]) -> String {
    let mut text = String::with_capacity(line.len());
    let mut rest = line;
    while let Some((&byte, after)) = rest.split_first() {
        let digits = match (byte, after.first()) {
            (b'\\', Some(b'u')) => 4,
            (b'\\', Some(b'U')) => 8,
            _ => 0,
        };
        let code = after.get(1..1 + digits).filter(|_| digits > 0).and_then(|hex| std::str::from_utf8(hex).ok());
        match code.and_then(|hex| u32::from_str_radix(hex, 16).ok()).and_then(char::from_u32) {
            Some(letter) => {
                text.push(letter);
                rest = &after[1 + digits..];
            }
            None => {
                text.push(char::from(byte));
                rest = after;
            }
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decodes_escapes_and_rejects_unknown_ones() {
        assert_eq!(repr_unescaped(br"a\x00\n\'\\").as_deref(), Some(b"a\0\n'\\".as_slice()));
        assert_eq!(repr_unescaped(br"\q"), None);
        assert_eq!(repr_unescaped(br"\x0"), None);
        assert_eq!(raw_unicode_unescaped(b"\xe9\\u005c\\u20ac\\u00"), "\u{e9}\\\u{20ac}\\u00");
    }
}
