//! State and health of a component, and how they are reported: news, events, the system interface.
//!
//! Invariant: every change of state or health is reported once, as news to the managers and as an event to
//! components; GetState is answered from a published row, so that a request costs a step nothing but a copy.

use std::sync::atomic::Ordering;

use trocar_loader::system;
use trocar_model::{ComponentId, Health, State};
use trocar_rt::os;

use super::super::boundary::EntryError;
use super::super::inbox::Party;
use super::super::{News, Report, context};
use super::Instance;

impl Instance {
    /// Sets state and fault text, and reports the change.
    pub(crate) fn set_state(&self, state: State, fault: &str) {
        let before = self.shut(state, fault);
        self.tell_change(before);
    }

    /// Sets state and fault text without a report; returns the former ones, for [`Instance::tell_change`].
    pub(crate) fn shut(&self, state: State, fault: &str) -> (State, String) {
        // State and reason change together: the second of two threads writes both.
        let mut text = self.standing.fault();
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
        if *self.standing.fault() != fault {
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
            let before = self.standing.fault().clone();
            let both = if before.is_empty() { text } else { format!("{before}; {text}") };
            self.set_state(State::Fault, &both);
        } else {
            self.tell_managers();
        }
    }

    /// Sets the state if it is still `from`; reports the change and returns true if it was.
    pub(crate) fn set_state_from(&self, from: State, state: State, fault: &str) -> bool {
        let mut text = self.standing.fault();
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
            fault: self.standing.fault().clone(),
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
        self.standing.keep(text)
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
        self.standing.forget(about);
        self.warn(&format!("{about}{how}"));
    }

    pub(crate) fn warnings(&self) -> Vec<String> {
        let mut all = self.threads.warnings();
        all.extend(self.standing.warnings());
        all
    }

    /// Forgets the warnings about an instance that is no more.
    pub(crate) fn clear_warnings(&self) {
        self.standing.forget("");
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
        let mut writer = self.standing.status();
        // Read under the lock: the last thread to publish has the newest values.
        let fault = self.standing.fault();
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
