//! A host inside the benchmark, with the measuring components of a real plugin file; alone, or as the GCM of
//! other processes.

use std::time::Duration;

use serde_json::{Value, json};
use tokio::runtime::Runtime;
use tonic::transport::Channel;
use trocar::Host;
use trocar::host::{HostBuilder, HostError};
use trocar::model::{ConnectOptions, Execution, ExecutionModel, Refusal};
use trocar_proto::v1::gcm_service_client::GcmServiceClient;
use trocar_tests::{Built, World, eventually};

/// Time a job gets.
const WITHIN: Duration = Duration::from_secs(60);

pub(crate) struct Lab {
    runtime: Runtime,
    host: Option<Host>,
    /// In front of the names of components: its own process, where there is no other.
    prefix: &'static str,
    world: World,
}

impl Lab {
    pub(crate) fn new() -> Lab {
        let lab = Lab::with("host/", |builder| builder);
        lab.await_gauge("");
        lab
    }

    /// The GCM of other processes, which listens for them; names begin with their process.
    pub(crate) fn of_processes() -> Lab {
        Lab::with("", |builder| builder.listen("127.0.0.1:0"))
    }

    fn with(prefix: &'static str, more: impl FnOnce(HostBuilder) -> HostBuilder) -> Lab {
        let runtime = Runtime::new().expect("a runtime can be made");
        let world = World::with_plugins(&["fixture_gauge"]);
        let builder = more(Host::builder().plugins(world.plugins()).vet_with(Built::trocar()));
        let host = runtime.block_on(builder.start()).unwrap_or_else(|e| panic!("no host: {e}"));
        Lab { runtime, host: Some(host), prefix, world }
    }

    pub(crate) fn await_gauge(&self, process: &str) {
        let name = format!("{process}first");
        self.create_when_offered(&name, "gauge", &Execution::default());
        self.remove(&name);
    }

    /// A file counts as finished when it has not changed for a while, and a process may still be about to
    /// come.
    pub(crate) fn create_when_offered(&self, name: &str, class: &str, execution: &Execution) {
        eventually(&format!("{class} is offered"), || {
            self.try_create(name, class, json!({}), execution.clone()).map_err(|e| e.to_string())
        });
    }

    pub(crate) fn world(&self) -> &World {
        &self.world
    }

    /// Where it listens.
    pub(crate) fn address(&self) -> String {
        self.host().addr().expect("it was told to listen").to_string()
    }

    /// A caller from outside, and what it waits on.
    pub(crate) fn client(&self) -> (GcmServiceClient<Channel>, Runtime) {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        let runtime = runtime.expect("a runtime can be made");
        let endpoint = Channel::from_shared(format!("http://{}", self.address()));
        let channel = runtime.block_on(endpoint.expect("an address of this machine").connect());
        (GcmServiceClient::new(channel.expect("the host answers")), runtime)
    }

    fn path(&self, name: &str) -> String {
        format!("{}{name}", self.prefix)
    }

    fn host(&self) -> &Host {
        self.host.as_ref().expect("the host is there until the lab is dropped")
    }

    fn try_create(
        &self,
        name: &str,
        class: &str,
        config: Value,
        execution: Execution,
    ) -> Result<(), Refusal> {
        let path = self.path(name);
        self.runtime.block_on(self.host().create_with(&path, class, config, execution)).map(drop)
    }

    pub(crate) fn create(&self, name: &str, class: &str, execution: Execution) {
        self.create_with(name, class, json!({}), execution);
    }

    pub(crate) fn create_with(&self, name: &str, class: &str, config: Value, execution: Execution) {
        self.try_create(name, class, config, execution).unwrap_or_else(|e| panic!("{name}: {e}"));
    }

    pub(crate) fn remove(&self, name: &str) {
        let gone = self.runtime.block_on(self.host().remove_forced(&self.path(name)));
        gone.unwrap_or_else(|e| panic!("{name}: {e}"));
    }

