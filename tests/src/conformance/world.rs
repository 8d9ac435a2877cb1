//! `Lab`: a host inside the test's own process, with the suite's classes.
//!
//! Invariant: dropping it opens the gate, so that nothing it made hangs, and shuts the host down, or the
//! processes.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Mutex, OnceLock};
use std::thread;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tokio::runtime::Runtime;
use trocar::Host;
use trocar::gcm::{ExecuteOptions, Executed, Gcm};
use trocar::host::HostBuilder;
use trocar::lcm::{Invoke, LogLine, Payload, Reply};
use trocar::model::{ConnectOptions, Execution, ExecutionModel, MemberId, Refusal, Request, Which};

use super::parts::machines;
use super::way::note_away;
use super::{Answer, Call, Languages, Samples, Way};
use crate::{HostProcess, World, eventually};

/// For calls that are to come back whatever happens: a watchdog, not a claim.
pub(super) const PATIENCE: Duration = Duration::from_secs(40);

/// One for all labs of a process, so that threads can be counted.
pub(super) fn runtime() -> &'static Runtime {
    static RUNTIME: OnceLock<Runtime> = OnceLock::new();
    RUNTIME.get_or_init(|| Runtime::new().unwrap_or_else(|e| panic!("no tokio runtime: {e}")))
}

/// For what an embedding program would await.
pub(super) fn block_on<F: Future>(future: F) -> F::Output {
    runtime().block_on(future)
}

/// A host and what is in it.
pub struct Lab {
    host: Option<Host>,
    pub(super) gcm: Gcm,
    /// Another process as far as components can tell: a host of its own, attached to the same GCM.
    pub(super) other: Option<Host>,
    /// Processes of the built program; then the host here has nothing but the GCM.
    pub(super) spawned: BTreeMap<&'static str, HostProcess>,
    /// The process of each component.
    pub(super) places: Mutex<BTreeMap<String, &'static str>>,
    /// What connections between clients and servers are pinned to, and who is on the servers' side.
    pub(super) carrier: &'static str,
    pub(super) servers: Mutex<BTreeSet<String>>,
    pub(super) languages: Languages,
    pub(super) world: World,
}

impl Lab {
    /// An empty host that offers the classes in this language, or these of clients and servers.
    #[must_use]
    pub fn new(languages: impl Into<Languages>) -> Lab {
        Lab::with(languages.into(), |host| host)
    }

    /// Two of them, as two processes.
    #[must_use]
    pub fn parted(languages: impl Into<Languages>) -> Lab {
        Lab::new(languages).part()
    }

    fn with(languages: Languages, more: impl FnOnce(HostBuilder) -> HostBuilder) -> Lab {
        let world = World::new();
        let builder = more(languages.offer(Host::builder().name("host"), &world));
        let host = runtime().block_on(builder.start()).unwrap_or_else(|e| panic!("no host: {e}"));
        Lab::around(host, languages, world)
    }

    pub(super) fn around(host: Host, languages: Languages, world: World) -> Lab {
        let gcm = host.gcm().cloned().unwrap_or_else(|| panic!("the host has no GCM"));
        Lab {
            host: Some(host),
            gcm,
            other: None,
            spawned: BTreeMap::new(),
            places: Mutex::default(),
            carrier: "",
            servers: Mutex::default(),
            languages,
            world,
        }
    }

    /// The processes of a way, without components.
    #[must_use]
    pub fn of(way: &Way) -> Lab {
        Lab::of_with(way, |host| host)
    }

    fn of_with(way: &Way, more: impl FnOnce(HostBuilder) -> HostBuilder) -> Lab {
        let deployment = way.deployment;
        if deployment.built_processes() {
            return Lab::spawned(way.languages);
        }
        let reached = machines(deployment.carrier());
        let mut lab = Lab::with(way.languages, |host| more(host).machines(reached));
        lab.carrier = deployment.carrier();
        if deployment.two_processes() { lab.part() } else { lab }
    }

    /// `host/client` and `host/server`, not connected, READY.
    #[must_use]
    pub fn pair(way: &Way) -> Lab {
        Lab::pair_with(way, json!({}))
    }

