//! The program's side of the gRPC services: one method per question, plain values in and out.
//!
//! Invariant: connects once, at the first question, and anew only after a loss; every failure is told with
//! the address that was asked.

mod changes;
pub(super) mod holding;
pub(super) mod recording;
mod system;

use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::Duration;

use parking_lot::Mutex;
use serde::Serialize;
use serde_json::Value;
use tokio::task::JoinSet;
use tonic::Streaming;
use trocar_proto::v1;

use super::client::{self, Client};
use super::failure::{Done, Exit, Failure};
use super::question::{For, Row, Waiting};
use super::view::{
    ChangeView, DescribeView, ItemView, LogView, PluginView, ReplyView, RowView, SystemView, WaitView,
};
use super::{convert, out};
use trocar::control::Dialler;
use trocar::runtime_dir::Door;

/// Port that a GCM listens on by default.
pub(super) const DEFAULT_GCM: &str = "127.0.0.1:50551";

/// Time beyond the deadline of a call that a GCM may take to report that the deadline passed.
const SILENCE: Duration = Duration::from_secs(3);

/// Time that other GCMs have to answer a Stop, too, when the one that leads has stopped.
const OTHERS: Duration = Duration::from_millis(300);

/// The value of `--identity`: every session of this program shows it.
static IDENTITY: OnceLock<PathBuf> = OnceLock::new();

/// Shows this to other machines from now on, where it is named.
pub(super) fn show(identity: Option<PathBuf>) {
    if let Some(identity) = identity {
        // It is said once, before anything is asked.
        let _ = IDENTITY.set(std::path::absolute(&identity).unwrap_or(identity));
    }
}

/// Returns the file that this program shows to other machines: that of `--identity`, else of the environment.
/// Absolute, so that programs that are started elsewhere find it.
pub(super) fn identity() -> Option<PathBuf> {
    let named = std::env::var_os("TROCAR_IDENTITY").filter(|path| !path.is_empty()).map(PathBuf::from);
    let from_env = || named.map(|path| std::path::absolute(&path).unwrap_or(path));
    IDENTITY.get().cloned().or_else(from_env)
}

/// The way to agents of other machines, with the identity of this program; it believes none of `revoked`.
pub(super) fn dialler_with(revoked: Option<&Path>) -> Result<Dialler, Failure> {
    Dialler::of_files(identity().as_deref(), revoked).map_err(unread)
}

fn unread(why: String) -> Failure {
    let help = "`trocar ca issue` makes one: name its file with --identity or TROCAR_IDENTITY";
    Failure::local("IDENTITY", why, help)
}

/// Tells whether a GCM that leads has refused something, rather than that none was there.
fn is_refusal(status: &tonic::Status) -> bool {
    let told = client::explain(status);
    !(told.transport || told.late || told.silent || told.reason == "NOT_LEADER")
}

/// Address of the GCM, form of the answers, and the connection once there is one.
pub(super) struct Session {
    explicit: Option<String>,
    json: bool,
    client: Mutex<Option<Client>>,
}

impl Session {
    pub(super) fn new(gcm: Option<String>, json: bool) -> Self {
        Self { explicit: gcm, json, client: Mutex::default() }
    }

    /// Reads the identity only where certificates are shown: no file keeps a Stop from this machine.
    fn dialler(addr: &str) -> Result<Dialler, Failure> {
        let identity = identity().filter(|_| addr.contains("https://"));
        Dialler::of_files(identity.as_deref(), None).map_err(unread)
    }

    pub(super) fn json(&self) -> bool {
        self.json
    }

    /// Returns the value of `--gcm`, without the environment: for subcommands that are a process themselves.
    pub(super) fn explicit_gcm(&self) -> Option<&str> {
        self.explicit.as_deref()
    }

    pub(super) fn address(&self) -> String {
        let from_env = || std::env::var("TROCAR_GCM").ok().filter(|a| !a.is_empty());
        self.explicit.clone().or_else(from_env).unwrap_or_else(|| DEFAULT_GCM.to_owned())
    }

