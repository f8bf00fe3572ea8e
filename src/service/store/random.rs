//! Random ids and secrets.

use super::error::StoreError;

/// Bytes of a secret.
pub(crate) const SECRET_BYTES: usize = 32;

/// Returns a new id: `<kind>_` and 122 random bits.
pub fn new_id(kind: &str) -> String {
    format!("{kind}_{}", uuid::Uuid::new_v4().simple())
}

/// Returns random bytes of the operating system.
pub(crate) fn random_bytes() -> Result<[u8; SECRET_BYTES], StoreError> {
    let mut bytes = [0; SECRET_BYTES];
    getrandom::fill(&mut bytes).map_err(|_| StoreError::NoRandomness)?;
    Ok(bytes)
}
