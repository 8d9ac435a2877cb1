//! The way to a port: by the socket beside it, else by TCP, with the token of the environment; to one of
//! another machine by TLS, with the certificate of this process.
//!
//! Invariant: a socket is taken only from this user's own runtime directory, so nobody else can stand behind
//! it. A caller that asks by a door never waits for ever: a host that stands still (its kernel still takes
//! connections) is found out by pings it does not answer.

use std::error::Error;
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use hyper_util::rt::TokioIo;
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::pki_types::ServerName;
use tonic::transport::{Channel, Endpoint, Uri};
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_client::HealthClient;
use tower::service_fn;
use trocar_net::{Client, Identity, Revoked};

use self::told::{Told, Why};
use super::caller::{Tokened, with_token};
use crate::runtime_dir::{Door, RuntimeDir};

mod told;

/// During a request, a host that is silent for this long is pinged.
const QUIET: Duration = Duration::from_secs(5);
/// The connection ends where it does not answer within that.
const ANSWERS: Duration = Duration::from_secs(5);
/// The port speaks gRPC alone to programs.
const PROTOCOLS: [&str; 1] = ["h2"];
/// In front of addresses where both sides show certificates.
const SECURED: &str = "https://";

/// The reason why nobody is reached; its innermost cause says it.
pub type DialError = Box<dyn Error + Send + Sync>;

/// Whoever is called, by the role of its certificate.
#[derive(Clone, Copy)]
enum Called {
    Gcm,
    /// A host, or an agent of one.
    Process,
}

/// The way of this process to ports, with the identity that it shows where certificates are asked for.
#[derive(Clone, Debug, Default)]
pub struct Dialler {
    identity: Option<Arc<Identity>>,
    revoked: Option<Arc<Revoked>>,
}

impl Dialler {
    /// One that shows nothing: it reaches ports of this machine.
    pub fn local() -> Dialler {
        Dialler::default()
    }

    /// One that shows this identity, and believes none of `revoked`.
    pub fn new(identity: Arc<Identity>, revoked: Option<Arc<Revoked>>) -> Dialler {
        Dialler { identity: Some(identity), revoked }
    }

    /// One that shows the identity in this file, and believes none of `revoked`, if they are named.
    ///
    /// # Errors
    /// A file is no identity, or no list.
    pub fn of_files(identity: Option<&Path>, revoked: Option<&Path>) -> Result<Dialler, String> {
        let identity = identity.map(Identity::read).transpose().map_err(|e| e.to_string())?;
        let revoked = revoked.map(Revoked::read).transpose()?;
        Ok(Dialler { identity: identity.map(Arc::new), revoked: revoked.map(Arc::new) })
    }

    /// Connects to `HOST:PORT`, `http://HOST:PORT` or, by TLS, `https://HOST:PORT`: by the socket beside it
    /// if `door` names one that exists; `within` bounds each attempt.
    ///
    /// # Errors
    /// No address, no listener there, no answer in time, or no certificate that is believed.
    pub async fn dial(&self, addr: &str, door: Option<Door>, within: Duration) -> Result<Tokened, DialError> {
        if let Some(door) = door
            && let Some(channel) = beside(addr, door, within).await
        {
            return Ok(with_token(channel));
        }
        // An Attach has heartbeats of its own.
        self.connect(addr, within, door.is_some()).await
    }

    /// Connects as [`Dialler::dial`], past the sockets, for a call that may be silent for long: a listener
    /// that stands still is found out by pings.
    ///
    /// # Errors
    /// As there.
    pub(super) async fn dial_pinged(&self, addr: &str, within: Duration) -> Result<Tokened, DialError> {
        self.connect(addr, within, true).await
    }

    /// Connects to an agent. Without pings: a connection that they ended would tell it that this program has
    /// hung up.
    ///
    /// # Errors
    /// As [`Dialler::dial`].
    pub(super) async fn dial_agent(&self, addr: &str, within: Duration) -> Result<Tokened, DialError> {
        self.connect_to(Called::Process, addr, within, false).await
    }

    async fn connect(&self, addr: &str, within: Duration, pings: bool) -> Result<Tokened, DialError> {
        self.connect_to(Called::Gcm, addr, within, pings).await
    }