    pub(crate) fn connect(&self, client: &str, server: &str) {
        self.connect_with(client, server, ConnectOptions::default());
    }

    pub(crate) fn connect_with(&self, client: &str, server: &str, options: ConnectOptions) {
        let (client, server) = (self.path(client), self.path(server));
        let made = self.runtime.block_on(self.host().connect_with(&client, &server, options));
        made.unwrap_or_else(|e| panic!("{client} to {server}: {e}"));
    }

    pub(crate) fn start(&self) {
        self.start_only("**");
    }

    pub(crate) fn start_only(&self, which: &str) {
        self.runtime.block_on(self.host().start(&self.path(which))).unwrap_or_else(|e| panic!("start: {e}"));
    }

    pub(crate) fn stop(&self, which: &str) {
        self.runtime.block_on(self.host().stop(&self.path(which))).unwrap_or_else(|e| panic!("stop: {e}"));
    }

    pub(crate) fn invoke(&self, member: &str, arg: Value) -> Value {
        let member = self.path(member);
        let reply = self.runtime.block_on(self.host().invoke_within(&member, arg, WITHIN));
        reply.unwrap_or_else(|e| panic!("{member}: {e}")).value.unwrap_or_default()
    }

    /// The state row of a component.
    pub(crate) fn row(&self, name: &str) -> Value {
        let row = self.runtime.block_on(self.host().read(&self.path(name)));
        row.unwrap_or_else(|e| panic!("{name}: {e}")).value
    }

    /// A number of its state row.
    pub(crate) fn number(&self, name: &str, field: &str) -> f64 {
        as_number(&self.row(name)[field])
    }

    /// A job of a gauge, done in its step; ns per call.
    pub(crate) fn measure(&self, gauge: &str, what: &str, calls: u64, runs: u64) -> f64 {
        let before = self.number(gauge, "jobs");
        self.invoke(&format!("{gauge}/time/measure"), json!({ "what": what, "calls": calls, "runs": runs }));
        eventually(&format!("{gauge} has measured {what}"), || {
            if self.number(gauge, "jobs") > before { Ok(()) } else { Err("not yet") }
        });
        let refused = self.number(gauge, "refused");
        assert!(refused == 0.0, "{what}: {refused} of {} calls were refused", calls * runs);
        self.number(gauge, "ns")
    }

    /// Waits until a number of a state row is at least this.
    pub(crate) fn wait_until(&self, name: &str, field: &str, least: f64) {
        eventually(&format!("{name}: {field} is {least}"), || {
            let now = self.number(name, field);
            if now >= least { Ok(()) } else { Err(format!("{now}")) }
        });
    }

    pub(crate) fn wait(&self, name: &str, field: &str, more: f64) {
        self.wait_until(name, field, self.number(name, field) + more);
    }

    /// What an embedding program would await.
    pub(crate) fn block_on<R>(&self, f: impl AsyncFnOnce(&Host) -> Result<R, HostError>) -> R {
        self.runtime.block_on(f(self.host())).unwrap_or_else(|e| panic!("{e}"))
    }
}

impl Drop for Lab {
    fn drop(&mut self) {
        if let Some(host) = self.host.take() {
            self.runtime.block_on(host.shutdown());
        }
    }
}

/// Whole numbers of 64 bits may come as text.
pub(crate) fn as_number(value: &Value) -> f64 {
    value.as_f64().or_else(|| value.as_str()?.parse().ok()).unwrap_or(f64::NAN)
}

pub(crate) fn model(model: ExecutionModel) -> Execution {
    Execution { model: Some(model), ..Execution::default() }
}

/// Inside the steps of `head`, after it.
pub(crate) fn after(head: &str) -> Execution {
    Execution { inside: Some(format!("host/{head}")), ..model(ExecutionModel::ExecOut) }
}

pub(crate) fn stream_of(head: &str) -> Execution {
    Execution { stream_of: Some(format!("host/{head}")), ..model(ExecutionModel::Stream) }
}
