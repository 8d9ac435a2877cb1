//! Finds out whether anything still holds what the host gave an instance: ports in a static, a host handle in
//! a thread.
//!
//! Invariant: the host frees slots after `bind` or `destroy`, and its table after `destroy`. Before either
//! returns, everything that an existing handle points to is kept (`trocar.keep/1`), so no handle ever points
//! to nothing.

use crate::host::Host;
use std::sync::Arc;

/// Held by each port that one `bind` tied.
#[derive(Clone)]
pub(crate) struct Lease(Arc<()>);

impl Lease {
    fn new() -> Lease {
        Lease(Arc::new(()))
    }

    /// Tells whether nothing else holds it, and nothing will.
    fn was_last(self) -> bool {
        Arc::into_inner(self.0).is_some()
    }
}

/// The means to tie a port.
pub struct Tie {
    pub(crate) host: Host,
    pub(crate) lease: Lease,
}

impl Tie {
    pub(crate) fn new(host: &Host) -> Tie {
        Tie { host: host.clone(), lease: Lease::new() }
    }

    /// Begins another `bind`: its ports are tied with the new value of `self`. The returned guard is dropped
    /// when `bind` is over, by a panic too; if some of the previous ports are left, it makes the host keep
    /// them.
    pub(crate) fn renew(&mut self) -> Settled {
        let before = core::mem::replace(&mut self.lease, Lease::new());
        Settled { before: Some(before), host: self.host.clone() }
    }

    /// Ends the instance, of which only this is left.
    pub(crate) fn end(self) {
        let Tie { host, lease } = self;
        let ports = lease.was_last();
        host.end(ports);
    }
}

/// The ports of the previous `bind`: a port that the new one leaves out may still exist somewhere.
pub(crate) struct Settled {
    before: Option<Lease>,
    host: Host,
}

impl Drop for Settled {
    fn drop(&mut self) {
        if self.before.take().is_some_and(|lease| !lease.was_last()) {
            self.host.keep();
        }
    }
}
