//! GcmService: one thin method per RPC.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tonic::{Request, Response, Status};
use trocar_model::{
    Change, ClassInfo, ComponentId, Connection, Name, Refusal, Request as Asked, SystemGraph,
};
use trocar_proto::v1;
use trocar_proto::v1::gcm_service_server::GcmService;

use super::identity::identity;
use super::list::{Listed, listed};
use super::page::Pages;
use super::part::{narrow, split};
use super::wait::{Awaited, Wait};
use super::watch::{WatchStream, watch};
use super::{Edge, not_built, past, refuse};
use crate::control::convert::{self, Common, Figures};
use crate::control::deadline::{deadline, room};
use crate::gcm::{ExecuteOptions, Executed, plan_lines};
use crate::lcm::{PluginInfo, Report};
use crate::system_file::Difference;

/// Executes and answers; the response types differ in name, and in the fields that are filled by the caller.
macro_rules! mutate {
    ($self:ident, $request:ident, $response:ident $({ $($extra:ident),* })?, $convert:expr) => {{
        let until = deadline(&$request);
        let identity = identity(&$request);
        let r = $request.into_inner();
        let common = Common {
            validate_only: r.validate_only,
            request_id: r.request_id.clone(),
            expected_revision: r.expected_revision,
        };
        let asked: Result<Vec<Asked>, Refusal> = $convert(r);
        let verb = stringify!($response).trim_end_matches("Response").to_lowercase();
        let asked = asked.map_err(|refusal| $self.not_read(&identity, &verb, refusal))?;
        let done = $self.execute(asked, common, until, identity).await?;
        (
            v1::$response {
                revision: done.revision,
                plan: plan_lines(&done.plan),
                components: told(&done),
                skipped: skipped(&done),
                warnings: $self.warnings(&done),
                $($($extra: Default::default(),)*)?
            },
            done,
        )
    }};
}

pub(super) fn skipped(done: &Executed) -> Vec<v1::SkippedComponent> {
    let skipped = done.skipped().iter();
    skipped.map(|s| v1::SkippedComponent { path: s.id.to_string(), why: s.why.clone() }).collect()
}

/// Returns the state of each component that exists in the end, once each; ports are for Describe.
pub(super) fn told(done: &Executed) -> Vec<v1::ComponentReport> {
    let mut out: Vec<v1::ComponentReport> = Vec::with_capacity(done.reports.len());
    let mut gone = BTreeSet::new();
    for change in &done.plan.changes {
        match change {
            Change::Create { id, .. } => _ = gone.remove(id),
            Change::Destroy { id, .. } => _ = gone.insert(id),
            _ => {}
        }
    }
    for report in done.reports.iter().filter(|report| !gone.contains(&report.id)) {
        let mut last = Report { ports: None, ..report.clone() };
        if let Some(at) = out.iter().position(|earlier| earlier.path == report.id.to_string()) {
            let earlier = out.remove(at);
            last.lost_connections.splice(0..0, earlier.lost_connections);
            last.warnings.splice(0..0, earlier.warnings);
        }
        out.push(convert::report(&last));
    }
    out
}

/// Each sentence once, though every change of a component reports it anew.
fn warnings(done: &Executed) -> Vec<String> {
    let failed = done.failed.iter().map(|(id, refusal)| format!("{id}: {refusal}"));
    let mut seen = BTreeSet::new();
    let all = done.reports.iter().flat_map(|r| r.warnings.clone()).chain(failed).chain(done.left.clone());
    all.filter(|warning| seen.insert(warning.clone())).collect()
}

pub(super) fn options(common: Common, until: Instant, identity: String) -> ExecuteOptions {
    ExecuteOptions {
        validate_only: common.validate_only,
        request_id: common.request_id,
        expected_revision: common.expected_revision,
        deadline: Some(until - room(until)),
        identity,
    }
}

impl Edge {
    /// Warnings of an answer.
    pub(super) fn warnings(&self, done: &Executed) -> Vec<String> {
        warnings(done).into_iter().chain(self.behind()).collect()
    }

