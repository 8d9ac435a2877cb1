//! Methods that a component's author implements, and what a step is told of its cycle.
//!
//! Invariant: the host enters one instance from one thread at a time, so methods take `&mut self` and need no
//! locks.

use crate::error::Result;
use crate::services::ServiceReply;
use crate::values::Stamp;
use trocar_plugin_api::abi;

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
    /// Ends the run: on Stop, after the last step. Run-time state stays, for `resume`.
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
    /// belongs to them. Called after `configure` or [`crate::Host::ports_changed`], between two steps, when a
    /// list has changed.
    fn ports_changed(&mut self) {}
    /// The answer to a service asked for with [`crate::Host::services`] or [`crate::Host::service`].
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