    async fn connect_to(
        &self,
        called: Called,
        addr: &str,
        within: Duration,
        pings: bool,
    ) -> Result<Tokened, DialError> {
        let (endpoint, client) = self.endpoint(called, addr, within)?;
        let endpoint = if pings { pinged(endpoint) } else { endpoint };
        let Some(client) = client else { return Ok(with_token(endpoint.connect().await?)) };
        let why = Why::default();
        let (told, revoked) = (why.clone(), self.revoked.clone());
        let connector =
            service_fn(move |at| secured(client.clone(), at, within, (told.clone(), revoked.clone())));
        let channel = endpoint.connect_with_connector(connector).await;
        let channel =
            channel.map_err(|e| why.get().map_or_else(|| e.into(), |why| DialError::from(why.clone())))?;
        // Under TLS 1.3 a caller hears only by its first question that it is not believed.
        let mut health = HealthClient::new(channel.clone());
        let asked = health.check(HealthCheckRequest::default());
        match (tokio::time::timeout(within, asked).await, why.get()) {
            (Ok(Ok(_)), _) => {}
            (_, Some(why)) => return Err(why.clone().into()),
            // An answer, if only a refusal.
            (Ok(Err(status)), None) if status.source().is_none() => {}
            (Ok(Err(_)), None) => {
                return Err(
                    "it ended the connection, as one does that does not take this side's certificate".into(),
                );
            }
            (Err(_), None) => return Err("it takes connections, and answers nothing".into()),
        }
        Ok(with_token(channel))
    }

    /// Connects at the first request, and again after a loss.
    ///
    /// # Errors
    /// No address, or no identity for it.
    pub(super) fn lazily(&self, addr: &str, within: Duration) -> Result<Tokened, DialError> {
        let (endpoint, client) = self.endpoint(Called::Gcm, addr, within)?;
        let Some(client) = client else { return Ok(with_token(endpoint.connect_lazy())) };
        let revoked = self.revoked.clone();
        let connector =
            service_fn(move |at| secured(client.clone(), at, within, (Why::default(), revoked.clone())));
        Ok(with_token(endpoint.connect_with_connector_lazy(connector)))
    }

    /// The endpoint of an address, and what is shown there under TLS.
    fn endpoint(
        &self,
        called: Called,
        addr: &str,
        within: Duration,
    ) -> Result<(Endpoint, Option<Client>), DialError> {
        let bare = addr.strip_prefix(SECURED).or_else(|| addr.strip_prefix("http://")).unwrap_or(addr);
        // Certificates are shown below HTTP, which knows nothing of them.
        let endpoint =
            Endpoint::from_shared(format!("http://{bare}"))?.connect_timeout(within).tcp_nodelay(true);
        if !addr.starts_with(SECURED) {
            return Ok((endpoint, None));
        }
        let Some(identity) = self.identity.clone() else {
            return Err("a certificate is asked for there: name the file of yours with --identity FILE or \
                        TROCAR_IDENTITY, which `trocar ca issue` makes"
                .into());
        };
        let client = match called {
            Called::Gcm => Client::new(identity, self.revoked.clone(), &PROTOCOLS)?,
            Called::Process => Client::of_processes(identity, self.revoked.clone(), &PROTOCOLS)?,
        };
        Ok((endpoint, Some(client)))
    }
}

/// Tells whether both sides show certificates at this address.
pub(super) fn is_secured(addr: &str) -> bool {
    addr.starts_with(SECURED)
}

async fn secured(
    client: Client,
    at: Uri,
    within: Duration,
    (why, revoked): (Why, Option<Arc<Revoked>>),
) -> io::Result<TokioIo<Told>> {
    let name = |text: &'static str| ServerName::try_from(text).map_err(io::Error::other);
    let shaking = async {
        let authority = at.authority().ok_or_else(|| io::Error::other("no address"))?;
        let stream = TcpStream::connect(authority.as_str()).await?;
        stream.set_nodelay(true)?;
        // The certificate alone says who it is.
        let stream = TlsConnector::from(client.config()).connect(name("trocar")?, stream).await;
        Ok(TokioIo::new(Told::new(stream.map_err(told::told)?, why, revoked)))
    };
    let late = || io::Error::new(io::ErrorKind::TimedOut, "it showed no certificate in time");
    tokio::time::timeout(within, shaking).await.map_err(|_| late())?
}

fn pinged(endpoint: Endpoint) -> Endpoint {
    endpoint.http2_keep_alive_interval(QUIET).keep_alive_timeout(ANSWERS)
}

async fn beside(addr: &str, door: Door, within: Duration) -> Option<Channel> {
    if is_secured(addr) {
        return None;
    }
    let addrs = tokio::net::lookup_host(addr.strip_prefix("http://").unwrap_or(addr)).await.ok()?;
    let dir = RuntimeDir::of_user();
    dir.is_own().ok()?;
    for addr in addrs.filter(|addr| addr.ip().is_loopback()) {
        let path = dir.way(addr, door);
        let Ok(endpoint) = Endpoint::from_shared(format!("unix:{}", path.display())) else { continue };
        // A socket that a killed host left refuses at once.
        if let Ok(channel) = pinged(endpoint).connect_timeout(within).connect().await {
            return Some(channel);
        }
    }
    None
}
