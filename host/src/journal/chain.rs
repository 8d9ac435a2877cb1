//! Hashes that chain records: sha-256 over a record as it is encoded.
//!
//! Invariant: a hash is made of the very bytes that are kept, never of a value that was decoded and encoded
//! again.

pub use trocar_loader::Hash;

use super::fault::Bad;

/// Reads a hash that was kept; `what`: its name in the error.
pub(super) fn read(bytes: &[u8], what: &str) -> Result<Hash, Bad> {
    let hash = bytes.try_into().map(Hash::from_bytes);
    hash.map_err(|_| Bad::damaged(format!("{what} has {} bytes, not 32", bytes.len())))
}
