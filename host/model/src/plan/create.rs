//! Create: an instance, and its configuration when that is complete.
//!
//! Invariant: without a configuration the schema's defaults are taken, and open settings keep the component
//! in CREATED; a configuration that was given must be valid.

use std::sync::Arc;

use serde_json::{Map, Value};

use super::{Planner, execution};
use crate::{
    Change, Component, ComponentId, Execution, Health, Name, Refusal, State, complete, defaults, merge,
    unknown_nulls, validate,
};

impl Planner {
    pub(super) fn create(
        &mut self,
        id: &ComponentId,
        class: &str,
        config: Option<&Value>,
        asked: &Execution,
    ) -> Result<(), Refusal> {
        self.graph.attached(&id.process)?;
        let class = self.graph.class(&id.process, class)?;
        if self.graph.components.contains_key(id) {
            return Err(Refusal::ComponentExists { id: id.clone() });
        }
        class.is_let_into(&id.process)?;
        let execution = execution::overlay(&class.execution, asked);
        execution::check_cycle(&self.graph, id, &execution)?;
        let schema = &class.config_schema;
        let whole = match config {
            None => defaults(schema),
            // Merged onto nothing, so that null means the same as in Configure: the default.
            Some(given @ Value::Object(_)) => complete(schema, merge(&Value::Object(Map::new()), given)),
            Some(other) => other.clone(),
        };
        let mut violations = validate(schema, &whole);
        violations.extend(config.iter().flat_map(|given| unknown_nulls(schema, &Value::Null, given)));
        if config.is_some() && !violations.is_empty() {
            return Err(Refusal::ConfigInvalid { id: id.clone(), violations });
        }
        execution::check(&self.graph, "Create", id, &class, &execution)?;
        let component = Component {
            ports: Arc::new(class.ports.clone()),
            class,
            config: whole.clone(),
            execution,
            state: State::Created,
            health: Health::Ok,
            fault: String::new(),
        };
        self.push(Change::Create { id: id.clone(), component: Box::new(component) });
        if violations.is_empty() {
            self.push(Change::Configure {
                id: id.clone(),
                from: whole.clone(),
                to: whole,
                from_state: State::Created,
                to_state: State::Ready,
            });
        }
        Ok(())
    }

    /// Creates in a process that is there as soon as the plan is carried out, with the classes of `home`.
    pub(super) fn create_isolated(
        &mut self,
        id: &ComponentId,
        home: &Name,
        class: &str,
        config: Option<&Value>,
        asked: &Execution,
    ) -> Result<(), Refusal> {
        let like = self.graph.attached(home)?.clone();
        self.graph.class(home, class)?;
        let written = ComponentId::new(home.clone(), id.component.clone());
        if let Some(taken) = [&written, id].into_iter().find(|id| self.graph.components.contains_key(id)) {
            return Err(Refusal::ComponentExists { id: taken.clone() });
        }
        if let Some(holder) = self.graph.processes.get(&id.process) {
            let (process, endpoint, pid) = (id.process.clone(), holder.endpoint.clone(), holder.pid);
            return Err(Refusal::ProcessExists { process, endpoint, pid });
        }
        self.graph.processes.insert(id.process.clone(), like);
        self.create(id, class, config, asked)
    }
}
