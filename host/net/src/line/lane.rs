//! The two ways of a line, and how each is served.

use std::time::Duration;

use super::wire::Rank;

/// Bytes of long samples that may wait in the kernel.
const MOST_UNSENT: u64 = 256 << 10;

/// One of the two ways of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lane {
    /// Short messages that are awaited: words, commands, answers, events, small samples.
    Prompt,
    /// Large samples. They hold up each other, and nothing else.
    Bulk,
}

impl Lane {
    /// Distance of two beats, ns.
    pub(super) fn beat_ns(self) -> u64 {
        match self {
            Lane::Prompt => 10_000_000,
            Lane::Bulk => 100_000_000,
        }
    }

    /// Silence after which the line is lost, ns. Long samples go last: on a full link they may come to a
    /// halt, and that the other end lives is known by the prompt lane.
    pub(super) fn silent_ns(self) -> u64 {
        match self {
            Lane::Prompt => 100_000_000,
            Lane::Bulk => 5_000_000_000,
        }
    }

    /// Time in which the other end takes hardly a byte, after which the line is lost.
    pub(super) fn stalled(self) -> Duration {
        match self {
            Lane::Prompt => Duration::from_secs(1),
            Lane::Bulk => Duration::from_secs(5),
        }
    }

    /// Rank by RFC 4594: the prompt lane as telephony (expedited forwarding), the bulk lane as anything.
    pub(super) fn rank(self, most_rate: Option<u64>) -> Rank {
        match self {
            Lane::Prompt => Rank { priority: 6, class: 46 << 2, most_unsent: 128 << 10, most_rate: None },
            Lane::Bulk => {
                // A quarter of a second's worth: a slow lane goes on in small steps.
                let most_unsent = most_rate.map_or(MOST_UNSENT, |rate| (rate / 4).min(MOST_UNSENT));
                Rank { priority: 2, class: 0, most_unsent: most_unsent as u32, most_rate }
            }
        }
    }

    /// Names of the thread that receives, and of the one that sends.
    pub(super) fn threads(self) -> [&'static str; 2] {
        match self {
            Lane::Prompt => ["trocar-line", "trocar-line-out"],
            Lane::Bulk => ["trocar-bulk", "trocar-bulk-out"],
        }
    }
}