    /// The same, with settings of the server.
    #[must_use]
    pub fn pair_with(way: &Way, server: Value) -> Lab {
        let lab = Lab::of(way);
        let server = lab.gated(server);
        lab.make_pair(way, "Client", "Server", server);
        lab
    }

    /// `host/client` and `host/server` of these classes, not connected.
    #[must_use]
    pub fn pair_of(way: &Way, client: &str, server: &str, config: Value) -> Lab {
        let lab = Lab::of(way);
        lab.make_pair(way, client, server, config);
        lab
    }

    fn make_pair(&self, way: &Way, client: &str, server: &str, config: Value) {
        let make_client = || self.create("client", client, json!({}), way.deployment.client());
        if way.deployment.client_leads() {
            make_client();
        }
        self.create("server", server, config, way.deployment.server());
        if !way.deployment.client_leads() {
            make_client();
        }
    }

    /// Both connected and ACTIVE.
    #[must_use]
    pub fn running(way: &Way) -> Lab {
        let lab = Lab::pair(way);
        lab.connect("client/peer", "server/ctl");
        lab.start("server");
        lab.start("client");
        lab
    }

    /// Both connected and ACTIVE, in a host with a gRPC port.
    #[must_use]
    pub fn listening(way: &Way) -> Lab {
        let lab = Lab::of_with(way, |host| host.listen("127.0.0.1:0"));
        let server = lab.gated(json!({}));
        lab.make_pair(way, "Client", "Server", server);
        lab.connect("client/peer", "server/ctl");
        lab.start("server");
        lab.start("client");
        lab
    }

    /// `config` with the file that opens the gate.
    #[must_use]
    pub fn gated(&self, mut config: Value) -> Value {
        config["gate"] = json!(self.world.path("gate").to_string_lossy());
        config
    }

    /// Lets everything pass that waits at the gate.
    pub fn open_gate(&self) {
        let written = std::fs::write(self.world.path("gate"), "");
        written.unwrap_or_else(|e| panic!("the gate cannot be opened: {e}"));
    }

    /// Closes it again for those that come later.
    pub fn close_gate(&self) {
        for file in ["gate", "gate.waiting"] {
            // It is closed already when there is no file.
            let _ = std::fs::remove_file(self.world.path(file));
        }
    }

