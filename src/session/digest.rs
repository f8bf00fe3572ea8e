//! SHA-256 digests as lower-case hex.

use sha2::{Digest, Sha256};
use std::io::{self, Read};

/// Digest of the remaining bytes of `reader`.
///
/// # Errors
/// The error of the reader.
pub fn sha256_of_reader(reader: &mut impl Read) -> io::Result<String> {
    let mut hasher = Sha256::new();
    absorb(&mut hasher, reader)?;
    Ok(hex::encode(hasher.finalize()))
}

/// Digest of named byte streams: of the digest of each name and the digest of its content, in the order of the calls.
#[derive(Default)]
pub struct NamedDigest(Sha256);

impl NamedDigest {
    /// Adds one stream. Both parts have a fixed length, so that different lists of streams cannot produce the same bytes.
    ///
    /// # Errors
    /// The error of the reader.
    pub fn add(&mut self, name: &str, reader: &mut impl Read) -> io::Result<()> {
        let mut content = Sha256::new();
        absorb(&mut content, reader)?;
        self.0.update(Sha256::digest(name.as_bytes()));
        self.0.update(content.finalize());
        Ok(())
    }

    /// The digest of all streams added.
    pub fn finish(self) -> String {
        hex::encode(self.0.finalize())
    }
}

fn absorb(hasher: &mut Sha256, reader: &mut impl Read) -> io::Result<()> {
    let mut block = vec![0; 1 << 16];
    loop {
        match reader.read(&mut block) {
            Ok(0) => return Ok(()),
            Ok(n) => hasher.update(&block[..n]),
            Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
            Err(e) => return Err(e),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matches_the_fips_180_example() {
        let digest = sha256_of_reader(&mut &b"abc"[..]).unwrap();
        assert_eq!(digest, "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    }

    #[test]
    fn separates_names_from_contents() {
        let digest = |parts: &[(&str, &str)]| {
            let mut d = NamedDigest::default();
            for (name, content) in parts {
                d.add(name, &mut content.as_bytes()).unwrap();
            }
            d.finish()
        };
        assert_ne!(digest(&[("ab", "c")]), digest(&[("a", "bc")]));
    }
}
