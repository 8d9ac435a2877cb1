//! The watchdog: one thread that looks at every component and reports its health.
//!
//! Invariant: it never enters a component and never waits for one; a look costs some loads per component. It
//! looks once in the shortest period (5 to 10 ms: it comes between the steps of all components, and patience
//! begins at 50 ms), when the patience for a running entry ends, and when a late cycle wakes it.

use std::cell::OnceCell;
use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use parking_lot::Mutex;
use trocar_rt::{house, os};

use super::super::context;
use super::super::hub::Hub;
use super::descriptors;
use super::home;
use super::hygiene::Premises;
use super::last;
use super::lateness::Lateness;
use super::observed::Observed;
use super::roster::{Guarded, Roster};
use super::strangers::Strangers;

/// Shortest and longest time between two looks, ns; between these limits it is the shortest period of a
/// running component.
const LOOK_NS: (u64, u64) = (5_000_000, 10_000_000);
/// Shortest time between two looks, however soon the patience for an entry ends, ns.
const SOONEST_NS: u64 = 1_000_000;
/// Shortest time between two looks per component, ns, so that looks stay cheap with many components.
const LOOK_EACH_NS: u64 = 10_000;
/// The watchdog of one LCM.
pub(crate) struct Watchdog {
    hub: Arc<Hub>,
    stop: Arc<AtomicBool>,
    thread: Mutex<Option<thread::JoinHandle<()>>>,
}

impl Watchdog {
    /// Starts the thread.
    ///
    /// # Errors
    /// The machine gives no more threads.
    pub(crate) fn start(hub: Arc<Hub>, roster: Arc<Roster>) -> std::io::Result<Watchdog> {
        home::settle();
        last::keep(&roster);
        let stop = Arc::new(AtomicBool::new(false));
        let (asked, shared) = (stop.clone(), hub.clone());
        let thread = house::spawn(thread::Builder::new().name("trocar-watchdog".into()), move || {
            context::deferred(|| keep_looking(&shared, &roster, &asked))
        })?;
        Ok(Watchdog { hub, stop, thread: Mutex::new(Some(thread)) })
    }

    /// Ends the thread and waits for its end.
    pub(crate) fn stop(&self) {
        self.stop.store(true, Ordering::Release);
        self.hub.watch.notify();
        let thread = self.thread.lock().take();
        if let Some(thread) = thread
            && thread.join().is_err()
        {
            log::error!("the watchdog panicked");
        }
    }
}

impl Drop for Watchdog {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        self.hub.watch.notify();
    }
}

/// Looks until `stop`; also after a breakdown, if the program goes on then.
fn keep_looking(hub: &Hub, roster: &Roster, stop: &AtomicBool) {
    while let Some(panic) = house::breakdown(|| Rounds::default().run(hub, roster, stop)) {
        last::cannot_go_on(hub, format!("its watchdog broke down: {panic}"));
        // If each look breaks down, this happens at the usual pace.
        hub.watch.wait(Some(os::now_ns() + LOOK_NS.1));
    }
}

/// Knowledge of the watchdog from its earlier looks.
#[derive(Default)]
struct Rounds {
    all_observed: Vec<Observed>,
    edition: u64,
    late: Lateness,
    priority: u8,
    premises: Premises,
    turns: descriptors::Turns,
}

impl Rounds {
    fn run(mut self, hub: &Hub, roster: &Roster, stop: &AtomicBool) {
        let mut next_ns = os::now_ns();
        loop {
            hub.watch.wait(Some(next_ns));
            if stop.load(Ordering::Acquire) {
                return;
            }
            let now_ns = os::now_ns();
            self.late.look(next_ns, now_ns);
            if let Some(all_guarded) = roster.news(&mut self.edition) {
                self.take(all_guarded);
            }
            self.look(now_ns);
            self.look_around(hub, now_ns, roster);
            next_ns = self.next_ns(os::now_ns());
        }
    }

