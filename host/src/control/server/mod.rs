//! The services' methods: take a request apart, ask the GCM or an LCM, put the answer together.

mod commanded;
mod gcm;
mod guest;
mod identity;
mod interact;
mod list;
mod logs;
mod page;
mod part;
mod past;
mod plugin;
mod standing;
mod system;
mod wait;
mod watch;

pub(super) use commanded::Commanded;
pub(super) use interact::FOLLOWED;
#[cfg(test)]
pub(super) use standing::STANDING;
pub(super) use standing::Standing;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::Semaphore;
use tokio::sync::watch::Receiver;
use tokio::task::JoinSet;
use tonic::{Extensions, Status};
use trocar_model::{ComponentId, Connection, Name, Refusal};

use super::caller::OnlyReads;
use super::convert::Figures;
use super::status::status;
use crate::gcm::{Gcm, Lines};
use crate::lcm::{Detail, Lcm, LinkDetail};

/// Time for live figures; a list is not held up longer.
const FIGURES: Duration = Duration::from_secs(1);
/// Most components in one question for figures: its answer is far below what a message may have.
const AT_ONCE: usize = 1024;

/// The component a request comes from, when it never left this process.
#[derive(Clone)]
pub(super) struct Caller(pub(super) String);

/// Whom this port speaks for.
#[derive(Clone)]
pub(super) struct Edge {
    pub(super) gcm: Option<Gcm>,
    pub(super) local: Option<(Name, Arc<dyn Lcm>)>,
    /// Address of the GCM that manages this process.
    pub(super) managed_by: Option<String>,
    /// Log lines kept here: of every process on a GCM, of this process otherwise.
    pub(super) lines: Arc<Lines>,
    /// One permit for each output or event that can still be followed here.
    pub(super) followed: Arc<Semaphore>,
    /// Places for calls that stay open here.
    pub(super) standing: Arc<Standing>,
    /// Commands of actuators that were asked of late.
    pub(super) commanded: Commanded,
    /// Closes when this port closes: calls that wait for something end then.
    pub(super) closing: Receiver<()>,
}

impl Edge {
    /// The GCM of this port.
    fn gcm(&self) -> Result<&Gcm, Status> {
        self.gcm.as_ref().ok_or_else(|| {
            let at = self.managed_by.clone().unwrap_or_default();
            status(&Refusal::ManagedElsewhere { at })
        })
    }

    /// Puts on record that a request cannot be read, and returns the answer to it.
    fn not_read(&self, who: &str, verb: &str, refusal: Refusal) -> Status {
        if let Some(gcm) = &self.gcm {
            gcm.put_on_record(who, format!("{{\"{verb}\":\"cannot be read\"}}"), Err(&refusal));
        }
        refuse(refusal)
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

    /// A caller that only reads may call commands that read.
    fn may_call(&self, extensions: &Extensions, path: &str) -> Result<(), Refusal> {
        let Some(limit) = extensions.get::<OnlyReads>() else { return Ok(()) };
        let (id, port, member) = part::split(path)?;
        let refused = || limit.refusal(path.to_owned());
        // Without a graph the effect of a command is unknown here.
        let graph = self.gcm.as_ref().map(Gcm::graph).ok_or_else(refused)?;
        let Some(component) = graph.components.get(&id) else {
            let known = graph.components.keys().cloned().collect();
            return Err(Refusal::ComponentNotFound { id, known });
        };
        let found = part::narrow(&component.ports, &id, port.as_ref(), member.as_ref())?;
        let mut commands = found.provided.iter().flat_map(|p| &p.commands);
        if commands.all(|c| c.kind.is_read()) { Ok(()) } else { Err(refused()) }
    }

    /// Every process whose LCM can be asked.
    fn processes(&self) -> Vec<Name> {
        match (&self.gcm, &self.local) {
            (Some(gcm), _) => gcm.graph().processes.keys().cloned().collect(),
            (None, Some((name, _))) => vec![name.clone()],
            (None, None) => Vec::new(),
        }
    }

    /// Returns the live figures of these components and connections; figures that do not come in time are a
    /// warning, not a failure. Only processes that have some of them are asked, all at the same time: a
    /// silent one costs the others nothing.
    async fn figures(&self, ids: &[ComponentId], shown: &[&Connection], deadline: Instant) -> Figures {
        let deadline = deadline.min(Instant::now() + FIGURES);
        let mut asking = JoinSet::new();
        let mut asked: BTreeMap<&Name, (Vec<ComponentId>, bool)> = BTreeMap::new();
        for end in shown.iter().flat_map(|c| [&c.client, &c.server]) {
            asked.entry(&end.component.process).or_default().1 = true;
        }
        for id in ids {
            asked.entry(&id.process).or_default().0.push(id.clone());
        }
        for (process, (ids, has_ends)) in asked {
            let Ok(lcm) = self.lcm(process) else { continue };
            let process = process.clone();
            asking.spawn(async move {
                let asked = tokio::time::timeout_at(deadline.into(), figures_of(lcm, ids, has_ends)).await;
                asked.unwrap_or_else(|_| Err(format!("process {process} did not give its figures in time")))
            });
        }
        let mut figures = Figures::default();
        while let Some(asked) = asking.join_next().await {
            match asked {
                Ok(Ok((details, links))) => {
                    figures.details.extend(details);
                    for link in links {
                        // The connection's other half.
                        let link = match figures.links.remove(&link.connection) {
                            Some(half) => half.merged(link),
                            None => link,
                        };
                        figures.links.insert(link.connection, link);
                    }
                }
                Ok(Err(warning)) => figures.warnings.push(warning),
                Err(e) => figures.warnings.push(format!("asking for figures panicked: {e}")),
            }
        }
        figures.warnings.sort();
        figures
    }
}

type Asked = (Vec<(ComponentId, Detail)>, Vec<LinkDetail>);

async fn figures_of(lcm: Arc<dyn Lcm>, ids: Vec<ComponentId>, has_ends: bool) -> Result<Asked, String> {
    let mut details = Vec::with_capacity(ids.len());
    for ids in ids.chunks(AT_ONCE) {
        details.extend(lcm.details(ids.to_vec()).await.map_err(|refusal| refusal.to_string())?);
    }
    let links = if has_ends { lcm.links().await.map_err(|refusal| refusal.to_string())? } else { Vec::new() };
    Ok((details, links))
}

/// Refusals leave as statuses.
fn refuse(refusal: Refusal) -> Status {
    status(&refusal)
}

/// An RPC that is declared and not built yet.
fn not_built(what: &str, hint: &str) -> Status {
    status(&Refusal::NotImplemented { what: what.into(), hint: hint.into() })
}
