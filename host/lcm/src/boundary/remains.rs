//! Handles that the host gave to a component that is gone, kept for a while: if its code still uses one, in a
//! static or a thread, the answer is that nobody is connected, and the handle does not lead to memory of
//! others.
//!
//! Invariant: the kept objects hold nothing of others: no connection, no frame, no sample.

use std::collections::VecDeque;
use std::sync::{Arc, Weak};

use parking_lot::Mutex;

use super::host_table::{HostContext, SharedTable};
use super::ports::Slots;

/// Most ports that are kept, those of the system interface included: the oldest make room. See ADR 0026 for
/// their cost.
const MOST_PORTS: usize = 16_384;

/// The host table and the ports of one component.
struct Remains {
    _table: Arc<SharedTable>,
    slots: Vec<Arc<Slots>>,
}

impl Remains {
    fn ports(&self) -> usize {
        self.slots.iter().map(|slots| slots.count()).sum()
    }
}

/// Remains of the last components that were removed.
#[derive(Default)]
pub(crate) struct AllRemains {
    kept: Mutex<VecDeque<Remains>>,
    /// Kept ports that still hold objects of others: a cycle was under way that may look at them.
    in_use: Mutex<Vec<Weak<Slots>>>,
}

impl AllRemains {
    /// Takes the remains of a component, and removes from them all that belongs to others; true when a cycle
    /// may still look at some of that, so that [`AllRemains::reclaim`] must be called. Not real-time.
    pub(crate) fn take(
        &self,
        host: &Arc<HostContext>,
        table: Arc<SharedTable>,
        slots: Vec<Arc<Slots>>,
    ) -> bool {
        host.leave();
        slots.iter().for_each(|slots| slots.retire(host));
        let in_use: Vec<_> = slots.iter().filter(|slots| slots.reclaim() > 0).map(Arc::downgrade).collect();
        let again = !in_use.is_empty();
        self.in_use.lock().extend(in_use);
        let mut all = self.kept.lock();
        all.push_back(Remains { _table: table, slots });
        let mut ports: usize = all.iter().map(Remains::ports).sum();
        let mut oldest = Vec::new();
        while ports > MOST_PORTS
            && let Some(remains) = all.pop_front()
        {
            ports -= remains.ports();
            oldest.push(remains);
        }
        drop(all);
        // Outside the lock: this may take a while.
        drop(oldest);
        again
    }

    /// Drops objects that cycles still looked at when their component was removed, and no longer do; returns
    /// how many sets of ports are left. Managers only.
    pub(crate) fn reclaim(&self) -> usize {
        let list = || self.in_use.lock();
        let before = list().clone();
        // Outside the lock: dropping links and cores takes time.
        let is_done = |slots: &Weak<Slots>| slots.upgrade().is_none_or(|slots| slots.reclaim() == 0);
        let done: Vec<_> = before.into_iter().filter(is_done).collect();
        let mut in_use = list();
        // They stay in the list meanwhile, so that a call beside this one counts them, too.
        in_use.retain(|slots| !done.iter().any(|d| Weak::ptr_eq(d, slots)));
        in_use.len()
    }
}
