//! Hashes that chain records: sha-256 over a record as it is encoded.
//!
//! Invariant: a hash is made of the very bytes that are kept, never of a value that was decoded and encoded
//! again.

use std::fmt;

use sha2::{Digest, Sha256};

use super::fault::Bad;

/// Hash of encoded bytes. `Display` and `Debug` print it in hex.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Hash([u8; 32]);

impl Hash {
    pub(super) fn of(bytes: &[u8]) -> Hash {
        Hash(Sha256::digest(bytes).into())
    }

    pub(super) fn read(bytes: &[u8], what: &str) -> Result<Hash, Bad> {
        let hash = bytes.try_into().map(Hash);
        hash.map_err(|_| Bad::damaged(format!("{what} has {} bytes, not 32", bytes.len())))
    }

    pub(super) fn bytes(&self) -> &[u8; 32] {
        &self.0
    }
}

impl fmt::Display for Hash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for Hash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}
