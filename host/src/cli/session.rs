//! The program's side of the gRPC services: one method per question, plain values in and out.
//!
//! Invariant: connects once, at the first question; every failure is told with the address that was asked.

use serde::Serialize;
use serde_json::Value;
use tokio::sync::OnceCell;
use tonic::Streaming;
use trocar_proto::v1;

use super::client::{self, Client};
use super::configure::ConfigureArgs;
use super::connect::{ConnectArgs, Cut};
use super::create::CreateArgs;
use super::failure::{Done, Exit, Failure};
use super::mutation::{Left, MutationArgs, Outcome, Standing};
use super::states::Verb;
use super::view::{ChangeView, DescribeView, ItemView, LogView, PluginView, ReplyView, SystemView};
use super::{convert, out};

/// Port a GCM listens on when nobody says otherwise.
pub(super) const DEFAULT_GCM: &str = "127.0.0.1:50551";

/// Where the GCM is, how answers are printed, and the connection once there is one.
pub(super) struct Session {
    explicit: Option<String>,
    json: bool,
    client: OnceCell<Client>,
}

impl Session {
    pub(super) fn new(gcm: Option<String>, json: bool) -> Self {
        Self { explicit: gcm, json, client: OnceCell::new() }
    }

    pub(super) fn json(&self) -> bool {
        self.json
    }

