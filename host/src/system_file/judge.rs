//! A system file against the classes there are: every request that would be refused, and what would be done.
//!
//! Invariant: pure. It is judged by the planner that carries requests out, so nothing is refused here that
//! would be done, nor the other way; what hangs on something that was refused is not judged.

use std::collections::{BTreeSet, VecDeque};

use trocar_model::{ComponentId, Plan, Planning, PortId, Refusal, Request, SystemGraph, Target, host_of};

use super::SystemFile;
use super::cursor::MOST;
use super::problem::Problem;

/// The verdict on a file.
#[derive(Clone, Debug, Default)]
pub struct Judged {
    /// In the order of the file.
    pub problems: Vec<Problem>,
    /// Its plan, as far as nothing is wrong.
    pub plan: Plan,
    /// Ports that a configuration may make, and their connections: nobody knows before the component is
    /// there.
    pub unknown: Vec<(PortId, Request)>,
}

impl SystemFile {
    /// Judges the file by the processes of `graph`, and what runs there already. A hundred problems are
    /// listed, at most.
    pub fn judge(&self, graph: &SystemGraph) -> Judged {
        let (mut judged, mut planning) = (Judged::default(), Planning::of(graph));
        // Not there, since their Create was refused; and those that miss a connection for such a reason.
        let (mut absent, mut incomplete) = (BTreeSet::new(), BTreeSet::new());
        let mut left: VecDeque<Request> = self.requests().into();
        while let Some(request) = left.pop_front().filter(|_| judged.problems.len() < MOST) {
            if let Some(targets) = several(&request) {
                // Together, and one by one where that is refused: one that cannot start hides no other.
                let mut complete = targets.clone();
                complete.retain(|target| named(target).is_none_or(|id| !incomplete.contains(id)));
                if planning.add(&Request::Start { targets: complete }).is_err() {
                    left.extend(targets.into_iter().map(|target| Request::Start { targets: vec![target] }));
                }
                continue;
            }
            let is_start = matches!(request, Request::Start { .. });
            if touched(&request).any(|id| absent.contains(&id) || is_start && incomplete.contains(&id)) {
                incomplete.extend(client(&request).cloned());
            } else if let Err(refusal) = planning.add(&request) {
                if matches!(request, Request::Create { .. }) {
                    absent.extend(client(&request).cloned());
                }
                incomplete.extend(client(&request).cloned());
                self.refused(&mut judged, planning.graph(), request, refusal);
            }
        }
        judged.problems.sort_by_key(|problem| (problem.line, problem.column));
        judged.plan = planning.plan();
        judged
    }

    fn refused(&self, judged: &mut Judged, graph: &SystemGraph, request: Request, refusal: Refusal) {
        match refusal {
            Refusal::InterfaceNotFound { port, .. } if self.may_make(&port) => {
                // The other end may be wrong all the same.
                let other = self.no_server(graph, &request).filter(|_| is_client(&port, &request));
                judged.problems.extend(other.map(|refusal| self.problem_of(&refusal)));
                judged.unknown.push((port, request));
            }
            Refusal::ConfigInvalid { id, violations } => {
                let alone =
                    |violation| Refusal::ConfigInvalid { id: id.clone(), violations: vec![violation] };
                judged.problems.extend(violations.into_iter().map(|v| self.problem_of(&alone(v))));
            }
            refusal => judged.problems.push(self.problem_of(&refusal)),
        }
    }

    /// Its component is given a configuration, which may make ports.
    fn may_make(&self, port: &PortId) -> bool {
        let of_it = self.components.iter().find(|c| c.id == port.component);
        let config = of_it.and_then(|c| c.config.as_ref()).and_then(serde_json::Value::as_object);
        config.is_some_and(|settings| !settings.is_empty())
    }

    /// The refusal of a connection whose server is not there, and is not made by a configuration.
    fn no_server(&self, graph: &SystemGraph, request: &Request) -> Option<Refusal> {
        let Request::Connect { server, .. } = request else { return None };
        let ports = &graph.components.get(&server.component)?.ports;
        let outputs = ports.outputs.iter().map(|output| &output.name);
        let known: Vec<String> = outputs.chain(ports.provided.iter().map(|p| &p.name)).cloned().collect();
        let is_there = known.iter().any(|name| server.port == name.as_str()) || self.may_make(server);
        (!is_there).then(|| Refusal::InterfaceNotFound { port: server.clone(), known })
    }

    fn problem_of(&self, refusal: &Refusal) -> Problem {
        self.locate(refusal).unwrap_or_else(|| Problem {
            file: self.document.file.clone(),
            line: 0,
            column: 0,
            pointer: String::new(),
            what: refusal.to_string(),
            help: refusal.help(),
        })
    }
}

/// The targets of a Start, where they are several.
fn several(request: &Request) -> Option<Vec<Target>> {
    match request {
        Request::Start { targets } if targets.len() > 1 => Some(targets.clone()),
        _ => None,
    }
}

fn named(target: &Target) -> Option<&ComponentId> {
    match target {
        Target::One(id) => Some(id),
        Target::Glob(_) => None,
    }
}

/// The component that a request is for.
fn client(request: &Request) -> Option<&ComponentId> {
    match request {
        Request::Create { id, .. } => Some(id),
        Request::Connect { client, .. } => Some(&client.component),
        Request::Start { targets } => targets.first().and_then(named),
        _ => None,
    }
}

fn is_client(port: &PortId, request: &Request) -> bool {
    matches!(request, Request::Connect { client, .. } if client == port)
}

/// All components that have to be there for it.
fn touched(request: &Request) -> impl Iterator<Item = ComponentId> {
    let other = match request {
        Request::Connect { server, .. } => Some(server.component.clone()),
        Request::Create { execution, .. } => host_of(execution),
        _ => None,
    };
    client(request).cloned().into_iter().chain(other)
}
