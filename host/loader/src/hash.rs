//! The sha256 of bytes. That of a file, or of a plugin with the libraries it brings, is the identity of
//! what is loaded.
//!
//! Invariant: trust, cache, vetting verdicts and loaded libraries are keyed by this and by nothing a file can
//! claim.

use std::fmt;

use sha2::{Digest, Sha256};

/// 32 bytes, shown as 64 lower-case hex digits.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Hash([u8; 32]);

impl Hash {
    pub fn of(bytes: &[u8]) -> Hash {
        let mut out = [0; 32];
        out.copy_from_slice(&Sha256::digest(bytes));
        Hash(out)
    }

    /// A hash that was kept as its bytes.
    pub fn from_bytes(bytes: [u8; 32]) -> Hash {
        Hash(bytes)
    }

    pub fn bytes(&self) -> &[u8; 32] {
        &self.0
    }

    /// The hash of a plugin with the libraries it brings, in any order: another one when any of them is
    /// another. Without libraries it is that of the file.
    pub fn with(self, brought: &[(&str, Hash)]) -> Hash {
        if brought.is_empty() {
            return self;
        }
        let mut brought = brought.to_vec();
        brought.sort_unstable();
        let line = |(name, hash): &(&str, Hash)| format!("{hash} {} {name}\n", name.len());
        let libraries: String = brought.iter().map(line).collect();
        Hash::of(format!("{self}\n{libraries}").as_bytes())
    }

    /// Parses 64 hex digits of either case.
    pub fn parse(text: &str) -> Option<Hash> {
        let digits = text.as_bytes();
        if digits.len() != 64 {
            return None;
        }
        let mut out = [0; 32];
        for (byte, pair) in out.iter_mut().zip(digits.chunks_exact(2)) {
            let value = |d: u8| char::from(d).to_digit(16);
            *byte = (value(pair[0])? << 4 | value(pair[1])?) as u8;
        }
        Some(Hash(out))
    }

    /// The first 12 hex digits, for people.
    pub fn short(&self) -> String {
        let mut text = self.to_string();
        text.truncate(12);
        text
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
