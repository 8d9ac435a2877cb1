//! What is told of the processes of a system: to its GCM, to people, to scripts.
//!
//! Invariant: a GCM that comes, or comes back, is told everything anew; a person reads each end of a process once.

use std::collections::BTreeMap;
use std::time::Duration;

use serde_json::json;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use trocar_model::Name;

use super::called;
use super::programs::GCM;
use crate::cli::out;
use crate::cli::session::Session;
use crate::cli::view::SystemView;
use crate::gcm::{Fate, Told};
use crate::processes::{Phase, Status};
use crate::system_file::SystemFile;

type Statuses = BTreeMap<String, Status>;

/// A GCM may have been restarted by somebody else: it is told this often, whatever happens.
const AGAIN: Duration = Duration::from_secs(1);
/// Between two attempts to tell a GCM that does not answer.
const PAUSE: Duration = Duration::from_millis(50);

/// What the GCM is told; `instead` of how they stand, when that is given.
pub(super) fn fates(statuses: &Statuses, instead: Option<Fate>) -> Vec<Told> {
    let told = |(name, status): (&String, &Status)| {
        let fate = match status.phase {
            Phase::Starting | Phase::Running => Fate::Running,
            Phase::Restarting => Fate::Restarting,
            Phase::Failed => Fate::Failed,
            Phase::Ended => Fate::Ended,
        };
        Some(Told {
            process: Name::parse(name).ok()?,
            fate: instead.unwrap_or(fate),
            pid: status.pid,
            last_exit: status.exit_text(),
            restarts: status.restarts,
        })
    };
    statuses.iter().filter(|(name, _)| *name != GCM).filter_map(told).collect()
}

/// Tells the GCM how the processes stand, now and always, in the background.
pub(super) fn keep_told(addr: &str, mut statuses: watch::Receiver<Statuses>) -> JoinHandle<()> {
    let session = Session::new(Some(addr.to_owned()), false);
    tokio::spawn(async move {
        loop {
            let now = fates(&statuses.borrow_and_update(), None);
            let pause = match session.tell(&now).await {
                Ok(()) => AGAIN,
                Err(failure) => {
                    log::debug!("the GCM is not told: {}", failure.message);
                    PAUSE
                }
            };
            if let Ok(Err(_)) = tokio::time::timeout(pause, statuses.changed()).await {
                return;
            }
        }
    })
}

/// How a system speaks.
pub(super) struct Voice {
    pub(super) name: String,
    pub(super) json: bool,
    /// Nobody reads any more once it is up.
    pub(super) quiet: bool,
}

impl Voice {
    /// Everything is there; what does not run is named.
    pub(super) fn say_up(
        &self,
        gcm: &str,
        statuses: &Statuses,
        standing: &SystemView,
        file: &SystemFile,
        warnings: &[String],
    ) {
        let wanted = |path: &str| file.components.iter().any(|c| c.start && c.id.to_string() == path);
        let idle = standing.components.iter().filter(|c| wanted(&c.path) && c.state != "ACTIVE");
        let idle: Vec<(String, String)> = idle
            .map(|c| {
                let why = if c.fault.is_empty() { String::new() } else { format!(": {}", c.fault) };
                (c.path.clone(), format!("{}{why}", c.state))
            })
            .collect();
        let hosts = || statuses.iter().filter(|(name, _)| *name != GCM);
        if self.json || self.quiet {
            let processes: Vec<_> = hosts()
                .map(|(name, s)| json!({ "name": name, "pid": s.pid, "listening": s.address }))
                .collect();
            let idle: Vec<_> =
                idle.iter().map(|(path, stands)| json!({ "path": path, "stands": stands })).collect();
            let line = json!({
                "name": self.name,
                "listening": gcm,
                "pid": std::process::id(),
                "gcm_pid": statuses.get(GCM).map(|s| s.pid),
                "processes": processes,
                "components": file.components.len(),
                "connections": file.connections.len(),
                "not_active": idle,
                "warnings": warnings,
            });
            return out::line(&out::json(&line.to_string()));
        }
        for warning in warnings {
            out::complain("warning", warning);
        }
        let (components, connections) = (file.components.len(), file.connections.len());
        out::line(&format!(
            "{} is up: {} processes, {components} components, {connections} connections; GCM {gcm}",
            self.name,
            hosts().count()
        ));
        for (name, status) in hosts() {
            let at = status.address.as_deref().unwrap_or("nowhere");
            out::line(&format!("  process {name}  pid {}  {at}", status.pid));
        }
        for (path, stands) in &idle {
            out::complain("warning", &format!("{path} does not run, it is {stands}"));
        }
        out::line("  Ctrl-C takes it down, devices safe first");
    }

    /// What is different.
    pub(super) fn tell(&self, before: &Statuses, now: &Statuses) {
        for (name, status) in now {
            let was = before.get(name).cloned().unwrap_or_default();
            if was == *status {
                continue;
            }
            if self.json && !self.quiet {
                let line = json!({
                    "process": name,
                    "phase": format!("{:?}", status.phase).to_uppercase(),
                    "pid": status.pid,
                    "restarts": status.restarts,
                    "last_exit": status.exit_text(),
                });
                out::line(&out::json(&line.to_string()));
                continue;
            }
            if let Some(text) = said(name, &was, status) {
                out::complain(if status.phase == Phase::Failed { "error" } else { "warning" }, &text);
            }
        }
    }
}

/// A sentence for a person; the steps between an end and the next life are none of theirs.
fn said(name: &str, was: &Status, now: &Status) -> Option<String> {
    let (who, exit) = (called(name), now.exit_text());
    match now.phase {
        Phase::Running if now.restarts > was.restarts || was.phase != Phase::Running => {
            Some(format!("{who} runs again, pid {} (restart {}): it {exit}", now.pid, now.restarts))
        }
        Phase::Restarting if was.phase != Phase::Restarting => {
            Some(format!("{who} {exit}; it is started again"))
        }
        Phase::Failed => Some(format!(
            "{who} is FAILED after {} restarts: it {exit}; correct that, then `trocar down` and `trocar up`",
            now.restarts
        )),
        Phase::Ended => Some(format!("{who} {exit} and is not started again")),
        Phase::Starting | Phase::Running | Phase::Restarting => None,
    }
}
