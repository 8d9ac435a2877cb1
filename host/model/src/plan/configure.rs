//! Configure: a merge patch on the present configuration, checked whole.
//!
//! Invariant: a running component only ever sees changes of settings its class declares live.

use serde_json::Value;

use super::Planner;
use crate::{
    Change, ComponentId, Refusal, State, Verb, allowed, complete, live_only, live_settings, merge,
    transition, validate,
};

impl Planner {
    pub(super) fn configure(&mut self, id: &ComponentId, patch: &Value) -> Result<(), Refusal> {
        let component = self.graph.component(id)?;
        self.graph.attached(&id.process)?;
        let (schema, state) = (&component.class.config_schema, component.state);
        let wrong = |why: String| Refusal::WrongState {
            id: id.clone(),
            state,
            verb: Verb::Configure,
            allowed: allowed(state),
            why,
        };
        let Some(to_state) = transition(state, Verb::Configure) else {
            return Err(wrong(component.fault.clone()));
        };
        let merged = merge(&component.config, patch);
        let to = if merged.is_object() { complete(schema, merged) } else { merged };
        // First what is wrong in any state: nobody should stop a running device over a misspelt name.
        let violations = validate(schema, &to);
        if !violations.is_empty() {
            return Err(Refusal::ConfigInvalid { id: id.clone(), violations });
        }
        if state == State::Active
            && let Err(fixed) = live_only(schema, &component.config, &to)
        {
            let live = live_settings(schema);
            let live = if live.is_empty() { "none".to_owned() } else { live.join(", ") };
            return Err(wrong(format!(
                "{} cannot change while it runs (live settings: {live})",
                fixed.join(", ")
            )));
        }
        if to == component.config && to_state == state {
            return Ok(());
        }
        let from = component.config.clone();
        self.push(Change::Configure { id: id.clone(), from, to, from_state: state, to_state });
        Ok(())
    }
}