    /// Tells when what is decided is not on record.
    pub(super) fn behind(&self) -> Option<String> {
        self.gcm.as_ref().and_then(|gcm| gcm.journal().borrow().warning())
    }

    async fn execute(
        &self,
        requests: Vec<Asked>,
        common: Common,
        until: Instant,
        identity: String,
    ) -> Result<Executed, Status> {
        let (gcm, options) = (self.gcm()?.clone(), options(common, until, identity));
        self.carried_out(async move { gcm.execute(requests, options).await }, until).await
    }

    /// A caller that goes away must not leave a change half made.
    pub(super) async fn carried_out(
        &self,
        change: impl Future<Output = Result<Executed, Refusal>> + Send + 'static,
        until: Instant,
    ) -> Result<Executed, Status> {
        match tokio::spawn(change).await {
            Ok(Ok(done)) => Ok(done),
            Ok(Err(refusal)) => Err(refuse(self.refused_file(refusal, until).await)),
            Err(e) => Err(refuse(Refusal::Internal { text: format!("the request panicked: {e}") })),
        }
    }

    /// When a class is unknown because its file was refused, that file's own reason says more.
    async fn refused_file(&self, refusal: Refusal, until: Instant) -> Refusal {
        let Refusal::ClassNotFound { process, class, .. } = &refusal else { return refusal };
        let Ok(lcm) = self.lcm(process) else { return refusal };
        let Ok(Ok(plugins)) = tokio::time::timeout_at(until.into(), lcm.plugins()).await else {
            return refusal;
        };
        let plugin = class.split('/').next().unwrap_or(class);
        let library = format!("libtrocar_{}.so", plugin.replace('-', "_"));
        let bare = format!("lib{}.so", plugin.replace('-', "_"));
        let is_it = |p: &&PluginInfo| {
            let file = p.file.rsplit('/').next().unwrap_or_default();
            !p.refused.is_empty() && (p.name == plugin || file == library || file == bare)
        };
        let Some(found) = plugins.iter().find(is_it) else { return refusal };
        let (file, text) = (found.file.clone(), found.refused.clone());
        match found.refused_reason.as_str() {
            "PLUGIN_ABI" => Refusal::PluginAbi { file, text },
            "PLUGIN_UNTRUSTED" => Refusal::PluginUntrusted { file, text },
            _ => Refusal::PluginBadFile { file, text },
        }
    }

    /// A component and the connections that end at it.
    async fn one_component(&self, id: &ComponentId, until: Instant) -> Result<v1::GetStateResponse, Status> {
        let graph = self.gcm()?.graph();
        let component = graph.components.get(id).ok_or_else(|| {
            refuse(match graph.processes.contains_key(&id.process) {
                true => Refusal::ComponentNotFound {
                    id: id.clone(),
                    known: graph.components.keys().cloned().collect(),
                },
                false => Refusal::ProcessNotFound {
                    process: id.process.clone(),
                    known: graph.processes.keys().cloned().collect(),
                },
            })
        })?;
        let ends_here = |c: &&Connection| c.client.component == *id || c.server.component == *id;
        let shown: Vec<&Connection> = graph.connections.values().filter(ends_here).collect();
        let figures = self.figures(std::slice::from_ref(id), &shown, until).await;
        Ok(v1::GetStateResponse {
            revision: graph.revision,
            component: Some(convert::component(id, component, figures.details.get(id))),
            connections: connections(&graph, &shown, &figures),
        })
    }
}

#[tonic::async_trait]
impl GcmService for Edge {
    async fn create(
        &self,
        request: Request<v1::CreateRequest>,
    ) -> Result<Response<v1::CreateResponse>, Status> {
        let (mut answer, done) =
            mutate!(self, request, CreateResponse { path }, |r| Ok(vec![convert::create(r)?]));
        if let Some(Change::Create { id, .. }) = done.plan.changes.first() {
            answer.path = id.to_string();
        }
        Ok(Response::new(answer))
    }

