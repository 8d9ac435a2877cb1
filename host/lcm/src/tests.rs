//! The LCM with components whose entries are closures of the tests: a small world to run them in.
#![allow(clippy::unwrap_used)]

mod allocations;
mod answering;
mod apart;
mod bells;
mod branches;
mod callbacks;
mod cycles;
mod executors;
mod filters;
mod going;
mod leaving;
mod manners;
mod outside;
mod passive;
mod phases;
mod premises;
mod reading;
mod removal;
mod rewiring;
mod safety;
mod services;
mod standing;
mod stopping;
mod supervision;
mod taps;
mod telling;

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use trocar_model::{
    Change, ClassInfo, Command, CommandKind, Component, ComponentId, ConnectOptions, Connection,
    ConnectionId, Execution, ExecutionModel, Function, Health, Input, MemberId, Name, OnFailure, Output,
    Overflow, PortId, PortType, Ports, Prim, Provided, Refusal, Required, Safety, State, Tag, Type, Verb,
};

use super::boundary::puppet::{Behaviour, PuppetClasses, behave, class};
use super::{Classes, Detail, Invoke, Lcm, LcmConfig, LocalLcm, Payload, Report};
use crate::watchdog::Watchdog;

/// Deadline of LCM requests that should be answered soon; a failure, not a speed limit.
const PATIENCE: Duration = Duration::from_secs(120);

struct World {
    lcm: Arc<LocalLcm>,
    process: &'static str,
}

impl World {
    /// `process` is unique over all tests: puppets are found by their path.
    fn new(process: &'static str) -> World {
        World::with(process, Arc::new(PuppetClasses), None)
    }

    /// A world with these classes, and with a socket where it listens for other processes.
    fn with(process: &'static str, classes: Arc<dyn Classes>, links: Option<PathBuf>) -> World {
        let process_name = Name::parse(process).unwrap();
        let config = LcmConfig {
            process: process_name,
            classes: Some(classes),
            links,
            afar: None,
            lock_memory: false,
            allow_exec: false,
        };
        World { lcm: LocalLcm::new(config).unwrap(), process }
    }

    fn id(&self, name: &str) -> ComponentId {
        ComponentId::parse(&format!("{}/{name}", self.process)).unwrap()
    }

    async fn detail(&self, name: &str) -> Detail {
        let mut details = self.lcm.details(vec![self.id(name)]).await.unwrap();
        details.pop().unwrap().1
    }

    async fn apply(&self, change: Change) -> Result<Report, Refusal> {
        self.lcm.apply(change, (Instant::now() + PATIENCE).into()).await
    }

    async fn create_as(
        &self,
        name: &str,
        info: ClassInfo,
        execution: Execution,
        behaviour: Arc<dyn Behaviour>,
    ) {
        let id = self.id(name);
        behave(&id.to_string(), behaviour);
        let component = Component {
            ports: Arc::new(info.ports.clone()),
            class: Arc::new(info),
            config: serde_json::json!({}),
            execution,
            state: State::Created,
            health: Health::Ok,
            fault: String::new(),
        };
        self.apply(Change::Create { id, component: Box::new(component) }).await.unwrap();
        self.configure(name).await.unwrap();
    }

    async fn create(&self, name: &str, execution: Execution, behaviour: Arc<dyn Behaviour>) {
        self.create_as(name, class(Ports::default(), Safety::None), execution, behaviour).await;
    }

    async fn configure(&self, name: &str) -> Result<Report, Refusal> {
        let (from, to) = (serde_json::json!({}), serde_json::json!({}));
        let (from_state, to_state) = (State::Created, State::Ready);
        self.apply(Change::Configure { id: self.id(name), from, to, from_state, to_state }).await
    }

    async fn run(&self, name: &str, verb: Verb) -> Result<Report, Refusal> {
        let (from, to) = (State::Ready, State::Active);
        self.apply(Change::Run { id: self.id(name), verb, from, to }).await
    }

    async fn start(&self, name: &str) {
        self.run(name, Verb::Start).await.unwrap();
    }

    async fn connect(&self, number: u64, client: &str, server: &str, options: ConnectOptions) {
        let port = |path: &str| PortId::parse(&format!("{}/{path}", self.process)).unwrap();
        let id = ConnectionId(number);
        let connection = Connection { id, client: port(client), server: port(server), options };
        self.apply(Change::Connect { connection }).await.unwrap();
    }

