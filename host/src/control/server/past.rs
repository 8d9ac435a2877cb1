//! Stop at the port of a host whose GCM is in another process: components of this process are stopped here,
//! whether that GCM answers or not.
//!
//! Invariant: this path only ever stops. Until the GCM has heard of it, and made it a Stop of its own,
//! nothing that it names is set in motion.

use std::sync::Arc;

use tonic::{Request, Status};
use trocar_model::{ComponentId, Name, Refusal, Target};
use trocar_proto::v1;

use super::identity::identity;
use super::refuse;
use crate::control::convert;
use crate::control::deadline::{deadline, room};
use crate::lcm::{Decision, Halted, Lcm, Order, Report, Stop};

/// Stops the components of `process` that the request names.
///
/// # Errors
/// All paths name nothing here; the LCM does not answer.
pub(super) async fn stop(
    process: &Name,
    lcm: &Arc<dyn Lcm>,
    request: Request<v1::StopRequest>,
) -> Result<v1::StopResponse, Status> {
    let (until, who) = (deadline(&request), identity(&request));
    let r = request.into_inner();
    let convert::ToStop { targets, unread } = convert::to_stop(r.paths, r.path).map_err(refuse)?;
    let there = async || {
        let there = lcm.inventory().await.map_err(refuse)?.components;
        Ok::<Vec<ComponentId>, Status>(there.into_iter().map(|c| c.id).collect())
    };
    let mut answer = v1::StopResponse::default();
    let failed = |path: String, refusal: &Refusal| v1::SkippedComponent { path, why: refusal.to_string() };
    answer.failed.extend(unread.into_iter().map(|(path, refusal)| failed(path, &refusal)));
    if r.validate_only {
        let known = there().await?;
        answer
            .failed
            .extend(strange(process, &targets, &known).map(|(path, refusal)| failed(path, &refusal)));
        let named = known.iter().filter(|id| targets.iter().any(|target| target.names(id)));
        answer.plan = named.map(|id| format!("- stop {id}, if it runs")).collect();
        return Ok(answer);
    }
    let order = Order { decision: Decision::HERE, ..Order::from(until - room(until)) };
    let stop = Stop { targets: targets.clone(), known_here: 0 };
    // Acts first: a component that is only being made is held off, too.
    let halted = lcm.stop(stop, order).await.map_err(refuse)?;
    let known = there().await?;
    let strange: Vec<(String, Refusal)> = strange(process, &targets, &known).collect();
    if let Some((_, refusal)) = strange.first().filter(|_| strange.len() == targets.len()) {
        return Err(refuse(refusal.clone()));
    }
    answer.failed.extend(strange.into_iter().map(|(path, refusal)| failed(path, &refusal)));
    let mut stopped = 0;
    for Halted { id, was, done } in halted {
        match done {
            Ok(report) if was == report.state => {}
            Ok(report) => {
                stopped += 1;
                answer.plan.push(format!("- stop {id}"));
                answer.components.push(convert::report(&Report { ports: None, ..report }));
            }
            Err(refusal) => answer.failed.push(failed(id.to_string(), &refusal)),
        }
    }
    log::info!(target: "audit", "{who} asked Stop at this host, past its GCM: {stopped} stopped");
    answer.warnings = vec![
        "it was stopped at its host, past the GCM: nothing moves again before the GCM has heard of it".into(),
    ];
    Ok(answer)
}

/// The targets that are a mistake here.
fn strange<'t>(
    process: &'t Name,
    targets: &'t [Target],
    known: &'t [ComponentId],
) -> impl Iterator<Item = (String, Refusal)> + 't {
    targets.iter().filter_map(|target| Some((target.to_string(), is_here(process, target, known).err()?)))
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
