//! `Host`: one process of a system, from its state directory up to its gRPC port.
//!
//! Invariant: start makes everything or nothing; shutdown makes devices safe before it closes the port, so that a caller
//! can see it happen.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::task::JoinHandle;
use trocar_model::{Change, Name, Request, State, StopReason, Target, Verb};

use super::announce::Announcement;
use super::{HostError, StateChoice, StateDir, StopRequest};
use crate::control::{ServeConfig, Server, Uplink};
use crate::gcm::{ExecuteOptions, Gcm, GcmConfig, Registration};
use crate::lcm::{Lcm, LcmConfig, LocalLcm, StoreClasses};
use crate::loader::{PluginStore, PluginStoreConfig, Trust, WatchHandle};

/// How long components may take to stand still at the end.
const SHUTDOWN: Duration = Duration::from_secs(5);

/// What a host is made from.
#[derive(Clone, Debug)]
pub struct HostConfig {
    pub name: Name,
    /// Watched plugin directories; empty: none.
    pub plugins: Vec<PathBuf>,
    /// Address to listen on; port 0 takes a free one.
    pub listen: String,
    pub state: StateChoice,
    /// Forget what an earlier process left in the state directory.
    pub fresh: bool,
    /// The GCM to attach to; `None`: this host embeds one.
    pub gcm: Option<String>,
    pub trust: Trust,
}

/// A running process of a system.
pub struct Host {
    parts: Parts,
    state: StateDir,
}

/// Everything that runs in a state directory.
struct Parts {
    /// A GCM process has none.
    lcm: Option<Arc<LocalLcm>>,
    gcm: Option<Gcm>,
    uplink: Option<Uplink>,
    server: Server,
    watch: Option<WatchHandle>,
    announced: Option<JoinHandle<()>>,
}

impl Parts {
    fn into_host(self, state: StateDir) -> Host {
        Host { parts: self, state }
    }
}

impl Host {
    /// Starts a process with an LCM, and a GCM of its own unless it attaches to another.
    ///
    /// # Errors
    /// Everything that can be wrong with its directories, its port and its name.
    pub async fn start(config: HostConfig) -> Result<Self, HostError> {
        let state = StateDir::open(&config.state, config.fresh)?;
        match Self::start_in(&config, &state).await {
            Ok(parts) => Ok(parts.into_host(state)),
            Err(e) => {
                state.undo();
                Err(e)
            }
        }
    }

    async fn start_in(config: &HostConfig, state: &StateDir) -> Result<Parts, HostError> {
        let store = open_store(config, state)?;
        let classes = StoreClasses::new(config.name.clone(), store.clone());
        let lcm = LocalLcm::new(LcmConfig { process: config.name.clone(), classes: Some(classes) })
            .map_err(|e| HostError::Threads { because: e.to_string() })?;
        let changed = Arc::downgrade(&lcm);
        let watch = store.watch(move |_| {
            if let Some(lcm) = changed.upgrade() {
                lcm.catalog_changed();
            }
        });
        match Self::serve(config, state, lcm.clone()).await {
            Ok((gcm, uplink, server)) => {
                let announced = announce(config.name.as_str(), gcm.clone(), lcm.clone());
                Ok(Parts { lcm: Some(lcm), gcm, uplink, server, watch: Some(watch), announced })
            }
            Err(e) => {
                lcm.shutdown(SHUTDOWN).await;
                Err(e)
            }
        }
    }

    async fn serve(
        config: &HostConfig,
        state: &StateDir,
        lcm: Arc<LocalLcm>,
    ) -> Result<(Option<Gcm>, Option<Uplink>, Server), HostError> {
        let local: Arc<dyn Lcm> = lcm;
        let gcm = match config.gcm {
            Some(_) => None,
            None => Some(start_gcm(state).await?),
        };
        let server = Server::start(ServeConfig {
            listen: config.listen.clone(),
            gcm: gcm.clone(),
            local: Some((config.name.clone(), local.clone())),
            managed_by: config.gcm.clone(),
        })
        .await?;
        let endpoint = server.addr().to_string();
        let registration = Registration::new(config.name.clone(), endpoint);
        match (&gcm, &config.gcm) {
            (Some(gcm), _) => {
                let inventory = local.inventory().await?;
                gcm.register(registration, local, inventory).await?;
                Ok((Some(gcm.clone()), None, server))
            }
            (None, Some(addr)) => {
                let uplink = Uplink::start(addr.clone(), registration, local).await?;
                Ok((None, Some(uplink), server))
            }
            (None, None) => Ok((None, None, server)),
        }
    }

    /// Starts a GCM without components: `trocar gcm`.
    ///
    /// # Errors
    /// State directory or port cannot be used.
    pub async fn start_gcm(listen: &str, state: &StateChoice, fresh: bool) -> Result<Self, HostError> {
        let state = StateDir::open(state, fresh)?;
        match Self::start_gcm_in(listen, &state).await {
            Ok(parts) => Ok(parts.into_host(state)),
            Err(e) => {
                state.undo();
                Err(e)
            }
        }
    }

