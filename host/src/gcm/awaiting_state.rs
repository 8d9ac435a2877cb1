//! Waiting for a component to reach a state.
//!
//! Invariant: the waiting ends by its deadline, and at once when the state cannot come: the component is
//! removed, or goes into FAULT.

use std::sync::Arc;
use std::time::Instant;

use trocar_lcm_api::clock;
use trocar_model::{ComponentId, Refusal, State, SystemGraph};

use super::Gcm;

impl Gcm {
    /// Waits until a component is in one of the states.
    ///
    /// # Errors
    /// ComponentNotFound, also when it is removed meanwhile; NotReached at the deadline; ComponentFault at
    /// once when it goes into FAULT and nobody waits for that.
    pub async fn wait_for(
        &self,
        id: &ComponentId,
        states: &[State],
        deadline: Instant,
    ) -> Result<Arc<SystemGraph>, Refusal> {
        let began = clock::now();
        let mut graphs = self.watch();
        loop {
            let graph = graphs.borrow_and_update().clone();
            let Some(component) = graph.components.get(id) else {
                return Err(Refusal::ComponentNotFound {
                    id: id.clone(),
                    known: graph.components.keys().cloned().collect(),
                });
            };
            if states.contains(&component.state) {
                return Ok(graph);
            }
            if component.state == State::Fault {
                return Err(Refusal::ComponentFault { id: id.clone(), text: component.fault.clone() });
            }
            let state = component.state;
            if !matches!(tokio::time::timeout_at(deadline.into(), graphs.changed()).await, Ok(Ok(()))) {
                let after_ns = given_ns(began, deadline);
                return Err(Refusal::NotReached { id: id.clone(), state, wanted: states.to_vec(), after_ns });
            }
        }
    }
}

/// Returns the time a caller was given, as it is told: whole ms, where there are any.
pub(crate) fn given_ns(began: Instant, deadline: Instant) -> u64 {
    let given = deadline.saturating_duration_since(began);
    let ms = (given.as_secs_f64() * 1e3).round() as u64;
    if ms > 0 { ms * 1_000_000 } else { given.subsec_nanos().into() }
}
