//! Recognition of videos and images by their first bytes: wandless reads 2D poses, so the refusal names what to run first.

/// First bytes of formats of videos and images, with the position at which they stand.
///
/// Sources: ISO/IEC 14496-12 (`ftyp`), RIFF (AVI, WebP), EBML (Matroska, WebM), ISO/IEC 13818-1 (MPEG program stream), RFC 2083
/// (PNG), ITU-T T.81 (JPEG), GIF89a, TIFF 6.0.
const SIGNATURES: &[(usize, &[u8])] = &[
    (4, b"ftyp"),
    (8, b"AVI "),
    (8, b"WEBP"),
    (0, &[0x1a, 0x45, 0xdf, 0xa3]),
    (0, &[0, 0, 1, 0xba]),
    (0, b"\x89PNG\r\n\x1a\n"),
    (0, &[0xff, 0xd8, 0xff]),
    (0, b"GIF8"),
    (0, &[b'I', b'I', 42, 0]),
    (0, &[b'M', b'M', 0, 42]),
];

/// Whether a file with these first bytes is a video or an image.
pub(crate) fn is_picture(head: &[u8]) -> bool {
    SIGNATURES.iter().any(|(at, bytes)| head.get(*at..at + bytes.len()) == Some(*bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recognises_videos_and_images_but_not_poses() {
        let pictures: [&[u8]; 4] =
            [b"\0\0\0\x20ftypisom", b"RIFF\x10\0\0\0AVI LIST", b"\xff\xd8\xff\xe0", b"\x89PNG\r\n\x1a\n"];
        assert!(pictures.into_iter().all(is_picture));
        let others: [&[u8]; 5] = [b"", b"PK\x03\x04", b"{\"people\": []}", b"\x93NUMPY", b"\x89HDF\r\n\x1a\n"];
        assert!(!others.into_iter().any(is_picture));
    }
}
