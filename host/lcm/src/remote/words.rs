//! Messages between two LCMs about a connection.
//!
//! ```text
//! client's LCM                     server's LCM
//!                      ◀──── Offered          its half stands: ask
//!   Open{hash, code}   ────▶
//!                      ◀──── Opened{epoch} + memory    or Declined{why}
//!   Close              ◀───▶                  either side, when its half goes
//! ```
//!
//! Invariant: every message is checked for its length and its form before it is used; numbers in it name
//! things, they are no sizes.

use serde::{Deserialize, Serialize};
use trocar_rt::pool::PoolShape;

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum Words {
    /// The server's half is ready.
    Offered { connection: u64 },
    /// The client's half is ready, and sees the types of this hash; its process has this code of the server's
    /// class, if any.
    Open {
        connection: u64,
        hash: u64,
        #[serde(default)]
        code: Option<String>,
        /// The last link, where its ends shared no memory.
        #[serde(default)]
        before: Option<Ended>,
    },
    /// The memory for the link; after it that of the server's rows, if `rows`, then that of these pools.
    Opened {
        connection: u64,
        epoch: u64,
        #[serde(default)]
        rows: bool,
        pools: Vec<Pool>,
    },
    /// Refused for now (`later`: ask again when it is offered), or for good as things are.
    Declined { connection: u64, why: String, later: bool },
    /// The link of this epoch is gone.
    Close { connection: u64, epoch: u64 },
    /// Memory of pools whose frames will come, or have come; by their places, one after another.
    Pools { connection: u64, epoch: u64, pools: Vec<Pool> },
    /// Commands on this link that were only sent: how many failed, and how many never ran.
    /// Its name on the wire is older.
    #[serde(rename = "Toll")]
    Failures { connection: u64, epoch: u64, failed: u64, unexecuted: u64 },
    /// Number of reads computed by the client that panicked on this link; the sentence of the last one
    /// follows.
    Panicked { connection: u64, epoch: u64, count: u64 },
    /// The caller wants the result of a read within this time, ns; its argument follows.
    Ask { connection: u64, epoch: u64, number: u64, index: u32, left_ns: u64 },
    /// Result of a read; the value follows, then the sentence.
    Told { connection: u64, epoch: u64, number: u64, outcome: i32, stamp_ns: u64, value_bytes: u32 },
}

/// A link that has ended: samples that left the server's end, or came to the client's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Ended {
    pub(super) epoch: u64,
    pub(super) samples: u64,
}

/// A pool, by its place on the link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Pool {
    pub(super) place: usize,
    pub(super) slots: u32,
    pub(super) header_bytes: usize,
    pub(super) max_bytes: usize,
}

impl Pool {
    pub(super) fn new(place: usize, shape: PoolShape) -> Pool {
        Pool { place, slots: shape.slots, header_bytes: shape.header_bytes, max_bytes: shape.max_bytes }
    }

    pub(super) fn shape(self) -> PoolShape {
        PoolShape { slots: self.slots, header_bytes: self.header_bytes, max_bytes: self.max_bytes }
    }
}

/// Bytes of the length in front.
const LENGTH: usize = 4;

impl Words {
    /// Encodes the words, and appends the bytes `behind` them.
    pub(super) fn encode(&self, behind: &[u8]) -> Vec<u8> {
        let words = serde_json::to_vec(self).unwrap_or_default();
        let mut bytes = u32::try_from(words.len()).unwrap_or(u32::MAX).to_le_bytes().to_vec();
        bytes.extend_from_slice(&words);
        bytes.extend_from_slice(behind);
        bytes
    }

    pub(super) fn decode(bytes: &[u8]) -> Result<(Words, &[u8]), String> {
        let (length, rest) = bytes.split_first_chunk::<LENGTH>().ok_or("nothing of ours")?;
        let length = u32::from_le_bytes(*length) as usize;
        let (words, behind) = rest.split_at_checked(length).ok_or("its length is another than it says")?;
        let words = serde_json::from_slice(words).map_err(|e| format!("no words of ours: {e}"))?;
        Ok((words, behind))
    }

    pub(super) fn connection(&self) -> u64 {
        match self {
            Words::Offered { connection }
            | Words::Open { connection, .. }
            | Words::Opened { connection, .. }
            | Words::Declined { connection, .. }
            | Words::Close { connection, .. }
            | Words::Failures { connection, .. }
            | Words::Panicked { connection, .. }
            | Words::Pools { connection, .. }
            | Words::Ask { connection, .. }
            | Words::Told { connection, .. } => *connection,
        }
    }
}