    /// What `--gcm` said, without the environment: for subcommands that are a process themselves.
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
        out::line(&text);
        Ok(Exit::Ok)
    }

    async fn client(&self) -> Result<Client, Failure> {
        let addr = self.address();
        let connect = || async { Client::connect(&addr).await.map_err(|e| Failure::no_gcm(&addr, &e)) };
        self.client.get_or_try_init(connect).await.cloned()
    }

    fn failed(&self, status: &tonic::Status) -> Failure {
        let told = client::explain(status);
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
        let ask = match class {
            true => v1::DescribeRequest { class: path.to_owned(), ..v1::DescribeRequest::default() },
            false => v1::DescribeRequest { path: path.to_owned(), ..v1::DescribeRequest::default() },
        };
        let answer = self.client().await?.gcm.describe(ask).await.map_err(|s| self.failed(&s))?;
        Ok(convert::description(path, answer.get_ref()))
    }

    pub(super) async fn create(&self, args: &CreateArgs) -> Result<Outcome, Failure> {
        let e = &args.execution;
        let execution = v1::Execution {
            model: e.model.map(|m| m.wire_name().to_owned()).unwrap_or_default(),
            rate_hz: e.rate_hz.unwrap_or(0.0),
            period: None,
            phase: e.phase.map(convert::duration),
            stream_of: e.stream_of.clone().unwrap_or_default(),
            inside: e.inside.clone().unwrap_or_default(),
            priority: e.priority.map(u32::from),
            cpus: e.cpus.clone(),
        };
        let ask = v1::CreateRequest {
            path: args.path.clone(),
            class: args.class.clone(),
            config: args.config.as_ref().map(convert::to_struct),
            execution: Some(execution),
            validate_only: args.mutation.dry_run,
            expected_revision: args.mutation.expected_revision,
            ..v1::CreateRequest::default()
        };
        let ask = timed(ask, &args.mutation);
        let a = self.client().await?.gcm.create(ask).await.map_err(|s| self.failed(&s))?.into_inner();
        Ok(outcome(a.revision, a.plan, a.components, a.skipped, a.warnings))
    }

    pub(super) async fn configure(&self, args: &ConfigureArgs) -> Result<Outcome, Failure> {
        let ask = v1::ConfigureRequest {
            path: args.path.clone(),
            config: Some(convert::to_struct(&args.config)),
            validate_only: args.mutation.dry_run,
            expected_revision: args.mutation.expected_revision,
            ..v1::ConfigureRequest::default()
        };
        let ask = timed(ask, &args.mutation);
        let a = self.client().await?.gcm.configure(ask).await.map_err(|s| self.failed(&s))?.into_inner();
        Ok(outcome(a.revision, a.plan, a.components, a.skipped, a.warnings))
    }

    pub(super) async fn verb(
        &self,
        verb: Verb,
        paths: &[String],
        m: &MutationArgs,
    ) -> Result<Outcome, Failure> {
        let mut gcm = self.client().await?.gcm;
        macro_rules! ask {
            ($request:ident, $method:ident) => {{
                let ask = v1::$request {
                    paths: paths.to_vec(),
                    validate_only: m.dry_run,
                    expected_revision: m.expected_revision,
                    ..v1::$request::default()
                };
                let a = gcm.$method(timed(ask, m)).await.map_err(|s| self.failed(&s))?.into_inner();
                outcome(a.revision, a.plan, a.components, a.skipped, a.warnings)
            }};
        }
        Ok(match verb {
            Verb::Start => ask!(StartRequest, start),
            Verb::Stop => with_failures(ask!(StopRequest, stop), m.dry_run),
            Verb::Resume => ask!(ResumeRequest, resume),
            Verb::Reset => ask!(ResetRequest, reset),
        })
    }

    pub(super) async fn remove(&self, path: &str, force: bool, m: &MutationArgs) -> Result<Outcome, Failure> {
        let ask = v1::RemoveRequest {
            path: path.to_owned(),
            force,
            validate_only: m.dry_run,
            expected_revision: m.expected_revision,
            ..v1::RemoveRequest::default()
        };
        let a =
            self.client().await?.gcm.remove(timed(ask, m)).await.map_err(|s| self.failed(&s))?.into_inner();
        Ok(outcome(a.revision, a.plan, a.components, a.skipped, a.warnings))
    }

    pub(super) async fn connect(&self, args: &ConnectArgs) -> Result<Outcome, Failure> {
        let queue = match (args.fifo, args.latest) {
            (Some(fifo), _) => Some(v1::Queue { fifo, drop_oldest: args.drop_oldest }),
            (None, true) => Some(v1::Queue { fifo: 0, drop_oldest: false }),
            (None, false) => None,
        };
        let options = v1::ConnectOptions {
            queue,
            max_age: args.max_age.map(convert::duration),
            deadline: args.deadline.map(convert::duration),
            mailbox: args.mailbox,
            adapt: args.adapt,
            replace: args.replace,
            carrier: args.carrier.clone().unwrap_or_default(),
        };
        let ask = v1::ConnectRequest {
            client: args.client.clone(),
            server: args.server.clone(),
            options: Some(options),
            validate_only: args.mutation.dry_run,
            expected_revision: args.mutation.expected_revision,
            ..v1::ConnectRequest::default()
        };
        let ask = timed(ask, &args.mutation);
        let a = self.client().await?.gcm.connect(ask).await.map_err(|s| self.failed(&s))?.into_inner();
        let connection = a.id;
        Ok(Outcome { connection, ..outcome(a.revision, a.plan, a.components, a.skipped, a.warnings) })
    }

    pub(super) async fn disconnect(&self, cut: &Cut, m: &MutationArgs) -> Result<Outcome, Failure> {
        let (id, client, server) = match cut {
            Cut::Id(id) => (*id, String::new(), String::new()),
            Cut::Pair { client, server } => (0, client.clone(), server.clone()),
        };
        let ask = v1::DisconnectRequest {
            id,
            client,
            server,
            validate_only: m.dry_run,
            expected_revision: m.expected_revision,
            ..v1::DisconnectRequest::default()
        };
        let a = self
            .client()
            .await?
            .gcm
            .disconnect(timed(ask, m))
            .await
            .map_err(|s| self.failed(&s))?
            .into_inner();
        Ok(outcome(a.revision, a.plan, a.components, a.skipped, a.warnings))
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

    pub(super) async fn plugins(&self, process: &str) -> Result<Vec<PluginView>, Failure> {
        let ask = v1::ListPluginsRequest { process: process.to_owned() };
        let a = self.client().await?.plugin.list_plugins(ask).await.map_err(|s| self.failed(&s))?;
        Ok(a.get_ref().plugins.iter().map(convert::plugin).collect())
    }

    pub(super) async fn subscribe(
        &self,
        paths: &[String],
        rate_hz: f64,
    ) -> Result<Follow<'_, v1::SubscribeResponse, ItemView>, Failure> {
        let selection =
            |path: &String| v1::Selection { path: path.clone(), max_rate_hz: rate_hz, thumbnail_width: 0 };
        let ask = v1::SubscribeRequest { selections: paths.iter().map(selection).collect() };
        let stream =
            self.client().await?.interact.subscribe(ask).await.map_err(|s| self.failed(&s))?.into_inner();
        Ok(Follow { session: self, stream, view: convert::item })
    }

    pub(super) async fn watch(
        &self,
        from: u64,
    ) -> Result<Follow<'_, v1::WatchResponse, ChangeView>, Failure> {
        let ask = v1::WatchRequest { from_revision: from };
        let stream = self.client().await?.gcm.watch(ask).await.map_err(|s| self.failed(&s))?.into_inner();
        Ok(Follow { session: self, stream, view: convert::change })
    }

    pub(super) async fn logs(
        &self,
        path: &str,
        level: &str,
        follow: bool,
    ) -> Result<Follow<'_, v1::LogsResponse, LogView>, Failure> {
        let ask = v1::LogsRequest { path: path.to_owned(), level: level.to_owned(), follow };
        let stream = self.client().await?.interact.logs(ask).await.map_err(|s| self.failed(&s))?.into_inner();
        Ok(Follow { session: self, stream, view: convert::log_line })
    }
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

