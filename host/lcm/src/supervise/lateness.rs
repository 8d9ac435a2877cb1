//! The watchdog's own lateness: a component is not blamed for it.

/// Longest time of a wake that does not count as lateness, ns: over the hundreds of looks in one patience it
/// must not add up to a pardon.
pub(super) const WAKING_NS: u64 = 250_000;

/// Time for which the watchdog was itself kept from looking, in total, ns.
#[derive(Clone, Copy, Default)]
pub(super) struct Lateness {
    pub(super) now_ns: u64,
    /// Total at the look before.
    pub(super) before_ns: u64,
}

impl Lateness {
    /// Adds one look, which was due at `due_ns`.
    pub(super) fn look(&mut self, due_ns: u64, now_ns: u64) {
        self.before_ns = self.now_ns;
        self.now_ns += now_ns.saturating_sub(due_ns + WAKING_NS);
    }

    /// The total at the begin of an entry that is seen for the first time now. A delay of the watchdog since
    /// then has delayed the entry, too: it was not there at the look before.
    pub(super) fn at(self, since_ns: u64, now_ns: u64) -> u64 {
        self.now_ns - (self.now_ns - self.before_ns).min(now_ns.saturating_sub(since_ns))
    }
}
