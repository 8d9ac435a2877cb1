//! Greeting of two processes before they trust each other: who they are, and that both see the same page of
//! memory.
//!
//! ```text
//! dialler                          listener
//!   Hello{version, card} ──────────▶  user, version, layout fit?
//!            ◀──── Welcome{card} + page, a number written in it
//!   Echo{number}         ──────────▶  the same number?
//!            ◀────────────── Ready   (or Refused{why} in place of any answer)
//! ```
//!
//! Invariant: the length of everything that arrives is checked before its content is read, and no allocation
//! depends on what it says.

use serde::{Deserialize, Serialize};

use crate::card::Card;
use crate::plain::plain;

/// Version of this conversation.
pub(crate) const VERSION: u32 = 1;
/// First byte of everything said here, so that a stranger's bytes are no greeting.
const GREETING: u8 = b'g';
/// First byte of what is said later; the second one tells how many files come along.
const DATA: u8 = b'd';
pub(crate) const DATA_HEAD: usize = 2;

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum Greeting {
    Hello { version: u32, card: Card },
    Welcome { card: Card },
    Echo { nonce: [u64; 2] },
    Ready,
    Refused { why: String },
}

impl Greeting {
    pub(crate) fn name(&self) -> &'static str {
        match self {
            Greeting::Hello { .. } => "Hello",
            Greeting::Welcome { .. } => "Welcome",
            Greeting::Echo { .. } => "Echo",
            Greeting::Ready => "Ready",
            Greeting::Refused { .. } => "Refused",
        }
    }

    pub(crate) fn encode(&self) -> Vec<u8> {
        let mut bytes = vec![GREETING];
        bytes.extend(serde_json::to_vec(self).unwrap_or_default());
        bytes
    }
}

/// Something that arrived.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Said<'a> {
    Greeting(Greeting),
    Data { files: usize, bytes: &'a [u8] },
}

pub(crate) fn parse(bytes: &[u8]) -> Result<Said<'_>, String> {
    match bytes {
        [GREETING, rest @ ..] => {
            let greeting = serde_json::from_slice(rest)
                .map_err(|e| format!("no greeting of ours: {}", plain(&e.to_string())))?;
            Ok(Said::Greeting(greeting))
        }
        [DATA, files, bytes @ ..] => Ok(Said::Data { files: usize::from(*files), bytes }),
        _ => Err(format!("{} bytes that are nothing of ours", bytes.len())),
    }
}

pub(crate) fn data_head(files: usize) -> [u8; DATA_HEAD] {
    [DATA, u8::try_from(files).unwrap_or(u8::MAX)]
}
