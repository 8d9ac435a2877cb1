//! Knowledge of the watchdog about one component, and its judgement after each look.
//!
//! Invariant: it never enters the component and never waits for it. Its statements about time take into
//! account that the watchdog may itself have been kept from running.

use trocar_loader::system;
use trocar_model::{Health, State, StopReason};
use trocar_plugin_api::abi::NOT_ACTIVE;
use trocar_rt::os;

use super::super::books::Misuse;
use super::super::watch::{Busy, Entry, Misdeed};
use super::lateness::Lateness;
use super::roster::Guarded;
use super::safe::give_up;
use super::strangers::Strangers;

/// Shortest time an overrun is shown, ns, so that health does not flicker.
const OVERRUN_SHOWN_NS: u64 = 1_000_000_000;
/// Longest stay in an entry that makes, starts or ends a component, ns; its own patience when that is longer.
const LIFECYCLE_NS: u64 = 1_000_000_000;
/// Longest wait for a processor that excuses a thread while it lasts, ns: a thread that starves that long is
/// stuck, too.
const STARVED_NS: u64 = 1_000_000_000;
/// A component counts as unresponsive so much before its patience ends, ns, or a fiftieth of the patience
/// when that is less: it is reported within the patience, not after it.
const AHEAD_NS: u64 = 1_000_000;

/// Time that threads of a stopped component get to end, ns.
pub(crate) const LEAVE_NS: u64 = 200_000_000;

/// Shortest time between two reports of refusals, failures or losses, ns.
const TELL_NS: u64 = 1_000_000_000;
/// Longest wait of a component's thread for a caller or device thread inside it, ns.
const ENTER_NS: u64 = 100_000_000;

/// One watched component, and the watchdog's observations.
pub(super) struct Observed {
    pub(super) guarded: Guarded,
    inside: Option<Inside>,
    overruns: u64,
    overrun_ns: Option<u64>,
    /// Entries and commands at the last look.
    entries: u64,
    commands: u64,
    /// Counted misuse at the last report, and the time of that report, ns.
    misuses: ([u64; Misuse::ALL.len()], u64),
    stops: u64,
    /// Time at which it was first seen stopped, ns, until its threads were looked for.
    rest_ns: Option<u64>,
}

/// An entry that was seen running.
struct Inside {
    busy: Busy,
    /// Time of its begin or, where that is unknown, of the first look, ns.
    since_ns: u64,
    /// Time at which its patience ends, if it is not kept from running until then, ns.
    ends_ns: u64,
    /// Lateness of the watchdog at its begin, ns.
    late_ns: u64,
    /// Time its thread had waited for a processor when the entry began to last long, ns.
    waited_ns: Option<u64>,
    /// Run time of its thread, ns, and since when it is seen ready without having run any more, ns.
    ready: Option<(u64, u64)>,
}

impl Inside {
    /// Time for which its thread has been kept from running since the entry began to last long, ns. A wait
    /// under way counts, too: the kernel adds it up only when it is over.
    fn kept_ns(&mut self, tid: i32, now_ns: u64) -> u64 {
        let waited_ns = waited_ns(tid);
        let over_ns = waited_ns.saturating_sub(*self.waited_ns.get_or_insert(waited_ns));
        // A thread that sleeps in between must run first, so ready at both looks without having run means
        // ready all the time.
        let ran_ns = if os::is_ready(tid) { os::thread_ran_ns(tid) } else { None };
        let since_ns = match (self.ready, ran_ns) {
            (Some((before_ns, since_ns)), Some(ran_ns)) if before_ns == ran_ns => since_ns,
            _ => now_ns,
        };
        self.ready = ran_ns.map(|ran_ns| (ran_ns, since_ns));
        over_ns + now_ns.saturating_sub(since_ns).min(STARVED_NS)
    }
}

