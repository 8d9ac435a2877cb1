//! What is seen of a lab: the graph, states, rows, figures, events.
//!
//! Invariant: asks the host only; nothing is estimated.

use std::sync::Arc;
use std::time::Duration;

use serde_json::Value;
use trocar::lcm::{Detail, Inventory, Item, Lcm, LinkDetail, Sample, When};
use trocar::model::{ClassInfo, Health, Refusal, State, SystemGraph};

use super::Lab;
use super::answer::whole;
use super::world::{PATIENCE, block_on};
use crate::eventually;

impl Lab {
    #[must_use]
    pub fn graph(&self) -> Arc<SystemGraph> {
        self.gcm().graph()
    }

    /// A class that the host offers, as `plugin/class`.
    #[track_caller]
    #[must_use]
    pub fn class(&self, full_name: &str) -> Arc<ClassInfo> {
        eventually(full_name, || {
            let all = self.inventory().classes;
            let found = all.iter().find(|c| c.full_name() == full_name);
            found.cloned().ok_or_else(|| all.iter().map(|c| c.full_name()).collect::<Vec<_>>().join(" "))
        })
    }

    /// # Errors
    /// It is not reached in time, or cannot be any more.
    pub fn wait_for(&self, name: &str, state: State, within: Duration) -> Result<(), Refusal> {
        block_on(self.host().wait_for(&self.path(name), state, within))
    }

    /// # Errors
    /// It is not sent in time, or cannot be any more.
    pub fn wait_for_event(&self, path: &str, within: Duration) -> Result<Item, Refusal> {
        let item = block_on(self.host().wait_for_event(&self.path(path), within))?;
        Ok(Item { value: self.as_declared(path, item.value), ..item })
    }

    /// Calls a command and waits for the event it leads to.
    ///
    /// # Errors
    /// As of the command, and as of the event.
    pub fn invoke_and_wait(&self, member: &str, arg: Value, event: &str) -> Result<Item, Refusal> {
        let item =
            block_on(self.host().invoke_and_wait(&self.path(member), arg, &self.path(event), PATIENCE))?;
        Ok(Item { value: self.as_declared(event, item.value), ..item })
    }

    /// An earlier row of a component.
    ///
    /// # Errors
    /// It is kept no more, or not there yet.
    pub fn row_at(&self, name: &str, when: When) -> Result<Sample, Refusal> {
        let row = block_on(self.host().read_at(&self.path(name), when))?;
        Ok(Sample { value: self.as_declared(name, row.value), ..row })
    }

    /// Where its gRPC port listens.
    #[must_use]
    pub fn address(&self) -> String {
        self.host().addr().map(|addr| addr.to_string()).unwrap_or_default()
    }

    /// State and health as the GCM knows them.
    #[must_use]
    pub fn stands(&self, name: &str) -> Option<(State, Health)> {
        self.graph().components.get(&self.id(name)).map(|c| (c.state, c.health))
    }

    /// Waits until the GCM knows it in this state.
    #[track_caller]
    pub fn await_state(&self, name: &str, state: State) {
        eventually(&format!("{name} is {state}"), || match self.stands(name) {
            Some((now, _)) if now == state => Ok(()),
            other => Err(format!("{other:?}")),
        });
    }

    /// The last published row of a component.
    #[must_use]
    pub fn row(&self, name: &str) -> Value {
        let path = self.path(name);
        let row = block_on(self.host().read(&path));
        let row = row.unwrap_or_else(|refusal| panic!("the state of {name}: {refusal}"));
        self.as_declared(name, row.value)
    }

    /// A whole number in the last published row.
    #[must_use]
    pub fn count(&self, name: &str, field: &str) -> u64 {
        whole(&self.row(name)[field])
    }

    /// Waits until a whole number of the row satisfies `is`.
    #[track_caller]
    pub fn await_count(&self, name: &str, field: &str, is: impl Fn(u64) -> bool) -> u64 {
        eventually(&format!("{field} of {name}"), || match self.count(name, field) {
            n if is(n) => Ok(n),
            n => Err(n),
        })
    }

    /// What the LCM has.
    #[must_use]
    pub fn inventory(&self) -> Inventory {
        let mut all = Inventory::default();
        for lcm in self.lcms() {
            let one = block_on(lcm.inventory()).unwrap_or_else(|refusal| panic!("no inventory: {refusal}"));
            all.components.extend(one.components);
            all.classes = one.classes;
        }
        all
    }

    /// Commands to this component that were lost: to full queues, or with their connection.
    #[must_use]
    pub fn lost_commands(&self, name: &str) -> u64 {
        self.detail(name).commands_rejected
    }

    /// Warnings that its users see.
    #[must_use]
    pub fn warnings(&self, name: &str) -> Vec<String> {
        self.detail(name).warnings
    }

    fn detail(&self, name: &str) -> Detail {
        let detail = block_on(self.host().detail(&self.path(name)));
        detail.unwrap_or_else(|refusal| panic!("the figures of {name}: {refusal}"))
    }

    /// Figures of all connections; of one between processes each end gives its own.
    #[must_use]
    pub fn links(&self) -> Vec<LinkDetail> {
        let links = |lcm: Arc<dyn Lcm>| block_on(lcm.links());
        let all = self.lcms().into_iter().map(links).collect::<Result<Vec<_>, _>>();
        let all = all.unwrap_or_else(|refusal| panic!("no links: {refusal}"));
        all.into_iter().flatten().collect()
    }

    /// Figures of the connection at this port of a client.
    #[track_caller]
    #[must_use]
    pub fn link(&self, client_port: &str) -> LinkDetail {
        let graph = self.graph();
        let found = graph.connections.values().find(|c| c.client == self.port(client_port));
        let connection = found.unwrap_or_else(|| panic!("{client_port} is not connected")).id.0;
        let link = self.links().into_iter().filter(|l| l.connection == connection).reduce(LinkDetail::merged);
        link.unwrap_or_else(|| panic!("connection {connection} has no figures"))
    }
}
