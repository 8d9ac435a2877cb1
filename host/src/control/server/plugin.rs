//! PluginService: what the directories of all processes hold.

use tonic::{Request, Response, Status};
use trocar_model::{Name, Refusal};
use trocar_proto::v1;
use trocar_proto::v1::plugin_service_server::PluginService;

use super::{Edge, not_built, refuse};
use crate::control::convert;
use crate::control::deadline::{deadline, room};
use crate::lcm::PluginInfo;

impl Edge {
    /// Plugins of one process, or of all; processes that do not answer are warnings when all were asked.
    async fn plugins(
        &self,
        process: &str,
        until: std::time::Instant,
    ) -> Result<(Vec<PluginInfo>, Vec<String>), Status> {
        let processes =
            if process.is_empty() { self.processes() } else { vec![Name::parse(process).map_err(refuse)?] };
        let until = until - room(until);
        let (mut plugins, mut warnings) = (Vec::new(), Vec::new());
        for name in processes {
            let asked = async { self.lcm(&name)?.plugins().await };
            let refusal = match tokio::time::timeout_at(until.into(), asked).await {
                Ok(Ok(found)) => {
                    plugins.extend(found);
                    continue;
                }
                Ok(Err(refusal)) => refusal,
                Err(_) => Refusal::LcmTimeout { process: name, what: "its list of plugins".into() },
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
        let (plugins, warnings) = self.plugins(&request.into_inner().process, until).await?;
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
        let (plugins, _) = self.plugins(&r.process, until).await?;
        let by_name = |p: &&PluginInfo| p.name == r.name || p.file.rsplit('/').next() == Some(&r.name);
        let Some(found) = plugins.iter().find(by_name).cloned() else {
            return Err(refuse(Refusal::PluginNotFound {
                name: r.name,
                known: plugins.into_iter().map(|p| p.name).filter(|n| !n.is_empty()).collect(),
            }));
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
}