    /// Looks at the components: those that are stuck, those whose thread is held by a stuck one, and the
    /// others.
    fn look(&mut self, now_ns: u64) {
        let late = self.late;
        let stuck: Vec<Option<String>> =
            self.all_observed.iter_mut().map(|o| o.stuck(now_ns, late)).collect();
        let holders: Vec<usize> = (0..stuck.len()).filter(|at| stuck[*at].is_some()).collect();
        for (at, why) in stuck.into_iter().enumerate() {
            let why = why.or_else(|| {
                let held =
                    holders.iter().filter_map(|by| self.all_observed[*by].holds(&self.all_observed[at]));
                // If one is inside another, the innermost came in last.
                held.max_by_key(|(since_ns, _)| *since_ns).map(|(_, why)| why)
            });
            self.all_observed[at].look(now_ns, why);
        }
    }

    /// Looks at the process and its threads, which components should leave as they were.
    fn look_around(&mut self, hub: &Hub, now_ns: u64, roster: &Roster) {
        let all_guarded: Vec<&Guarded> = self.all_observed.iter().map(|o| &o.guarded).collect();
        if let Some(why) = descriptors::look(hub, &all_guarded, &mut self.turns) {
            last::cannot_go_on(hub, why);
        }
        let counts: Vec<(u64, u64)> = self.all_observed.iter().map(Observed::counts).collect();
        let busy = || -> Vec<&Guarded> {
            let those = |is: fn(&Observed) -> bool| {
                self.all_observed.iter().filter(move |o| is(o)).map(|o| &o.guarded)
            };
            let commanded: Vec<&Guarded> = those(Observed::commanded).collect();
            if commanded.is_empty() { those(Observed::entered).collect() } else { commanded }
        };
        let settled = self.premises.look(now_ns, &all_guarded, || roster.has_only(&all_guarded), busy);
        // One look serves all components that have come to rest; if there are none, it costs nothing.
        let strangers = OnceCell::new();
        for (observed, counts) in self.all_observed.iter_mut().zip(counts) {
            observed.look_behind(now_ns, || strangers.get_or_init(Strangers::look));
            // Components that may have made an unsettled change stay noted.
            if settled {
                observed.note(counts);
            }
        }
    }

    /// Takes another list of components; keeps the knowledge about those that stay.
    fn take(&mut self, all_guarded: Vec<Guarded>) {
        let before = std::mem::take(&mut self.all_observed).into_iter();
        let mut before: HashMap<u32, Observed> = before.map(|o| (o.guarded.instance.number, o)).collect();
        self.all_observed = all_guarded
            .into_iter()
            .map(|guarded| match before.remove(&guarded.instance.number) {
                Some(observed) => observed.on(guarded),
                None => Observed::new(guarded),
            })
            .collect();
        self.rise();
    }

    /// Raises its priority above the highest real-time priority of a component, where the machine allows it.
    fn rise(&mut self) {
        let highest =
            self.all_observed.iter().map(|o| o.guarded.executor.settings.priority()).max().unwrap_or(0);
        if highest == 0 || highest < self.priority {
            return;
        }
        self.priority = highest.saturating_add(1).min(99);
        if let Err(e) = os::set_fifo(self.priority) {
            log::warn!("the watchdog runs below the components it watches: {e}");
        }
    }

    /// Time of the next look, ns.
    fn next_ns(&self, now_ns: u64) -> u64 {
        let running = self.all_observed.iter().map(|o| &o.guarded.instance).filter(|i| i.is_active());
        let shortest = running.map(|i| i.pace_ns()).min().unwrap_or(LOOK_NS.1);
        let crowd_ns = self.all_observed.len() as u64 * LOOK_EACH_NS;
        let pause_ns = shortest.clamp(LOOK_NS.0, LOOK_NS.1).max(crowd_ns);
        let ends = self.all_observed.iter().filter_map(|o| o.next_end_ns(now_ns)).min().unwrap_or(u64::MAX);
        ends.max(now_ns + SOONEST_NS.max(crowd_ns)).min(now_ns + pause_ns)
    }
}

#[cfg(test)]
mod tests;
