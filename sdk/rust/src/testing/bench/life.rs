//! The life of the component on the bench: configure, start, stop, reset and what survives a swap.
//!
//! Invariant: as in a host: an action that a state does not allow is refused without entering the component,
//! and after an entry that failed the component is made safe and in FAULT: only `reset` leads out of there.

use super::{Bench, Done, Failure, Life, collect, create};
use crate::class::Class;
use crate::payload::as_bytes;
use core::ffi::c_void;
use core::fmt::Display;
use serde_json::{Map, Value as Json};
use std::sync::atomic::Ordering;
use trocar_plugin_api::abi::{self, Bytes, ErrBuf, Sink, Status};
use trocar_plugin_api::desc::Safety;

impl<C: Class> Bench<C> {
    /// Returns the state of the component.
    pub fn life(&self) -> Life {
        self.life
    }

    /// Configures as a host does: of a started component only settings that are `live` may change.
    ///
    /// # Errors
    /// The host's or the component's sentence; its former configuration stays. After a panic it is in FAULT.
    #[track_caller]
    pub fn configure(&mut self, config: impl Display) -> Done {
        self.allow("configure", &[Life::Created, Life::Ready, Life::Active, Life::Stopped])?;
        let json = config.to_string();
        self.history.note(self.now().ns(), format!("configure {json}"));
        let wanted = whole::<C>(&json);
        if self.is_active()
            && let Some(wanted) = &wanted
            && let Some(fixed) = super::super::config::fixed_change(C::DESC, &self.config, wanted)
        {
            return Err(Failure { status: abi::STATUS_INVALID, reason: fixed });
        }
        let bytes = Bytes { ptr: json.as_ptr(), len: json.len() };
        let f = self.table.configure;
        // SAFETY: a live instance; the text lives through the call.
        let done = self.enter(|this, err| f.map_or(abi::STATUS_OK, |f| unsafe { f(this, bytes, err) }));
        done.map_err(|e| if e.status == abi::STATUS_INVALID { e } else { self.failed("configure", e) })?;
        self.config = wanted.unwrap_or_default();
        if !self.is_active() {
            self.set_life(Life::Ready);
        }
        self.host.ports_changed.store(self.table.describe.is_some(), Ordering::Relaxed);
        self.change_ports();
        self.reply_all();
        Ok(())
    }

    /// Starts the component.
    ///
    /// # Errors
    /// The component's sentence; it was made safe then and is in FAULT, as everywhere below. Or the component
    /// is not READY or STOPPED.
    #[track_caller]
    pub fn start(&mut self) -> Done {
        self.allow("start", &[Life::Ready, Life::Stopped])?;
        self.cycle = 0;
        self.plain("start", self.table.start).map_err(|e| self.failed("start", e))?;
        self.set_life(Life::Active);
        self.reply_all();
        Ok(())
    }

    /// `stop` and then `make_safe`, as a host does; nothing where it does not run.
    ///
    /// # Errors
    /// The component's sentence when it is in FAULT then. Where nothing moves, a `make_safe` that refuses is
    /// only one of the [`Bench::warnings`]: the component is STOPPED.
    #[track_caller]
    pub fn stop(&mut self) -> Done {
        if !self.is_active() {
            return Ok(());
        }
        self.set_life(Life::Stopped);
        self.plain("stop", self.table.stop).map_err(|e| self.failed("stop", e))?;
        let safe = self.make_safe();
        self.reply_all();
        safe.or_else(|e| if self.life == Life::Fault { Err(e) } else { Ok(()) })
    }

    /// Lets a stopped component go on with its run-time state.
    ///
    /// # Errors
    /// The component's sentence, or that it is not STOPPED.
    #[track_caller]
    pub fn resume(&mut self) -> Done {
        self.allow("resume", &[Life::Stopped])?;
        self.plain("resume", self.table.resume).map_err(|e| self.failed("resume", e))?;
        self.set_life(Life::Active);
        self.reply_all();
        Ok(())
    }

    /// Treats a component whose entry failed as a host does.
    pub(crate) fn failed(&mut self, entry: &str, failure: Failure) -> Failure {
        self.fault = format!("{entry}: {}", failure.reason);
        self.set_life(Life::Fault);
        // The first failure is the one to tell.
        let _ = self.make_safe();
        failure
    }

    /// Handles the result of an entry after which the component is trusted further unless it panicked.
    pub(crate) fn survived(&mut self, entry: &str, done: Done) -> Done {
        done.map_err(|e| if e.panicked() { self.failed(entry, e) } else { e })
    }

    /// Stops without being asked: no step begins any more.
    pub(crate) fn halt(&mut self) -> Done {
        self.set_life(Life::Stopped);
        self.make_safe()
    }

