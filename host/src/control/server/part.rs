//! The part of a system, or of a component's ports, that a path names.
//!
//! Invariant: an unknown name is refused with the known ones, never answered with nothing.

use std::collections::BTreeSet;

use trocar_model::{
    ComponentId, ConnectionId, MemberId, Name, Pattern, PortId, Ports, Refusal, SystemGraph, Target, Touched,
};

/// A part of the system that can be listed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Part {
    Everything,
    Process(Name),
    Components(Target),
}

impl Part {
    /// # Errors
    /// It is no path, and no pattern.
    pub(super) fn read(path: &str) -> Result<Part, Refusal> {
        Ok(match path {
            "" => Part::Everything,
            name if !name.contains(['/', '*']) => Part::Process(Name::parse(name)?),
            target => Part::Components(Target::parse(target)?),
        })
    }

    /// Leaves only the named process or component, or everything that a glob matches, with the processes that
    /// hold it.
    ///
    /// # Errors
    /// There is no such process or component.
    pub(super) fn keep(&self, graph: &mut SystemGraph) -> Result<(), Refusal> {
        match self {
            Part::Everything => return Ok(()),
            Part::Process(name) if !graph.processes.contains_key(name) => {
                let known = graph.processes.keys().cloned().collect();
                return Err(Refusal::ProcessNotFound { process: name.clone(), known });
            }
            Part::Process(name) => {
                graph.processes.retain(|p, _| p == name);
                graph.components.retain(|id, _| id.process == *name);
                return Ok(());
            }
            Part::Components(Target::One(id)) if !graph.components.contains_key(id) => {
                let known = graph.components.keys().cloned().collect();
                return Err(Refusal::ComponentNotFound { id: id.clone(), known });
            }
            Part::Components(Target::One(one)) => graph.components.retain(|id, _| id == one),
            Part::Components(Target::Glob(pattern)) => {
                let all: Vec<ComponentId> = graph.components.keys().cloned().collect();
                graph.components.retain(|id, _| pattern.matches(id));
                // "Everything" holds also where there is nothing.
                if *pattern == Pattern::all() {
                    return Ok(());
                }
                if graph.components.is_empty() {
                    return Err(Refusal::NothingMatches { pattern: pattern.to_string(), known: all });
                }
            }
        }
        let holds: BTreeSet<Name> = graph.components.keys().map(|id| id.process.clone()).collect();
        graph.processes.retain(|name, _| holds.contains(name));
        Ok(())
    }

    /// Tells whether something that was touched may be in it, as it is listed now or was before.
    pub(super) fn concerns(&self, touched: &Touched, now: &SystemGraph) -> bool {
        let holds = |id: &ComponentId| match self {
            Part::Everything => true,
            Part::Process(name) => id.process == *name,
            Part::Components(target) => target.names(id),
        };
        let shows = |process: &Name| match self {
            Part::Everything => true,
            Part::Process(name) => process == name,
            Part::Components(target) => target.within(process).is_some(),
        };
        let ends_there = |id: &ConnectionId| {
            let connection = now.connections.get(id);
            connection.is_none_or(|c| holds(&c.client.component) || holds(&c.server.component))
        };
        touched.components.iter().any(holds)
            || touched.processes.iter().any(shows)
            || touched.connections.iter().any(ends_there)
    }
}

/// `process/component[/port[/member]]` taken apart.
pub(super) fn split(path: &str) -> Result<(ComponentId, Option<Name>, Option<Name>), Refusal> {
    match path.split('/').count() {
        4.. => {
            let m = MemberId::parse(path)?;
            Ok((m.port.component, Some(m.port.port), Some(m.member)))
        }
        3 => {
            let p = PortId::parse(path)?;
            Ok((p.component, Some(p.port), None))
        }
        _ => Ok((ComponentId::parse(path)?, None, None)),
    }
}

/// Only the named port, and of an interface only the named member.
pub(super) fn narrow(
    ports: &Ports,
    id: &ComponentId,
    port: Option<&Name>,
    member: Option<&Name>,
) -> Result<Ports, Refusal> {
    let Some(port) = port else { return Ok(ports.clone()) };
    let mut kept = ports.clone();
    kept.state = None;
    kept.inputs.retain(|p| p.name == port.as_str());
    kept.outputs.retain(|p| p.name == port.as_str());
    kept.required.retain(|p| p.name == port.as_str());
    kept.provided.retain(|p| p.name == port.as_str());
    if kept.find(port.as_str()).is_none() {
        let known = ports.names().map(str::to_owned).collect();
        return Err(Refusal::InterfaceNotFound { port: id.port(port.clone()), known });
    }
    let Some(member) = member else { return Ok(kept) };
    let mut known: Vec<String> = Vec::new();
    let mut is = |name: &String| {
        known.push(name.clone());
        name == member.as_str()
    };
    for p in &mut kept.provided {
        p.commands.retain(|c| is(&c.name));
        p.events.retain(|e| is(&e.name));
    }
    for r in &mut kept.required {
        r.functions.retain(|f| is(&f.name));
        r.handlers.retain(|h| is(&h.name));
    }
    if known.iter().any(|name| name == member.as_str()) {
        Ok(kept)
    } else {
        Err(Refusal::MemberNotFound { member: id.port(port.clone()).member(member.clone()), known })
    }
}
