//! `Host`: one process of a system, from its state directory up to its gRPC port.
//!
//! Invariant: [`HostConfig::start`] is the only way to a host with components, for the command line and for
//! programs alike. Start makes everything or nothing: each part is given to the thread that ends it before
//! the next one is made. The end makes devices safe before it closes the port, so that a caller can
//! see it happen.

use std::future::pending;
use std::net::SocketAddr;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

use tokio::task::JoinHandle;
use trocar_loader::{CatalogChange, PluginEntry, PluginError};
use trocar_model::{Request, Target};

use super::announce::Announcement;
use super::candidacy::{Among, Candidacy};
use super::ending::{Ending, SHUTDOWN};
use super::machines::Ways;
use super::sources::{self, Sources};
use super::state_dir::Kind;
use super::{HostConfig, HostError, Machines, StateChoice, StateDir, StopRequest, files, threads};
use crate::control::{Begin, Dialler, GcmServices, PortRules, Secured, ServeConfig, Server, Uplink};
use crate::gcm::{ExecuteOptions, Gcm, GcmConfig, Registration, StartError};
use crate::journal::RedbStore;
use crate::lcm::{Decision, Lcm, LcmConfig, LocalLcm, LogLine, Order, Stop, keep_descriptors};
use crate::runtime_dir::RuntimeDir;

/// A running process of a system.
///
/// Its components are made safe, stopped and destroyed however the host is let go: by [`Host::shutdown`], or
/// by dropping it, be that at an early return, in a panic, outside its runtime or after that has ended. Only
/// `std::process::exit`, `abort` and `std::mem::forget` pass by that.
pub struct Host {
    /// A GCM process has none.
    lcm: Option<Arc<LocalLcm>>,
    gcm: Option<Gcm>,
    uplink: Option<Uplink>,
    /// Address of the GCM when it is another process's.
    managed_by: Option<String>,
    /// A host inside a program may listen nowhere.
    addr: Option<SocketAddr>,
    /// The address that other machines reach.
    secured: Option<SocketAddr>,
    state: Arc<StateDir>,
    /// True: everything that the host was to be is there; before that it leaves nothing behind.
    is_up: bool,
    ending: Ending,
}

impl HostConfig {
    /// Starts a process with an LCM, and a GCM of its own unless it attaches to another.
    ///
    /// # Errors
    /// Everything that can be wrong with its directories, its port, its linked plugins and its name.
    pub async fn start(self) -> Result<Host, HostError> {
        needs_runtime()?;
        let mut host = Host::in_directory(&self.state, self.fresh)?;
        let done = host.bring_up(&self).await;
        host.if_up(done).await
    }
}

impl Host {
    /// Starts a GCM without components: `trocar gcm`.
    ///
    /// # Errors
    /// State directory or port cannot be used.
    pub async fn start_gcm(
        listen: &str,
        state: &StateChoice,
        fresh: bool,
        (rules, machines): (PortRules, &Machines),
    ) -> Result<Self, HostError> {
        needs_runtime()?;
        let secured = machines.open(None)?.secured;
        let mut host = Self::in_directory(state, fresh)?;
        let done = host.bring_up_gcm(listen, rules, secured).await;
        host.if_up(done).await
    }

    /// Starts a GCM without components among several for one system: `trocar gcm --store`. It leads when
    /// nobody else does, until it is not heard for its lease.
    ///
    /// # Errors
    /// State directory or port cannot be used, or what lies at that place is not a journal that can be read.
    pub async fn start_candidate(
        listen: &str,
        state: &StateChoice,
        among: &Among,
        (rules, machines): (PortRules, &Machines),
    ) -> Result<Self, HostError> {
        needs_runtime()?;
        let secured = machines.open(None)?.secured;
        let mut host = Self::in_directory(state, false)?;
        let done = host.bring_up_candidate(listen, among, (rules, secured)).await;
        host.if_up(done).await
    }

