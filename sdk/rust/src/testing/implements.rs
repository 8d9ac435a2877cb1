//! Proof that a class fulfils the contract of a standard device.
//!
//! Invariant: the bench compares as a host does, by the description of the class.

use super::bench::Bench;
use super::manifest::description;
use crate::class::Class;
use trocar_plugin_api::contracts::{self, Contract};
use trocar_plugin_api::manifest::Description;

/// Fails the test, with every difference, unless the class fulfils the contract of a standard device.
///
/// ```no_run
/// use trocar_sdk::testing::{assert_implements, contracts};
/// # use trocar_sdk::prelude::*;
/// # #[derive(Component)] struct EyeRobot {}
/// # impl Component for EyeRobot {}
/// assert_implements::<EyeRobot>(&contracts::ARM);
/// ```
#[track_caller]
pub fn assert_implements<C: Class>(contract: &Contract) {
    assert_implements_as::<C>(contract, "");
}

/// Checks as [`assert_implements`] does, where the device is behind the interface of this name: one of
/// several of its kind.
#[track_caller]
pub fn assert_implements_as<C: Class>(contract: &Contract, interface: &str) {
    fulfils(&description(C::DESC), contract, interface);
}

impl<C: Class> Bench<C> {
    /// Checks as [`assert_implements_as`] does the interfaces the component has now: with its present
    /// configuration.
    #[track_caller]
    pub fn assert_implements_as(&self, contract: &Contract, interface: &str) {
        fulfils(self.shape.description(), contract, interface);
    }
}

#[track_caller]
fn fulfils(described: &Description, contract: &Contract, interface: &str) {
    let Description { types, class } = described;
    let violations = contracts::check_class(types, class, contract, interface);
    let told: Vec<String> = violations.iter().map(|v| format!("\n- {v}")).collect();
    assert!(
        told.is_empty(),
        "class `{}` is no `{}` (docs/INTERFACES.md):{}",
        class.name,
        contract.name,
        told.concat()
    );
}
