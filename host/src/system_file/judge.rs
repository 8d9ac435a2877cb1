//! A system file against the classes there are: every request that would be refused, and what would be done.
//!
//! Invariant: pure. It is judged by the planner that carries requests out, so nothing is refused here that
//! would be done, nor the other way; what hangs on something that was refused is not judged.

use std::collections::BTreeSet;

use trocar_model::{ComponentId, Plan, PortId, Refusal, Request, SystemGraph, Target, host_of, plan};

use super::SystemFile;
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
    /// Judges the file by the processes of `graph`, and what runs there already.
    pub fn judge(&self, graph: &SystemGraph) -> Judged {
        let (mut judged, mut graph) = (Judged::default(), graph.clone());
        // Not there, since their Create was refused; and those that miss a connection for such a reason.
        let (mut absent, mut incomplete) = (BTreeSet::new(), BTreeSet::new());
        for request in self.requests().into_iter().flat_map(one_by_one) {
            let is_start = matches!(request, Request::Start { .. });
            let hangs =
                touched(&request).any(|id| absent.contains(&id) || is_start && incomplete.contains(&id));
            if hangs {
                incomplete.extend(client(&request).cloned());
                continue;
            }
            let refusal = match plan(&graph, &request) {
                Ok(done) => {
                    graph.apply(&done);
                    judged.plan.changes.extend(done.changes);
                    judged.plan.skipped.extend(done.skipped);
                    continue;
                }
                Err(refusal) => refusal,
            };
            let of = if matches!(request, Request::Create { .. }) { &mut absent } else { &mut incomplete };
            of.extend(client(&request).cloned());
            match refusal {
                Refusal::InterfaceNotFound { port, .. } if self.may_make(&port) => {
                    // The other end may be wrong all the same.
                    let other = self.no_server(&graph, &request).filter(|_| is_client(&port, &request));
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
        judged.problems.sort_by_key(|problem| (problem.line, problem.column));
        judged
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

/// A Start of each component by itself: one that cannot start hides no other.
fn one_by_one(request: Request) -> Vec<Request> {
    match request {
        Request::Start { targets } => {
            targets.into_iter().map(|target| Request::Start { targets: vec![target] }).collect()
        }
        other => vec![other],
    }
}

/// The component that a request is for.
fn client(request: &Request) -> Option<&ComponentId> {
    match request {
        Request::Create { id, .. } => Some(id),
        Request::Connect { client, .. } => Some(&client.component),
        Request::Start { targets } => targets.first().and_then(|target| match target {
            Target::One(id) => Some(id),
            Target::Glob(_) => None,
        }),
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
