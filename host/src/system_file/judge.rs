//! A system file against the classes there are: every request that would be refused, and what would be done.
//!
//! Invariant: pure. It is judged by the planner that carries requests out, so nothing is refused here that
//! would be done, nor the other way; what hangs on something that was refused, or could not be read, is not
//! judged.

use std::collections::{BTreeSet, VecDeque};

use trocar_model::{
    ComponentId, Execution, Plan, Planning, PortId, Refusal, Request, SystemGraph, Target, host_of, nearest,
};

use super::cursor::MOST;
use super::problem::Problem;
use super::{Draft, SystemFile};

/// The verdict on a file.
#[derive(Clone, Debug, Default)]
pub struct Judged {
    /// Problems in the order of the file.
    pub problems: Vec<Problem>,
    /// Plan of the file, as far as nothing is wrong.
    pub plan: Plan,
    /// Ports that a configuration may make, and their connections: not known before the component is there.
    pub unknown: Vec<(PortId, Request)>,
}

impl Draft {
    /// Judges the file by the processes of `graph`, and what runs there already. A hundred problems are
    /// listed, at most, those of reading first.
    pub fn judge(&self, graph: &SystemGraph) -> Judged {
        let mut judging = Judging {
            draft: self,
            planning: Planning::of(graph),
            judged: Judged { problems: self.problems.clone(), ..Judged::default() },
            absent: BTreeSet::new(),
            hosts_nobody: BTreeSet::new(),
            incomplete: BTreeSet::new(),
        };
        let mut left: VecDeque<Request> = self.file.requests().into();
        let mut connections = 0..;
        while let Some(request) = left.pop_front().filter(|_| judging.judged.problems.len() < MOST) {
            match &request {
                Request::Create { .. } => judging.create(request),
                Request::Connect { .. } => judging.connect(request, connections.next().unwrap_or_default()),
                Request::Start { targets } => judging.start(targets),
                _ => {}
            }
        }
        let Judging { mut judged, planning, .. } = judging;
        judged.problems.sort_by_key(|problem| (problem.line, problem.column));
        judged.plan = planning.plan();
        judged
    }
}

/// A draft while it is judged, request by request.
struct Judging<'a> {
    draft: &'a Draft,
    planning: Planning,
    judged: Judged,
    /// Components that are not there: requests that name them are not judged.
    absent: BTreeSet<ComponentId>,
    /// Components that are there with the execution of their class: whether others may run in their threads
    /// is not judged.
    hosts_nobody: BTreeSet<ComponentId>,
    /// Components with a request that was refused, or not judged: whether they can start is not judged.
    incomplete: BTreeSet<ComponentId>,
}

impl Judging<'_> {
    /// A component whose settings are refused is there without them, so that its connections are judged.
    fn create(&mut self, request: Request) {
        let Request::Create { id, mut class, mut config, mut execution } = request else { return };
        let (doubts, written) = (&self.draft.doubts, self.draft.file.written(&id));
        let host = host_of(&execution);
        if doubts.components.contains(written)
            || host.is_some_and(|host| self.absent.contains(&host) || self.hosts_nobody.contains(&host))
        {
            self.absent.insert(id);
            return;
        }
        if doubts.executions.contains(written) {
            self.hosts_nobody.insert(id.clone());
            self.incomplete.insert(id.clone());
        }
        loop {
            let request = Request::Create {
                id: id.clone(),
                class: class.clone(),
                config: config.clone(),
                execution: execution.clone(),
            };
            let Err(refusal) = self.planning.add(&request) else { return };
            self.incomplete.insert(id.clone());
            let is_known = !matches!(refusal, Refusal::ClassNotFound { .. })
                || !doubts.processes.contains(&written.process);
            let again = match &refusal {
                // Judged on as what was meant, so that a slip of the fingers hides no other mistake.
                Refusal::ClassNotFound { known, elsewhere, ambiguous, .. }
                    if is_known && elsewhere.is_empty() && ambiguous.is_empty() =>
                {
                    let meant = nearest(&class, known.iter().map(String::as_str)).map(str::to_owned);
                    meant.is_some_and(|meant| std::mem::replace(&mut class, meant) != class)
                }
                Refusal::ConfigInvalid { .. } => config.take().is_some(),
                Refusal::ArgumentInvalid { .. } if execution != Execution::default() => {
                    execution = Execution::default();
                    self.hosts_nobody.insert(id.clone())
                }
                _ => false,
            };
            if is_known {
                self.refused(request, refusal);
            }
            if !again {
                self.absent.insert(id);
                return;
            }
        }
    }

    /// The connection of this number in the draft.
    fn connect(&mut self, request: Request, number: usize) {
        let Request::Connect { client, server, .. } = &request else { return };
        if [client, server].iter().any(|end| self.absent.contains(&end.component)) {
            self.incomplete.insert(client.component.clone());
        } else if let Err(refusal) = self.planning.add(&request) {
            self.incomplete.insert(client.component.clone());
            if !self.draft.doubts.connections.contains(&number) || is_of_ports(&refusal) {
                self.refused(request, refusal);
            }
        }
    }

    /// Judges all together, and one by one where that is refused: one that cannot start hides no other.
    fn start(&mut self, targets: &[Target]) {
        if self.draft.doubts.is_one_lost {
            return;
        }
        let is_judged = |id: &&ComponentId| !self.absent.contains(*id) && !self.incomplete.contains(*id);
        let ids: Vec<ComponentId> = targets.iter().filter_map(named).filter(is_judged).cloned().collect();
        let of =
            |ids: &[ComponentId]| Request::Start { targets: ids.iter().cloned().map(Target::One).collect() };
        if self.planning.add(&of(&ids)).is_ok() {
            return;
        }
        for id in ids {
            let alone = of(&[id]);
            if let Err(refusal) = self.planning.add(&alone) {
                self.refused(alone, refusal);
            }
        }
    }

    fn refused(&mut self, request: Request, refusal: Refusal) {
        let file = &self.draft.file;
        let judged = &mut self.judged;
        if judged.problems.len() >= MOST {
            return;
        }
        match refusal {
            Refusal::InterfaceNotFound { port, .. } if file.may_make(&port) => {
                // The other end may be wrong all the same.
                let other = file.no_server(self.planning.graph(), &request);
                let other = other.filter(|_| is_client(&port, &request));
                judged.problems.extend(other.map(|refusal| file.problem_of(&refusal)));
                judged.unknown.push((port, request));
            }
            Refusal::ConfigInvalid { id, violations } => {
                let alone =
                    |violation| Refusal::ConfigInvalid { id: id.clone(), violations: vec![violation] };
                judged.problems.extend(violations.into_iter().map(|v| file.problem_of(&alone(v))));
            }
            refusal => judged.problems.push(file.problem_of(&refusal)),
        }
    }
}

impl SystemFile {
    /// Tells whether the component of a port is given a configuration, which may make ports.
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

fn named(target: &Target) -> Option<&ComponentId> {
    match target {
        Target::One(id) => Some(id),
        Target::Glob(_) => None,
    }
}

fn is_client(port: &PortId, request: &Request) -> bool {
    matches!(request, Request::Connect { client, .. } if client == port)
}

/// Tells whether a refusal is about the ports by themselves: no option of the connection would change it.
fn is_of_ports(refusal: &Refusal) -> bool {
    matches!(
        refusal,
        Refusal::InterfaceNotFound { .. }
            | Refusal::WrongDirection { .. }
            | Refusal::AlreadyConnected { .. }
            | Refusal::CommandMissing { .. }
            | Refusal::CommandKindMismatch { .. }
            | Refusal::TruthToActuator { .. }
    )
}
