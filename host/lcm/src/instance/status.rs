//! State and health of a component, and how they are reported: news, events, the system interface.
//!
//! Invariant: every change of state or health is reported once, as news to the managers and as an event to
//! components; GetState is answered from a published row, so that a request costs a step nothing but a copy.

use std::collections::BTreeMap;
use std::sync::atomic::Ordering;
use std::sync::{Arc, PoisonError};

use trocar_loader::system;
use trocar_model::{ComponentId, Health, State};
use trocar_rt::os;

use super::super::boundary::EntryError;
use super::super::inbox::Party;
use super::super::loss::Loss;
use super::super::realtime::Settings;
use super::super::supervise::Moment;
use super::super::{News, Report, context};
use super::Instance;

/// Most warnings kept of one component; the oldest gives way.
const WARNINGS: usize = 16;

impl Instance {
    /// Sets state and fault text, and reports the change.
    pub(crate) fn set_state(&self, state: State, fault: &str) {
        let before = self.shut(state, fault);
        self.tell_change(before);
    }

    /// Sets state and fault text without a report; returns the former ones, for [`Instance::tell_change`].
    pub(crate) fn shut(&self, state: State, fault: &str) -> (State, String) {
        // State and reason change together: the second of two threads writes both.
        let mut text = self.fault.lock().unwrap_or_else(PoisonError::into_inner);
        let before = self.set_gate(state);
        self.show_standing();
        (before, std::mem::replace(&mut *text, fault.to_owned()))
    }

    /// Reports a change, if state or fault text differ from these.
    pub(super) fn tell_change(&self, (state, fault): (State, String)) {
        if self.state() != state {
            self.tell_standing();
            return;
        }
        self.publish_status();
        if *self.fault.lock().unwrap_or_else(PoisonError::into_inner) != fault {
            self.tell_managers();
        }
    }

    /// Handles a device that did not get to its safe condition: the sentence is kept with its state; a
    /// component that moves something, or panicked, is in FAULT.
    pub(crate) fn not_made_safe(&self, entry: &str, e: &EntryError) {
        let text = format!("{entry}: {}", e.text);
        self.say(log::Level::Error, &text);
        self.message(system::ERROR, &text);
        self.keep_warning(&text);
        if self.is_actuator() || e.panicked() {
            let before = self.fault.lock().unwrap_or_else(PoisonError::into_inner).clone();
            let both = if before.is_empty() { text } else { format!("{before}; {text}") };
            self.set_state(State::Fault, &both);
        } else {
            self.tell_managers();
        }
    }

    /// Sets the state if it is still `from`; reports the change and returns true if it was.
    pub(crate) fn set_state_from(&self, from: State, state: State, fault: &str) -> bool {
        let mut text = self.fault.lock().unwrap_or_else(PoisonError::into_inner);
        if !self.set_gate_from(from, state) {
            return false;
        }
        fault.clone_into(&mut text);
        drop(text);
        self.tell_standing();
        true
    }

    /// Reports the present state everywhere: row, event, news.
    fn tell_standing(&self) {
        self.publish_status();
        let mut row = [0u8; system::MAX_BYTES];
        self.read_status(&mut row);
        self.system_event(system::STATE_CHANGED, &row);
        self.tell_managers();
    }

    fn tell_managers(&self) {
        // A failure is fine without listeners: the inventory has the state.
        let _ = self.hub.news.send(News::State(self.report(false)));
    }

    pub(crate) fn report(&self, with_ports: bool) -> Report {
        // Counted before the look: a later change is in a report of a higher number.
        let number = self.hub.reports.fetch_add(1, Ordering::SeqCst) + 1;
        // Read before the state: a warning tells of a change, and no report may show it beside the state from
        // before.
        let warnings = self.warnings();
        Report {
            id: self.id.clone(),
            number,
            state: self.state(),
            health: self.watch.health(),
            fault: self.fault.lock().unwrap_or_else(PoisonError::into_inner).clone(),
            ports: with_ports.then(|| self.ports()),
            lost_connections: Vec::new(),
            warnings,
        }
    }

    /// Sets the health and reports it if it changed. Watchdog only.
    pub(crate) fn set_health(&self, health: Health, why: &str) {
        if self.watch.set_health(health) == health {
            return;
        }
        if health == Health::Ok {
            self.say(log::Level::Info, why);
            self.message(system::STATUS, why);
        } else {
            self.say(log::Level::Warn, why);
            self.message(system::WARNING, why);
        }
        self.tell_standing();
    }

    /// Keeps a sentence that is shown with the state from now on; true when it is new.
    pub(crate) fn keep_warning(&self, text: &str) -> bool {
        let mut warnings = self.warnings.lock().unwrap_or_else(PoisonError::into_inner);
        if warnings.iter().any(|w| w == text) {
            return false;
        }
        if warnings.len() == WARNINGS {
            warnings.remove(0);
        }
        warnings.push(text.to_owned());
        true
    }

    /// Reports a sentence about the component everywhere: log, `warning` event, with its state.
    pub(crate) fn warn(&self, text: &str) {
        self.say(log::Level::Warn, text);
        self.message(system::WARNING, text);
        if self.keep_warning(text) {
            self.tell_managers();
        }
    }

