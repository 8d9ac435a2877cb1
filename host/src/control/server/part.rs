//! The part of a system, or of a component's ports, that a path names.
//!
//! Invariant: an unknown name is refused with the known ones, never answered with nothing.

use std::collections::BTreeSet;

use trocar_model::{ComponentId, MemberId, Name, Pattern, PortId, Ports, Refusal, SystemGraph, Target};

/// Leaves only the named process or component, or everything that a glob matches, with the processes that
/// hold it.
pub(super) fn keep_only(graph: &mut SystemGraph, path: &str) -> Result<(), Refusal> {
    if !path.contains(['/', '*']) {
        let name = Name::parse(path)?;
        if !graph.processes.contains_key(&name) {
            let known = graph.processes.keys().cloned().collect();
            return Err(Refusal::ProcessNotFound { process: name, known });
        }
        graph.processes.retain(|p, _| *p == name);
        graph.components.retain(|id, _| id.process == name);
        return Ok(());
    }
    match Target::parse(path)? {
        Target::One(id) if !graph.components.contains_key(&id) => {
            let known = graph.components.keys().cloned().collect();
            return Err(Refusal::ComponentNotFound { id, known });
        }
        Target::One(one) => graph.components.retain(|id, _| *id == one),
        Target::Glob(pattern) => {
            let all: Vec<ComponentId> = graph.components.keys().cloned().collect();
            graph.components.retain(|id, _| pattern.matches(id));
            // "Everything" holds also where there is nothing.
            if pattern == Pattern::all() {
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
