//! Notes of a component's thread for the watchdog: the entry it is in and since when, its late cycles, its
//! misdeeds.
//!
//! Invariant: plain atomic words, written with one store each; nothing here waits, allocates or reads a
//! clock.

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};

use trocar_model::Health;

/// An entry of a component's class in which a thread may get stuck.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub(crate) enum Entry {
    Step = 1,
    Command,
    Event,
    Callback,
    Create,
    Configure,
    Start,
    Stop,
    Resume,
    MakeSafe,
    Destroy,
    Service,
    Describe,
    Bind,
}

impl Entry {
    const ALL: [Entry; 14] = [
        Entry::Step,
        Entry::Command,
        Entry::Event,
        Entry::Callback,
        Entry::Create,
        Entry::Configure,
        Entry::Start,
        Entry::Stop,
        Entry::Resume,
        Entry::MakeSafe,
        Entry::Destroy,
        Entry::Service,
        Entry::Describe,
        Entry::Bind,
    ];

    pub(crate) fn name(self) -> &'static str {
        match self {
            Entry::Step => "step",
            Entry::Command => "command",
            Entry::Event => "on_event",
            Entry::Callback => "callback",
            Entry::Create => "create",
            Entry::Configure => "configure",
            Entry::Start => "start",
            Entry::Stop => "stop",
            Entry::Resume => "resume",
            Entry::MakeSafe => "make_safe",
            Entry::Destroy => "destroy",
            Entry::Service => "on_service",
            Entry::Describe => "describe",
            Entry::Bind => "bind",
        }
    }

    /// True for entries of a running component; the others make, start and end it, and may take longer.
    pub(crate) fn runs(self) -> bool {
        matches!(self, Entry::Step | Entry::Command | Entry::Event | Entry::Callback | Entry::Service)
    }
}

/// A change of its thread or process that a component should not have made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub(crate) enum Misdeed {
    Rounding = 1,
    Signals = 2,
    Directory = 4,
    RoundingInCall = 8,
}

impl Misdeed {
    pub(super) const ALL: [Misdeed; 4] =
        [Misdeed::Rounding, Misdeed::Signals, Misdeed::Directory, Misdeed::RoundingInCall];

    /// Text of its warning.
    pub(super) fn says(self) -> &'static str {
        match self {
            Misdeed::Rounding => "step: it changed the rounding mode of its thread, which was put back",
            Misdeed::Signals => "step: it changed the signal mask of its thread, which was put back",
            Misdeed::Directory => "step: it changed the working directory of the process",
            Misdeed::RoundingInCall => {
                "a command or event handler: it changed the rounding mode of its thread, which was put back"
            }
        }
    }
}

const ENTRY_BITS: u64 = 4;

/// The words between one component and the watchdog.
#[derive(Default)]
pub(crate) struct Watch {
    /// Begin of the entry that runs now (ns, shifted up) and its kind; 0 between entries. A time of 0 is
    /// unknown.
    busy: AtomicU64,
    /// Entries begun, so that two looks at the same word can be told apart.
    entries: AtomicU64,
    /// Number of the command that runs, or ran last.
    command: AtomicU32,
    overruns: AtomicU64,
    stops: AtomicU64,
    misdeeds: AtomicU32,
    /// Misdeeds among them that were found under suspicion.
    found_out: AtomicU32,
    /// Own looks at its manners begun and ended: odd while one of its entries looks itself.
    minded: AtomicU64,
    /// True when it is one of several suspects: looked at after each of its steps.
    suspected: AtomicBool,
    /// Set when it was found stuck while it could move something: its own thread makes it safe when it
    /// returns.
    owes_safe: AtomicBool,
    health: AtomicU32,
}

/// One look at [`Watch::busy`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Busy {
    pub(crate) entry: Entry,
    /// 0 = unknown.
    pub(crate) since_ns: u64,
    /// The same in two looks while no entry ended in between.
    pub(crate) ticket: u64,
}

impl Watch {
    /// As [`Watch::begin`], for one of its commands.
    pub(crate) fn begin_command(&self, command: u32) -> u64 {
        self.command.store(command, Ordering::Relaxed);
        self.begin(Entry::Command, 0)
    }

    /// Number of the command that runs; when none runs, of the last one.
    pub(super) fn command(&self) -> u32 {
        self.command.load(Ordering::Relaxed)
    }

