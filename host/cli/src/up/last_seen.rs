//! Contents of a process when it was last seen whole, and the requests that make them again.
//!
//! Invariant: the contents are those that were seen, not those of a file: a component that was removed
//! meanwhile is not made again, and one that was created or connected meanwhile is. Of an incarnation that
//! has ended, only the last states of its components are taken in.

use std::collections::BTreeMap;

use trocar_model::{
    ComponentId, ConnectOptions, Execution, ExecutionModel, OnFailure, PortId, Queue, Request, Wake,
};

use super::standing::Standing;
use crate::view::{ComponentView, ConnectionView, ExecutionView, OptionsView};

#[derive(Default)]
pub(super) struct LastSeen {
    /// Pid of the incarnation that was seen; 0 = none was.
    pid: u32,
    /// By path.
    components: BTreeMap<String, ComponentView>,
    /// Whether the components ran, or were on their way to.
    ran: BTreeMap<String, bool>,
    /// Connections with an end in the process, by number.
    connections: BTreeMap<u64, ConnectionView>,
}

impl LastSeen {
    /// Takes in the contents of a process that is whole.
    pub(super) fn take(&mut self, process: &str, pid: u32, standing: &Standing) {
        self.pid = pid;
        self.components = standing.within(process).map(|c| (c.path.clone(), c.clone())).collect();
        self.ran = self.components.values().map(|c| (c.path.clone(), self.runs(c))).collect();
        let here = |port: &str| process_of(port) == process;
        // A connection whose other process the GCM does not have yet is not known to it yet, either.
        let awaited = |c: &ConnectionView| {
            let other = if here(&c.client) { process_of(&c.server) } else { process_of(&c.client) };
            standing.processes.get(other).is_none_or(|p| p.state != "ATTACHED")
        };
        self.connections.retain(|_, c| awaited(c));
        let now = standing.connections.iter().filter(|(_, c)| here(&c.client) || here(&c.server));
        self.connections.extend(now.map(|(id, c)| (*id, c.clone())));
    }

    /// Takes in the states of the components when the incarnation that was seen ended.
    pub(super) fn take_last(&mut self, process: &str, standing: &Standing) {
        if self.pid == 0 || standing.processes.get(process).is_none_or(|p| p.pid != self.pid) {
            return;
        }
        for now in standing.within(process) {
            let runs = self.runs(now);
            self.ran.insert(now.path.clone(), runs);
        }
    }

    /// Tells whether a component runs. A component that waits to be resumed since a restart counts as it did
    /// before: a second end may come before that.
    fn runs(&self, c: &ComponentView) -> bool {
        c.state == "ACTIVE" || c.state == "STOPPED{restarted}" && self.ran(&c.path)
    }

    /// Tells whether the process was seen at all.
    pub(super) fn is_known(&self) -> bool {
        self.pid != 0
    }

    /// Tells whether a component ran; one that was never seen counts as one that ran.
    pub(super) fn ran(&self, path: &str) -> bool {
        self.ran.get(path).copied().unwrap_or(true)
    }

    pub(super) fn components(&self) -> Vec<ComponentId> {
        self.components.keys().filter_map(|path| ComponentId::parse(path).ok()).collect()
    }

    /// Returns the requests that make all of it again, and start nothing.
    pub(super) fn requests(&self) -> Vec<Request> {
        let creates = self.components.values().filter_map(create);
        creates.chain(self.connections.values().filter_map(connect)).collect()
    }
}

/// The process of a path.
fn process_of(path: &str) -> &str {
    path.split('/').next().unwrap_or(path)
}

fn create(c: &ComponentView) -> Option<Request> {
    Some(Request::Create {
        id: ComponentId::parse(&c.path).ok()?,
        class: c.class.clone(),
        // A component in CREATED has an incomplete configuration, which is refused when it is given.
        config: Some(c.config.clone()).filter(|config| config.is_object() && c.state != "CREATED"),
        execution: execution(&c.execution),
    })
}

fn connect(c: &ConnectionView) -> Option<Request> {
    let (client, server) = (PortId::parse(&c.client).ok()?, PortId::parse(&c.server).ok()?);
    Some(Request::Connect { client, server, options: options(&c.options) })
}

fn execution(e: &ExecutionView) -> Execution {
    let some = |n: u64| (n > 0).then_some(n);
    let few = |n: u32| (n > 0).then_some(n);
    let text = |text: &str| (!text.is_empty()).then(|| text.to_owned());
    Execution {
        model: ExecutionModel::ALL.into_iter().find(|m| m.name() == e.model),
        period_ns: some(e.period_ns),
        phase_ns: e.phase_ns,
        stream_of: text(&e.stream_of),
        inside: text(&e.inside),
        priority: few(e.priority).and_then(|p| u8::try_from(p).ok()),
        cpus: e.cpus.iter().filter_map(|cpu| usize::try_from(*cpu).ok()).collect(),
        catch_up: few(e.catch_up),
        threads: few(e.threads),
        max_step_ns: some(e.max_step_ns),
        history: few(e.history),
        on_failure: OnFailure::ALL.into_iter().find(|f| f.name() == e.on_failure),
        wake: Wake::ALL.into_iter().find(|w| w.name() == e.wake),
    }
}

fn options(o: &OptionsView) -> ConnectOptions {
    let depth = |n: u32| usize::try_from(n).unwrap_or(usize::MAX);
    ConnectOptions {
        queue: o.fifo.map(|fifo| match fifo {
            0 => Queue::Latest,
            fifo => Queue::Fifo { depth: depth(fifo), drop_oldest: o.drop_oldest },
        }),
        max_age_ns: o.max_age_ns,
        deadline_ns: o.deadline_ns,
        mailbox: o.mailbox.map(depth),
        adapt: o.adapt,
        delay: o.delay,
        replace: false,
        carrier: o.carrier.clone(),
    }
}