    async fn remove(
        &self,
        request: Request<v1::RemoveRequest>,
    ) -> Result<Response<v1::RemoveResponse>, Status> {
        Ok(Response::new(mutate!(self, request, RemoveResponse, |r| Ok(vec![convert::remove(r)?])).0))
    }

    async fn forget(
        &self,
        request: Request<v1::ForgetRequest>,
    ) -> Result<Response<v1::ForgetResponse>, Status> {
        Ok(Response::new(mutate!(self, request, ForgetResponse, |r| Ok(vec![convert::forget(r)?])).0))
    }

    async fn restart(
        &self,
        request: Request<v1::RestartRequest>,
    ) -> Result<Response<v1::RestartResponse>, Status> {
        let (until, who) = (deadline(&request), identity(&request));
        let process = Name::parse(&request.into_inner().process).map_err(refuse)?;
        let answer = self.gcm()?.restart(&process, until - room(until)).await;
        let outcome =
            answer.as_ref().map_or_else(ToString::to_string, |graph| format!("revision {}", graph.revision));
        log::info!(target: "audit", "{who} asked {{\"restart\":{{\"process\":\"{process}\"}}}}: {outcome}");
        let graph = answer.map_err(refuse)?;
        let epoch = graph.processes.get(&process).map_or(0, |there| there.epoch);
        Ok(Response::new(v1::RestartResponse { revision: graph.revision, epoch }))
    }

    async fn configure(
        &self,
        request: Request<v1::ConfigureRequest>,
    ) -> Result<Response<v1::ConfigureResponse>, Status> {
        Ok(Response::new(mutate!(self, request, ConfigureResponse, |r| Ok(vec![convert::configure(r)?])).0))
    }

    async fn start(&self, request: Request<v1::StartRequest>) -> Result<Response<v1::StartResponse>, Status> {
        Ok(Response::new(
            mutate!(self, request, StartResponse, |r: v1::StartRequest| Ok(vec![Asked::Start {
                targets: convert::targets("Start", r.paths, r.path)?
            }]))
            .0,
        ))
    }

    async fn stop(&self, request: Request<v1::StopRequest>) -> Result<Response<v1::StopResponse>, Status> {
        if let (None, Some((process, lcm))) = (&self.gcm, &self.local) {
            return past::stop(process, lcm, request).await.map(Response::new);
        }
        let mut unread = Vec::new();
        let (mut answer, done) =
            mutate!(self, request, StopResponse { failed, doubted }, |r: v1::StopRequest| {
                let stop = convert::to_stop(r.paths, r.path)?;
                unread = stop.unread;
                Ok(vec![Asked::Stop { targets: stop.targets }])
            });
        answer.warnings.extend(unread.iter().map(|(text, refusal)| format!("{text}: {refusal}")));
        let failed = done.failed.iter().map(|(target, refusal)| (target.to_string(), refusal.to_string()));
        let unread = unread.into_iter().map(|(text, refusal)| (text, refusal.to_string()));
        answer.failed = failed.chain(unread).map(|(path, why)| v1::SkippedComponent { path, why }).collect();
        answer.doubted = self.gcm.as_ref().is_some_and(|gcm| gcm.is_doubted());
        Ok(Response::new(answer))
    }

    async fn resume(
        &self,
        request: Request<v1::ResumeRequest>,
    ) -> Result<Response<v1::ResumeResponse>, Status> {
        Ok(Response::new(
            mutate!(self, request, ResumeResponse, |r: v1::ResumeRequest| Ok(vec![Asked::Resume {
                targets: convert::targets("Resume", r.paths, r.path)?
            }]))
            .0,
        ))
    }

    async fn reset(&self, request: Request<v1::ResetRequest>) -> Result<Response<v1::ResetResponse>, Status> {
        Ok(Response::new(
            mutate!(self, request, ResetResponse, |r: v1::ResetRequest| Ok(vec![Asked::Reset {
                targets: convert::targets("Reset", r.paths, r.path)?
            }]))
            .0,
        ))
    }

