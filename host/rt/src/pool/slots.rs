//! Free slots, the counts on the others, and the generation of each.
//!
//! A slot is free exactly while its bit is set; its count and generation are touched only by holders of a
//! loan. Taking and giving back are wait-free: a look at each bit at most, and no word that could return to
//! an old value.

use crate::sync::{AtomicU32, AtomicU64, Ordering};

/// Counters of a pool, in slots and refused loans.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PoolStats {
    pub slots: u32,
    /// Slots that can be lent now.
    pub free: u32,
    /// The most slots that were ever lent at once.
    pub high_water: u32,
    /// Loans refused because every slot was lent.
    pub exhausted: u64,
}

pub(super) struct Slots {
    free: Box<[AtomicU64]>,
    entries: Box<[Entry]>,
    lent: AtomicU32,
    high_water: AtomicU32,
    exhausted: AtomicU64,
}

/// Own cache line: counts of neighbouring frames are touched by different threads.
#[repr(align(64))]
struct Entry {
    count: AtomicU32,
    /// Odd exactly while the one handle for writing is out as a number. +1 when it goes out and when it comes
    /// back, +2 when numbers of frames become stale otherwise: made unique, given back.
    generation: AtomicU32,
    /// Bytes in use after the header, set when frozen.
    len: AtomicU64,
    /// Address of the pool, set when lent: it leads a descriptor back.
    owner: AtomicU64,
}

impl Slots {
    pub(super) fn new(slots: u32) -> Self {
        let word = |at: u32| AtomicU64::new(u64::MAX >> (64 - (slots - at * 64).min(64)));
        Self {
            free: (0..slots.div_ceil(64)).map(word).collect(),
            entries: (0..slots)
                .map(|_| Entry {
                    count: AtomicU32::new(0),
                    generation: AtomicU32::new(0),
                    len: AtomicU64::new(0),
                    owner: AtomicU64::new(0),
                })
                .collect(),
            lent: AtomicU32::new(0),
            high_water: AtomicU32::new(0),
            exhausted: AtomicU64::new(0),
        }
    }

    /// Takes a free slot with a count of one.
    pub(super) fn take(&self) -> Option<u32> {
        let Some(slot) = self.free.iter().zip(0..).find_map(|(word, at)| Self::take_bit(word, at)) else {
            self.exhausted.fetch_add(1, Ordering::Relaxed);
            return None;
        };
        self.entry(slot).count.store(1, Ordering::Relaxed);
        let lent = self.lent.fetch_add(1, Ordering::Relaxed) + 1;
        if lent > self.high_water.load(Ordering::Relaxed) {
            self.high_water.fetch_max(lent.min(self.entries.len() as u32), Ordering::Relaxed);
        }
        Some(slot)
    }

    /// Takes this very slot with a count of one; false when it is held, or does not exist.
    pub(super) fn claim(&self, slot: u32) -> bool {
        let Some(entry) = self.entries.get(slot as usize) else { return false };
        let claimed = entry.count.compare_exchange(0, 1, Ordering::Acquire, Ordering::Relaxed).is_ok();
        if claimed {
            self.lent.fetch_add(1, Ordering::Relaxed);
        }
        claimed
    }

    fn take_bit(word: &AtomicU64, at: u32) -> Option<u32> {
        let mut seen = word.load(Ordering::Relaxed);
        // Each turn drops a bit from `seen`, won or lost, so there are at most 64.
        while seen != 0 {
            let bit = seen & seen.wrapping_neg();
            if word.fetch_and(!bit, Ordering::Acquire) & bit != 0 {
                return Some(at * 64 + bit.trailing_zeros());
            }
            seen &= !bit;
        }
        None
    }

    /// Returns the number of slots lent now.
    pub(super) fn lent(&self) -> u32 {
        self.lent.load(Ordering::Relaxed)
    }

    /// Tells whether at least `n` slots could be taken now: by their bits, as a taker sees them, not by the
    /// counter.
    pub(super) fn has_free(&self, n: u64) -> bool {
        let mut free = 0;
        self.free.iter().any(|word| {
            free += u64::from(word.load(Ordering::Relaxed).count_ones());
            free >= n
        })
    }

    pub(super) fn share(&self, slot: u32) {
        self.entry(slot).count.fetch_add(1, Ordering::Relaxed);
    }