    /// Notes that `entry` begins; returns the former note, for [`Watch::leave`]. `since_ns` 0 = not known
    /// here.
    pub(crate) fn begin(&self, entry: Entry, since_ns: u64) -> u64 {
        let before = self.busy.load(Ordering::Relaxed);
        // An entry inside another counts from the outer one's begin, if that is known.
        let since = if since_ns == 0 { before >> ENTRY_BITS } else { since_ns };
        self.busy.store(since << ENTRY_BITS | entry as u64, Ordering::Relaxed);
        // Only the thread inside writes it.
        self.entries.store(self.entries.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
        before
    }

    pub(crate) fn leave(&self, before: u64) {
        self.busy.store(before, Ordering::Relaxed);
    }

    pub(crate) fn busy(&self) -> Option<Busy> {
        let ticket = self.entries.load(Ordering::Relaxed);
        let word = self.busy.load(Ordering::Relaxed);
        let entry = Entry::ALL.into_iter().find(|e| *e as u64 == word & ((1 << ENTRY_BITS) - 1))?;
        Some(Busy { entry, since_ns: word >> ENTRY_BITS, ticket })
    }

    /// Entries begun so far.
    pub(crate) fn entries(&self) -> u64 {
        self.entries.load(Ordering::Relaxed)
    }

    /// Counts a cycle that ended after the next was due; true when the watchdog should look now.
    pub(crate) fn overran(&self) -> bool {
        self.overruns.store(self.overruns.load(Ordering::Relaxed) + 1, Ordering::Relaxed);
        self.health() == Health::Ok
    }

    pub(crate) fn overruns(&self) -> u64 {
        self.overruns.load(Ordering::Relaxed)
    }

    /// Notes that the component was stopped.
    pub(crate) fn stopped(&self) {
        self.stops.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn stops(&self) -> u64 {
        self.stops.load(Ordering::Relaxed)
    }

    /// Notes a misdeed, any number of times.
    pub(crate) fn misdeed(&self, what: Misdeed) {
        self.misdeeds.fetch_or(what as u32, Ordering::Relaxed);
    }

    /// Notes that an entry begins, or has ended, to check the component's manners itself. Called before its
    /// first look and after its last.
    pub(super) fn mind(&self) {
        self.minded.fetch_add(1, Ordering::SeqCst);
    }

    /// Odd: a change found now belongs to the entry that looks. The same word in two looks: no such entry
    /// began or ended.
    pub(super) fn minded(&self) -> u64 {
        self.minded.load(Ordering::SeqCst)
    }

    /// Notes a misdeed that was found under suspicion.
    pub(super) fn find_out(&self, what: Misdeed) {
        self.found_out.fetch_or(what as u32, Ordering::Relaxed);
        self.misdeed(what);
    }

    /// True when it was found out since the last call.
    pub(super) fn takes_found_out(&self, what: Misdeed) -> bool {
        self.found_out.fetch_and(!(what as u32), Ordering::Relaxed) & what as u32 != 0
    }

    pub(super) fn suspect(&self, suspected: bool) {
        self.found_out.store(0, Ordering::Relaxed);
        self.suspected.store(suspected, Ordering::Relaxed);
    }

    pub(crate) fn is_suspected(&self) -> bool {
        self.suspected.load(Ordering::Relaxed)
    }

    /// Takes the misdeeds noted since the last look.
    pub(crate) fn take_misdeeds(&self) -> u32 {
        if self.misdeeds.load(Ordering::Relaxed) == 0 { 0 } else { self.misdeeds.swap(0, Ordering::Relaxed) }
    }

    /// Notes that its own thread has to make it safe; false when that was noted already.
    pub(crate) fn owe_safe(&self) -> bool {
        !self.owes_safe.swap(true, Ordering::AcqRel)
    }

    pub(crate) fn owes_safe(&self) -> bool {
        self.owes_safe.load(Ordering::Acquire)
    }

    /// True once after each [`Watch::owe_safe`]; a plain load while nothing is owed.
    pub(crate) fn takes_owed_safe(&self) -> bool {
        self.owes_safe.load(Ordering::Relaxed) && self.owes_safe.swap(false, Ordering::AcqRel)
    }

    /// The health as last reported.
    pub(crate) fn health(&self) -> Health {
        match self.health.load(Ordering::Relaxed) {
            0 => Health::Ok,
            1 => Health::Overrun,
            2 => Health::StaleInput,
            3 => Health::Unresponsive,
            _ => Health::Lost,
        }
    }

    /// Sets the health; returns the former one.
    pub(crate) fn set_health(&self, health: Health) -> Health {
        let before = self.health();
        let word = match health {
            Health::Ok => 0,
            Health::Overrun => 1,
            Health::StaleInput => 2,
            Health::Unresponsive => 3,
            Health::Lost => 4,
        };
        self.health.store(word, Ordering::Relaxed);
        before
    }
}

#[cfg(test)]
mod tests {
    use super::{Entry, Watch};

    #[test]
    fn an_entry_inside_another_names_itself_and_counts_from_the_outer_begin() {
        let watch = Watch::default();
        assert_eq!(watch.busy(), None);
        let outer = watch.begin(Entry::Step, 77);
        let inner = watch.begin(Entry::Command, 0);
        let seen = watch.busy();
        assert_eq!(seen.map(|b| (b.entry, b.since_ns)), Some((Entry::Command, 77)));
        watch.leave(inner);
        assert_eq!(watch.busy().map(|b| b.entry), Some(Entry::Step));
        watch.leave(outer);
        assert_eq!(watch.busy(), None);
    }

    #[test]
    fn two_looks_at_different_entries_of_one_kind_can_be_told_apart() {
        let watch = Watch::default();
        let before = watch.begin(Entry::Command, 0);
        let first = watch.busy();
        watch.leave(before);
        watch.begin(Entry::Command, 0);
        assert_ne!(first, watch.busy());
    }
}
