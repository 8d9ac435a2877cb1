//! The component class, as `#[derive(Component)]` implements it.
//!
//! Invariant: `DESC` and the methods are written in one pass over the same fields, so ids and slots agree.

use crate::binder::Binder;
use crate::call::Call;
use crate::component::Component;
use crate::config::JsonObject;
use crate::error::Result;
use crate::host::Host;
use crate::lists::{Layout, Lists};
use crate::payload::Payload;
use crate::safe::MakeSafe;
use std::sync::Arc;
use trocar_plugin_api::abi::Status;
use trocar_plugin_api::desc::ClassDesc;

/// A component class: made by `#[derive(Component)]`, not by hand.
///
/// # Safety
/// `DESC` names, id by id and slot by slot, the types that the methods use.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is no component class",
    note = "put `#[derive(Component)]` on the struct"
)]
pub unsafe trait Class: Component + Send + Sized + 'static {
    /// The description that the manifest is written from.
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
