//! The components that go with the program that made them.
//!
//! Invariant: a component has one holder, the last that asked. A component that was removed otherwise is held
//! no more, so a later component of its name is never removed for an earlier one.

use std::collections::{BTreeMap, BTreeSet};

use tokio::sync::watch;
use trocar_model::{ComponentId, Refusal};

/// Most components that are held; each costs little, but a script that holds in a loop should be told.
const MOST: usize = 1024;

/// The holds there are; a hold whose sender is gone is over.
#[derive(Default)]
pub(super) struct Holds(BTreeMap<ComponentId, watch::Sender<()>>);

impl Holds {
    /// Components that come and go with programs.
    pub(super) fn all(&self) -> BTreeSet<ComponentId> {
        self.0.keys().cloned().collect()
    }

    /// Holds a component; the hold is over when the receiver is closed. This ends the hold before it.
    ///
    /// # Errors
    /// There are too many holds.
    pub(super) fn hold(&mut self, component: &ComponentId) -> Result<watch::Receiver<()>, Refusal> {
        if self.0.len() >= MOST && !self.0.contains_key(component) {
            return Err(Refusal::ArgumentInvalid {
                what: "Hold".into(),
                why: format!(
                    "{MOST} components are held in this system, which is the most: end some of those calls"
                ),
                field: "component".into(),
            });
        }
        let (sender, over) = watch::channel(());
        self.0.insert(component.clone(), sender);
        Ok(over)
    }

    /// The component was removed.
    pub(super) fn removed(&mut self, id: &ComponentId) {
        self.0.remove(id);
    }
}