    /// Prints one JSON document on one line.
    pub(super) fn print_json(&self, value: &impl Serialize) -> Done {
        let text = serde_json::to_string(value).map_err(|e| {
            Failure::local("INTERNAL", format!("cannot write JSON: {e}"), "please report this")
        })?;
        out::line(&out::json(&text));
        Ok(Exit::Ok)
    }

    async fn client(&self) -> Result<Client, Failure> {
        let addr = self.address();
        if let Some(client) = self.client.lock().clone() {
            return Ok(client);
        }
        let dialler = Self::dialler(&addr)?;
        let connected = match addr.contains(',') {
            true => Client::of_leader(&dialler, &addr).await,
            false => Client::connect(&dialler, &addr, Door::Calls).await,
        };
        let client = connected.map_err(|e| Failure::no_gcm(&addr, &e))?;
        Ok(self.client.lock().get_or_insert(client).clone())
    }

    /// Stops over a connection that waits for nothing else that is asked. Of several GCMs all are asked, side
    /// by side: one that doubts its lead stops what it still reaches, and a Stop does no harm twice. The
    /// answer of the one that leads counts, then a refusal, then the answer of one that doubts.
    async fn stopped(
        &self,
        ask: impl Fn() -> tonic::Request<v1::StopRequest>,
    ) -> Result<Result<v1::StopResponse, tonic::Status>, Failure> {
        let all = self.address();
        let mut asking = JoinSet::new();
        for addr in all.split(',').map(|addr| addr.trim().to_owned()) {
            let ask = ask();
            asking.spawn(async move {
                let dialler = Self::dialler(&addr)?;
                let client = Client::connect(&dialler, &addr, Door::Stop).await;
                let mut client = client.map_err(|e| Failure::no_gcm(&addr, &e))?;
                Ok(client.gcm.stop(ask).await.map(tonic::Response::into_inner))
            });
        }
        let (mut sure, mut doubted, mut refused, mut until) = (None, None, None, None);
        // Said by one that is not there, or does not lead.
        let mut absent = None;
        loop {
            let next = match until {
                Some(until) => tokio::time::timeout_at(until, asking.join_next()).await.ok().flatten(),
                None => asking.join_next().await,
            };
            let Some(next) = next else { break };
            match next.map_err(|e| Failure::local("INTERNAL", e.to_string(), "please report this"))? {
                Ok(Ok(answer)) if answer.doubted => doubted = Some(answer),
                Ok(Ok(answer)) => {
                    until.get_or_insert_with(|| tokio::time::Instant::now() + OTHERS);
                    sure = Some(answer);
                }
                Ok(Err(status)) if is_refusal(&status) => refused = Some(status),
                other => absent = absent.or(Some(other)),
            }
        }
        match (sure, refused, doubted, absent) {
            (Some(answer), ..) | (None, None, Some(answer), _) => Ok(Ok(answer)),
            (None, Some(status), ..) => Ok(Err(status)),
            (None, None, None, Some(absent)) => absent,
            (None, None, None, None) => Err(Failure::no_gcm(&all, "there is no address")),
        }
    }

    fn failed(&self, status: &tonic::Status) -> Failure {
        let told = client::explain(status);
        if told.transport || told.late || told.reason == "NOT_LEADER" {
            // Another may lead: it is looked for at the next question.
            self.client.lock().take();
        }
        if told.late {
            return Failure::late(&self.address());
        }
        if told.silent {
            return Failure::silent(&self.address());
        }
        if told.transport {
            return Failure::no_gcm(&self.address(), &told.message);
        }
        Failure::answered(told.code, &told.reason, told.message, told.help, told.metadata)
    }

    pub(super) async fn list(&self) -> Result<SystemView, Failure> {
        self.list_of("").await
    }

