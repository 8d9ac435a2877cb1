//! Remove: refused while something depends on the component, unless forced. Forget: all of a process that has
//! ended.
//!
//! Invariant: a component is stopped before its connections are taken away, so that it stops on request and
//! does not first lose its peers; no connection outlives one of its ends.

use super::{Planner, host_of};
use crate::{Change, ComponentId, Connection, Name, ProcessState, Refusal, State, Verb};

impl Planner {
    pub(super) fn remove(&mut self, id: &ComponentId, force: bool) -> Result<(), Refusal> {
        self.graph.component(id)?;
        self.graph.attached(&id.process)?;
        let touches = |c: &&Connection| c.client.component == *id || c.server.component == *id;
        let connections: Vec<Connection> = self.graph.connections.values().filter(touches).cloned().collect();
        let rides = |other: &ComponentId| {
            self.graph.components.get(other).is_some_and(|c| host_of(&c.execution).as_ref() == Some(id))
        };
        let riders: Vec<ComponentId> =
            self.graph.components.keys().filter(|other| *other != id && rides(other)).cloned().collect();
        let used = !connections.is_empty() || !riders.is_empty();
        if used && !force {
            let wires =
                connections.iter().map(|c| format!("connection {} ({} → {})", c.id.0, c.server, c.client));
            let threads = riders.iter().map(|r| format!("{r}, which runs in its thread"));
            return Err(Refusal::InUse { id: id.clone(), by: wires.chain(threads).collect() });
        }
        for other in riders.iter().chain([id]) {
            if self.graph.components.get(other).is_some_and(|c| c.state == State::Active) {
                self.push_run(other, Verb::Stop, State::Active);
            }
        }
        for connection in connections {
            self.push(Change::Disconnect { connection, replaced: false });
        }
        let component = Box::new(self.graph.component(id)?.clone());
        self.push(Change::Destroy { id: id.clone(), component });
        Ok(())
    }

    /// Forgets a process: it leaves together with its components; that is no change of a component.
    pub(super) fn forget(&mut self, process: &Name) -> Result<(), Refusal> {
        let there = self.graph.process(process)?;
        if matches!(there.state, ProcessState::Attached | ProcessState::Restarting) {
            let (state, pid) = (there.state, there.pid);
            return Err(Refusal::ProcessRuns { process: process.clone(), state, pid });
        }
        let ends_here = |c: &&Connection| c.ends_in(process);
        let connections: Vec<Connection> =
            self.graph.connections.values().filter(ends_here).cloned().collect();
        for connection in connections {
            self.push(Change::Disconnect { connection, replaced: false });
        }
        let its: Vec<ComponentId> =
            self.graph.components.keys().filter(|id| id.process == *process).cloned().collect();
        for id in its {
            let component = Box::new(self.graph.component(&id)?.clone());
            self.push(Change::Destroy { id, component });
        }
        Ok(())
    }
}