    async fn start_gcm_in(listen: &str, state: &StateDir) -> Result<Parts, HostError> {
        let gcm = start_gcm(state).await?;
        let server = Server::start(ServeConfig {
            listen: listen.to_owned(),
            gcm: Some(gcm.clone()),
            local: None,
            managed_by: None,
        })
        .await?;
        Ok(Parts { lcm: None, gcm: Some(gcm), uplink: None, server, watch: None, announced: None })
    }

    /// Where it listens.
    pub fn addr(&self) -> SocketAddr {
        self.parts.server.addr()
    }

    /// Its own GCM, unless it is attached to another.
    pub fn gcm(&self) -> Option<&Gcm> {
        self.parts.gcm.as_ref()
    }

    /// Its LCM; a GCM process has none.
    pub fn lcm(&self) -> Option<&Arc<LocalLcm>> {
        self.parts.lcm.as_ref()
    }

    /// Its state directory.
    pub fn state(&self) -> &StateDir {
        &self.state
    }

    /// Ends when the process is asked to end, or when the GCM it attached to sends it away for good.
    ///
    /// # Errors
    /// Why the GCM sent it away.
    pub async fn until_asked_to_stop(&mut self, stop: &mut StopRequest) -> Result<(), HostError> {
        match &mut self.parts.uplink {
            None => stop.asked().await,
            Some(uplink) => tokio::select! {
                () = stop.asked() => {}
                refusal = uplink.refused() => return Err(refusal.into()),
            },
        }
        Ok(())
    }

    /// Stops components, devices safe first, then everything else.
    pub async fn shutdown(self) {
        let Self { parts, state } = self;
        if let Some(task) = &parts.announced {
            task.abort();
        }
        if let Some(lcm) = &parts.lcm {
            lcm.shutdown(SHUTDOWN).await;
        }
        if let Some(uplink) = parts.uplink {
            uplink.shutdown().await;
        }
        parts.server.shutdown().await;
        // Dropping it joins the watching thread, which must not hold up a thread of the runtime.
        let watch = parts.watch;
        let _ = tokio::task::spawn_blocking(move || drop(watch)).await;
        drop(state);
    }
}

fn open_store(config: &HostConfig, state: &StateDir) -> Result<Arc<PluginStore>, HostError> {
    let host_exe = std::env::current_exe().map_err(|e| HostError::Threads { because: e.to_string() })?;
    let mut store = PluginStoreConfig::new(config.plugins.clone(), state.path().to_owned(), host_exe);
    store.trust = config.trust.clone();
    store.log = crate::lcm::plugin_log;
    Ok(PluginStore::open(store)?)
}

async fn start_gcm(state: &StateDir) -> Result<Gcm, HostError> {
    let dir = (!state.is_ephemeral()).then(|| state.path().to_owned());
    Gcm::start(GcmConfig { state: dir })
        .await
        .map_err(|e| HostError::StateUnwritable { dir: state.path().to_owned(), because: e.to_string() })
}

/// Without its socket a process still works; only `stop --all` cannot find it when the GCM is gone.
fn announce(name: &str, gcm: Option<Gcm>, lcm: Arc<LocalLcm>) -> Option<JoinHandle<()>> {
    let announcement = Announcement::open(name)
        .inspect_err(|e| log::warn!("`trocar stop --all` will not find this process without its GCM: {e}"))
        .ok()?;
    Some(tokio::spawn(async move {
        announcement.serve(move || stop_all(gcm.clone(), lcm.clone())).await;
    }))
}

/// Stops every component of this process: by its own GCM, or past a GCM that is elsewhere or does not answer.
async fn stop_all(gcm: Option<Gcm>, lcm: Arc<LocalLcm>) -> Result<String, String> {
    let deadline = Instant::now() + SHUTDOWN;
    if let Some(gcm) = gcm
        && let Ok(target) = Target::parse("**")
    {
        let options = ExecuteOptions {
            deadline: Some(deadline),
            identity: "stop --all".into(),
            ..ExecuteOptions::default()
        };
        if let Err(refusal) = gcm.execute(vec![Request::Stop { targets: vec![target] }], options).await {
            log::warn!("the GCM refused to stop everything, stopping past it: {refusal}");
        }
    }
    let inventory = lcm.inventory().await.map_err(|e| e.to_string())?;
    let active: Vec<_> = inventory.components.into_iter().filter(|c| c.state == State::Active).collect();
    let mut failed = Vec::new();
    for c in &active {
        let to = State::Stopped(StopReason::Requested);
        let stop = Change::Run { id: c.id.clone(), verb: Verb::Stop, from: State::Active, to };
        if let Err(refusal) = lcm.apply(stop, deadline).await {
            failed.push(refusal.to_string());
        }
    }
    if failed.is_empty() { Ok("everything stands still".to_owned()) } else { Err(failed.join("; ")) }
}
