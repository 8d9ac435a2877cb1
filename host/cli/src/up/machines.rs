//! What a system needs whose processes run on several machines.
//!
//! Invariant: pure; what cannot work is said before anything is started.

use std::net::SocketAddr;

use super::programs::Reached;
use crate::failure::Failure;
use crate::hosting::MachineArgs;
use crate::session::{self, Session};
use trocar::system_file::SystemFile;

/// Returns the way by which other machines reach the system's own GCM, where it is to have one.
///
/// # Errors
/// Processes of the file run on other machines, and these cannot reach the GCM.
pub(super) fn reached(
    file: &SystemFile,
    args: &MachineArgs,
    session: &Session,
) -> Result<Option<Reached>, Failure> {
    let is_afar = |machine: &str| {
        let of_it = file.machines.iter().find(|m| m.name.as_str() == machine);
        of_it.is_some_and(|machine| machine.agent.starts_with("https://"))
    };
    let machine = |p: &trocar::system_file::ProcessSpec| p.machine.as_ref().map(ToString::to_string);
    let mut afar = file.processes.iter().filter_map(|p| Some((p.name.to_string(), machine(p)?)));
    let afar = afar.find(|(_, machine)| is_afar(machine));
    let usage = |what: String, help: &str| Err(Failure::usage(what, help));
    if let (Some((process, machine)), None) = (&afar, session::identity()) {
        let help = "name the file that `trocar ca issue` made: --identity FILE, of the role gcm, with --process for each process \
                    that runs here";
        return usage(
            format!("process {process} runs on the machine {machine}, and certificates are shown there"),
            help,
        );
    }
    match (session.explicit_gcm(), &args.listen_tls, afar) {
        (Some(_), Some(_), _) => {
            usage("with --gcm there is no GCM of its own to reach".into(), "leave --listen-tls out")
        }
        (Some(gcm), None, Some((process, machine))) if !gcm.starts_with("https://") => usage(
            format!("process {process} runs on the machine {machine}, which does not reach the GCM at {gcm}"),
            "give the address that other machines reach: --gcm https://HOST:PORT",
        ),
        (None, None, Some((process, machine))) => usage(
            format!("process {process} runs on the machine {machine}, which has to reach the GCM"),
            "give the GCM an address of this machine for it: --listen-tls 10.0.0.1:50552",
        ),
        (None, Some(listen), _) => {
            let is_none = |addr: SocketAddr| addr.ip().is_unspecified() || addr.port() == 0;
            if listen.parse().is_ok_and(is_none) {
                return usage(
                    format!("other machines reach no GCM at {listen}"),
                    "give an address and a port of this machine: --listen-tls 10.0.0.1:50552",
                );
            }
            let revoked = args.revoked.as_ref().map(|file| std::path::absolute(file).unwrap_or(file.clone()));
            Ok(Some(Reached { listen: listen.clone(), revoked }))
        }
        _ => Ok(None),
    }
}
