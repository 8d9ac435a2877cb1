//! Stops the components here without a plan: when the GCM is elsewhere, or when there is none.
//!
//! Invariant: one component that cannot be stopped keeps no other from being stopped.

use std::sync::Arc;
use std::time::Instant;

use tokio::task::JoinSet;
use trocar_model::{Change, ComponentId, Refusal, State, StopReason, Verb};

use trocar_lcm_api::{Lcm, Report};

/// The outcome of one component.
pub type Stopped = (ComponentId, Result<Report, Refusal>);

/// Stops every ACTIVE component that `which` names, all at once; returns the results in the order of their
/// names.
///
/// # Errors
/// The LCM does not tell its components.
pub async fn stop_active(
    lcm: &Arc<dyn Lcm>,
    which: impl Fn(&ComponentId) -> bool,
    deadline: Instant,
) -> Result<Vec<Stopped>, Refusal> {
    let there = lcm.inventory().await?.components;
    let mut stopping = JoinSet::new();
    for id in there.into_iter().filter(|c| c.state == State::Active).map(|c| c.id).filter(which) {
        let (lcm, to) = (lcm.clone(), State::Stopped(StopReason::Requested));
        let stop = Change::Run { id: id.clone(), verb: Verb::Stop, from: State::Active, to };
        stopping.spawn(async move { (id, lcm.apply(stop, deadline).await) });
    }
    let mut all = Vec::new();
    while let Some(stopped) = stopping.join_next().await {
        match stopped {
            Ok(stopped) => all.push(stopped),
            Err(e) => log::error!("stopping a component panicked: {e}"),
        }
    }
    all.sort_by(|a, b| a.0.cmp(&b.0));
    Ok(all)
}
