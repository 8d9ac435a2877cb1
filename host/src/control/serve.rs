//! The port: binds, serves every service with reflection and health, and the viewer; stops gracefully.
//!
//! Invariant: without certificates only loopback addresses, whose callers the kernel knows; connections are
//! bounded in size, number, number of streams and silence.

use std::fmt;
use std::io::ErrorKind;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;

use parking_lot::Mutex;
use tokio::net::TcpListener;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::{Semaphore, watch};
use tokio::task::JoinHandle;
use tonic::service::{Routes, RoutesBuilder};
use tonic_health::ServingStatus;
use tonic_health::server::HealthReporter;
use trocar_model::{Name, Refusal};
use trocar_net::{Identity, Revoked, Role};
use trocar_proto::FILE_DESCRIPTOR_SET;
use trocar_proto::v1::agent_service_server::AgentServiceServer;
use trocar_proto::v1::attach_service_server::AttachServiceServer;
use trocar_proto::v1::gcm_service_server::GcmServiceServer;
use trocar_proto::v1::guest_service_server::GuestServiceServer;
use trocar_proto::v1::interact_service_server::InteractServiceServer;
use trocar_proto::v1::plugin_service_server::PluginServiceServer;

use super::agents::AgentEdge;
use super::attach::{AttachEdge, MAX_MESSAGE};
use super::caller::{Access, PortRules, READERS, own_user};
use super::doors::Doors;
use super::incoming::{Connection, Incoming, Secure};
use super::occupant::{self, Occupant};
use super::seat::{Seat, refusing};
use super::server::{Commanded, Edge, FOLLOWED, Standing};
use super::transport::{GRACE, patient, transport};
use super::web;
use crate::agent::Agent;
use crate::gcm::{Gcm, Lead, Lines, Standing as Journal};
use crate::lcm::{Lcm, News};
use crate::runtime_dir::RuntimeDir;

/// Services and settings of a port.
pub struct ServeConfig {
    /// Address and port; port 0 takes a free one.
    pub listen: String,
    pub gcm: Option<Gcm>,
    /// The LCM of this process.
    pub local: Option<(Name, Arc<dyn Lcm>)>,
    /// Address of the GCM that manages this process, when it is another's.
    pub managed_by: Option<String>,
    pub rules: PortRules,
    /// A second address, for callers from other machines.
    pub secured: Option<Secured>,
    /// Directory of the sockets beside the port and of the user's token; `None`: neither exists.
    pub runtime: Option<RuntimeDir>,
}

/// An address that other machines reach, where both sides show certificates.
#[derive(Clone, Debug)]
pub struct Secured {
    /// Address and port; port 0 takes a free one.
    pub listen: String,
    pub identity: Arc<Identity>,
    /// Certificates that are believed no more.
    pub revoked: Option<Arc<Revoked>>,
}

/// Protocols of a port under TLS.
const PROTOCOLS: [&str; 2] = ["h2", "http/1.1"];

/// Why a port cannot be served.
#[derive(Clone, Debug, PartialEq)]
pub enum ServeError {
    /// The address cannot be listened on; `help` says what to do.
    Unusable { because: String, help: String },
    /// A process of this name listens there already.
    Exists(Refusal),
}

impl fmt::Display for ServeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            ServeError::Unusable { because, .. } => f.write_str(because),
            ServeError::Exists(refusal) => write!(f, "{refusal}"),
        }
    }
}

impl std::error::Error for ServeError {}

/// A served port.
pub struct Server {
    addr: SocketAddr,
    /// The address that other machines reach.
    secured: Option<SocketAddr>,
    stop: watch::Sender<bool>,
    doors: Option<Doors>,
    /// Streams that would never end by themselves end with it.
    open: watch::Sender<()>,
    tasks: Vec<JoinHandle<()>>,
    /// Keeps log lines where no GCM does.
    logging: Option<JoinHandle<()>>,
}