impl Observed {
    pub(super) fn new(guarded: Guarded) -> Observed {
        let overruns = guarded.instance.watch.overruns();
        Observed {
            guarded,
            inside: None,
            overruns,
            overrun_ns: None,
            entries: 0,
            commands: 0,
            misuses: ([0; Misuse::ALL.len()], 0),
            stops: 0,
            rest_ns: None,
        }
    }

    /// The same component, perhaps on another thread.
    pub(super) fn on(self, guarded: Guarded) -> Observed {
        Observed { guarded, ..self }
    }

    /// Entries and commands begun so far, for [`Observed::note`].
    pub(super) fn counts(&self) -> (u64, u64) {
        (self.guarded.instance.watch.entries(), self.guarded.instance.books.commands())
    }

    /// Notes these counts as looked at. They are counted before the look: an entry that began during it
    /// belongs to the next look, too.
    pub(super) fn note(&mut self, counts: (u64, u64)) {
        (self.entries, self.commands) = counts;
    }

    /// Tells whether it ran a command since the last look.
    pub(super) fn commanded(&self) -> bool {
        self.commands != self.guarded.instance.books.commands()
    }

    /// Tells whether a thread was inside since the last look, or is.
    pub(super) fn entered(&self) -> bool {
        self.entries != self.guarded.instance.watch.entries() || self.guarded.instance.watch.busy().is_some()
    }