    /// Calls the command `do` of interface `ctl`.
    async fn call(&self, name: &str) -> Result<(), Refusal> {
        self.invoke(name, false).await
    }

    /// Sends that command.
    async fn send(&self, name: &str) {
        self.invoke(name, true).await.unwrap();
    }

    async fn invoke(&self, name: &str, send: bool) -> Result<(), Refusal> {
        let member = MemberId::parse(&format!("{}/{name}/ctl/do", self.process)).unwrap();
        let call = Invoke { member, arg: Payload::None, send, deadline_ns: 20_000_000_000 };
        self.lcm.invoke(call).await.map(|_| ())
    }

    async fn report(&self, name: &str) -> Report {
        let id = self.id(name);
        let inventory = self.lcm.inventory().await.unwrap();
        inventory.components.into_iter().find(|r| r.id == id).unwrap()
    }

    async fn eventually(&self, what: &str, name: &str, is: impl Fn(&Report) -> bool) -> Report {
        let mut watchdog = Watchdog::of(format!("{name} comes to {what}"));
        loop {
            let report = self.report(name).await;
            if is(&report) {
                return report;
            }
            watchdog.saw(format_args!("{report:?}"));
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }

    async fn end(self) {
        self.lcm.shutdown(PATIENCE).await;
    }
}

/// Waits until `is` holds, under the watchdog.
async fn eventually(what: &str, is: impl Fn() -> bool) {
    let mut watchdog = Watchdog::of(what);
    while !is() {
        watchdog.saw("it is not so");
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
}

fn model(model: ExecutionModel) -> Execution {
    Execution { model: Some(model), ..Execution::default() }
}

fn periodic(period_us: u64) -> Execution {
    Execution { period_ns: Some(period_us * 1000), ..model(ExecutionModel::Periodic) }
}

fn inside(how: ExecutionModel, host: &ComponentId) -> Execution {
    Execution { inside: Some(host.to_string()), ..model(how) }
}

fn stream_of(head: &ComponentId) -> Execution {
    Execution { stream_of: Some(head.to_string()), ..model(ExecutionModel::Stream) }
}

/// A provided interface `ctl` with one void command, `do`.
fn ctl() -> Ports {
    let command = Command {
        name: "do".into(),
        doc: String::new(),
        kind: CommandKind::Void,
        arg: None,
        ret: None,
        ret_unit: String::new(),
        overflow: Overflow::Reject,
    };
    let (name, doc, tag) = ("ctl".into(), String::new(), Tag::None);
    Ports {
        provided: vec![Provided { name, doc, tag, commands: vec![command], events: Vec::new() }],
        ..Ports::default()
    }
}

/// A required interface `peer` with these functions: name and result.
fn requires(functions: &[(&str, Option<Type>)]) -> Ports {
    let function = |(name, ret): &(&str, Option<Type>)| Function {
        name: (*name).into(),
        doc: String::new(),
        arg: None,
        ret: ret.clone(),
        unit: String::new(),
        optional: false,
        any: false,
    };
    let functions = functions.iter().map(function).collect();
    let (name, doc) = ("peer".into(), String::new());
    Ports {
        required: vec![Required { name, doc, optional: false, functions, handlers: Vec::new() }],
        ..Ports::default()
    }
}

fn requires_ctl() -> Ports {
    requires(&[("do", None)])
}

fn requires_system() -> Ports {
    let system = trocar_loader::system::interface();
    let get_state = &system.commands[trocar_loader::system::GET_STATE];
    requires(&[(&get_state.name, get_state.ret.clone())])
}

/// One plain output `out`, or input `in`, of u64.
fn plain(input: bool, output: bool) -> Ports {
    let ty = || PortType::Plain(Type::Prim(Prim::U64));
    let (doc, optional, fifo) = (String::new, false, 0);
    Ports {
        inputs: Vec::from_iter(input.then(|| Input {
            name: "in".into(),
            doc: doc(),
            ty: ty(),
            tag: Tag::None,
            optional,
            fifo,
        })),
        outputs: Vec::from_iter(output.then(|| Output {
            name: "out".into(),
            doc: doc(),
            ty: ty(),
            tag: Tag::None,
        })),
        ..Ports::default()
    }
}