    async fn connect(
        &self,
        request: Request<v1::ConnectRequest>,
    ) -> Result<Response<v1::ConnectResponse>, Status> {
        let (mut answer, done) =
            mutate!(self, request, ConnectResponse { id }, |r| Ok(vec![convert::connect(r)?]));
        for change in &done.plan.changes {
            if let Change::Connect { connection } = change {
                answer.id = connection.id.0;
            }
        }
        Ok(Response::new(answer))
    }

    async fn disconnect(
        &self,
        request: Request<v1::DisconnectRequest>,
    ) -> Result<Response<v1::DisconnectResponse>, Status> {
        Ok(Response::new(mutate!(self, request, DisconnectResponse, |r| Ok(vec![convert::disconnect(r)?])).0))
    }

    async fn apply(&self, request: Request<v1::ApplyRequest>) -> Result<Response<v1::ApplyResponse>, Status> {
        if !request.get_ref().system.is_empty() || request.get_ref().prune {
            return self.apply_system(request).await.map(Response::new);
        }
        Ok(Response::new(
            mutate!(self, request, ApplyResponse, |r: v1::ApplyRequest| convert::steps(r.steps)).0,
        ))
    }

    async fn save(&self, request: Request<v1::SaveRequest>) -> Result<Response<v1::SaveResponse>, Status> {
        self.saved(request).await.map(Response::new)
    }

    async fn compare(
        &self,
        request: Request<v1::CompareRequest>,
    ) -> Result<Response<v1::CompareResponse>, Status> {
        let (revision, found) = self.gcm()?.compare(&request.into_inner().system).map_err(refuse)?;
        let Difference { lines: differences, left: notes, .. } = found;
        Ok(Response::new(v1::CompareResponse { revision, differences, notes }))
    }

    async fn get_state(
        &self,
        request: Request<v1::GetStateRequest>,
    ) -> Result<Response<v1::GetStateResponse>, Status> {
        let until = deadline(&request);
        let id = ComponentId::parse(&request.into_inner().path).map_err(refuse)?;
        Ok(Response::new(self.one_component(&id, until).await?))
    }

    async fn list(&self, request: Request<v1::ListRequest>) -> Result<Response<v1::ListResponse>, Status> {
        let until = deadline(&request);
        let r = request.into_inner();
        let gcm = self.gcm()?;
        let pages = Pages::of(&r).map_err(refuse)?;
        let places = &self.standing.lists;
        let listed = listed(gcm, &r, until - room(until), self.closing.clone(), places).await?;
        let Listed { whole, mut part, etag } = listed;
        let cursor = gcm.history().cursor(&whole);
        let mut classes = if r.classes { classes(&part) } else { Vec::new() };
        let next_page_token = pages.cut(&mut part, &mut classes);
        let ids: Vec<ComponentId> = part.components.keys().cloned().collect();
        let shown: Vec<&Connection> = part.connections.values().collect();
        let mut figures = if r.brief { Figures::default() } else { self.figures(&ids, &shown, until).await };
        figures.warnings.extend(self.behind());
        Ok(Response::new(v1::ListResponse {
            etag,
            cursor,
            next_page_token,
            classes: classes.iter().map(|c| convert::class(c)).collect(),
            ..convert::list(&whole, &part, gcm.term(), &figures)
        }))
    }