    /// Looks for threads it left behind, a while after it was stopped.
    pub(super) fn look_behind<'a>(&mut self, now_ns: u64, strangers: impl FnOnce() -> &'a Strangers) {
        if self.guarded.instance.is_active() {
            self.rest_ns = None;
            return;
        }
        let stops = self.guarded.instance.watch.stops();
        if stops != self.stops {
            (self.stops, self.rest_ns) = (stops, Some(now_ns));
        }
        if self.rest_ns.is_none_or(|since| now_ns.saturating_sub(since) < LEAVE_NS) {
            return;
        }
        self.rest_ns = None;
        let left = strangers().left_behind(&self.guarded);
        if !left.is_empty() {
            self.guarded.instance.warn(&format!(
                "{} of its own threads still run after it was stopped: {}",
                left.len(),
                left.join(", ")
            ));
        }
    }

    /// Updates and reports its health; `stuck`: why it, or its thread, makes no progress.
    pub(super) fn look(&mut self, now_ns: u64, stuck: Option<String>) {
        let instance = self.guarded.instance.clone();
        let (health, why) = match stuck {
            Some(why) => (Health::Unresponsive, why),
            None => self.health(now_ns),
        };
        let before = instance.watch.health();
        let runs = self.inside.as_ref().is_none_or(|i| i.busy.entry.runs());
        if health == Health::Unresponsive && before != health && !runs {
            // The caller that makes, starts or ends it waits, and may look why.
            instance.keep_warning(&why);
        }
        instance.set_health(health, &why);
        if health == Health::Unresponsive && before != health {
            // In other entries its caller is waiting for it already.
            if instance.is_actuator() && runs {
                instance.set_state_from(State::Active, State::Fault, &why);
                give_up(&self.guarded);
            }
        }
        let misdeeds = instance.watch.take_misdeeds();
        let done = |what: &Misdeed| misdeeds & *what as u32 != 0;
        Misdeed::ALL.iter().filter(|what| done(what)).for_each(|what| instance.warn(what.says()));
        self.mind_peers(now_ns);
        self.tell_misuse(now_ns);
        instance.show_figures();
    }

    /// Makes an actuator safe and stops it when it has lost a required connection, unless it was only
    /// rewired.
    fn mind_peers(&self, now_ns: u64) {
        let instance = &self.guarded.instance;
        if !instance.is_actuator() || !instance.is_active() {
            return;
        }
        let missing = instance.missing();
        if missing.iter().any(|(_, lost_ns)| now_ns >= *lost_ns) {
            lose_peer(&self.guarded);
        }
    }

    /// Reports refusals and failures, at most once a second.
    fn tell_misuse(&mut self, now_ns: u64) {
        let instance = &self.guarded.instance;
        let (now, (before, told_ns)) = (instance.books.misuses(), self.misuses);
        if now == before || now_ns.saturating_sub(told_ns) < TELL_NS {
            return;
        }
        self.misuses = (now, now_ns);
        for (what, (now, before)) in Misuse::ALL.into_iter().zip(now.into_iter().zip(before)) {
            if now == before {
                continue;
            }
            let mut often = format!(" ({now} so far)");
            if let Some(last) = instance.books.last_words(what) {
                often = format!("{often}, the last one: {last}");
            }
            if what.is_error() {
                instance.say(log::Level::Error, &format!("{}{often}", what.says()));
                instance.message(system::ERROR, &format!("{}{often}", what.says()));
            }
            instance.warn_about(what.says(), &often);
        }
    }

    /// Reason why it counts as unresponsive, if it does.
    pub(super) fn stuck(&mut self, now_ns: u64, late: Lateness) -> Option<String> {
        let Some(busy) = self.guarded.instance.watch.busy() else {
            self.inside = None;
            return None;
        };
        if self.inside.as_ref().is_none_or(|i| i.busy != busy) {
            let since_ns = if busy.since_ns == 0 { now_ns } else { busy.since_ns };
            let late_ns = late.at(since_ns, now_ns);
            self.inside = Some(Inside { busy, since_ns, ends_ns: 0, late_ns, waited_ns: None, ready: None });
        }
        let tid = self.guarded.executor.tid();
        let inside = self.inside.as_mut()?;
        let own = self.guarded.instance.patience_ns();
        let patience_ns = if busy.entry.runs() { own } else { own.max(LIFECYCLE_NS) };
        let allowed_ns = patience_ns - AHEAD_NS.min(patience_ns / 50);
        let lasted_ns = now_ns.saturating_sub(inside.since_ns);
        // While the watchdog could not run, the component may not have run either.
        let mut counted_ns = lasted_ns.saturating_sub(late.now_ns - inside.late_ns);
        if counted_ns > patience_ns / 2 {
            counted_ns = counted_ns.saturating_sub(inside.kept_ns(tid, now_ns));
        }
        inside.ends_ns = now_ns.saturating_add(allowed_ns.saturating_sub(counted_ns));
        (counted_ns >= allowed_ns).then(|| {
            let (inside, allowed) = (inside_of(&self.guarded, busy), short(patience_ns));
            format!("it has not come back out of its {inside}, which may take {allowed}")
        })
    }

    /// Reason why `other`, which does not run, waits for this component, and since when this one is inside,
    /// ns: one of its own entries holds the thread both step on.
    pub(super) fn holds(&self, other: &Observed) -> Option<(u64, String)> {
        let (instance, waiting) = (&self.guarded.instance, &other.guarded.instance);
        let inside = self.inside.as_ref()?;
        let elsewhere = instance.is_passive() || instance.is_called_back();
        let on_thread = !(elsewhere && inside.busy.entry.runs());
        let steps = waiting.is_active() && !waiting.is_passive() && !waiting.is_called_back();
        let same = instance.executor_id() == waiting.executor_id() && instance.number != waiting.number;
        if !(on_thread && steps && same) || other.inside.is_some() {
            return None;
        }
        let entry = inside.busy.entry.name();
        Some((inside.since_ns, format!("its thread is held by {} inside its {entry}", instance.id)))
    }

    /// The next moment after `now_ns` at which its period or its patience ends, ns.
    pub(super) fn next_end_ns(&self, now_ns: u64) -> Option<u64> {
        let ends = self.inside.as_ref().map(|i| i.ends_ns);
        ends.into_iter().chain(self.overruns_at_ns().map(|due| due + 1)).filter(|end| *end > now_ns).min()
    }

    /// Time at which a step that runs now has taken longer than its period, ns.
    fn overruns_at_ns(&self) -> Option<u64> {
        let period_ns = self.guarded.instance.period_ns();
        let running = self.guarded.instance.watch.busy().filter(|b| b.entry.runs() && b.since_ns > 0)?;
        (period_ns > 0).then(|| running.since_ns.saturating_add(period_ns))
    }

    fn health(&mut self, now_ns: u64) -> (Health, String) {
        let instance = &self.guarded.instance;
        let overruns = instance.watch.overruns();
        // A step that still runs is counted by its own thread when it ends, and shown now.
        if overruns != self.overruns || self.overruns_at_ns().is_some_and(|due| now_ns > due) {
            self.overruns = overruns;
            self.overrun_ns = Some(now_ns);
        }
        if !instance.is_active() {
            self.overrun_ns = None;
            return (Health::Ok, "it is at rest".into());
        }
        if let Some(why) = stale(&self.guarded, now_ns) {
            return (Health::StaleInput, why);
        }
        match self.overrun_ns {
            Some(at) if now_ns.saturating_sub(at) < OVERRUN_SHOWN_NS => {
                let period = short(instance.period_ns());
                (Health::Overrun, format!("a cycle takes longer than its period ({period})"))
            }
            _ => (Health::Ok, "recovered".into()),
        }
    }
}

