//! The services' methods: take a request apart, ask the GCM or an LCM, put the answer together.

mod gcm;
mod interact;
mod logs;
mod plugin;
mod watch;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

use tonic::Status;
use trocar_model::{ComponentId, Name, Refusal, SystemGraph};

use super::convert::Figures;
use super::status::status;
use crate::gcm::{Gcm, Lines};
use crate::lcm::Lcm;

/// Whom this port speaks for.
#[derive(Clone)]
pub(super) struct Edge {
    pub(super) gcm: Option<Gcm>,
    pub(super) local: Option<(Name, Arc<dyn Lcm>)>,
    /// Address of the GCM that manages this process.
    pub(super) managed_by: Option<String>,
    /// What was logged here: by every process of a GCM, by this one otherwise.
    pub(super) lines: Arc<Lines>,
}

impl Edge {
    /// The GCM of this port.
    fn gcm(&self) -> Result<&Gcm, Status> {
        self.gcm.as_ref().ok_or_else(|| {
            let at = self.managed_by.clone().unwrap_or_default();
            status(&Refusal::ManagedElsewhere { at })
        })
    }

    /// The LCM of a process: any process for a GCM, this one otherwise.
    fn lcm(&self, process: &Name) -> Result<Arc<dyn Lcm>, Refusal> {
        if let Some(gcm) = &self.gcm {
            return gcm.lcm_of(process);
        }
        match &self.local {
            Some((name, lcm)) if name == process => Ok(lcm.clone()),
            local => Err(Refusal::ProcessNotFound {
                process: process.clone(),
                known: local.iter().map(|(name, _)| name.clone()).collect(),
            }),
        }
    }

    /// Every process whose LCM can be asked.
    fn processes(&self) -> Vec<Name> {
        match (&self.gcm, &self.local) {
            (Some(gcm), _) => gcm.graph().processes.keys().cloned().collect(),
            (None, Some((name, _))) => vec![name.clone()],
            (None, None) => Vec::new(),
        }
    }

    /// Live figures of `ids` and of all connections; what cannot be had in time is a warning, not a failure.
    async fn figures(&self, graph: &SystemGraph, ids: &[ComponentId], deadline: Instant) -> Figures {
        let mut figures = Figures::default();
        let mut by_process: BTreeMap<&Name, Vec<&ComponentId>> = BTreeMap::new();
        for id in ids {
            by_process.entry(&id.process).or_default().push(id);
        }
        for process in graph.processes.keys() {
            let Ok(lcm) = self.lcm(process) else { continue };
            let asked = async {
                for id in by_process.get(process).into_iter().flatten() {
                    match lcm.detail((*id).clone()).await {
                        Ok(detail) => _ = figures.details.insert((*id).clone(), detail),
                        Err(refusal) => figures.warnings.push(refusal.to_string()),
                    }
                }
                for link in lcm.links().await? {
                    figures.links.insert(link.connection, link);
                }
                Ok::<(), Refusal>(())
            };
            match tokio::time::timeout_at(deadline.into(), asked).await {
                Ok(Ok(())) => {}
                Ok(Err(refusal)) => figures.warnings.push(refusal.to_string()),
                Err(_) => figures.warnings.push(format!("process {process} did not give its figures in time")),
            }
        }
        figures
    }
}

/// Refusals leave as statuses.
fn refuse(refusal: Refusal) -> Status {
    status(&refusal)
}

/// An RPC that is declared and not built yet.
fn not_built(what: &str, hint: &str) -> Status {
    status(&Refusal::NotImplemented { what: what.into(), hint: hint.into() })
}
