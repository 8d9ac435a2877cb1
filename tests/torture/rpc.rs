//! What anybody could ask over gRPC, said in one line each.
//!
//! Invariant: every call has a deadline, so that a server which hangs makes a row fail and never hang.

use std::fmt;
use std::sync::OnceLock;
use std::time::Duration;

use prost_types::Struct;
use serde_json::Value;
use tokio::runtime::Runtime;
use tonic::transport::{Channel, Endpoint};
use tonic::{Code, Response, Status};
use tonic_types::StatusExt;
use trocar_proto::v1::gcm_service_client::GcmServiceClient;
use trocar_proto::v1::interact_service_client::InteractServiceClient;
use trocar_proto::v1::{
    Component, ComponentState, ComponentStats, ConfigureRequest, ConnectOptions, ConnectRequest,
    CreateRequest, DisconnectRequest, Execution, GetStateRequest, InvokeRequest, ListRequest, ListResponse,
    ReadRequest, RemoveRequest, ResetRequest, ResumeRequest, StartRequest, StopRequest,
};

use crate::clock::eventually;
use crate::json::{from_wire, to_struct, to_wire};

/// For every call.
pub(crate) const PATIENCE: Duration = Duration::from_secs(10);

/// The beginning of the message where nothing answered.
pub(crate) const NO_ANSWER: &str = "no answer";

/// Why a call did not do what it should: code, reason and sentence.
#[derive(Clone, Debug)]
pub(crate) struct Refused {
    pub(crate) code: Code,
    pub(crate) reason: String,
    pub(crate) message: String,
    /// The component it is about, where it names one.
    pub(crate) component: String,
}

impl From<Status> for Refused {
    fn from(status: Status) -> Refused {
        let info = status.get_details_error_info();
        let component = info.as_ref().and_then(|info| info.metadata.get("component").cloned());
        let reason = info.map(|info| info.reason).unwrap_or_default();
        let (message, component) = (status.message().to_owned(), component.unwrap_or_default());
        Refused { code: status.code(), reason, message, component }
    }
}

impl fmt::Display for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?} {}: {}", self.code, self.reason, self.message)
    }
}

impl From<Refused> for String {
    fn from(refused: Refused) -> String {
        refused.to_string()
    }
}

pub(crate) type Answer<T> = Result<T, Refused>;

impl Refused {
    /// A busy machine alone may be the reason: a process is thought lost for a moment, a deadline goes by
    /// before what it bounds has begun.
    fn may_pass(&self) -> bool {
        self.reason == "PROCESS_LOST" || self.code == Code::DeadlineExceeded
    }
}

/// Asks until those who are to answer are heard: no row judges by how soon they are. Only for what may be
/// asked twice.
fn heard<T>(what: &str, mut ask: impl FnMut() -> Answer<T>) -> Answer<T> {
    let settled = eventually(what, || match ask() {
        Err(refused) if refused.may_pass() => Err(refused.to_string()),
        answer => Ok(answer),
    });
    settled.unwrap_or_else(|message| {
        let (reason, component) = (String::new(), String::new());
        Err(Refused { code: Code::DeadlineExceeded, reason, message, component })
    })
}

/// One server; it is dialled anew whenever it was lost.
#[derive(Clone)]
pub(crate) struct Rpc {
    pub(crate) address: String,
    pub(crate) channel: Channel,
}

pub(crate) fn runtime() -> &'static Runtime {
    static RUNTIME: OnceLock<Runtime> = OnceLock::new();
    RUNTIME.get_or_init(|| Runtime::new().unwrap_or_else(|e| panic!("no tokio runtime: {e}")))
}

impl Rpc {
    pub(crate) fn at(address: &str) -> Rpc {
        let endpoint = Endpoint::from_shared(format!("http://{address}"));
        let endpoint = endpoint.unwrap_or_else(|e| panic!("{address} is no address: {e}"));
        let endpoint = endpoint.tcp_nodelay(true).connect_timeout(Duration::from_secs(1));
        let _inside = runtime().enter();
        Rpc { address: address.to_owned(), channel: endpoint.connect_lazy() }
    }

    pub(crate) fn gcm(&self) -> GcmServiceClient<Channel> {
        GcmServiceClient::new(self.channel.clone()).max_decoding_message_size(64 << 20)
    }

    fn interact(&self) -> InteractServiceClient<Channel> {
        InteractServiceClient::new(self.channel.clone())
    }

    /// The whole graph with its figures.
    pub(crate) fn list(&self) -> Answer<ListResponse> {
        self.listed(ListRequest::default())
    }

    /// The same without figures, which need an answer of every process.
    pub(crate) fn brief(&self) -> Answer<ListResponse> {
        self.listed(ListRequest { brief: true, ..ListRequest::default() })
    }

    fn listed(&self, request: ListRequest) -> Answer<ListResponse> {
        heard("the graph is listed", || done(async { self.gcm().list(request.clone()).await }))
    }

    pub(crate) fn component(&self, path: &str) -> Answer<Component> {
        let request = GetStateRequest { path: path.into() };
        let answer = done(async { self.gcm().get_state(request).await })?;
        Ok(answer.component.unwrap_or_default())
    }

    /// Its figures, which its process has to tell.
    pub(crate) fn stats(&self, path: &str) -> Answer<ComponentStats> {
        heard(&format!("figures of {path}"), || {
            self.component(path)?.stats.ok_or_else(|| Refused {
                code: Code::Unavailable,
                reason: "PROCESS_LOST".into(),
                message: format!("{path} is listed without figures"),
                component: path.to_owned(),
            })
        })
    }

