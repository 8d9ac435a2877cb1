//! The way by which other machines know a process, and reach it.

use std::net::{IpAddr, SocketAddr, ToSocketAddrs, UdpSocket};
use std::path::PathBuf;
use std::sync::Arc;

use trocar_net::{Identity, Revoked, Role};

use super::HostError;
use crate::control::{Dialler, Secured};
use crate::lcm::Afar;

/// Bytes/s of 1 Mbit/s.
const BYTES_PER_MBIT: u64 = 125_000;

/// The way by which other machines know a process, and reach it; by default they do not.
#[derive(Clone, Debug, Default)]
pub struct Machines {
    /// File of its identity, which `trocar ca issue` made.
    pub identity: Option<PathBuf>,
    /// Address at which other machines reach it; port 0 takes a free one.
    pub listen: Option<String>,
    /// Address at which components of other machines' processes connect to its own; port 0 takes a free one.
    /// `None`: a free port where a GCM of another machine is reached, or beside `listen`.
    pub lines: Option<String>,
    /// Mbit/s that large samples take at most on the line to one other process; `None`: as many as it takes.
    pub line_mbps: Option<u32>,
    /// File of the certificates that are believed no more; it is looked at again and again.
    pub revoked: Option<PathBuf>,
}

/// The way to other machines, as it was found.
pub(super) struct Ways {
    pub(super) dialler: Dialler,
    /// The needs of the port for other machines.
    pub(super) secured: Option<Secured>,
    /// The way by which other machines' processes reach the components.
    pub(super) afar: Option<Afar>,
}

impl Machines {
    /// Returns the way to others, `gcm` among them.
    ///
    /// # Errors
    /// A file is missing or not what it should be, or an address lacks an identity, or is none.
    pub(super) fn open(&self, gcm: Option<&str>) -> Result<Ways, HostError> {
        let unusable = |because: String| HostError::Identity { because };
        let Some(path) = &self.identity else {
            return match self.listen.as_ref().or(self.lines.as_ref()) {
                Some(listen) => Err(unusable(format!(
                    "{listen} can be reached from other machines, and this process has no identity to show them"
                ))),
                None if self.revoked.is_some() => Err(unusable(
                    "a list of revoked certificates is named, and no identity: nobody shows this process any"
                        .into(),
                )),
                None => Ok(Ways { dialler: Dialler::local(), secured: None, afar: None }),
            };
        };
        let identity = Identity::read(path).map_err(|e| unusable(e.to_string()))?;
        let identity = Arc::new(identity);
        let revoked = self.revoked.as_deref().map(Revoked::read).transpose().map_err(unusable)?.map(Arc::new);
        let dialler = Dialler::new(identity.clone(), revoked.clone());
        let afar = self.afar(gcm, &identity, &revoked).map_err(unusable)?;
        let secured = self.listen.clone().map(|listen| Secured { listen, identity, revoked });
        Ok(Ways { dialler, secured, afar })
    }

    /// The way by which other machines' processes reach the components.
    ///
    /// # Errors
    /// An address is none.
    fn afar(
        &self,
        gcm: Option<&str>,
        identity: &Arc<Identity>,
        revoked: &Option<Arc<Revoked>>,
    ) -> Result<Option<Afar>, String> {
        let of_gcm = gcm.and_then(|gcm| gcm.strip_prefix("https://"));
        let listen = match (&self.lines, of_gcm, &self.listen) {
            (Some(lines), ..) => address(lines)?,
            // At all addresses that come, if the network is not up yet.
            (None, Some(gcm), _) => {
                let everywhere = IpAddr::from([0; 4]);
                SocketAddr::new(towards(gcm).unwrap_or(everywhere), 0)
            }
            (None, None, Some(listen)) => SocketAddr::new(address(listen)?.ip(), 0),
            (None, None, None) => return Ok(None),
        };
        let holder = identity.holder();
        if !matches!(holder.role, Role::Host | Role::Gcm) {
            return match self.lines {
                // Its GCM refuses it with what it takes.
                None => Ok(None),
                Some(_) => Err(format!(
                    "its certificate is of the {holder}, and components of other machines connect to a host or a gcm alone"
                )),
            };
        }
        // An address that stands for all of this machine says nothing to another one.
        let told = listen.ip().is_unspecified().then(|| of_gcm.and_then(towards).map_or_else(own_name, said));
        let (identity, revoked) = (identity.clone(), revoked.clone());
        let most_rate = self.line_mbps.map(|mbps| u64::from(mbps) * BYTES_PER_MBIT);
        Ok(Some(Afar { listen, told, identity, revoked, most_rate }))
    }
}

fn address(text: &str) -> Result<SocketAddr, String> {
    let none = || format!("{text} is no address of this machine and port, as 10.0.0.2:50553 is one");
    text.to_socket_addrs().ok().and_then(|mut all| all.next()).ok_or_else(none)
}

/// The address of this machine that the way to another one begins at. Nothing is sent.
fn towards(other: &str) -> Option<IpAddr> {
    let other = other.to_socket_addrs().ok()?.next()?;
    let any: IpAddr = if other.is_ipv6() { [0; 16].into() } else { [0; 4].into() };
    let socket = UdpSocket::bind((any, 0)).ok()?;
    socket.connect(other).ok()?;
    Some(socket.local_addr().ok()?.ip())
}

fn said(ip: IpAddr) -> String {
    match ip {
        IpAddr::V6(ip) => format!("[{ip}]"),
        IpAddr::V4(ip) => ip.to_string(),
    }
}

/// The name of this machine.
fn own_name() -> String {
    std::fs::read_to_string("/proc/sys/kernel/hostname")
        .map_or_else(|_| "localhost".into(), |name| name.trim().into())
}
