//! Things that the host gave to a component that is gone, kept for a while: a handle that its code still
//! holds, in a static or a thread, is answered that nobody is connected instead of leading to memory of
//! others.
//!
//! Invariant: what is kept holds nothing of others: no connection, no frame, no sample.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use super::host_table::{HostContext, SharedTable};
use super::ports::Slots;

/// Ports that are kept, those of the system interface included: the oldest make room. See ADR 0026 for what
/// they cost.
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

/// Remains of the components that went last.
#[derive(Default)]
pub(in crate::lcm) struct AllRemains(Mutex<VecDeque<Remains>>);

impl AllRemains {
    /// Takes what its component leaves, and all that others own out of it. Not real-time.
    pub(in crate::lcm) fn take(
        &self,
        host: &Arc<HostContext>,
        table: Arc<SharedTable>,
        slots: Vec<Arc<Slots>>,
    ) {
        host.leave();
        slots.iter().for_each(|slots| slots.retire(host));
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
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
        // Outside the lock: that may take a while.
        drop(oldest);
    }
}
