//! The frame pools of an output: the source of the frames of its loans.
//!
//! Invariant: a pool stays as long as a frame of it is out; one lends, the others only wait for their frames.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use parking_lot::Mutex;
use trocar_plugin_api::abi::Loan;
use trocar_rt::cell::BindingCell;
use trocar_rt::os::OsError;
use trocar_rt::pool::{FrameMut, FramePool, PoolFile};

use super::super::room;

/// The pools of one output.
pub(super) struct Pools {
    now: BindingCell<Present>,
    /// Lets pools be changed one after the other.
    changing: Mutex<()>,
    /// Number of the last pool that was locked or whose locking failed; 0 = none.
    locked: AtomicU64,
    /// Refused loans so far; counted here, as pools come and go.
    exhausted: AtomicU64,
}

/// The pools there are now.
#[derive(Clone, Default)]
struct Present {
    lends: Option<Arc<FramePool>>,
    /// Counts the pools before the one that lends.
    number: u64,
    /// Earlier pools, of which frames may still be out.
    earlier: Vec<Arc<FramePool>>,
}

impl Default for Pools {
    fn default() -> Self {
        Pools {
            now: BindingCell::new(Box::default()),
            changing: Mutex::new(()),
            locked: AtomicU64::new(0),
            exhausted: AtomicU64::new(0),
        }
    }
}

impl Pools {
    /// Makes another pool, or none, lend from now on. The one before stays at least until the next
    /// [`Pools::reclaim`].
    pub(super) fn change(&self, lends: Option<Arc<FramePool>>) {
        let _one = self.changing.lock();
        let Present { lends: before, number, mut earlier } = self.now.enter().clone();
        earlier.extend(before);
        self.now.swap(Box::new(Present { lends, number: number + 1, earlier }));
    }

    /// Lets go of all pools. Frames that are out keep theirs.
    pub(super) fn retire(&self) {
        let _one = self.changing.lock();
        self.now.swap(Box::default());
    }

    /// Drops earlier pools whose frames have all come back, and what cycles that have ended looked at;
    /// returns how much of that is left.
    pub(super) fn reclaim(&self) -> usize {
        let one = self.changing.lock();
        let mut pools = self.now.enter().clone();
        let all = pools.earlier.len();
        pools.earlier.retain(|p| p.stats().free < p.stats().slots);
        if pools.earlier.len() < all {
            self.now.swap(Box::new(pools));
        }
        drop(one);
        self.now.reclaim()
    }

    /// The memory of all pools.
    pub(super) fn files(&self) -> Vec<Arc<PoolFile>> {
        let pools = self.now.enter();
        pools.lends.iter().chain(&pools.earlier).filter_map(|pool| pool.file()).cloned().collect()
    }

    /// Locks the lending pool into memory, once; returns the reason of a failure. Managers only.
    pub(super) fn lock(&self) -> Option<OsError> {
        let Present { lends, number, .. } = self.now.enter().clone();
        let pool = lends?;
        if self.locked.swap(number, Ordering::Relaxed) == number {
            return None;
        }
        pool.lock_memory().err()
    }

    /// A free frame of the lending pool. Real-time.
    #[inline]
    pub(super) fn loan(&self) -> Option<FrameMut> {
        self.now.look(|pools| pools.lends.as_ref().and_then(|pool| pool.loan()))
    }

    /// Counts a loan that was refused.
    pub(super) fn refuse(&self) {
        self.exhausted.fetch_add(1, Ordering::Relaxed);
    }

    /// Loans that were refused, over all pools.
    pub(super) fn exhausted(&self) -> u64 {
        self.exhausted.load(Ordering::Relaxed)
    }

    /// The frame of a loan that comes back; `None` when it is no loan of this output, or came back already.
    pub(super) fn take_back(&self, loan: *mut Loan) -> Option<FrameMut> {
        // SAFETY: null, or lent for the call.
        if !unsafe { room::is_lent(loan) } {
            return None;
        }
        // SAFETY: lent for the call; the first Loans had a token.
        let token = std::mem::take(unsafe { &mut (*loan).token });
        self.now.look(|pools| {
            pools.lends.iter().chain(&pools.earlier).any(|p| p.is_descriptor(token)).then(|| {
                // SAFETY: the number of a slot of a pool that is alive here, which checks whether it is good.
                unsafe { FrameMut::from_raw(token) }
            })
        })?
    }

    /// Figures of the pool that lends now; `None` without a pool.
    #[cfg(test)]
    pub(super) fn stats(&self) -> Option<trocar_rt::PoolStats> {
        self.now.enter().lends.as_ref().map(|pool| pool.stats())
    }
}