    /// Makes a host with nothing yet but the directory, and the thread that ends the rest.
    fn in_directory(state: &StateChoice, fresh: bool) -> Result<Self, HostError> {
        let state = Arc::new(StateDir::open(state, fresh)?);
        let ending = Ending::prepare(state.clone()).inspect_err(|_| state.undo())?;
        Ok(Host {
            lcm: None,
            gcm: None,
            uplink: None,
            managed_by: None,
            addr: None,
            secured: None,
            state,
            is_up: false,
            ending,
        })
    }

    /// Returns the whole host or, when something was refused, takes everything back.
    async fn if_up(mut self, done: Result<(), HostError>) -> Result<Self, HostError> {
        match done {
            Ok(()) => {
                self.is_up = true;
                self.ending.running().is_up = true;
                Ok(self)
            }
            Err(e) => {
                self.state.undo();
                self.shutdown().await;
                Err(e)
            }
        }
    }

    async fn bring_up(&mut self, config: &HostConfig) -> Result<(), HostError> {
        let Ways { dialler, secured, afar } = config.machines.open(config.gcm.as_deref())?;
        let Sources { classes, store } = sources::open(config, &self.state)?;
        let lcm = LocalLcm::new(LcmConfig {
            process: config.name.clone(),
            classes,
            links: Some(self.state.path().join("links.sock")),
            afar,
            lock_memory: config.lock_memory,
            allow_exec: config.allow_exec,
        })
        .map_err(|e| HostError::Threads { because: e.to_string() })?;
        config.memory.keep(&lcm)?;
        files::keep(&lcm);
        threads::keep(&lcm);
        self.lcm = Some(lcm.clone());
        self.ending.running().lcm = Some(lcm.clone());
        let changed = Arc::downgrade(&lcm);
        self.ending.running().watch = store.map(|store| {
            let refused = |reason: &PluginError| log::warn!("plugin file refused: {reason}");
            for entry in store.list() {
                if let PluginEntry::Refused { reason, .. } = &entry {
                    refused(reason);
                }
            }
            store.watch(move |change| {
                if let CatalogChange::Refused { reason, .. } = change {
                    refused(reason);
                }
                if let Some(lcm) = changed.upgrade() {
                    lcm.catalog_changed();
                }
            })
        });
        self.serve(config, lcm.clone(), &dialler, secured).await?;
        offer_services(config, &lcm, self.gcm.as_ref(), &dialler)
    }

    async fn serve(
        &mut self,
        config: &HostConfig,
        lcm: Arc<LocalLcm>,
        dialler: &Dialler,
        secured: Option<Secured>,
    ) -> Result<(), HostError> {
        let local: Arc<dyn Lcm> = lcm.clone();
        self.managed_by = config.gcm.clone();
        if config.gcm.is_none() {
            self.gcm = Some(start_gcm(&self.state).await?);
            self.ending.running().gcm = self.gcm.clone();
        }
        if let Some(listen) = &config.listen {
            self.listen(ServeConfig {
                listen: listen.clone(),
                gcm: self.gcm.clone(),
                local: Some((config.name.clone(), local.clone())),
                managed_by: config.gcm.clone(),
                rules: config.rules,
                secured,
                runtime: Some(RuntimeDir::of_user()),
            })
            .await?;
        }
        let secured = self.secured.map(|addr| format!("https://{addr}"));
        let endpoint = secured.or_else(|| self.addr.map(|addr| addr.to_string())).unwrap_or_default();
        self.ending.running().announced = announce(config.name.as_str(), self.gcm.clone(), lcm);
        // From here on the GCM makes components.
        keep_descriptors();
        let registration = Registration::new(config.name.clone(), endpoint);
        match (&self.gcm, &config.gcm) {
            (Some(gcm), _) => {
                let inventory = local.inventory().await?;
                gcm.register(registration, local, inventory).await?;
            }
            (None, Some(addr)) => {
                let begin = if config.await_gcm { Begin::Patient } else { Begin::AtOnce };
                let mut uplink =
                    Uplink::start(addr.clone(), dialler.clone(), registration, local, begin).await?;
                self.ending.running().uplink = uplink.take_task();
                self.uplink = Some(uplink);
            }
            (None, None) => {}
        }
        Ok(())
    }