impl Server {
    /// Binds and serves in the background.
    ///
    /// # Errors
    /// The address is malformed, taken, or not a loopback address.
    pub async fn start(config: ServeConfig) -> Result<Server, ServeError> {
        let listener = bind(&config.listen, config.local.as_ref().map(|(name, _)| name)).await?;
        let (lines, logging) = lines(config.gcm.as_ref(), config.local.as_ref());
        let (open, closing) = watch::channel(());
        let edge = Edge {
            gcm: config.gcm.clone(),
            local: config.local,
            managed_by: config.managed_by,
            lines,
            followed: Arc::new(Semaphore::new(FOLLOWED)),
            standing: Arc::new(Standing::default()),
            commanded: Commanded::default(),
            closing: closing.clone(),
        };
        let access = access(config.rules, config.runtime.as_ref());
        let routes = routes(edge, config.gcm, access, closing, None).await.map_err(damaged)?;
        let secured = secure(config.secured).await?;
        let at = (config.listen.as_str(), listener, secured);
        Server::serve(at, (routes, transport), config.runtime, (open, logging))
    }

    /// Binds, and serves an agent in the background.
    ///
    /// # Errors
    /// As [`Server::start`].
    pub async fn start_agent(
        listen: &str,
        rules: PortRules,
        secured: Option<Secured>,
        runtime: Option<RuntimeDir>,
        agent: Agent,
    ) -> Result<Server, ServeError> {
        let listener = bind(listen, None).await?;
        let secured = secure(secured).await?;
        let (open, closing) = watch::channel(());
        let (reporter, health) = tonic_health::server::health_reporter();
        reporter.set_serving::<AgentServiceServer<AgentEdge>>().await;
        let mut services = described(Routes::builder()).map_err(damaged)?;
        services.add_service(AgentServiceServer::new(AgentEdge::new(agent, closing))).add_service(health);
        let routes = web::without_page(services.routes(), access(rules, runtime.as_ref()));
        Server::serve((listen, listener, secured), (routes, patient), runtime, (open, None))
    }

    /// Binds, and serves what the seat of a GCM among several says, in the background.
    ///
    /// # Errors
    /// As [`Server::start`].
    pub async fn start_seat(
        listen: &str,
        rules: PortRules,
        secured: Option<Secured>,
        runtime: Option<RuntimeDir>,
    ) -> Result<(Server, Seat), ServeError> {
        let listener = bind(listen, None).await?;
        let secured = secure(secured).await?;
        let (reporter, health) = tonic_health::server::health_reporter();
        let mut services = described(Routes::builder()).map_err(damaged)?;
        services.add_service(health);
        let idle = web::with_page(refusing(services.routes()), None, access(rules, runtime.as_ref()));
        let seat = Seat::new(idle, reporter);
        let open = watch::channel(()).0;
        let at = (listen, listener, secured);
        let server = Server::serve(at, (seat.routes(), transport), runtime, (open, None))?;
        Ok((server, seat))
    }

    fn serve(
        (listen, listener, secured): (&str, TcpListener, Option<(SocketAddr, Secure)>),
        (routes, transport): (Routes, fn() -> tonic::transport::Server),
        runtime: Option<RuntimeDir>,
        (open, logging): (watch::Sender<()>, Option<JoinHandle<()>>),
    ) -> Result<Server, ServeError> {
        let addr = listener.local_addr().map_err(|e| unusable(listen, &e))?;
        let doors = runtime.map(|dir| Doors::open(&dir, addr, &routes));
        let stop = watch::Sender::new(false);
        let incoming = Incoming::tcp(listener, own_user());
        let on = transport();
        let mut tasks = vec![tokio::spawn(answer(incoming, on.clone(), routes.clone(), stop.subscribe()))];
        let (secured, callers) = secured.unzip();
        tasks.extend(callers.map(|callers| tokio::spawn(answer(callers, on, routes, stop.subscribe()))));
        Ok(Server { addr, secured, stop, doors, open, tasks, logging })
    }

