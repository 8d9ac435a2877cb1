//! PluginService: the content of the directories of all processes.

use tonic::{Request, Response, Status};
use trocar_model::{Name, Refusal};
use trocar_proto::v1;
use trocar_proto::v1::plugin_service_server::PluginService;

use super::identity::identity;
use super::{Edge, not_built, refuse};
use crate::control::convert;
use crate::control::deadline::{deadline, room};
use crate::lcm::PluginInfo;

impl Edge {
    /// Returns the plugins of one process, or of all; those called `again` are looked at again first.
    /// Processes that do not answer are warnings when all were asked.
    pub(super) async fn plugins(
        &self,
        process: &str,
        again: Option<&str>,
        until: std::time::Instant,
    ) -> Result<(Vec<PluginInfo>, Vec<String>), Status> {
        let processes =
            if process.is_empty() { self.processes() } else { vec![Name::parse(process).map_err(refuse)?] };
        let until = until - room(until);
        let (mut plugins, mut warnings) = (Vec::new(), Vec::new());
        // All are asked at once: a process that hangs delays no other answer.
        let asked = processes.into_iter().map(|name| {
            let (lcm, again) = (self.lcm(&name), again.map(str::to_owned));
            tokio::spawn(async move {
                let lcm = lcm?;
                let found = async {
                    match again {
                        Some(called) => lcm.recheck(&called, until).await,
                        None => lcm.plugins().await,
                    }
                };
                let what = "its list of plugins".into();
                let late = |_| Refusal::LcmTimeout { process: name, what };
                tokio::time::timeout_at(until.into(), found).await.map_err(late).flatten()
            })
        });
        for asking in asked.collect::<Vec<_>>() {
            let panicked = |e| Err(Refusal::Internal { text: format!("listing plugins panicked: {e}") });
            let refusal = match asking.await.unwrap_or_else(panicked) {
                Ok(found) => {
                    plugins.extend(found);
                    continue;
                }
                Err(refusal) => refusal,
            };
            if !process.is_empty() {
                return Err(refuse(refusal));
            }
            warnings.push(refusal.to_string());
        }
        Ok((plugins, warnings))
    }

    fn revision(&self) -> u64 {
        self.gcm.as_ref().map_or(0, |g| g.graph().revision)
    }
}

#[tonic::async_trait]
impl PluginService for Edge {
    async fn list_plugins(
        &self,
        request: Request<v1::ListPluginsRequest>,
    ) -> Result<Response<v1::ListPluginsResponse>, Status> {
        let until = deadline(&request);
        let (plugins, warnings) = self.plugins(&request.into_inner().process, None, until).await?;
        Ok(Response::new(v1::ListPluginsResponse {
            revision: self.revision(),
            plugins: plugins.into_iter().map(convert::plugin).collect(),
            warnings,
        }))
    }

    async fn describe_plugin(
        &self,
        request: Request<v1::DescribePluginRequest>,
    ) -> Result<Response<v1::DescribePluginResponse>, Status> {
        let until = deadline(&request);
        let r = request.into_inner();
        let (plugins, _) = self.plugins(&r.process, None, until).await?;
        let Some(found) = plugins.iter().find(|p| !r.name.is_empty() && p.is_called(&r.name)).cloned() else {
            return Err(refuse(not_found(r.name, plugins)));
        };
        let graph = self.gcm()?.graph();
        let classes = graph.processes.values().flat_map(|p| &p.classes);
        let mine = classes.filter(|c| c.hash == found.hash).map(|c| convert::class(c));
        Ok(Response::new(v1::DescribePluginResponse {
            revision: graph.revision,
            classes: mine.take(found.classes.len()).collect(),
            plugin: Some(convert::plugin(found)),
        }))
    }

    async fn load(&self, _: Request<v1::LoadRequest>) -> Result<Response<v1::LoadResponse>, Status> {
        Err(not_built("Load", "drop the file into the plugin directory; it is loaded at the first Create"))
    }

    async fn unload(&self, _: Request<v1::UnloadRequest>) -> Result<Response<v1::UnloadResponse>, Status> {
        Err(not_built("Unload", "remove the file from the plugin directory"))
    }

    async fn reload(&self, _: Request<v1::ReloadRequest>) -> Result<Response<v1::ReloadResponse>, Status> {
        Err(not_built("Reload", "copy the new file over the old one, then remove and create the component"))
    }

    async fn recheck(
        &self,
        request: Request<v1::RecheckRequest>,
    ) -> Result<Response<v1::RecheckResponse>, Status> {
        let (until, who) = (deadline(&request), identity(&request));
        let r = request.into_inner();
        let answer = self.plugins(&r.process, Some(&r.name), until).await;
        let outcome = answer.as_ref().map_or_else(
            |status| status.message().to_owned(),
            |(plugins, _)| match plugins.len() {
                1 => "1 file looked at".to_owned(),
                n => format!("{n} files looked at"),
            },
        );
        log::info!(target: "audit", "{who} asked {{\"recheck\":{{\"process\":\"{}\",\"name\":{:?}}}}}: {outcome}", r.process, r.name);
        let (plugins, warnings) = answer?;
        if plugins.is_empty() && !r.name.is_empty() && warnings.is_empty() {
            let (known, _) = self.plugins(&r.process, None, until).await?;
            return Err(refuse(not_found(r.name, known)));
        }
        Ok(Response::new(v1::RecheckResponse {
            revision: self.revision(),
            plugins: plugins.into_iter().map(convert::plugin).collect(),
            warnings,
        }))
    }
}

fn not_found(name: String, known: Vec<PluginInfo>) -> Refusal {
    let known = known.into_iter().map(|plugin| plugin.name).filter(|name| !name.is_empty()).collect();
    Refusal::PluginNotFound { name, known }
}