    async fn bring_up_gcm(
        &mut self,
        listen: &str,
        rules: PortRules,
        secured: Option<Secured>,
    ) -> Result<(), HostError> {
        let gcm = start_gcm(&self.state).await?;
        self.gcm = Some(gcm.clone());
        self.ending.running().gcm = self.gcm.clone();
        self.listen(ServeConfig {
            listen: listen.to_owned(),
            gcm: Some(gcm),
            local: None,
            managed_by: None,
            rules,
            secured,
            runtime: Some(RuntimeDir::of_user()),
        })
        .await?;
        if let Some(addr) = self.addr {
            self.state.is_used_by(&Kind::Gcm(addr));
        }
        Ok(())
    }

    async fn bring_up_candidate(
        &mut self,
        listen: &str,
        among: &Among,
        (rules, secured): (PortRules, Option<Secured>),
    ) -> Result<(), HostError> {
        let runtime = RuntimeDir::of_user();
        let (server, seat) = Server::start_seat(listen, rules, secured, Some(runtime.clone())).await?;
        let addr = server.addr();
        (self.addr, self.secured) = (Some(addr), server.secured());
        let reached = self.secured.map_or_else(|| addr.to_string(), |addr| format!("https://{addr}"));
        // Others are led to where certificates are shown.
        let advertise = among.advertise.clone().map(|named| match self.secured {
            Some(_) => format!("https://{named}"),
            None => named,
        });
        let among = &Among { advertise, ..among.clone() };
        self.ending.running().server = Some(server);
        let begun = Candidacy::begin(seat, (among, reached), (rules, runtime)).await?;
        self.ending.running().candidacy = Some(begun);
        self.state.is_used_by(&Kind::Candidate);
        Ok(())
    }

    async fn listen(&mut self, config: ServeConfig) -> Result<(), HostError> {
        let server = Server::start(config).await?;
        (self.addr, self.secured) = (Some(server.addr()), server.secured());
        self.ending.running().server = Some(server);
        Ok(())
    }

    /// Returns the address that it listens on, or did; `None` for a host without a port.
    pub fn addr(&self) -> Option<SocketAddr> {
        self.addr
    }

    /// Returns the address at which other machines reach it, if there is one.
    pub fn secured(&self) -> Option<SocketAddr> {
        self.secured
    }

    /// Address of the GCM that manages this host when it is another process's.
    pub fn managed_by(&self) -> Option<&str> {
        self.managed_by.as_deref()
    }

    /// Returns its own GCM, unless it is attached to another.
    pub fn gcm(&self) -> Option<&Gcm> {
        self.gcm.as_ref()
    }

    /// Returns its LCM; a GCM process has none.
    pub fn lcm(&self) -> Option<&Arc<LocalLcm>> {
        self.lcm.as_ref()
    }

    /// Returns the function that keeps the program's own log lines for `Logs`, under the name of its process.
    pub fn own_lines(&self) -> impl Fn(LogLine) + Send + use<> {
        let gcm = self.gcm.as_ref().map(|gcm| gcm.lines().clone());
        let lcm = self.lcm.as_ref().map(Arc::downgrade);
        let path = self.lcm.as_ref().map_or_else(|| "gcm".to_owned(), |lcm| lcm.process().to_string());
        move |line| {
            let line = LogLine { path: path.clone(), ..line };
            match (&gcm, lcm.as_ref().and_then(Weak::upgrade)) {
                (Some(lines), _) => lines.keep(line),
                (None, Some(lcm)) => lcm.tell_line(line),
                (None, None) => {}
            }
        }
    }

    /// Returns its state directory.
    pub fn state_dir(&self) -> &StateDir {
        &self.state
    }

    /// True when it was shut down.
    pub fn has_ended(&self) -> bool {
        self.ending.has_ended()
    }

