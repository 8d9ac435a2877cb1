//! The peers of a component: queues they fill, views they have of it, and those it has lost.
//!
//! Invariant: the lists are changed by managers, one after the other, and looked at by steps without waiting.

use std::collections::BTreeMap;
use std::sync::Arc;

use parking_lot::{Mutex, MutexGuard};
use trocar_rt::cell::BindingCell;
use trocar_rt::os;

use super::super::inbox::Inbox;
use super::super::loss::Loss;
use super::views::Views;

/// The peers of one component, whose core is an `S`.
pub(super) struct Peers<S> {
    pub(super) inboxes: BindingCell<Vec<Arc<Inbox>>>,
    /// Lets managers change the list of inboxes one after the other.
    editing: Mutex<()>,
    pub(super) views: Views<S>,
    /// Required ports whose connection was lost or cut, and the time from which it counts as lost, ns.
    missing: Mutex<BTreeMap<String, u64>>,
}

impl<S: 'static> Peers<S> {
    pub(super) fn new(external: Arc<Inbox>) -> Peers<S> {
        Peers {
            inboxes: BindingCell::new(Box::new(vec![external])),
            editing: Mutex::new(()),
            views: Views::default(),
            missing: Mutex::new(BTreeMap::new()),
        }
    }

    /// Changes the list of queues; managers only.
    pub(super) fn edit_inboxes(&self, f: impl FnOnce(&mut Vec<Arc<Inbox>>)) {
        let _one = self.editing.lock();
        let mut inboxes = self.inboxes.enter().clone();
        f(&mut inboxes);
        self.inboxes.swap(Box::new(inboxes));
    }

    fn ports(&self) -> MutexGuard<'_, BTreeMap<String, u64>> {
        self.missing.lock()
    }

    /// Notes that a required port has a connection, again or for the first time.
    pub(super) fn connected(&self, port: &str) {
        self.ports().remove(port);
    }

    /// Notes that a required port lost its connection.
    pub(super) fn disconnected(&self, port: &str, how: Loss) {
        let lost_ns = os::now_ns().saturating_add(how.spared_ns());
        let mut ports = self.ports();
        let missing = ports.entry(port.to_owned()).or_insert(lost_ns);
        *missing = lost_ns.min(*missing);
    }

    /// Required ports that lost their connection, and the time from which each counts as lost, ns.
    pub(super) fn missing(&self) -> Vec<(String, u64)> {
        self.ports().iter().map(|(port, lost_ns)| (port.clone(), *lost_ns)).collect()
    }

    pub(super) fn reclaim(&self) -> usize {
        self.inboxes.reclaim() + self.views.reclaim()
    }
}