    /// Returns the address it listens on.
    pub fn addr(&self) -> SocketAddr {
        self.addr
    }

    /// Returns the address that other machines reach, if there is one.
    pub fn secured(&self) -> Option<SocketAddr> {
        self.secured
    }

    /// Takes no more calls; open ones get a moment, streams are cut.
    pub async fn shutdown(mut self) {
        // First: as soon as the port is free, another process's lead to its own.
        self.doors.iter_mut().for_each(Doors::close);
        self.stop.send_replace(true);
        drop(self.open);
        if let Some(logging) = self.logging {
            logging.abort();
        }
        let late = tokio::time::Instant::now() + GRACE;
        for mut task in self.tasks {
            if tokio::time::timeout_at(late, &mut task).await.is_err() {
                task.abort();
            }
        }
    }

    /// Takes no more calls and leaves open ones to themselves; does not wait.
    pub(crate) fn cut(self) {
        if let Some(logging) = &self.logging {
            logging.abort();
        }
        self.tasks.iter().for_each(JoinHandle::abort);
    }
}

/// Answers those who come in until it is told to stop.
async fn answer<I>(
    incoming: I,
    mut transport: tonic::transport::Server,
    routes: Routes,
    mut stop: watch::Receiver<bool>,
) where
    I: tokio_stream::Stream<Item = std::io::Result<Connection>> + Unpin + Send + 'static,
{
    let stopped = async move {
        // A dropped sender means the same.
        let _ = stop.wait_for(|stop| *stop).await;
    };
    if let Err(e) = transport.add_routes(routes).serve_with_incoming_shutdown(incoming, stopped).await {
        log::error!("the gRPC port ended: {e}");
    }
}

/// Listens for callers from other machines.
async fn secure(wanted: Option<Secured>) -> Result<Option<(SocketAddr, Secure)>, ServeError> {
    let Some(Secured { listen, identity, revoked }) = wanted else { return Ok(None) };
    let because = |why: &dyn fmt::Display| {
        ServeError::Unusable {
        because: format!("{listen} cannot be listened on: {why}"),
        help: "give an address of this machine and a port: --listen-tls 10.0.0.1:50552 (port 0 takes a free one)".into(),
    }
    };
    if !matches!(identity.holder().role, Role::Gcm | Role::Host) {
        let (path, holder) = (identity.path().display(), identity.holder());
        return Err(ServeError::Unusable {
            because: format!("{path} is of the {holder}, and nobody believes that it is a process or a GCM"),
            help: "issue one with --role gcm, or --role host --process NAME: `trocar ca issue`".into(),
        });
    }
    let server = trocar_net::Server::new(identity, revoked, &PROTOCOLS).map_err(|e| because(&e))?;
    let listener = TcpListener::bind(&listen).await.map_err(|e| because(&e))?;
    let addr = listener.local_addr().map_err(|e| because(&e))?;
    Ok(Some((addr, Secure::new(listener, server))))
}

/// `own` is the name of this process, which a GCM has not.
async fn bind(listen: &str, own: Option<&Name>) -> Result<TcpListener, ServeError> {
    let addrs = tokio::net::lookup_host(listen).await.map_err(|e| ServeError::Unusable {
        because: format!("\"{listen}\" is not an address to listen on: {e}"),
        help: "give HOST:PORT, for example --listen 127.0.0.1:50551 (port 0 takes a free one)".into(),
    })?;
    let addrs: Vec<SocketAddr> = addrs.collect();
    if let Some(open) = addrs.iter().find(|a| !is_loopback(a.ip())) {
        return Err(ServeError::Unusable {
            because: format!("{open} can be reached from other machines, where nobody knows who calls"),
            help: format!(
                "listen on 127.0.0.1 or [::1], and for other machines beside it: --listen-tls {open} --identity FILE, which \
                 `trocar ca issue` makes; or reach it through an SSH tunnel"
            ),
        });
    }
    match TcpListener::bind(&addrs[..]).await {
        Ok(listener) => Ok(listener),
        Err(e) => match addrs.last() {
            // The error is that of the last address tried.
            Some(addr) if e.kind() == ErrorKind::AddrInUse => {
                Err(taken(*addr, own, &occupant::ask(*addr).await))
            }
            _ => Err(unusable(listen, &e)),
        },
    }
}

