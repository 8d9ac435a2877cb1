//! What two LCMs say to each other about a connection.
//!
//! ```text
//! client's LCM                     server's LCM
//!                      ◀──── Offered          its half stands: ask
//!   Open{hash, code}   ────▶
//!                      ◀──── Opened{epoch} + memory    or Declined{why}
//!   Close              ◀───▶                  either side, when its half goes
//! ```
//!
//! Invariant: whatever arrives is checked for its length and its form before it is used; numbers in it name things, they are no sizes.

use serde::{Deserialize, Serialize};
use trocar_rt::pool::PoolShape;

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum Words {
    /// The server's half stands.
    Offered { connection: u64 },
    /// The client's half stands, and sees the types of this hash; its process has this code of the server's class, if any.
    Open {
        connection: u64,
        hash: u64,
        #[serde(default)]
        code: Option<String>,
    },
    /// The memory for it; behind it, if so, that of the server's rows, then that of these pools.
    Opened {
        connection: u64,
        epoch: u64,
        #[serde(default)]
        rows: bool,
        pools: Vec<Pool>,
    },
    /// Not now (`later`: ask again when it is offered), or never as things are.
    Declined { connection: u64, why: String, later: bool },
    /// The link of this epoch went.
    Close { connection: u64, epoch: u64 },
    /// Memory of pools whose frames are to come, or have; by their places, one after another.
    Pools { connection: u64, epoch: u64, pools: Vec<Pool> },
    /// Of the commands that were only sent so many failed, and so many never ran, on this link.
    Toll { connection: u64, epoch: u64, failed: u64, unexecuted: u64 },
    /// Of the reads the client works out itself so many panicked on this link; what the last one said is behind.
    Panicked { connection: u64, epoch: u64, count: u64 },
    /// The result of a read is wanted within this time, ns; its argument is behind.
    Ask { connection: u64, epoch: u64, number: u64, index: u32, left_ns: u64 },
    /// It is behind, then the sentence.
    Told { connection: u64, epoch: u64, number: u64, outcome: i32, stamp_ns: u64, value_bytes: u32 },
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
    /// The words, and what is behind them.
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
            | Words::Toll { connection, .. }
            | Words::Panicked { connection, .. }
            | Words::Pools { connection, .. }
            | Words::Ask { connection, .. }
            | Words::Told { connection, .. } => *connection,
        }
    }
}