    async fn describe(
        &self,
        request: Request<v1::DescribeRequest>,
    ) -> Result<Response<v1::DescribeResponse>, Status> {
        let until = deadline(&request);
        let r = request.into_inner();
        let graph = self.gcm()?.graph();
        let mut answer = v1::DescribeResponse { revision: graph.revision, ..Default::default() };
        if !r.class.is_empty() {
            let classes = graph.processes.values().flat_map(|p| &p.classes);
            let found = classes.clone().find(|c| c.full_name() == r.class || c.name == r.class);
            let class = found.ok_or_else(|| {
                refuse(Refusal::PluginNotFound {
                    name: r.class.clone(),
                    known: classes.map(|c| c.full_name()).collect(),
                })
            })?;
            answer.class = Some(convert::class(class));
            return Ok(Response::new(answer));
        }
        if !r.path.contains('/') {
            let name = Name::parse(&r.path).map_err(refuse)?;
            let process = graph.processes.get(&name).ok_or_else(|| {
                refuse(Refusal::ProcessNotFound {
                    process: name.clone(),
                    known: graph.processes.keys().cloned().collect(),
                })
            })?;
            answer.process = Some(convert::process(&name, process));
            answer.classes = process.classes.iter().map(|c| convert::class(c)).collect();
            let leaves_it = |c: &&Connection| !c.is_near() && c.ends_in(&name);
            let shown: Vec<&Connection> = graph.connections.values().filter(leaves_it).collect();
            let figures = self.figures(&[], &shown, until).await;
            answer.connections = connections(&graph, &shown, &figures);
            return Ok(Response::new(answer));
        }
        let (id, port, member) = split(&r.path).map_err(refuse)?;
        let stands = self.one_component(&id, until).await?;
        (answer.component, answer.connections) = (stands.component, stands.connections);
        if let Some(component) = graph.components.get(&id) {
            let ports = narrow(&component.ports, &id, port.as_ref(), member.as_ref()).map_err(refuse)?;
            answer.ports = Some(convert::ports(&ports));
            answer.class = Some(convert::class(&component.class));
        }
        Ok(Response::new(answer))
    }

    async fn wait_for(
        &self,
        request: Request<v1::WaitForRequest>,
    ) -> Result<Response<v1::WaitForResponse>, Status> {
        if let Some(call) = &request.get_ref().call {
            self.may_call(request.extensions(), &call.path).map_err(refuse)?;
        }
        let who = identity(&request);
        let Wait { what, until } = Wait::read(request).map_err(refuse)?;
        let _held = self.standing.waits.take()?;
        let (id, item) = match what {
            Awaited::States(id, states) => {
                self.gcm()?.wait_for(&id, &states, until).await.map_err(refuse)?;
                (id, None)
            }
            Awaited::Event(member, call) => {
                let item = self.event(&member, call.map(|call| (who, call)), until).await?;
                (member.port.component, Some(convert::item(item)))
            }
        };
        let v1::GetStateResponse { revision, component, .. } =
            self.one_component(&id, deadline_from(until)).await?;
        let stamp_ns = item.as_ref().map_or(0, |i| i.stamp_ns);
        let json = item.and_then(|i| i.json);
        Ok(Response::new(v1::WaitForResponse { revision, component, json, stamp_ns }))
    }

    async fn replace(&self, _: Request<v1::ReplaceRequest>) -> Result<Response<v1::ReplaceResponse>, Status> {
        Err(not_built("Replace (hot swap)", "stop, remove and create the component again"))
    }

    async fn r#move(&self, _: Request<v1::MoveRequest>) -> Result<Response<v1::MoveResponse>, Status> {
        Err(not_built("Move", "remove the component and create it in the other process"))
    }

    type WatchStream = WatchStream;

    async fn watch(&self, request: Request<v1::WatchRequest>) -> Result<Response<WatchStream>, Status> {
        let gcm = self.gcm()?;
        let held = self.standing.watches.take()?;
        Ok(Response::new(watch(gcm, request.get_ref(), self.closing.clone(), held)?))
    }
}

/// Each class once that these processes offer.
fn classes(part: &SystemGraph) -> Vec<Arc<ClassInfo>> {
    let mut seen = BTreeSet::new();
    let all = part.processes.values().flat_map(|p| &p.classes);
    all.filter(|c| seen.insert((c.full_name(), c.hash.clone()))).cloned().collect()
}

fn connections(graph: &SystemGraph, shown: &[&Connection], figures: &Figures) -> Vec<v1::Connection> {
    shown.iter().map(|c| convert::connection(graph, c, figures.links.get(&c.id.0))).collect()
}

/// At least a moment for the last question.
fn deadline_from(until: Instant) -> Instant {
    until.max(Instant::now() + Duration::from_millis(100))
}