    /// Calls `make_safe` in any state.
    ///
    /// # Errors
    /// The component's sentence; an actuator that could not be made safe is in FAULT.
    pub fn make_safe(&mut self) -> Done {
        self.made_safe += 1;
        let done = self.plain("make_safe", self.table.make_safe);
        if let Err(e) = &done {
            let text = format!("make_safe: {}", e.reason);
            if e.panicked() || C::DESC.safety == Safety::Actuator {
                self.fault =
                    if self.fault.is_empty() { text.clone() } else { format!("{}; {text}", self.fault) };
                self.set_life(Life::Fault);
            }
            self.warnings.push(text);
        }
        done
    }

    /// Returns the warnings that a host would show beside the component's state since it was made or reset:
    /// each `make_safe` that refused.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// # Errors
    /// NOT_ACTIVE: a host answers so to calls that only an ACTIVE component takes.
    pub(crate) fn allow_active(&self, what: &str) -> Done {
        self.allow(what, &[Life::Active])
            .map_err(|e| Failure { reason: format!("NOT_ACTIVE: {}", e.reason), ..e })
    }

    /// # Errors
    /// The component is in another state; it was not entered.
    fn allow(&self, what: &str, lives: &[Life]) -> Done {
        if lives.contains(&self.life) {
            return Ok(());
        }
        let (life, lives) = (self.life, lives.iter().map(Life::to_string).collect::<Vec<_>>());
        let reason = match life {
            Life::Fault => format!("{what}: it is in FAULT ({}); only `reset` leads on", self.fault),
            _ => format!("{what}: it is {life}, and has to be {}", lives.join(" or ")),
        };
        Err(Failure { status: abi::STATUS_FAILED, reason })
    }

    /// Returns how often `make_safe` was called: by the test, by `stop` and `lose_peer`, and after an entry
    /// that failed.
    pub fn made_safe(&self) -> u64 {
        self.made_safe
    }

    /// Replaces this instance by another one, configured the same, not started: what Reset does. Connections
    /// stay.
    ///
    /// # Errors
    /// The component's sentence.
    #[track_caller]
    pub fn reset(&mut self) -> Done {
        self.history.note(self.now().ns(), "reset".to_string());
        let config = std::mem::take(&mut self.config);
        self.destroy();
        self.this = create::<C>(&self.host_table);
        self.set_life(Life::Created);
        self.cycle = 0;
        self.warnings.clear();
        self.describe();
        self.bind();
        self.publish();
        self.configure(Json::Object(config))
    }

    /// Returns what a swap takes along: the bytes of the state row, and the snapshot.
    pub fn snapshot(&mut self) -> (Vec<u8>, Vec<u8>) {
        let mut taken: Vec<u8> = Vec::new();
        if let Some(f) = self.table.snapshot {
            let sink = Sink { ctx: (&raw mut taken).cast(), write: collect };
            // SAFETY: a live instance; the sink lives through the call.
            unsafe { f(self.this, &sink) };
        }
        (as_bytes(&self.row).to_vec(), taken)
    }

    /// Takes what [`Bench::snapshot`] of another bench gave. A READY component is STOPPED then: `resume` goes
    /// on with it.
    ///
    /// # Errors
    /// The component's sentence.
    pub fn restore(&mut self, state: &[u8], snapshot: &[u8]) -> Done {
        let bytes = |b: &[u8]| Bytes { ptr: b.as_ptr(), len: b.len() };
        let (f, state, snapshot) = (self.table.restore, bytes(state), bytes(snapshot));
        // SAFETY: a live instance; both slices live through the call.
        self.enter(|this, err| f.map_or(abi::STATUS_OK, |f| unsafe { f(this, state, snapshot, err) }))?;
        if self.life == Life::Ready {
            self.set_life(Life::Stopped);
        }
        Ok(())
    }

    fn is_active(&self) -> bool {
        self.host.active.load(Ordering::Relaxed)
    }

    fn set_life(&mut self, life: Life) {
        self.life = life;
        self.host.active.store(life == Life::Active, Ordering::Relaxed);
        if life != Life::Fault {
            self.fault.clear();
        }
    }

    fn plain(
        &mut self,
        name: &str,
        f: Option<unsafe extern "C" fn(*mut c_void, *mut ErrBuf) -> Status>,
    ) -> Done {
        self.history.note(self.now().ns(), name.to_string());
        // SAFETY: a live instance.
        self.enter(|this, err| f.map_or(abi::STATUS_OK, |f| unsafe { f(this, err) }))
    }

    pub(super) fn destroy(&mut self) {
        if let Some(destroy) = self.table.destroy {
            // SAFETY: the instance's last use; the caller makes another one or drops cells, slots and host
            // after it.
            unsafe { destroy(self.this) };
        }
    }
}

/// The configuration with defaults filled in; none when it is no object, which the component refuses itself.
fn whole<C: Class>(json: &str) -> Option<Map<String, Json>> {
    let mut given = if json.is_empty() { Map::new() } else { serde_json::from_str(json).ok()? };
    for field in C::DESC.config {
        if let (false, Ok(default)) = (given.contains_key(field.name), serde_json::from_str(field.default)) {
            given.insert(field.name.to_string(), default);
        }
    }
    Some(given)
}
