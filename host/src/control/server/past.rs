//! Stop at the port of a host whose GCM is in another process: components of this process are stopped here,
//! whether that GCM answers or not.
//!
//! Invariant: this path only ever stops. The GCM, if there is one, hears of it like of anything a component
//! does by itself.

use std::sync::Arc;

use tonic::{Request, Status};
use trocar_model::{ComponentId, Name, Refusal, Target};
use trocar_proto::v1;

use super::identity::identity;
use super::refuse;
use crate::control::convert;
use crate::control::deadline::{deadline, room};
use crate::lcm::{Lcm, Report, stop_active};

/// Stops the components of `process` that the request names.
///
/// # Errors
/// The paths name nothing here; the LCM does not answer.
pub(super) async fn stop(
    process: &Name,
    lcm: &Arc<dyn Lcm>,
    request: Request<v1::StopRequest>,
) -> Result<v1::StopResponse, Status> {
    let (until, who) = (deadline(&request), identity(&request));
    let r = request.into_inner();
    let targets = convert::targets("Stop", r.paths, r.path).map_err(refuse)?;
    let there = lcm.inventory().await.map_err(refuse)?.components;
    let known: Vec<ComponentId> = there.into_iter().map(|c| c.id).collect();
    for target in &targets {
        is_here(process, target, &known).map_err(refuse)?;
    }
    let named = |id: &ComponentId| {
        targets.iter().any(|target| match target {
            Target::One(one) => one == id,
            Target::Glob(pattern) => pattern.matches(id),
        })
    };
    if r.validate_only {
        let plan = known.iter().filter(|id| named(id)).map(|id| format!("- stop {id}, if it runs")).collect();
        return Ok(v1::StopResponse { plan, ..Default::default() });
    }
    let stopped = stop_active(lcm, named, until - room(until)).await.map_err(refuse)?;
    log::info!(target: "audit", "{who} asked Stop at this host, past its GCM: {} stopped", stopped.len());
    let mut answer = v1::StopResponse {
        warnings: vec!["it was stopped at its host, past the GCM, which hears of it afterwards".to_owned()],
        ..Default::default()
    };
    for (id, done) in stopped {
        match done {
            Ok(report) => {
                answer.plan.push(format!("- stop {id}"));
                answer.components.push(convert::report(&Report { ports: None, ..report }));
            }
            Err(refusal) => {
                let (path, why) = (id.to_string(), refusal.to_string());
                answer.failed.push(v1::SkippedComponent { path, why });
            }
        }
    }
    Ok(answer)
}

/// A glob may match nothing; a name that is no component of this process is a mistake.
fn is_here(process: &Name, target: &Target, known: &[ComponentId]) -> Result<(), Refusal> {
    let Target::One(id) = target else { return Ok(()) };
    if id.process != *process {
        return Err(Refusal::ProcessNotFound { process: id.process.clone(), known: vec![process.clone()] });
    }
    if known.contains(id) {
        return Ok(());
    }
    Err(Refusal::ComponentNotFound { id: id.clone(), known: known.to_vec() })
}
