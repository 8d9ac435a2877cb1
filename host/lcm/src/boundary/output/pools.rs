//! The frame pools of an output: the source of the frames of its loans.
//!
//! Invariant: a pool stays as long as a frame of it is out; one lends, the others only wait for their frames.

use std::io;
use std::sync::atomic::Ordering;
use std::sync::{Arc, PoisonError};

use trocar_plugin_api::abi::Loan;
use trocar_rt::os::OsError;
use trocar_rt::pool::{FrameMut, FramePool, PoolFile};

use super::super::inside::running;
use super::super::room;
use super::OutCell;

/// The pools of one output.
#[derive(Clone, Default)]
pub(super) struct Pools {
    pub(super) lends: Option<Arc<FramePool>>,
    /// Counts the pools before the one that lends.
    number: u64,
    /// Earlier pools, of which frames may still be out.
    pub(super) earlier: Vec<Arc<FramePool>>,
}

impl OutCell {
    /// (Re)makes the pool; not from `step`.
    ///
    /// # Errors
    /// There is no memory for it.
    pub(in crate::boundary) fn make_pool(&self, max_bytes: usize, slots: u32) -> io::Result<()> {
        let pool = FramePool::new(slots, self.shape().bytes, max_bytes)?;
        self.change_pool(Some(pool));
        Ok(())
    }

    /// Warns the component whose code runs here, and whose output this is, that it got no pool.
    pub(super) fn tell_refused(&self, asked: &str) {
        let told = running(|instance| {
            let set = instance.described.now();
            let name = set.slots.output_of(self).map_or("an output", |i| set.ports.outputs[i].name.as_str());
            instance.warn(&format!("{name}: {asked}"));
        });
        if told.is_none() {
            log::error!("{asked}");
        }
    }

    /// Makes another pool, or none, lend from now on. The one before stays at least until the next
    /// [`OutCell::reclaim`].
    pub(super) fn change_pool(&self, lends: Option<Arc<FramePool>>) {
        let _one = self.pooling.lock().unwrap_or_else(PoisonError::into_inner);
        let Pools { lends: before, number, mut earlier } = self.pools.enter().clone();
        earlier.extend(before);
        self.pools.swap(Box::new(Pools { lends, number: number + 1, earlier }));
    }

    /// The memory of all its pools, for readers in another process.
    pub(crate) fn pool_files(&self) -> Vec<Arc<PoolFile>> {
        let pools = self.pools.enter();
        pools.lends.iter().chain(&pools.earlier).filter_map(|pool| pool.file()).cloned().collect()
    }

    /// Drops earlier pools whose frames have all come back.
    pub(super) fn drop_pools(&self) {
        let _one = self.pooling.lock().unwrap_or_else(PoisonError::into_inner);
        let mut pools = self.pools.enter().clone();
        let all = pools.earlier.len();
        pools.earlier.retain(|p| p.stats().free < p.stats().slots);
        if pools.earlier.len() < all {
            self.pools.swap(Box::new(pools));
        }
    }

    /// Locks the lending pool into memory, once; returns the reason of a failure. Managers only.
    pub(in crate::boundary) fn lock_pool(&self) -> Option<OsError> {
        let Pools { lends, number, .. } = self.pools.enter().clone();
        let pool = lends?;
        if self.locked.swap(number, Ordering::Relaxed) == number {
            return None;
        }
        pool.lock_memory().err()
    }

    /// The frame of a loan that comes back; `None` when it is no loan of this output, or came back already.
    pub(super) fn take_back(&self, loan: *mut Loan) -> Option<FrameMut> {
        // SAFETY: null, or lent for the call.
        if !unsafe { room::is_lent(loan) } {
            return None;
        }
        // SAFETY: lent for the call; the first Loans had a token.
        let token = std::mem::take(unsafe { &mut (*loan).token });
        self.pools.look(|pools| {
            pools.lends.iter().chain(&pools.earlier).any(|p| p.is_descriptor(token)).then(|| {
                // SAFETY: the number of a slot of a pool that is alive here, which checks whether it is good.
                unsafe { FrameMut::from_raw(token) }
            })
        })?
    }

    /// Figures of the pool that lends now; `None` without a pool.
    #[cfg(test)]
    pub(crate) fn pool(&self) -> Option<trocar_rt::PoolStats> {
        self.pools.enter().lends.as_ref().map(|pool| pool.stats())
    }

    /// Loans that were refused, over all pools.
    pub(crate) fn exhausted(&self) -> u64 {
        self.exhausted.load(Ordering::Relaxed)
    }
}