    /// Opens the gate when what it answers is dropped.
    pub(super) fn opens_at_end(&self) -> OpensAtEnd<'_> {
        OpensAtEnd(self)
    }

    /// Waits until somebody waits at the gate.
    pub fn await_waiting(&self) {
        let sign = self.world.path("gate.waiting");
        eventually("somebody waits at the gate", || if sign.exists() { Ok(()) } else { Err("nobody does") });
    }

    /// Keeps the server inside a command, in a thread that is not the client's, while `f` runs.
    pub fn occupied<R>(&self, f: impl FnOnce() -> R) -> R {
        self.close_gate();
        thread::scope(|scope| {
            let inside = scope.spawn(|| self.invoke("server/ctl/hold", None, false));
            // Opened also when `f` fails: the scope waits for the thread inside.
            let gate = OpensAtEnd(self);
            self.await_waiting();
            let result = f();
            drop(gate);
            // It may have been lost with the server: that is `f`'s doing.
            let _ = inside.join();
            result
        })
    }

    // Asking the GCM.

    /// # Errors
    /// What the GCM refuses.
    pub fn ask(&self, request: Request) -> Result<Executed, Refusal> {
        let options = ExecuteOptions {
            deadline: Some(Instant::now() + PATIENCE),
            identity: "conformance".into(),
            ..ExecuteOptions::default()
        };
        let done = runtime().block_on(self.gcm.execute(vec![request], options));
        self.settle();
        done
    }

    #[track_caller]
    pub(super) fn done(&self, request: Request) -> Executed {
        let text = format!("{request:?}");
        // A busy machine may think a process lost for a moment. A refused request has done nothing, or has
        // taken it back.
        let answer = eventually("the processes are heard", || match self.ask(request.clone()) {
            Err(lost @ Refusal::ProcessLost { .. }) => Err(lost),
            answer => Ok(answer),
        });
        answer.unwrap_or_else(|refusal| panic!("{text}\nwas refused: {refusal}"))
    }

    /// # Errors
    /// What the GCM refuses.
    pub fn try_create(
        &self,
        name: &str,
        class: &str,
        config: Value,
        execution: Execution,
    ) -> Result<Executed, Refusal> {
        let mut execution = self.place(name, class, execution);
        let mut config = config;
        match (execution.model, class) {
            (Some(ExecutionModel::OnCallback), "Server") => config["rings"] = json!(true),
            // Nobody calls the other classes back.
            (Some(ExecutionModel::OnCallback), _) => execution.model = Some(ExecutionModel::OnSignal),
            _ => {}
        }
        let class = format!("{}/{class}", self.languages.plugin(class));
        self.ask(Request::Create { id: self.id(name), class, config: Some(config), execution })
    }

    #[track_caller]
    pub fn create(&self, name: &str, class: &str, config: Value, execution: Execution) {
        let made = self.try_create(name, class, config, execution);
        made.unwrap_or_else(|refusal| panic!("creating {name} was refused: {refusal}"));
    }

    #[track_caller]
    pub fn connect(&self, client: &str, server: &str) {
        self.connect_with(client, server, ConnectOptions::default());
    }

    #[track_caller]
    pub fn connect_with(&self, client: &str, server: &str, options: ConnectOptions) {
        let options = self.carried(client, server, options);
        self.done(Request::Connect { client: self.port(client), server: self.port(server), options });
    }

    /// # Errors
    /// What the GCM refuses.
    pub fn try_connect(&self, client: &str, server: &str, options: ConnectOptions) -> Result<(), Refusal> {
        let options = self.carried(client, server, options);
        self.ask(Request::Connect { client: self.port(client), server: self.port(server), options })
            .map(|_| ())
    }

    #[track_caller]
    pub fn disconnect(&self, client: &str, server: &str) {
        self.done(Request::Disconnect {
            which: Which::Pair { client: self.port(client), server: self.port(server) },
        });
    }

    #[track_caller]
    pub fn start(&self, name: &str) {
        self.done(Request::Start { targets: self.targets(name) });
    }

    #[track_caller]
    pub fn stop(&self, name: &str) {
        self.done(Request::Stop { targets: self.targets(name) });
    }

    #[track_caller]
    pub fn resume(&self, name: &str) {
        self.done(Request::Resume { targets: self.targets(name) });
    }

    #[track_caller]
    pub fn reset(&self, name: &str) {
        self.done(Request::Reset { targets: self.targets(name) });
    }

    /// # Errors
    /// What the GCM refuses.
    pub fn configure(&self, name: &str, patch: Value) -> Result<(), Refusal> {
        let done = runtime().block_on(self.host().configure(&self.path(name), patch)).map(|_| ());
        self.settle();
        done
    }

    #[track_caller]
    pub fn remove(&self, name: &str) {
        self.done(Request::Remove { id: self.id(name), force: true });
    }

    // Calling.

    /// Calls a command from outside.
    ///
    /// # Errors
    /// The refusal that its outcome becomes.
    pub fn invoke(&self, member: &str, arg: Option<Value>, send: bool) -> Result<Reply, Refusal> {
        self.invoke_within(member, arg, send, PATIENCE)
    }

    /// Waits until the samples that are on their way between machines have come.
    fn settle(&self) {
        if self.carrier != "net" {
            return;
        }
        eventually("what was sent has come", || {
            let mut on_the_way = BTreeMap::<u64, (u64, u64)>::new();
            for link in self.links() {
                let sums = on_the_way.entry(link.connection).or_default();
                *sums = (sums.0 + link.sent, sums.1 + link.came);
            }
            on_the_way.retain(|_, (sent, came)| sent > came);
            if on_the_way.is_empty() {
                Ok(())
            } else {
                Err(format!("(sent, came) by connection: {on_the_way:?}"))
            }
        });
    }

    /// # Errors
    /// The refusal that its outcome becomes.
    pub fn invoke_within(
        &self,
        member: &str,
        arg: Option<Value>,
        send: bool,
        within: Duration,
    ) -> Result<Reply, Refusal> {
        let id = MemberId::parse(&self.path(member))?;
        let arg = arg.map_or(Payload::None, Payload::Json);
        let deadline_ns = u64::try_from(within.as_nanos()).unwrap_or(u64::MAX);
        let lcm = self.lcm_of(id.port.component.component.as_str());
        let reply = runtime().block_on(lcm.invoke(Invoke { member: id, arg, send, deadline_ns }))?;
        self.settle();
        let value = reply.value.map(|value| self.as_declared(member, value));
        Ok(Reply { value, ..reply })
    }

    /// Has a client make calls now; it may be refused.
    ///
    /// # Errors
    /// The client does not exist, does not run, or did not come back.
    pub fn order(&self, client: &str, call: Call, within: Duration) -> Result<Answer, Refusal> {
        let reply = self.invoke_within(&format!("{client}/run/perform"), Some(call.json()), false, within)?;
        Ok(Answer::of(&reply.value.unwrap_or_default()))
    }

    /// Has the client make calls now, in one of its commands, and answer what they came to.
    #[track_caller]
    pub fn perform(&self, call: Call) -> Answer {
        let answer = self.order("client", call, PATIENCE);
        answer.unwrap_or_else(|refusal| panic!("the client did not perform {call:?}: {refusal}"))
    }

    /// Has the client make calls in its next step, and waits until it has.
    #[track_caller]
    pub fn perform_in_step(&self, call: Call) -> Answer {
        let before = self.count("client", "scheduled");
        self.schedule(call);
        self.await_scheduled(before)
    }

    /// Sends the client calls for its next step.
    #[track_caller]
    pub(super) fn schedule(&self, call: Call) {
        let sent = self.invoke("client/run/schedule", Some(call.json()), true);
        sent.unwrap_or_else(|refusal| panic!("the client did not take {call:?}: {refusal}"));
    }

    /// What the calls came to that were scheduled after so many.
    #[track_caller]
    pub(super) fn await_scheduled(&self, before: u64) -> Answer {
        self.await_count("client", "scheduled", |n| n > before);
        Answer::of(&self.row("client")["tally"])
    }

    /// A command of the client's own interface that answers samples.
    #[track_caller]
    pub fn samples(&self, command: &str) -> Samples {
        Samples::of(&self.own(command))
    }

    /// A command without argument of the client's own interface.
    #[track_caller]
    pub fn own(&self, command: &str) -> Value {
        let reply = self.invoke(&format!("client/run/{command}"), None, false);
        let reply = reply.unwrap_or_else(|refusal| panic!("{command}: {refusal}"));
        reply.value.unwrap_or_default()
    }

    pub(super) fn gcm(&self) -> &Gcm {
        &self.gcm
    }

    pub(super) fn host(&self) -> &Host {
        self.host.as_ref().unwrap_or_else(|| panic!("the host was shut down"))
    }
}

/// Opens the gate when dropped: whoever waits there is waited for.
pub(super) struct OpensAtEnd<'a>(&'a Lab);

impl Drop for OpensAtEnd<'_> {
    fn drop(&mut self) {
        self.0.open_gate();
    }
}

impl Drop for Lab {
    fn drop(&mut self) {
        self.open_gate();
        let stood_still =
            |process: &HostProcess| process.printed().contains(" is lost (this process stood still for ");
        if self.spawned.values().any(stood_still) {
            note_away();
        }
        self.spawned.clear();
        for host in [self.other.take(), self.host.take()].into_iter().flatten() {
            runtime().block_on(host.shutdown());
        }
        let (lines, _) = self.gcm.lines().tail();
        // Told by now, if at all: a link between the two hosts whose thread got no processor.
        let silent = |line: &LogLine| line.message.contains(": nothing was heard of it for ");
        if lines.iter().any(silent) {
            note_away();
        }
        if std::thread::panicking() {
            lines.iter().for_each(|line| eprintln!("{}: {}", line.path, line.message));
        }
    }
}