fn is_loopback(ip: IpAddr) -> bool {
    ip.is_loopback()
}

fn unusable(listen: &str, e: &std::io::Error) -> ServeError {
    ServeError::Unusable {
        because: format!("{listen} cannot be listened on: {e}"),
        help: "choose another address with --listen".into(),
    }
}

fn taken(addr: SocketAddr, own: Option<&Name>, occupant: &Occupant) -> ServeError {
    if let (Some(own), Some(there)) = (own, occupant.process())
        && own.as_str() == there.name
    {
        let (process, endpoint, pid) = (own.clone(), there.endpoint.clone(), there.pid);
        return ServeError::Exists(Refusal::ProcessExists { process, endpoint, pid });
    }
    let who = match occupant {
        Occupant::Host(p) => format!("the host `{}` (pid {}), which has a GCM of its own", p.name, p.pid),
        Occupant::Managed { by, process: Some(p) } => {
            format!("the host `{}` (pid {}), which the GCM at {by} manages", p.name, p.pid)
        }
        Occupant::Managed { by, process: None } => format!("a host of the GCM at {by}"),
        Occupant::Gcm => "a GCM".to_owned(),
        Occupant::Stranger => format!(
            "a program that does not answer as trocar does within {} ms",
            occupant::PATIENCE.as_millis()
        ),
    };
    let gcm = match occupant {
        Occupant::Host(_) | Occupant::Gcm => Some(addr.to_string()),
        Occupant::Managed { by, .. } => Some(by.clone()),
        Occupant::Stranger => None,
    };
    let elsewhere = "listen elsewhere: --listen 127.0.0.1:0 takes a free port and prints it, for TROCAR_GCM of those who ask";
    let help = match gcm {
        Some(gcm) => format!(
            "`trocar ls --gcm {gcm}` shows what runs there, and `trocar host --gcm {gcm} --listen 127.0.0.1:0 --name NAME` \
             joins it; else end it, or {elsewhere}"
        ),
        None => format!("`ss -ltnp 'sport = :{}'` names it: end it, or {elsewhere}", addr.port()),
    };
    ServeError::Unusable { because: format!("{addr} is taken by {who}"), help }
}

/// Returns the log lines this port shows, and their keeper.
fn lines(gcm: Option<&Gcm>, local: Option<&(Name, Arc<dyn Lcm>)>) -> (Arc<Lines>, Option<JoinHandle<()>>) {
    if let Some(gcm) = gcm {
        return (gcm.lines().clone(), None);
    }
    let lines = Arc::<Lines>::default();
    let keeper = local.map(|(_, lcm)| {
        let (mut news, lines) = (lcm.news(), lines.clone());
        tokio::spawn(async move {
            loop {
                match news.recv().await {
                    Ok(News::Log(line)) => lines.keep(line),
                    Ok(_) | Err(RecvError::Lagged(_)) => {}
                    Err(RecvError::Closed) => return,
                }
            }
        })
    });
    (lines, keeper)
}

/// Name of the journal in gRPC health.
pub(crate) const JOURNAL: &str = "journal";

/// Says over gRPC health whether what is decided is on record.
async fn tell_journal(
    reporter: HealthReporter,
    mut standing: watch::Receiver<Journal>,
    mut closing: watch::Receiver<()>,
) {
    loop {
        let health = match *standing.borrow_and_update() {
            Journal::Behind { .. } => ServingStatus::NotServing,
            Journal::None | Journal::Written => ServingStatus::Serving,
        };
        reporter.set_service_status(JOURNAL, health).await;
        tokio::select! {
            changed = standing.changed() => if changed.is_err() { return },
            _ = closing.changed() => return,
        }
    }
}

