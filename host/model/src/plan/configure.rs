//! Configure: a merge patch on the present configuration, and a change of the thread, checked whole.
//!
//! Invariant: a running component only ever sees changes of settings its class declares live; its execution
//! changes only while neither it nor another component in its thread runs.

use serde_json::Value;

use super::circle::check_circles;
use super::wire::default_max_age;
use super::{Planner, carrier, execution, host_of};
use crate::{
    Change, Component, ComponentId, Connection, Execution, Refusal, Safety, State, Verb, allowed, complete,
    live_only, live_settings, merge, transition, unknown_nulls, validate,
};

impl Planner {
    pub(super) fn configure(
        &mut self,
        id: &ComponentId,
        patch: &Value,
        asked: Option<&Execution>,
    ) -> Result<(), Refusal> {
        let component = self.graph.component(id)?;
        self.graph.attached(&id.process)?;
        let (schema, state) = (&component.class.config_schema, component.state);
        let wrong = |why: String| wrong_state(id, state, why);
        let Some(to_state) = transition(state, Verb::Configure) else {
            return Err(wrong(component.fault.clone()));
        };
        let execution = asked.map(|asked| self.execution(id, asked)).transpose()?.flatten();
        let merged = merge(&component.config, patch);
        let to = if merged.is_object() { complete(schema, merged) } else { merged };
        // Violations come first that are wrong in any state: a running device should not be stopped over a
        // misspelt name.
        let mut violations = validate(schema, &to);
        violations.extend(unknown_nulls(schema, &component.config, patch));
        // A thread can be chosen before the configuration is complete.
        let only_execution = execution.is_some() && to == component.config;
        let open = state == State::Created && only_execution;
        if !violations.is_empty() && !open {
            return Err(Refusal::ConfigInvalid { id: id.clone(), violations });
        }
        if state == State::Active {
            if execution.is_some() {
                return Err(wrong("its execution cannot change while it runs".to_owned()));
            }
            if let Err(fixed) = live_only(schema, &component.config, &to) {
                let live = live_settings(schema);
                let live = if live.is_empty() { "none".to_owned() } else { live.join(", ") };
                return Err(wrong(format!(
                    "{} cannot change while it runs (live settings: {live})",
                    fixed.join(", ")
                )));
            }
        }
        let from = component.config.clone();
        if let Some(execution) = execution {
            return self.make_anew(id, execution, (!open).then_some(to));
        }
        if to != from || to_state != state {
            self.push(Change::Configure { id: id.clone(), from, to, from_state: state, to_state });
        }
        Ok(())
    }

    /// Returns the new execution, if it is different.
    fn execution(&self, id: &ComponentId, asked: &Execution) -> Result<Option<Execution>, Refusal> {
        let component = self.graph.component(id)?;
        let after = execution::change(&component.class.execution, &component.execution, asked);
        execution::check_cycle(&self.graph, id, &after)?;
        execution::check(&self.graph, "Configure", id, &component.class, &after)?;
        Ok((component.execution != after).then_some(after))
    }

    /// Destroys the component and those that run in its thread, and makes them anew with the configurations
    /// and connections they had; `config` is the component's own, if it has one by now.
    fn make_anew(
        &mut self,
        id: &ComponentId,
        execution: Execution,
        config: Option<Value>,
    ) -> Result<(), Refusal> {
        let moved = self.thread_of(id)?;
        let touches =
            |c: &&Connection| moved.iter().any(|(m, _)| c.client.component == *m || c.server.component == *m);
        let connections: Vec<Connection> = self.graph.connections.values().filter(touches).cloned().collect();
        // An age that was the default follows the new period.
        let is_default = |c: &Connection| {
            c.options.max_age_ns.is_some() && c.options.max_age_ns == default_max_age(&self.graph, c)
        };
        let by_default: Vec<bool> = connections.iter().map(is_default).collect();
        for connection in &connections {
            self.spare_actuators(id, connection)?;
            self.push(Change::Disconnect { connection: connection.clone(), replaced: false });
        }
        for (id, component) in moved.iter().rev() {
            if component.state != State::Created {
                self.turn(id, component, component.config.clone(), component.state, State::Created);
            }
            let created = Component { state: State::Created, ..component.clone() };
            self.push(Change::Destroy { id: id.clone(), component: Box::new(created) });
        }
        for (other, component) in &moved {
            let mut created = Component { state: State::Created, ..component.clone() };
            if other == id {
                created.execution = execution.clone();
            } else if let Err(why) = execution::check_thread(&self.graph, &component.execution)
                .and_then(|()| execution::check_limits(&self.graph, &component.class, &component.execution))
            {
                return Err(Refusal::InUse { id: id.clone(), by: vec![format!("{other}: {why}")] });
            }
            self.push(Change::Create { id: other.clone(), component: Box::new(created) });
            let config = match other == id {
                true => config.clone(),
                false => (component.state != State::Created).then(|| component.config.clone()),
            };
            if let Some(config) = config {
                self.turn(other, component, config, State::Created, State::Ready);
            }
        }
        for (mut connection, by_default) in connections.into_iter().zip(by_default) {
            if by_default {
                connection.options.max_age_ns = default_max_age(&self.graph, &connection);
            }
            carrier::check(&self.graph, &format!("Configure {id}: connection of"), &connection)?;
            self.push(Change::Connect { connection });
        }
        check_circles(&self.graph)
    }

    /// Returns the component and all that run in its thread, hosts first; none of them may run or be in
    /// FAULT.
    fn thread_of(&self, id: &ComponentId) -> Result<Vec<(ComponentId, Component)>, Refusal> {
        let mut moved = vec![(id.clone(), self.graph.component(id)?.clone())];
        let mut at = 0;
        while let Some((host, _)) = moved.get(at).cloned() {
            for (other, component) in &self.graph.components {
                if host_of(&component.execution).as_ref() != Some(&host)
                    || moved.iter().any(|(m, _)| m == other)
                {
                    continue;
                }
                if matches!(component.state, State::Active | State::Fault) {
                    let why = format!("it runs in the thread of `{id}`, whose execution is to change");
                    return Err(wrong_state(other, component.state, why));
                }
                moved.push((other.clone(), component.clone()));
            }
            at += 1;
        }
        Ok(moved)
    }

    /// Refuses to part a running actuator from a connection it requires: it would stop.
    fn spare_actuators(&self, id: &ComponentId, connection: &Connection) -> Result<(), Refusal> {
        let client = &connection.client.component;
        let runs = self.graph.components.get(client).filter(|c| c.state == State::Active);
        match runs {
            Some(c)
                if c.class.safety == Safety::Actuator
                    && c.ports.requires(connection.client.port.as_str()) =>
            {
                let why = format!("it is an actuator and requires `{id}`, whose execution is to change");
                Err(wrong_state(client, State::Active, why))
            }
            _ => Ok(()),
        }
    }

    fn turn(&mut self, id: &ComponentId, was: &Component, to: Value, from_state: State, to_state: State) {
        let from = was.config.clone();
        self.push(Change::Configure { id: id.clone(), from, to, from_state, to_state });
    }
}

fn wrong_state(id: &ComponentId, state: State, why: String) -> Refusal {
    Refusal::WrongState { id: id.clone(), state, verb: Verb::Configure, allowed: allowed(state), why }
}