    /// Its state, e.g. `ACTIVE`.
    pub(crate) fn state(&self, path: &str) -> Answer<String> {
        let state = self.component(path)?.state();
        Ok(state_name(state))
    }

    pub(crate) fn create(&self, path: &str, class: &str, config: Value) -> Answer<()> {
        self.create_with(path, class, config, Execution::default())
    }

    pub(crate) fn create_with(
        &self,
        path: &str,
        class: &str,
        config: Value,
        execution: Execution,
    ) -> Answer<()> {
        let config: Option<Struct> = Some(to_struct(&config));
        let (path, class, execution) = (path.into(), class.into(), Some(execution));
        let request = CreateRequest { path, class, config, execution, ..CreateRequest::default() };
        done(async { self.gcm().create(request).await }).map(drop)
    }

    pub(crate) fn configure(&self, path: &str, patch: Value) -> Answer<()> {
        let config = Some(to_struct(&patch));
        let request = ConfigureRequest { path: path.into(), config, ..ConfigureRequest::default() };
        done(async { self.gcm().configure(request).await }).map(drop)
    }

    /// With force: whatever it does and whoever uses it.
    pub(crate) fn remove(&self, path: &str, force: bool) -> Answer<()> {
        let request = RemoveRequest { path: path.into(), force, ..RemoveRequest::default() };
        done(async { self.gcm().remove(request).await }).map(drop)
    }

    pub(crate) fn start(&self, path: &str) -> Answer<()> {
        let request = StartRequest { path: path.into(), ..StartRequest::default() };
        done(async { self.gcm().start(request).await }).map(drop)
    }

    pub(crate) fn stop(&self, path: &str) -> Answer<()> {
        let request = StopRequest { path: path.into(), ..StopRequest::default() };
        done(async { self.gcm().stop(request).await }).map(drop)
    }

    pub(crate) fn resume(&self, path: &str) -> Answer<()> {
        let request = ResumeRequest { path: path.into(), ..ResumeRequest::default() };
        done(async { self.gcm().resume(request).await }).map(drop)
    }

    pub(crate) fn reset(&self, path: &str) -> Answer<()> {
        let request = ResetRequest { path: path.into(), ..ResetRequest::default() };
        done(async { self.gcm().reset(request).await }).map(drop)
    }

    /// The new connection's number.
    pub(crate) fn connect(&self, client: &str, server: &str, options: ConnectOptions) -> Answer<u64> {
        let (client, server, options) = (client.into(), server.into(), Some(options));
        let request = ConnectRequest { client, server, options, ..ConnectRequest::default() };
        done(async { self.gcm().connect(request).await }).map(|answer| answer.id)
    }

    pub(crate) fn disconnect(&self, client: &str, server: &str) -> Answer<()> {
        let (client, server) = (client.into(), server.into());
        let request = DisconnectRequest { client, server, ..DisconnectRequest::default() };
        done(async { self.gcm().disconnect(request).await }).map(drop)
    }

    /// The state row of a component, or the newest sample of an output.
    pub(crate) fn row(&self, path: &str) -> Answer<Value> {
        let request = ReadRequest { path: path.into(), ..ReadRequest::default() };
        let answer = heard(path, || done(async { self.interact().read(request.clone()).await }))?;
        Ok(answer.json.map_or(Value::Null, from_wire))
    }

    /// Calls a command and answers its result.
    pub(crate) fn invoke(&self, path: &str, arg: &Value, within: Duration) -> Answer<Value> {
        self.invoked(path, arg, within, false)
    }

    /// Calls a command that may be carried out twice, until it was.
    pub(crate) fn settle(&self, path: &str, arg: &Value) -> Answer<Value> {
        heard(path, || self.invoke(path, arg, PATIENCE))
    }

    /// Has a command queued.
    pub(crate) fn send(&self, path: &str, arg: &Value) -> Answer<()> {
        self.invoked(path, arg, Duration::from_secs(1), true).map(drop)
    }

    fn invoked(&self, path: &str, arg: &Value, within: Duration, send: bool) -> Answer<Value> {
        let json = (!arg.is_null()).then(|| to_wire(arg));
        let deadline = Some(prost_types::Duration {
            seconds: within.as_secs() as i64,
            nanos: within.subsec_nanos() as i32,
        });
        let request = InvokeRequest { path: path.into(), json, deadline, send, ..InvokeRequest::default() };
        let answer = done(async { self.interact().invoke(request).await })?;
        Ok(answer.json.map_or(Value::Null, from_wire))
    }
}

pub(crate) fn state_name(state: ComponentState) -> String {
    state.as_str_name().trim_start_matches("COMPONENT_STATE_").to_owned()
}

/// The answer to a call, or that there was none.
pub(crate) fn done<T>(call: impl Future<Output = Result<Response<T>, Status>>) -> Answer<T> {
    done_within(PATIENCE, call)
}

/// The same of what may take long.
pub(crate) fn done_within<T>(
    patience: Duration,
    call: impl Future<Output = Result<Response<T>, Status>>,
) -> Answer<T> {
    let late = |_| Status::deadline_exceeded(format!("{NO_ANSWER} within {} s", patience.as_secs()));
    let answer =
        runtime().block_on(async { tokio::time::timeout(patience, call).await.map_err(late).flatten() });
    Ok(answer?.into_inner())
}
