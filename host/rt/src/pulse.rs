//! The page two processes share to see that the other one lives.
//!
//! Invariant: a number of the other process is only compared.

use std::io;
use std::os::fd::{BorrowedFd, OwnedFd};
use std::sync::Arc;

use crate::region::{Layout, Region, Table};
use crate::sync::{AtomicU32, AtomicU64, Ordering, Padded};

/// Words of the number that proves that both look at the same page.
pub const NONCE_WORDS: usize = 2;

/// Flag of a word of life: the kernel is to wake the threads that sleep on it.
pub(crate) const OWNED: u32 = libc::FUTEX_WAITERS;

/// Meaning of the other process's word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Life {
    /// The word tells nothing: the process has written none, or took it back, or wrote nonsense.
    Untold,
    /// The process lived when it wrote this, and the kernel changes the word when it does not any more.
    Lives(u32),
    /// The kernel has marked the word, or the other process, which can write there, too.
    Died,
}

/// End of the page this process has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    Maker,
    Guest,
}

pub struct Pulse {
    region: Arc<Region>,
    /// The beats of both, then the number.
    words: Table<AtomicU64>,
    lives: Table<Padded<AtomicU32>>,
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

/// Words before those of the number.
const BEATS: usize = 2;

fn parts(layout: &mut Layout) -> (Table<AtomicU64>, Table<Padded<AtomicU32>>) {
    let words = layout.table(BEATS + NONCE_WORDS, |_| AtomicU64::new(0));
    (words, layout.table(2, |_| Padded(AtomicU32::new(0))))
}

impl Pulse {
    /// Makes a page of its own.
    ///
    /// # Errors
    /// The machine gives no such memory.
    pub fn create(nonce: [u64; NONCE_WORDS]) -> io::Result<Pulse> {
        let region = Region::shared(Layout::measure(parts))?;
        let pulse = Self::of(&region, &mut Layout::fresh(&region), End::Maker);
        for (word, value) in pulse.words[BEATS..].iter().zip(nonce) {
            word.store(value, Ordering::Relaxed);
        }
        Ok(pulse)
    }

    /// Opens the page the other process made.
    ///
    /// # Errors
    /// The file is no such page.
    pub fn open(fd: OwnedFd) -> io::Result<Pulse> {
        let region = Region::open(fd, Layout::measure(parts))?;
        Ok(Self::of(&region, &mut Layout::of_other_end(&region), End::Guest))
    }

    fn of(region: &Arc<Region>, layout: &mut Layout, end: End) -> Pulse {
        let (words, lives) = parts(layout);
        Pulse { region: Arc::clone(region), words, lives, end }
    }

    /// Returns the descriptor for the other process.
    pub fn fd(&self) -> Option<BorrowedFd<'_>> {
        self.region.fd()
    }

    /// The number written there.
    pub fn nonce(&self) -> [u64; NONCE_WORDS] {
        std::array::from_fn(|i| self.words[BEATS + i].load(Ordering::Relaxed))
    }

    /// Tells that this process was alive at `now_ns`.
    pub fn beat(&self, now_ns: u64) {
        self.words[self.end as usize].store(now_ns, Ordering::Relaxed);
    }

    /// Returns the number the other process wrote at its last beat.
    pub fn theirs(&self) -> u64 {
        self.words[1 - self.end as usize].load(Ordering::Relaxed)
    }

    /// Returns the meaning of the other process's word.
    pub fn life(&self) -> Life {
        match self.lives[1 - self.end as usize].0.load(Ordering::Acquire) {
            word if word & libc::FUTEX_OWNER_DIED != 0 => Life::Died,
            word if word & OWNED != 0 && word & libc::FUTEX_TID_MASK != 0 => Life::Lives(word),
            _ => Life::Untold,
        }
    }

    /// Returns that word, to sleep on.
    #[cfg(not(loom))]
    pub fn life_word(&self) -> &AtomicU32 {
        &self.lives[1 - self.end as usize].0
    }

    /// Returns the place of this process's word: its file, and its offset there, B.
    #[cfg(not(loom))]
    pub(crate) fn own_life(&self) -> Option<(&Arc<Region>, BorrowedFd<'_>, usize)> {
        let at = (&raw const self.lives[self.end as usize]).addr();
        Some((&self.region, self.region.fd()?, at - self.region.at(0).addr()))
    }

    #[cfg(not(loom))]
    pub(crate) fn is_in(&self, region: &Arc<Region>) -> bool {
        Arc::ptr_eq(&self.region, region)
    }
}