    /// Ends when the process is asked to end, or when the GCM it attached to sends it away for good.
    ///
    /// # Errors
    /// The reason why the GCM sent it away.
    pub async fn until_asked_to_stop(&mut self, stop: &mut StopRequest) -> Result<(), HostError> {
        let uplink = self.uplink.as_mut();
        let refused = async {
            match uplink {
                Some(uplink) => uplink.refused().await,
                None => pending().await,
            }
        };
        tokio::select! {
            () = stop.asked() => Ok(()),
            refusal = refused => Err(refusal.into()),
        }
    }

    /// Stops components, devices safe first, then everything else. Comes back when that is done, after 5 s
    /// and a little more when components hang. May be called any number of times, by several callers at once,
    /// and from any runtime or none. Once begun it goes on, also when nobody waits for it any more.
    ///
    /// Dropping the host does the same and blocks the thread meanwhile, but cuts open calls of the port.
    pub async fn shutdown(&self) {
        self.ending.end().await;
    }
}

impl Drop for Host {
    fn drop(&mut self) {
        if !self.is_up {
            self.state.undo();
        }
        self.ending.end_now();
    }
}

/// # Errors
/// There is no tokio runtime, or one that lacks clock or network.
fn needs_runtime() -> Result<(), HostError> {
    if tokio::runtime::Handle::try_current().is_err() {
        return Err(HostError::NoRuntime { lacks: "there is none around" });
    }
    // Tokio tells which drivers a runtime has only by panicking over those that are missing.
    let panics = |probe: fn()| catch_unwind(AssertUnwindSafe(probe)).is_err();
    if panics(|| drop(tokio::time::sleep(Duration::ZERO))) {
        return Err(HostError::NoRuntime { lacks: "this one has no clock" });
    }
    if panics(|| drop(tokio::net::UnixDatagram::unbound())) {
        return Err(HostError::NoRuntime { lacks: "this one has no network" });
    }
    Ok(())
}

/// Lets components ask the GCM of their system for dynamic component services.
fn offer_services(
    config: &HostConfig,
    lcm: &Arc<LocalLcm>,
    gcm: Option<&Gcm>,
    dialler: &Dialler,
) -> Result<(), HostError> {
    let services = match (gcm, &config.gcm) {
        (Some(gcm), _) => GcmServices::here(gcm.clone()),
        (None, Some(addr)) => GcmServices::at(addr, dialler)
            .map_err(|because| HostError::NoGcm { addr: addr.clone(), because })?,
        (None, None) => return Ok(()),
    };
    lcm.offer_services(Arc::new(services)).map_err(|e| HostError::Threads { because: e.to_string() })
}

async fn start_gcm(state: &StateDir) -> Result<Gcm, HostError> {
    let dir = state.lasting().map(Path::to_owned);
    let started = match dir {
        Some(dir) => {
            let store = Box::new(RedbStore::new(&dir));
            Gcm::resume(GcmConfig { state: Some(dir), ..GcmConfig::default() }, store).await
        }
        None => Gcm::start(GcmConfig::default()).await,
    };
    started.map_err(|e| match e {
        StartError::Store(e) => HostError::Journal(e),
        StartError::Refused(refusal) => HostError::Refused(refusal),
        StartError::Threads(because) => HostError::Threads { because },
    })
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
    if let Some(gcm) = gcm {
        let options = ExecuteOptions {
            deadline: Some(deadline),
            identity: "stop --all".into(),
            ..ExecuteOptions::default()
        };
        if let Err(refusal) =
            gcm.execute(vec![Request::Stop { targets: vec![Target::everything()] }], options).await
        {
            log::warn!("the GCM refused to stop everything, stopping past it: {refusal}");
        }
    }
    let everything = Stop { targets: vec![Target::everything()], known_here: 0 };
    let order = Order { decision: Decision::HERE, ..Order::from(deadline) };
    let stopped = lcm.stop(everything, order).await.map_err(|e| e.to_string())?;
    let failed: Vec<_> =
        stopped.into_iter().filter_map(|halted| halted.done.err()).map(|e| e.to_string()).collect();
    if failed.is_empty() { Ok("everything stands still".to_owned()) } else { Err(failed.join("; ")) }
}