/// A request with the caller's own deadline, if one was given.
fn timed<T>(ask: T, m: &MutationArgs) -> tonic::Request<T> {
    let mut ask = tonic::Request::new(ask);
    if let Some(ns) = m.timeout {
        ask.set_timeout(std::time::Duration::from_nanos(ns));
    }
    ask
}

/// A Stop goes on over failures: what was planned and has no report did not stop, a warning says why.
fn with_failures(mut outcome: Outcome, dry_run: bool) -> Outcome {
    // "- stop host/robot (ACTIVE → STOPPED{requested})"
    let planned = outcome.plan.iter().filter_map(|line| line.split(' ').nth(2)).filter(|_| !dry_run);
    for path in planned.filter(|path| outcome.components.iter().all(|c| c.path != **path)) {
        let prefix = format!("{path}: ");
        let why =
            outcome.warnings.iter().find_map(|w| w.strip_prefix(&prefix)).unwrap_or("no answer").to_owned();
        outcome.failed.push(Left { path: path.to_owned(), why });
    }
    outcome.warnings.retain(|w| outcome.failed.iter().all(|f| *w != format!("{}: {}", f.path, f.why)));
    outcome
}

fn outcome(
    revision: u64,
    plan: Vec<String>,
    components: Vec<v1::ComponentReport>,
    skipped: Vec<v1::SkippedComponent>,
    mut warnings: Vec<String>,
) -> Outcome {
    // A plan may touch a component several times; how it stands in the end counts.
    let last = |i: &usize| components[i + 1..].iter().all(|later| later.path != components[*i].path);
    let lasting: Vec<usize> = (0..components.len()).filter(last).collect();
    let standing = |c: &v1::ComponentReport| Standing {
        path: c.path.clone(),
        state: convert::state(c.state(), c.stop_reason()),
        health: convert::health(c.health()),
        fault: c.fault.clone(),
    };
    // Told with the component's path instead.
    warnings.retain(|w| components.iter().all(|c| !c.warnings.contains(w)));
    warnings.extend(components.iter().flat_map(|c| c.warnings.iter().map(|w| format!("{}: {w}", c.path))));
    Outcome {
        revision,
        plan,
        components: lasting.iter().map(|i| standing(&components[*i])).collect(),
        skipped: skipped.into_iter().map(|s| Left { path: s.path, why: s.why }).collect(),
        failed: Vec::new(),
        warnings,
        connection: 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(path: &str, state: v1::ComponentState) -> v1::ComponentReport {
        v1::ComponentReport { path: path.to_owned(), state: state.into(), ..v1::ComponentReport::default() }
    }

    #[test]
    fn a_component_touched_twice_is_shown_once_as_it_ended() {
        let reports =
            vec![report("h/a", v1::ComponentState::Created), report("h/a", v1::ComponentState::Ready)];
        let shown = outcome(1, Vec::new(), reports, Vec::new(), Vec::new());
        let states: Vec<&str> = shown.components.iter().map(|c| c.state.as_str()).collect();
        assert_eq!(states, ["READY"]);
    }

    #[test]
    fn a_stop_that_left_one_running_is_partial() {
        let reports = vec![report("h/a", v1::ComponentState::Stopped)];
        let plan = ["a", "b"].map(|name| format!("- stop h/{name} (ACTIVE → STOPPED{{requested}})")).to_vec();
        let done = outcome(1, plan, reports, Vec::new(), vec!["h/b: it hangs".to_owned()]);
        let done = with_failures(done, false);
        assert_eq!(done.failed, [Left { path: "h/b".into(), why: "it hangs".into() }]);
        assert!(done.warnings.is_empty(), "{:?}", done.warnings);
    }
}