    /// As [`Instance::warn`] for repeated causes: only the newest sentence about each one is kept.
    pub(crate) fn warn_about(&self, about: &str, how: &str) {
        let mut warnings = self.warnings.lock().unwrap_or_else(PoisonError::into_inner);
        warnings.retain(|w| !w.starts_with(about));
        drop(warnings);
        self.warn(&format!("{about}{how}"));
    }

    pub(crate) fn warnings(&self) -> Vec<String> {
        // Read each time: helping threads may still be settling.
        let of_thread = self.settings.get().map_or_else(Vec::new, |settings| settings.warnings());
        let own = self.warnings.lock().unwrap_or_else(PoisonError::into_inner);
        of_thread.into_iter().chain(own.iter().cloned()).collect()
    }

    /// Sets the settings of its thread; once.
    pub(crate) fn set_thread(&self, settings: Arc<Settings>) {
        let _ = self.settings.set(settings);
    }

    /// Forgets the warnings about an instance that is no more.
    pub(crate) fn clear_warnings(&self) {
        self.warnings.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }

    /// Notes threads, with their names, that appeared during one of its entries; `lasts`: they may live until
    /// `destroy`.
    pub(crate) fn note_brood(&self, threads: impl Iterator<Item = (i32, String)>, lasts: bool) {
        let threads = threads.map(|(tid, name)| (tid, (name, lasts)));
        self.brood.lock().unwrap_or_else(PoisonError::into_inner).extend(threads);
    }

    pub(crate) fn brood(&self) -> BTreeMap<i32, String> {
        let brood = self.brood.lock().unwrap_or_else(PoisonError::into_inner);
        brood.iter().map(|(tid, (name, _))| (*tid, name.clone())).collect()
    }

    /// Tells whether this is a thread of its own that may live until `destroy`.
    pub(crate) fn lasts(&self, tid: i32) -> bool {
        let brood = self.brood.lock().unwrap_or_else(PoisonError::into_inner);
        brood.get(&tid).is_some_and(|(_, lasts)| *lasts)
    }

    /// Sets the moment before its code first ran: threads from before cannot be its own. Only the first call
    /// counts.
    pub(crate) fn set_made(&self, before: Moment) {
        self.made.get_or_init(|| before);
    }

    /// The moment before its code first ran.
    pub(crate) fn made(&self) -> Option<Moment> {
        self.made.get().copied()
    }

    /// Notes that a required port has a connection, again or for the first time.
    pub(crate) fn connected(&self, port: &str) {
        self.missing.lock().unwrap_or_else(PoisonError::into_inner).remove(port);
        self.hub.watch.notify();
    }

    /// Notes that a required port lost its connection.
    pub(crate) fn disconnected(&self, port: &str, how: Loss) {
        let lost_ns = os::now_ns().saturating_add(how.spared_ns());
        let mut ports = self.missing.lock().unwrap_or_else(PoisonError::into_inner);
        let missing = ports.entry(port.to_owned()).or_insert(lost_ns);
        *missing = lost_ns.min(*missing);
        drop(ports);
        self.hub.watch.notify();
    }

    /// Required ports that lost their connection, and the time from which each counts as lost, ns.
    pub(crate) fn missing(&self) -> Vec<(String, u64)> {
        let ports = self.missing.lock().unwrap_or_else(PoisonError::into_inner);
        ports.iter().map(|(port, lost_ns)| (port.clone(), *lost_ns)).collect()
    }

    /// Emits `status`, `warning` or `error` of the system interface.
    pub(crate) fn message(&self, event: usize, text: &str) {
        let mut row = [0u8; system::MESSAGE_BYTES];
        system::write_message(os::now_ns(), text, &mut row);
        self.system_event(event, &row);
    }

    fn system_event(&self, event: usize, row: &[u8]) {
        let set = self.described.now();
        let cell = set.system_event(event);
        // Passive observers handle it on their own threads: this one may be the watchdog's or a manager's.
        context::deferred(|| cell.emit(&row[..cell.bytes.min(row.len())]));
    }

    /// Publishes the present state.
    pub(super) fn publish_status(&self) {
        let mut row = [0u8; system::MAX_BYTES];
        let mut writer = self.status.lock().unwrap_or_else(PoisonError::into_inner);
        // Read under the lock: the last thread to publish has the newest values.
        let fault = self.fault.lock().unwrap_or_else(PoisonError::into_inner);
        let (state, health) = (self.state().to_string(), self.watch.health().to_string());
        let stamp_ns = os::now_ns();
        system::write_status(stamp_ns, &state, &health, &fault, &mut row);
        writer.publish(stamp_ns, 0, |out| out.copy_from_slice(&row));
        drop((writer, fault));
        self.show_standing();
    }
}

impl Party for Instance {
    fn id(&self) -> &ComponentId {
        &self.id
    }

    fn warn_about(&self, about: &str, how: &str) {
        Instance::warn_about(self, about, how);
    }
}
