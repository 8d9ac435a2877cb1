//! What a component's thread leaves for the watchdog: where it is since when, how often it was late, what it did wrong.
//!
//! Invariant: plain atomic words, written with one store each; nothing here waits, allocates or reads a clock.

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};

use trocar_model::Health;

/// An entry of a component's class, as far as somebody may get stuck in it.
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

    /// Belongs to the running component; the others make, start and end it, and may take longer.
    pub(crate) fn runs(self) -> bool {
        matches!(self, Entry::Step | Entry::Command | Entry::Event | Entry::Callback | Entry::Service)
    }
}

/// Something a component did to its thread or process that it should not have.
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

    /// What is said of it.
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
    /// When the entry that runs now began (ns, shifted up) and which it is; 0 between entries. A time of 0 is unknown.
    busy: AtomicU64,
    /// Entries begun, so that two looks at the same word can be told apart.
    entries: AtomicU64,
    /// Number of the command that runs, or ran last.
    command: AtomicU32,
    overruns: AtomicU64,
    stops: AtomicU64,
    misdeeds: AtomicU32,
    /// Those among them that were found while it was suspected.
    found_out: AtomicU32,
    /// Looks at its manners begun and ended: odd while one of its entries looks after them itself.
    minded: AtomicU64,
    /// It is one of several that may have done something: looked at after each of its steps.
    suspected: AtomicBool,
    /// Found stuck while it could move something: its own thread makes it safe when it comes back.
    owes_safe: AtomicBool,
    health: AtomicU32,
}

/// One look at [`Watch::busy`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Busy {
    pub(crate) entry: Entry,
    /// 0 = unknown.
    pub(crate) since_ns: u64,
    /// The same in two looks while nobody left in between.
    pub(crate) ticket: u64,
}

impl Watch {
    /// As [`Watch::begin`], for one of its commands.
    pub(crate) fn begin_command(&self, command: u32) -> u64 {
        self.command.store(command, Ordering::Relaxed);
        self.begin(Entry::Command, 0)
    }

    /// Number of the command that runs; of one that just ended where none does.
    pub(super) fn command(&self) -> u32 {
        self.command.load(Ordering::Relaxed)
    }

    /// Notes that `entry` begins; hands back what was noted before, for [`Watch::leave`]. `since_ns` 0 = not known here.
    pub(crate) fn begin(&self, entry: Entry, since_ns: u64) -> u64 {
        let before = self.busy.load(Ordering::Relaxed);
        // An entry inside another counts from the outer one's begin, if that is known.
        let since = if since_ns == 0 { before >> ENTRY_BITS } else { since_ns };
        self.busy.store(since << ENTRY_BITS | entry as u64, Ordering::Relaxed);
        // Only whoever is inside writes it.
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

    /// Counts a cycle that ended after the next was due; true when the watchdog should hear of it now.
    pub(crate) fn overran(&self) -> bool {
        self.overruns.store(self.overruns.load(Ordering::Relaxed) + 1, Ordering::Relaxed);
        self.health() == Health::Ok
    }

    pub(crate) fn overruns(&self) -> u64 {
        self.overruns.load(Ordering::Relaxed)
    }

    /// Notes that it was stopped.
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

    /// An entry begins, or has ended, to look after the component's manners itself. Before its first look, after its last.
    pub(super) fn mind(&self) {
        self.minded.fetch_add(1, Ordering::SeqCst);
    }

    /// Odd: whatever is found now belongs to the entry that looks; the same word in two looks: nothing began or ended.
    pub(super) fn minded(&self) -> u64 {
        self.minded.load(Ordering::SeqCst)
    }

    /// Notes a misdeed that was found because it was suspected.
    pub(super) fn find_out(&self, what: Misdeed) {
        self.found_out.fetch_or(what as u32, Ordering::Relaxed);
        self.misdeed(what);
    }

    /// True when it was found out since this was asked last.
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

    /// Its own thread is to make it safe; false when it was to already.
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

    /// The health the world was last told.
    pub(crate) fn health(&self) -> Health {
        match self.health.load(Ordering::Relaxed) {
            0 => Health::Ok,
            1 => Health::Overrun,
            2 => Health::StaleInput,
            3 => Health::Unresponsive,
            _ => Health::Lost,
        }
    }

    /// Sets it; answers what it was before.
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
