//! Making a device safe while its component cannot be entered: the handle stands beside the component, not in
//! it.
//!
//! Invariant: a handle is taken once, right after the component is made and before anybody enters it; from
//! then on making safe touches nothing of the component, so it may run beside any entry that hangs.

use crate::component::Component;
use crate::error::Result;
use std::sync::Arc;

/// Brings a device to its safe condition from any thread, at any time, beside anything else that runs in the
/// component.
///
/// The type holds what is made for several threads: atomics, the handle of a library that allows it. The call
/// is short, right when made twice, at the same time from two threads, and before the device is open; it
/// never waits, also for no lock that the component holds while it talks to the device. A panic is contained
/// and counts as failed.
pub trait MakeSafe: Send + Sync + 'static {
    /// Brings the device to its safe condition, once more if it is there. Any thread; short, never waits.
    ///
    /// # Errors
    /// Why the device is not at rest; an actuator is then in FAULT with this sentence.
    fn make_safe(&self) -> Result;
}

/// Takes the place of [`Component::make_safe`] in a class with `#[component(safe_from_any_thread)]`;
/// `make_safe` is not called for such a class: Stop, FAULT, a lost peer and the watchdog all use its handle.
///
/// ```
/// use std::sync::{Arc, atomic::{AtomicBool, Ordering}};
/// use trocar_sdk::prelude::*;
///
/// /// Shared between the component and whoever makes it safe.
/// #[derive(Default)]
/// struct Brake { closed: AtomicBool }
///
/// impl MakeSafe for Brake {
///     fn make_safe(&self) -> Result {
///         self.closed.store(true, Ordering::Release);
///         Ok(())
///     }
/// }
///
/// #[derive(Component)]
/// #[component(rate_hz = 1000, safety = "actuator", hardware, safe_from_any_thread)]
/// struct Axis { brake: Arc<Brake> }
///
/// impl SafeFromAnyThread for Axis {
///     fn safe_handle(&self) -> Arc<dyn MakeSafe> { self.brake.clone() }
/// }
/// impl Component for Axis {}
/// ```
/// Without a handle such a class does not compile:
/// ```compile_fail,E0277
/// use trocar_sdk::prelude::*;
/// #[derive(Component)]
/// #[component(rate_hz = 1000, safe_from_any_thread)]
/// struct Axis {}
/// impl Component for Axis {}
/// ```
#[diagnostic::on_unimplemented(
    message = "`{Self}` is `safe_from_any_thread` and has no handle that makes it so",
    label = "needs `impl SafeFromAnyThread`",
    note = "another thread may not touch a component that hangs: move what `make_safe` does into a type of its own, \
            `impl MakeSafe` for that, keep it in an `Arc` field, and hand out a clone in \
            `impl SafeFromAnyThread for {Self} {{ fn safe_handle(&self) -> Arc<dyn MakeSafe> }}`",
    note = "`Component::make_safe` is not called for such a class"
)]
pub trait SafeFromAnyThread: Component {
    /// Called once, right after the component is made: with its fields as `Default` gives them, before
    /// `configure`. A device that is opened later (in `start`) goes into the handle then.
    fn safe_handle(&self) -> Arc<dyn MakeSafe>;
}