/// Name of the entry a thread is in; of a command with its name.
fn inside_of(guarded: &Guarded, busy: Busy) -> String {
    let (entry, instance) = (busy.entry.name(), &guarded.instance);
    if busy.entry != Entry::Command {
        return entry.to_owned();
    }
    match instance.name_of(instance.watch.command()) {
        Some(name) => format!("{entry} {name}"),
        None => entry.to_owned(),
    }
}

/// "33.333 ms", "500 µs".
fn short(ns: u64) -> String {
    let (scale, unit) = if ns < 1_000_000 { (1e3, "µs") } else { (1e6, "ms") };
    format!("{} {unit}", (ns as f64 / scale * 1e3).round() / 1e3)
}

/// Names its sources that are silent or gone.
fn stale(guarded: &Guarded, now_ns: u64) -> Option<String> {
    let instance = &guarded.instance;
    // An end that is only rewired is not without a source.
    let gone = instance.missing().into_iter().filter(|(_, lost_ns)| now_ns >= *lost_ns);
    let missing: Vec<String> = gone.map(|(port, _)| port).collect();
    if !missing.is_empty() {
        return Some(format!("nothing is connected any more to {}", missing.join(", ")));
    }
    let silent = instance.stale_inputs(now_ns);
    (!silent.is_empty()).then(|| format!("no data for longer than max_age at {}", silent.join(", ")))
}

/// Lets no step begin any more; its own thread brings it to its safe condition.
fn lose_peer(guarded: &Guarded) {
    let instance = guarded.instance.clone();
    let lost = State::Stopped(StopReason::PeerLost);
    if !instance.set_state_from(State::Active, lost, "") {
        return;
    }
    instance.say(log::Level::Warn, "it is stopped and made safe: what it requires is gone");
    guarded.executor.submit(move |_| {
        instance.refuse_queued(NOT_ACTIVE);
        match instance.object.enter_until(os::now_ns() + ENTER_NS) {
            Some(mut entered) => {
                // A failure is reported in there, and there is nothing safer to do.
                let _ = instance.make_safe(&mut entered);
                instance.publish_state(&mut entered);
            }
            // The thread inside makes it safe when it leaves.
            None => {
                instance.watch.owe_safe();
                instance.serve();
            }
        }
    });
}

/// Time for which a thread was ready to run and got no processor, ns; 0 where the kernel does not say.
fn waited_ns(tid: i32) -> u64 {
    let text = std::fs::read_to_string(format!("/proc/self/task/{tid}/schedstat")).unwrap_or_default();
    text.split_ascii_whitespace().nth(1).and_then(|w| w.parse().ok()).unwrap_or(0)
}