    /// Gives one count back; with the last one the slot becomes free. Returns whether that was so.
    pub(super) fn give_back(&self, slot: u32) -> bool {
        let before = self.entry(slot).count.fetch_sub(1, Ordering::AcqRel);
        if before != 1 {
            return false;
        }
        self.make_stale(slot);
        self.lent.fetch_sub(1, Ordering::Relaxed);
        self.free[slot as usize / 64].fetch_or(1 << (slot % 64), Ordering::Release);
        true
    }

    /// Tells whether the caller's count is the only one; then everything former holders did has happened
    /// before.
    pub(super) fn is_unique(&self, slot: u32) -> bool {
        self.entry(slot).count.load(Ordering::Acquire) == 1
    }

    pub(super) fn set_owner<T>(&self, slot: u32, pool: *const T) {
        self.entry(slot).owner.store(pool.expose_provenance() as u64, Ordering::Release);
    }

    /// Returns what a holder hands out for its count: address of the entry (48 bits, the low 6 of them 0)
    /// under the low 16 bits of the generation. Never 0.
    pub(super) fn descriptor(&self, slot: u32) -> u64 {
        let entry = self.entry(slot);
        let address = std::ptr::from_ref(entry).expose_provenance() as u64;
        u64::from(entry.generation.load(Ordering::Acquire)) << 48 | address
    }

    /// The pool's address and the entry's, when the descriptor's generation is still the entry's.
    ///
    /// # Safety
    /// 0, or a number with the address of an entry of a pool that is still alive.
    pub(super) unsafe fn resolve<T>(descriptor: u64) -> Option<(*const T, *const ())> {
        let address = (descriptor << 16 >> 16) as usize;
        if address == 0 {
            return None;
        }
        let entry = std::ptr::with_exposed_provenance::<Entry>(address);
        // SAFETY: the caller vouches that this is the address of an entry of a pool that is alive.
        let Entry { generation, owner, .. } = unsafe { &*entry };
        if generation.load(Ordering::Acquire) & 0xffff != (descriptor >> 48) as u32 {
            return None;
        }
        let pool = std::ptr::with_exposed_provenance(owner.load(Ordering::Acquire) as usize);
        Some((pool, entry.cast()))
    }

    /// Tells whether the descriptor's address is that of one of these entries; its lowest bit does not count.
    pub(super) fn has_entry(&self, descriptor: u64) -> bool {
        let address = (descriptor << 16 >> 16 & !1) as usize;
        let offset = address.wrapping_sub(self.entries.as_ptr().addr());
        offset < size_of_val(&*self.entries) && offset.is_multiple_of(size_of::<Entry>())
    }

    /// The slot whose entry lies at this address, as `resolve` gave it.
    pub(super) fn slot_at(&self, entry: *const ()) -> u32 {
        ((entry.addr() - self.entries.as_ptr().addr()) / size_of::<Entry>()) as u32
    }

    /// For the only holder: makes every descriptor given out before stale.
    pub(super) fn make_stale(&self, slot: u32) {
        self.entry(slot).generation.fetch_add(2, Ordering::Release);
    }

    /// For the only holder, which gives up its handle for the descriptor that follows.
    pub(super) fn go_out(&self, slot: u32) {
        self.entry(slot).generation.fetch_add(1, Ordering::Release);
    }

    /// Makes the bearer of this descriptor the only holder again; true for one of all that bear it. However
    /// old it is, it fits only a slot whose only holder is out, since only those have odd generations.
    pub(super) fn come_back(&self, slot: u32, descriptor: u64) -> bool {
        let generation = &self.entry(slot).generation;
        let now = generation.load(Ordering::Relaxed);
        u64::from(now & 0xffff) == descriptor >> 48
            && now % 2 == 1
            && generation
                .compare_exchange(now, now.wrapping_add(1), Ordering::Acquire, Ordering::Relaxed)
                .is_ok()
    }

    pub(super) fn len(&self, slot: u32) -> usize {
        self.entry(slot).len.load(Ordering::Relaxed) as usize
    }

    pub(super) fn set_len(&self, slot: u32, len: usize) {
        self.entry(slot).len.store(len as u64, Ordering::Relaxed);
    }

    pub(super) fn stats(&self) -> PoolStats {
        let slots = self.entries.len() as u32;
        PoolStats {
            slots,
            free: slots.saturating_sub(self.lent.load(Ordering::Relaxed)),
            high_water: self.high_water.load(Ordering::Relaxed),
            exhausted: self.exhausted.load(Ordering::Relaxed),
        }
    }

    fn entry(&self, slot: u32) -> &Entry {
        &self.entries[slot as usize]
    }
}
