//! The page two processes share to see that the other one lives.
//!
//! Invariant: nothing is done with what the other one writes but to compare it.

use std::io;
use std::os::fd::{BorrowedFd, OwnedFd};
use std::sync::Arc;

use crate::region::{Layout, Region, Table};
use crate::sync::{AtomicU64, Ordering};

/// Words of the number that proves that both look at the same page.
pub const NONCE_WORDS: usize = 2;

/// Which of the two ends this process is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    Maker,
    Guest,
}

pub struct Pulse {
    region: Arc<Region>,
    beats: Table<AtomicU64>,
    nonce: Table<AtomicU64>,
    end: End,
}

impl std::fmt::Debug for Pulse {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Pulse")
            .field("end", &self.end)
            .field("theirs", &self.theirs())
            .finish_non_exhaustive()
    }
}

fn parts(layout: &mut Layout) -> (Table<AtomicU64>, Table<AtomicU64>) {
    (layout.table(2, |_| AtomicU64::new(0)), layout.table(NONCE_WORDS, |_| AtomicU64::new(0)))
}

impl Pulse {
    /// A page of its own.
    ///
    /// # Errors
    /// The machine gives no such memory.
    pub fn create(nonce: [u64; NONCE_WORDS]) -> io::Result<Pulse> {
        let region = Region::shared(Layout::measure(parts))?;
        let pulse = Self::of(&region, &mut Layout::fresh(&region), End::Maker);
        for (word, value) in pulse.nonce.iter().zip(nonce) {
            word.store(value, Ordering::Relaxed);
        }
        Ok(pulse)
    }

    /// The page the other process made.
    ///
    /// # Errors
    /// What was handed over is no such page.
    pub fn open(fd: OwnedFd) -> io::Result<Pulse> {
        let region = Region::open(fd, Layout::measure(parts))?;
        Ok(Self::of(&region, &mut Layout::of_other_end(&region), End::Guest))
    }

    fn of(region: &Arc<Region>, layout: &mut Layout, end: End) -> Pulse {
        let (beats, nonce) = parts(layout);
        Pulse { region: Arc::clone(region), beats, nonce, end }
    }

    /// What the other process is given.
    pub fn fd(&self) -> Option<BorrowedFd<'_>> {
        self.region.fd()
    }

    /// The number written there.
    pub fn nonce(&self) -> [u64; NONCE_WORDS] {
        std::array::from_fn(|i| self.nonce[i].load(Ordering::Relaxed))
    }

    /// This process was alive at `now_ns`.
    pub fn beat(&self, now_ns: u64) {
        self.beats[self.end as usize].store(now_ns, Ordering::Relaxed);
    }

    /// What the other process wrote at its last beat.
    pub fn theirs(&self) -> u64 {
        self.beats[1 - self.end as usize].load(Ordering::Relaxed)
    }
}