    pub(super) async fn list_of(&self, path: &str) -> Result<SystemView, Failure> {
        let ask = v1::ListRequest { path: path.to_owned(), ..v1::ListRequest::default() };
        let answer = self.client().await?.gcm.list(ask).await.map_err(|s| self.failed(&s))?;
        Ok(convert::system(answer.get_ref()))
    }

    pub(super) async fn describe(&self, path: &str, class: bool) -> Result<DescribeView, Failure> {
        if class {
            return self.class(path).await;
        }
        let failure = match self.path(path).await {
            Err(failure) if failure.reason.ends_with("_NOT_FOUND") => failure,
            answered => return answered,
        };
        // A path that exists is tried first; a name under which no path exists may be a class.
        self.class(path).await.map_err(|other| nor_a_class(path, failure, &other))
    }

    /// Describes the object at a path.
    pub(super) async fn path(&self, path: &str) -> Result<DescribeView, Failure> {
        self.described(path, v1::DescribeRequest { path: path.to_owned(), ..Default::default() }).await
    }

    /// The class of this name, if a plugin has one.
    async fn class(&self, name: &str) -> Result<DescribeView, Failure> {
        self.described(name, v1::DescribeRequest { class: name.to_owned(), ..Default::default() }).await
    }

    async fn described(&self, what: &str, ask: v1::DescribeRequest) -> Result<DescribeView, Failure> {
        let answer = self.client().await?.gcm.describe(ask).await.map_err(|s| self.failed(&s))?;
        Ok(convert::description(what, answer.get_ref()))
    }

    pub(super) async fn invoke(
        &self,
        path: &str,
        arg: Option<&Value>,
        deadline_ns: u64,
        send: bool,
    ) -> Result<ReplyView, Failure> {
        let ask = v1::InvokeRequest {
            path: path.to_owned(),
            json: arg.map(convert::to_wire),
            deadline: Some(convert::duration(deadline_ns)),
            send,
            ..v1::InvokeRequest::default()
        };
        let a = self.client().await?.interact.invoke(ask).await.map_err(|s| self.failed(&s))?.into_inner();
        Ok(ReplyView {
            executed: a.executed,
            value: a.json.as_ref().map(convert::from_wire),
            unit: a.unit,
            stamp_ns: a.stamp_ns,
            age_ns: a.age_ns,
        })
    }

    /// One row of a state table, or the newest sample of an output.
    pub(super) async fn read(&self, path: &str, row: Option<Row>) -> Result<RowView, Failure> {
        use v1::read_request::Row as Wire;
        let row = row.map(|row| match row {
            Row::At(ns) => Wire::AtNs(ns),
            Row::Nearest(ns) => Wire::NearestNs(ns),
            Row::Tick(tick) => Wire::Tick(tick),
            Row::Delayed(rows) => Wire::Delayed(rows),
        });
        let ask = v1::ReadRequest { path: path.to_owned(), row, frame: false };
        let a = self.client().await?.interact.read(ask).await.map_err(|s| self.failed(&s))?;
        Ok(convert::row(path, a.get_ref()))
    }

    pub(super) async fn wait_for(&self, waiting: &Waiting) -> Result<WaitView, Failure> {
        let mut ask = v1::WaitForRequest {
            path: waiting.path.clone(),
            deadline: Some(convert::duration(waiting.deadline_ns)),
            ..v1::WaitForRequest::default()
        };
        match &waiting.what {
            For::States(states) => ask.states = convert::states(states),
            For::Event(call) => {
                ask.call = call.as_ref().map(|(path, arg)| v1::InvokeRequest {
                    path: path.clone(),
                    json: arg.as_ref().map(convert::to_wire),
                    ..v1::InvokeRequest::default()
                });
            }
        }
        let mut ask = tonic::Request::new(ask);
        // The GCM keeps the deadline; this is for one that does not answer any more.
        ask.set_timeout(Duration::from_nanos(waiting.deadline_ns) + SILENCE);
        let a = self.client().await?.gcm.wait_for(ask).await.map_err(|s| self.failed(&s))?;
        Ok(convert::waited(&waiting.path, a.get_ref()))
    }

