//! Methods that a component's author implements, and the additions of the derive.
//!
//! Invariant: the host enters one instance from one thread at a time, so methods take `&mut self` and need no
//! locks.

use crate::call::Call;
use crate::config::JsonObject;
use crate::describe::Lists;
use crate::host::Host;
use crate::lease::Layout;
use crate::payload::Payload;
use crate::ports::Binder;
use crate::safe::MakeSafe;
use crate::services::ServiceReply;
use crate::values::Stamp;
use std::sync::Arc;
use trocar_plugin_api::abi::{self, Status};
use trocar_plugin_api::desc::ClassDesc;

/// Any error, made with `?` or from text: `Err("no light".into())`.
pub type Error = Box<dyn std::error::Error + Send + Sync>;
/// The result of every entry. An error from `step`, `start` or `configure` puts the component in FAULT.
pub type Result<T = (), E = Error> = std::result::Result<T, E>;

/// The entries of a component; override what you need.
pub trait Component {
    /// The whole configuration was checked and is in the `#[config]` field. On an error the old one comes
    /// back.
    fn configure(&mut self) -> Result {
        Ok(())
    }
    /// A fresh start: make run-time state here.
    fn start(&mut self) -> Result {
        Ok(())
    }
    fn stop(&mut self) -> Result {
        Ok(())
    }
    /// Goes on after a stop with the run-time state that is there.
    fn resume(&mut self) -> Result {
        Ok(())
    }
    /// Brings the device to its safe condition. Called on FAULT, Stop, peer loss and shutdown; short, never
    /// waits. Not called for a class with `safe_from_any_thread`: such a class has
    /// [`crate::SafeFromAnyThread`].
    fn make_safe(&mut self) -> Result {
        Ok(())
    }
    /// One cycle. Real-time: no allocation, no lock, no waiting.
    fn step(&mut self, tick: &Tick) -> Result {
        let _ = tick;
        Ok(())
    }
    /// Lists of names set before are in force now, in [`crate::Many`] and [`crate::Names`]: size here what
    /// belongs to them. Called after `configure` or [`Host::ports_changed`], between two steps, when a list
    /// has changed.
    fn ports_changed(&mut self) {}
    /// The answer to a service asked for with [`Host::services`] or [`Host::service`].
    fn answered(&mut self, reply: ServiceReply) -> Result {
        let _ = reply;
        Ok(())
    }
    /// The same answer as raw JSON, before it is read; the default calls [`Component::answered`].
    fn service_reply(&mut self, token: u64, reply: &str) -> Result {
        self.answered(ServiceReply::parse(token, reply))
    }
    /// Returns what must survive a swap and is not in a `#[state]` field.
    fn snapshot(&self) -> Vec<u8> {
        Vec::new()
    }
    /// Takes the output of the former version's [`Component::snapshot`]; `#[state]` fields are already
    /// restored.
    fn restore(&mut self, snapshot: &[u8]) -> Result {
        let _ = snapshot;
        Ok(())
    }
}

/// A component class: made by `#[derive(Component)]`, not by hand.
///
/// # Safety
/// `DESC` names, id by id and slot by slot, the types that the methods use.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is no component class",
    note = "put `#[derive(Component)]` on the struct"
)]
pub unsafe trait Class: Component + Send + Sized + 'static {
    const DESC: &'static ClassDesc;
    /// One row of the state table: the `#[state]` fields.
    type State: Payload;

    /// The rendered description, empty for a class whose ports are all fixed.
    #[doc(hidden)]
    const DESCRIPTION: &'static str = "";

    #[doc(hidden)]
    fn create(host: Host) -> Self;
    /// Returns the handle of a class with `safe_from_any_thread`.
    #[doc(hidden)]
    fn safe_handle(&self) -> Option<Arc<dyn MakeSafe>> {
        None
    }
    #[doc(hidden)]
    fn apply(&mut self, object: &JsonObject) -> Result;
    #[doc(hidden)]
    fn bind(&mut self, binder: &Binder<'_>);
    #[doc(hidden)]
    fn state(&self) -> Self::State;
    #[doc(hidden)]
    fn set_state(&mut self, row: &Self::State);
    #[doc(hidden)]
    fn command(&mut self, id: u32, lists: &Layout, call: &mut Call) -> Status;
    #[doc(hidden)]
    fn read(row: &Self::State, id: u32, call: &mut Call) -> Status;
    #[doc(hidden)]
    fn on_event(&mut self, id: u32, lists: &Layout, call: &mut Call) -> Status;
    /// Returns the lists of names behind the repeated parts.
    #[doc(hidden)]
    fn lists(&self) -> Lists<'_> {
        Lists { inputs: Vec::new(), outputs: Vec::new(), required: Vec::new(), provided: Vec::new() }
    }
}

/// Facts about the cycle for a `step`.
#[derive(Clone, Copy, Debug)]
#[repr(transparent)]
pub struct Tick(pub(crate) abi::Tick);

impl Tick {
    /// Cycle number since Start, from 0; skipped cycles are counted too.
    pub fn cycle(&self) -> u64 {
        self.0.cycle
    }

    /// When this step began.
    pub fn now(&self) -> Stamp {
        Stamp::from_ns(self.0.now_ns)
    }

    /// When it should have begun; equals `now` for components without a grid.
    pub fn deadline(&self) -> Stamp {
        Stamp::from_ns(self.0.deadline_ns)
    }

    /// The nominal period in s; without one, the time since the previous step.
    #[inline]
    pub fn period_s(&self) -> f64 {
        let ns = if self.0.period_ns != 0 { self.0.period_ns } else { self.0.elapsed_ns };
        ns as f64 * 1e-9
    }

    /// Time since the previous step began, s.
    #[inline]
    pub fn elapsed_s(&self) -> f64 {
        self.0.elapsed_ns as f64 * 1e-9
    }
}
