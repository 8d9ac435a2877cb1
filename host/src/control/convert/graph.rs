//! Graph, reports and figures: model → wire.

use std::collections::BTreeMap;

use trocar_model::{Component, ComponentId, Connection, Name, Process, ProcessState, Refusal, SystemGraph};
use trocar_proto::v1;

use super::answers::{link, proxy, stats};
use super::json::to_struct;
use super::types::{execution_out, health, options_out, ports, safety, state};
use crate::gcm::{Fate, Isolated, Orders, Supervisor, Told};
use crate::lcm::{Detail, LinkDetail, Report};

pub(crate) fn process(name: &Name, p: &Process) -> v1::Process {
    let state = match p.state {
        ProcessState::Attached => v1::ProcessState::Attached,
        ProcessState::Lost => v1::ProcessState::Lost,
        ProcessState::Restarting => v1::ProcessState::Restarting,
        ProcessState::Failed => v1::ProcessState::Failed,
    };
    v1::Process {
        name: name.to_string(),
        epoch: p.epoch,
        state: state as i32,
        endpoint: p.endpoint.clone(),
        pid: p.pid,
        classes: p.classes.iter().map(|c| c.full_name()).collect(),
        last_exit: p.last_exit.clone(),
        restarts: p.restarts,
        warnings: p.warnings.sentences.clone(),
        guest: p.guest.clone(),
        unfit: p.warnings.unfit,
    }
}

/// Decodes a supervisor's report about a process.
pub(crate) fn told(fate: v1::ProcessFate) -> Result<Told, Refusal> {
    let process = Name::parse(&fate.process)?;
    let what = match fate.fate() {
        v1::Fate::Unspecified => {
            let (what, why) =
                (format!("Tell {process}"), "fate is missing: give one of FATE_RUNNING, FATE_RESTARTING, …");
            return Err(Refusal::ArgumentInvalid { what, why: why.into(), field: "processes.fate".into() });
        }
        v1::Fate::Running => Fate::Running,
        v1::Fate::Restarting => Fate::Restarting,
        v1::Fate::Failed => Fate::Failed,
        v1::Fate::Ended => Fate::Ended,
        v1::Fate::Dismissed => Fate::Dismissed,
    };
    let v1::ProcessFate { pid, last_exit, restarts, .. } = fate;
    Ok(Told { process, fate: what, pid, last_exit, restarts })
}

/// Decodes a supervisor's request for its orders.
pub(crate) fn supervisor(r: v1::SuperviseRequest) -> Result<Supervisor, Refusal> {
    let isolated = |a: &v1::ApartProcess| {
        Ok::<_, Refusal>(Isolated { process: Name::parse(&a.process)?, home: Name::parse(&a.home)? })
    };
    Ok(Supervisor {
        processes: r.processes.iter().map(|name| Name::parse(name)).collect::<Result<_, _>>()?,
        isolated: r.apart.iter().map(isolated).collect::<Result<_, _>>()?,
        term: r.term,
    })
}

/// Encodes the GCM's orders for a supervisor.
pub(crate) fn wanted(term: u64, wanted: Orders) -> v1::SuperviseResponse {
    let one = |a: Isolated| v1::ApartProcess { process: a.process.to_string(), home: a.home.to_string() };
    v1::SuperviseResponse {
        term,
        apart: wanted.isolated.into_iter().map(one).collect(),
        restart: wanted.restart.iter().map(ToString::to_string).collect(),
    }
}

pub(crate) fn component(id: &ComponentId, c: &Component, detail: Option<&Detail>) -> v1::Component {
    let (state, stop_reason) = state(c.state);
    v1::Component {
        path: id.to_string(),
        class: c.class.full_name(),
        plugin_version: c.class.version.clone(),
        state: state as i32,
        stop_reason: stop_reason as i32,
        health: health(c.health) as i32,
        fault: c.fault.clone(),
        config: Some(to_struct(&c.config)),
        execution: Some(execution_out(&c.execution)),
        safety: safety(c.class.safety) as i32,
        stats: detail.map(stats),
    }
}

/// With its halves as the graph has them, or as they have just been asked for.
pub(crate) fn connection(graph: &SystemGraph, c: &Connection, detail: Option<&LinkDetail>) -> v1::Connection {
    let asked = detail.map(|d| d.halves.as_slice()).unwrap_or_default();
    let halves = graph.proxies_of(c).into_iter().map(|(end, told)| {
        let now = asked.iter().find(|(e, _)| *e == end).map_or(&told, |(_, now)| now);
        proxy(end, now)
    });
    let link = link(detail.cloned().unwrap_or_default());
    let carrier = if graph.is_guests(&c.client) { "grpc".into() } else { link.carrier.clone() };
    v1::Connection {
        id: c.id.0,
        client: c.client.to_string(),
        server: c.server.to_string(),
        options: Some(options_out(&c.options)),
        proxies: halves.collect(),
        carrier,
        ..link
    }
}

/// Live figures gathered from the LCMs.
#[derive(Default)]
pub(crate) struct Figures {
    pub(crate) details: BTreeMap<ComponentId, Detail>,
    pub(crate) links: BTreeMap<u64, LinkDetail>,
    pub(crate) warnings: Vec<String>,
}

/// Returns the answer of List for `part` of the graph.
pub(crate) fn list(
    graph: &SystemGraph,
    part: &SystemGraph,
    term: u64,
    figures: &Figures,
) -> v1::ListResponse {
    v1::ListResponse {
        revision: graph.revision,
        term,
        processes: part.processes.iter().map(|(n, p)| process(n, p)).collect(),
        components: part.components.iter().map(|(id, c)| component(id, c, figures.details.get(id))).collect(),
        connections: part
            .connections
            .values()
            .map(|c| connection(graph, c, figures.links.get(&c.id.0)))
            .collect(),
        classes: Vec::new(),
        warnings: figures.warnings.clone(),
        etag: String::new(),
        cursor: String::new(),
        next_page_token: String::new(),
    }
}

pub(crate) fn report(r: &Report) -> v1::ComponentReport {
    let (state, stop_reason) = state(r.state);
    v1::ComponentReport {
        path: r.id.to_string(),
        state: state as i32,
        stop_reason: stop_reason as i32,
        health: health(r.health) as i32,
        fault: r.fault.clone(),
        warnings: r.warnings.clone(),
        ports: r.ports.as_deref().map(ports),
        lost_connections: r.lost_connections.clone(),
        number: r.number,
    }
}
