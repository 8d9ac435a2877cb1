//! `Host`: one process of a system, from its state directory up to its gRPC port.
//!
//! Invariant: start makes everything or nothing; shutdown makes devices safe before it closes the port, so that a caller
//! can see it happen.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::task::JoinHandle;
use trocar_model::{Change, Request, State, StopReason, Target, Verb};

use super::announce::Announcement;
use super::sources::{self, Sources};
use super::{HostConfig, HostError, StateChoice, StateDir, StopRequest};
use crate::control::{GcmServices, ServeConfig, Server, Uplink};
use crate::gcm::{ExecuteOptions, Gcm, GcmConfig, Registration};
use crate::lcm::{Lcm, LcmConfig, LocalLcm};
use crate::loader::WatchHandle;

/// How long components may take to stand still at the end.
const SHUTDOWN: Duration = Duration::from_secs(5);

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
    /// Where the GCM is when it is another process's.
    managed_by: Option<String>,
    /// A host inside a program may listen nowhere.
    server: Option<Server>,
    watch: Option<WatchHandle>,
    announced: Option<JoinHandle<()>>,
}

impl Parts {
    fn into_host(self, state: StateDir) -> Host {
        Host { parts: self, state }
    }
}

impl Host {
    /// Starts what the configuration says; [`HostConfig::start`] is the way in.
    pub(super) async fn from_config(config: HostConfig) -> Result<Self, HostError> {
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
        let Sources { classes, store } = sources::open(config, state)?;
        let lcm = LocalLcm::new(LcmConfig {
            process: config.name.clone(),
            classes,
            lock_memory: config.lock_memory,
        })
        .map_err(|e| HostError::Threads { because: e.to_string() })?;
        let changed = Arc::downgrade(&lcm);
        let watch = store.map(|store| {
            store.watch(move |_| {
                if let Some(lcm) = changed.upgrade() {
                    lcm.catalog_changed();
                }
            })
        });
        let served = Self::serve(config, state, lcm.clone()).await;
        match served.and_then(|parts| offer_services(config, &lcm, parts.0.as_ref()).map(|()| parts)) {
            Ok((gcm, uplink, server)) => {
                let announced = announce(config.name.as_str(), gcm.clone(), lcm.clone());
                let managed_by = config.gcm.clone();
                Ok(Parts { lcm: Some(lcm), gcm, uplink, managed_by, server, watch, announced })
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
    ) -> Result<(Option<Gcm>, Option<Uplink>, Option<Server>), HostError> {
        let local: Arc<dyn Lcm> = lcm;
        let gcm = match config.gcm {
            Some(_) => None,
            None => Some(start_gcm(state).await?),
        };
        let server = match &config.listen {
            None => None,
            Some(listen) => {
                let serving = Server::start(ServeConfig {
                    listen: listen.clone(),
                    gcm: gcm.clone(),
                    local: Some((config.name.clone(), local.clone())),
                    managed_by: config.gcm.clone(),
                });
                Some(serving.await?)
            }
        };
        let endpoint = server.as_ref().map(|s| s.addr().to_string()).unwrap_or_default();
        let registration = Registration::new(config.name.clone(), endpoint);
        let uplink = match (&gcm, &config.gcm) {
            (Some(gcm), _) => {
                let inventory = local.inventory().await?;
                gcm.register(registration, local, inventory).await?;
                None
            }
            (None, Some(addr)) => Some(Uplink::start(addr.clone(), registration, local).await?),
            (None, None) => None,
        };
        Ok((gcm, uplink, server))
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
        Ok(Parts {
            lcm: None,
            gcm: Some(gcm),
            uplink: None,
            managed_by: None,
            server: Some(server),
            watch: None,
            announced: None,
        })
    }

    /// Where it listens; `None` for a host without a port.
    pub fn addr(&self) -> Option<SocketAddr> {
        self.parts.server.as_ref().map(Server::addr)
    }

    /// Address of the GCM that manages this host when it is another process's.
    pub fn managed_by(&self) -> Option<&str> {
        self.parts.managed_by.as_deref()
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
    pub fn state_dir(&self) -> &StateDir {
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
        if let Some(server) = parts.server {
            server.shutdown().await;
        }
        // Dropping it joins the watching thread, which must not hold up a thread of the runtime.
        let watch = parts.watch;
        let _ = tokio::task::spawn_blocking(move || drop(watch)).await;
        drop(state);
    }
}

/// Lets components ask the GCM of their system for dynamic component services.
fn offer_services(config: &HostConfig, lcm: &Arc<LocalLcm>, gcm: Option<&Gcm>) -> Result<(), HostError> {
    let services = match (gcm, &config.gcm) {
        (Some(gcm), _) => GcmServices::here(gcm.clone()),
        (None, Some(addr)) => {
            GcmServices::at(addr).map_err(|because| HostError::NoGcm { addr: addr.clone(), because })?
        }
        (None, None) => return Ok(()),
    };
    lcm.offer_services(Arc::new(services)).map_err(|e| HostError::Threads { because: e.to_string() })
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
