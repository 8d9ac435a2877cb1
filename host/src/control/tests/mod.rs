//! The edge as callers see it: real clients against a server on a free port, with scripted LCMs.
#![allow(clippy::unwrap_used)]

mod attach;
mod edge;
mod execution;
mod feeds;
mod refusals;
mod video;
mod waiting;

use std::sync::Arc;

use tonic::Status;
use tonic::transport::{Channel, Endpoint};
use tonic_types::StatusExt;
use trocar_proto::v1;
use trocar_proto::v1::gcm_service_client::GcmServiceClient;
use trocar_proto::v1::interact_service_client::InteractServiceClient;
use trocar_proto::v1::plugin_service_client::PluginServiceClient;

use super::{PortRules, ServeConfig, Server};
use crate::gcm::fake::{FakeLcm, name};
use crate::gcm::{Gcm, GcmConfig, Registration};
use crate::lcm::Lcm;
use crate::watchdog::Watchdog;

/// A GCM with a port, and a process "host" of its own.
struct System {
    gcm: Gcm,
    lcm: Arc<FakeLcm>,
    server: Server,
    channel: Channel,
}

async fn serve(listen: &str, gcm: Option<&Gcm>, local: Option<&Arc<FakeLcm>>) -> Server {
    serve_by(PortRules::default(), listen, gcm, local).await
}

async fn serve_by(rules: PortRules, listen: &str, gcm: Option<&Gcm>, local: Option<&Arc<FakeLcm>>) -> Server {
    let config = ServeConfig {
        listen: listen.into(),
        gcm: gcm.cloned(),
        local: local.map(|lcm| (name("host"), lcm.clone() as Arc<dyn Lcm>)),
        managed_by: gcm.is_none().then(|| "127.0.0.1:50551".into()),
        rules,
        secured: None,
        runtime: None,
    };
    Server::start(config).await.unwrap()
}

async fn connect(server: &Server) -> Channel {
    Endpoint::from_shared(format!("http://{}", server.addr())).unwrap().connect().await.unwrap()
}

impl System {
    async fn start() -> System {
        System::start_with(PortRules::default()).await
    }

    async fn start_with(rules: PortRules) -> System {
        let (gcm, lcm) = (Gcm::start(GcmConfig::default()).await.unwrap(), FakeLcm::new("host"));
        let inventory = lcm.inventory().await.unwrap();
        gcm.register(Registration::new(name("host"), String::new()), lcm.clone(), inventory).await.unwrap();
        let server = serve_by(rules, "127.0.0.1:0", Some(&gcm), Some(&lcm)).await;
        let channel = connect(&server).await;
        System { gcm, lcm, server, channel }
    }

    fn gcm(&self) -> GcmServiceClient<Channel> {
        GcmServiceClient::new(self.channel.clone())
    }

    fn interact(&self) -> InteractServiceClient<Channel> {
        InteractServiceClient::new(self.channel.clone())
    }

    fn plugin(&self) -> PluginServiceClient<Channel> {
        PluginServiceClient::new(self.channel.clone())
    }
}

fn create(path: &str) -> v1::CreateRequest {
    v1::CreateRequest { path: path.into(), class: "arm".into(), ..Default::default() }
}

fn start(path: &str) -> v1::StartRequest {
    v1::StartRequest { path: path.into(), ..Default::default() }
}

fn stop(path: &str) -> v1::StopRequest {
    v1::StopRequest { path: path.into(), ..Default::default() }
}

fn link(client: &str, server: &str) -> v1::ConnectRequest {
    v1::ConnectRequest { client: client.into(), server: server.into(), ..Default::default() }
}

/// Asks until an answer of the server arrives: on a busy machine a caller may give up just before it.
async fn in_time<T>(mut ask: impl AsyncFnMut() -> Result<T, Status>) -> Result<T, Status> {
    let mut watchdog = Watchdog::of("an answer before the caller gives up");
    loop {
        match ask().await {
            Err(given_up) if given_up.get_details_error_info().is_none() => watchdog.saw(given_up),
            answer => return answer,
        }
    }
}

fn reason(status: &Status) -> String {
    status.get_details_error_info().map(|info| info.reason).unwrap_or_else(|| format!("none: {status}"))
}