impl Seat {
    /// Answers from now on by a GCM that leads, as long as that holds.
    ///
    /// # Errors
    /// The descriptions of the services are damaged.
    pub async fn reigns(
        &self,
        gcm: Gcm,
        lead: Lead,
        rules: PortRules,
        runtime: Option<&RuntimeDir>,
    ) -> Result<(), ServeError> {
        let (open, closing) = watch::channel(());
        let edge = Edge {
            gcm: Some(gcm.clone()),
            local: None,
            managed_by: None,
            lines: gcm.lines().clone(),
            followed: Arc::new(Semaphore::new(FOLLOWED)),
            standing: Arc::new(Standing::default()),
            commanded: Commanded::default(),
            closing: closing.clone(),
        };
        let health = Some(self.health().clone());
        let routes = routes(edge, Some(gcm), access(rules, runtime), closing, health).await;
        self.leads(lead, routes.map_err(damaged)?, open);
        Ok(())
    }
}

fn access(rules: PortRules, runtime: Option<&RuntimeDir>) -> Access {
    Access {
        rules,
        user: own_user(),
        tokens: runtime.cloned(),
        refused: Mutex::default(),
        readers: Arc::new(Semaphore::new(READERS)),
    }
}

fn damaged(because: String) -> ServeError {
    ServeError::Unusable { because, help: "rebuild trocar: its service descriptions are damaged".into() }
}

/// Joins the services of a port. `health`: where the state of the journal is told, if not here.
async fn routes(
    edge: Edge,
    gcm: Option<Gcm>,
    access: Access,
    closing: watch::Receiver<()>,
    health: Option<HealthReporter>,
) -> Result<Routes, String> {
    let (reporter, own_health) = tonic_health::server::health_reporter();
    reporter.set_serving::<GcmServiceServer<Edge>>().await;
    reporter.set_serving::<InteractServiceServer<Edge>>().await;
    reporter.set_serving::<PluginServiceServer<Edge>>().await;
    reporter.set_serving::<GuestServiceServer<Edge>>().await;
    if let Some(gcm) = &gcm {
        reporter.set_serving::<AttachServiceServer<AttachEdge>>().await;
        tokio::spawn(tell_journal(health.unwrap_or(reporter), gcm.journal(), closing.clone()));
    }
    let pictures = Some(edge.clone());
    let mut services = described(Routes::builder())?;
    services
        .add_service(GcmServiceServer::new(edge.clone()))
        .add_service(InteractServiceServer::new(edge.clone()))
        .add_service(PluginServiceServer::new(edge.clone()))
        .add_service(GuestServiceServer::new(edge))
        .add_service(own_health);
    if let Some(gcm) = gcm {
        services.add_service(
            AttachServiceServer::new(AttachEdge::new(gcm, closing))
                .max_decoding_message_size(MAX_MESSAGE)
                .max_encoding_message_size(MAX_MESSAGE),
        );
    }
    Ok(web::with_page(services.routes(), pictures, access))
}

/// Adds reflection, of both versions.
fn described(mut services: RoutesBuilder) -> Result<RoutesBuilder, String> {
    let reflection = || {
        tonic_reflection::server::Builder::configure()
            .register_encoded_file_descriptor_set(FILE_DESCRIPTOR_SET)
            .register_encoded_file_descriptor_set(tonic_types::pb::FILE_DESCRIPTOR_SET)
            .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
            // Both versions tell of both, so a list of services is the same by either.
            .register_encoded_file_descriptor_set(tonic_reflection::pb::v1::FILE_DESCRIPTOR_SET)
            .register_encoded_file_descriptor_set(tonic_reflection::pb::v1alpha::FILE_DESCRIPTOR_SET)
            .include_reflection_service(false)
    };
    services
        .add_service(reflection().build_v1().map_err(|e| e.to_string())?)
        .add_service(reflection().build_v1alpha().map_err(|e| e.to_string())?);
    Ok(services)
}