    pub(super) async fn plugins(&self, process: &str) -> Result<Vec<PluginView>, Failure> {
        let ask = v1::ListPluginsRequest { process: process.to_owned() };
        let a = self.client().await?.plugin.list_plugins(ask).await.map_err(|s| self.failed(&s))?;
        Ok(a.get_ref().plugins.iter().map(convert::plugin).collect())
    }

    /// Has hosts look again at plugins of this name; returns these plugins, and warnings.
    pub(super) async fn recheck(
        &self,
        name: &str,
        process: &str,
        within: Duration,
    ) -> Result<(Vec<PluginView>, Vec<String>), Failure> {
        let ask = v1::RecheckRequest { name: name.to_owned(), process: process.to_owned() };
        let mut ask = tonic::Request::new(ask);
        ask.set_timeout(within);
        let a = self.client().await?.plugin.recheck(ask).await.map_err(|s| self.failed(&s))?.into_inner();
        Ok((a.plugins.iter().map(convert::plugin).collect(), a.warnings))
    }

    pub(super) async fn subscribe(
        &self,
        paths: &[String],
        rate_hz: f64,
    ) -> Result<Follow<'_, v1::SubscribeResponse, ItemView>, Failure> {
        let selection =
            |path: &String| v1::Selection { path: path.clone(), max_rate_hz: rate_hz, ..Default::default() };
        let ask = v1::SubscribeRequest { selections: paths.iter().map(selection).collect() };
        let stream =
            self.client().await?.interact.subscribe(ask).await.map_err(|s| self.failed(&s))?.into_inner();
        Ok(Follow { session: self, stream, view: convert::item })
    }

    pub(super) async fn watch(
        &self,
        after: &str,
    ) -> Result<Follow<'_, v1::WatchResponse, ChangeView>, Failure> {
        let ask = v1::WatchRequest { after: after.to_owned(), ..Default::default() };
        let stream = self.client().await?.gcm.watch(ask).await.map_err(|s| self.failed(&s))?.into_inner();
        Ok(Follow { session: self, stream, view: convert::change })
    }

    pub(super) async fn logs(
        &self,
        path: &str,
        level: &str,
        follow: bool,
        last: Option<u32>,
    ) -> Result<Follow<'_, v1::LogsResponse, LogView>, Failure> {
        let ask = v1::LogsRequest {
            path: path.to_owned(),
            level: level.to_owned(),
            follow,
            last: last.unwrap_or(0),
        };
        let stream = self.client().await?.interact.logs(ask).await.map_err(|s| self.failed(&s))?.into_inner();
        Ok(Follow { session: self, stream, view: convert::log_line })
    }
}

/// Adds the classes of a plugin: a user who typed `plugin/Clas`, with a plugin that exists, meant a class.
fn nor_a_class(path: &str, no_path: Failure, no_class: &Failure) -> Failure {
    let Some((plugin, _)) = path.split_once('/') else { return no_path };
    let known = no_class.metadata.get("known").map_or("", String::as_str);
    let of_plugin: Vec<&str> =
        known.split(',').filter(|class| class.split('/').next() == Some(plugin)).collect();
    if of_plugin.is_empty() || no_path.reason != "PROCESS_NOT_FOUND" {
        return no_path;
    }
    let message = format!(
        "{}; nor has plugin `{plugin}` a class of this name: there is {}",
        no_path.message,
        of_plugin.join(", ")
    );
    Failure { message, ..no_path }
}

/// A stream of answers, each turned into what is shown.
pub(super) struct Follow<'s, W, V> {
    session: &'s Session,
    stream: Streaming<W>,
    view: fn(&W) -> V,
}

impl<W, V> Follow<'_, W, V> {
    /// The next item; `None` when the server ended the stream.
    pub(super) async fn next(&mut self) -> Result<Option<V>, Failure> {
        let item = self.stream.message().await.map_err(|s| self.session.failed(&s))?;
        Ok(item.as_ref().map(self.view))
    }
}
