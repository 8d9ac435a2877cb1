//! Reports about the processes of a system: to its GCM, to people, to scripts.
//!
//! Invariant: a GCM that comes, or comes back, is told everything anew. A person reads each end of a process
//! once, and a reader that does not read holds up nothing.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, SyncSender, channel, sync_channel};
use std::time::Duration;

use serde_json::json;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use trocar_model::{ComponentId, Name};
use trocar_rt::house;

use super::super::alike::folded;
use super::super::units;
use super::news::News;
use super::programs::{GCM, called};
use crate::session::Session;
use crate::view::SystemView;
use crate::{hosting, out};
use trocar::gcm::{Fate, Told};
use trocar::processes::{Phase, Status};
use trocar::system_file::SystemFile;

type Statuses = BTreeMap<String, Status>;

/// Period of telling the GCM, whatever happens: another program may have restarted it.
const AGAIN: Duration = Duration::from_secs(1);
/// Pause between two attempts to tell a GCM that does not answer.
const PAUSE: Duration = Duration::from_millis(50);

/// Returns the fates of the processes for the GCM; `instead`, when given, replaces the fate of each one.
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

/// Tells the GCM the state of the processes, now and later, in the background.
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

/// Facts about a system that has come up.
pub(crate) struct Up {
    /// Address of its GCM.
    pub(crate) addr: String,
    pub(crate) warnings: Vec<String>,
    pub(super) standing: SystemView,
    /// Components that were not started, since their processes crashed while the system came up.
    pub(super) waiting: BTreeSet<ComponentId>,
    /// Directory with the output of its processes here, where there is one.
    pub(super) place: Option<PathBuf>,
    /// Machines on which agents keep processes, and the directory with the output of each.
    pub(super) elsewhere: Vec<(String, String)>,
}

impl Up {
    /// Returns the components that the file starts and that do not run, each with its state instead.
    fn idle(&self, file: &SystemFile) -> Vec<(String, String)> {
        let started: BTreeMap<String, &ComponentId> =
            file.components.iter().filter(|c| c.start).map(|c| (c.id.to_string(), &c.id)).collect();
        let idle = self.standing.components.iter().filter_map(|c| {
            let id = started.get(&c.path).filter(|_| c.state != "ACTIVE" || c.health == "UNRESPONSIVE")?;
            let mut stands = match (c.state.as_str(), c.fault.as_str()) {
                ("ACTIVE", _) => "UNRESPONSIVE".to_owned(),
                (state, "") => state.to_owned(),
                (state, fault) => format!("{state}: {fault}"),
            };
            if self.waiting.contains(*id) {
                stands.push_str(": its process crashed while it came up, and it can move something");
            }
            Some((c.path.clone(), stands))
        });
        idle.collect()
    }
}

/// Speech of a system. A thread speaks that may wait for a reader for ever, since nobody has to read.
pub(crate) struct Voice {
    name: String,
    json: bool,
    /// True: nobody reads any more once the system is up.
    quiet: bool,
    mouth: Mouth,
}

impl Voice {
    pub(super) fn new(name: &str, json: bool, quiet: bool) -> Voice {
        Voice { name: name.to_owned(), json, quiet, mouth: Mouth::open() }
    }

    pub(super) fn complain(&self, kind: &str, text: &str) {
        self.mouth.say(format!("{kind}: {}", out::paragraph(text)), true);
    }

    fn line(&self, line: &str) {
        self.mouth.say(line.to_owned(), false);
    }

    fn object(&self, object: &serde_json::Value) {
        self.line(&out::json(&object.to_string()));
    }

    /// Says that everything is there; components that do not run are named.
    pub(super) fn say_up(&self, up: &Up, statuses: &Statuses, file: &SystemFile) {
        let Up { addr: gcm, warnings, .. } = up;
        let idle = up.idle(file);
        let hosts = || statuses.iter().filter(|(name, _)| *name != GCM);
        if self.json || self.quiet {
            let processes: Vec<_> = hosts()
                .map(|(name, s)| json!({ "name": name, "pid": s.pid, "listening": s.address }))
                .collect();
            let idle: Vec<_> =
                idle.iter().map(|(path, stands)| json!({ "path": path, "stands": stands })).collect();
            return self.object(&json!({
                "name": self.name,
                "listening": gcm,
                "pid": std::process::id(),
                "viewer": hosting::viewer(gcm),
                "gcm_pid": statuses.get(GCM).map(|s| s.pid),
                "processes": processes,
                "components": file.components.len(),
                "connections": file.connections.len(),
                "not_active": idle,
                "warnings": warnings,
            }));
        }
        for warning in folded(warnings.iter().cloned()) {
            self.complain("warning", &warning);
        }
        let (components, connections) = (file.components.len(), file.connections.len());
        self.line(&format!(
            "{} is up: {}, {}, {}; GCM {gcm}",
            self.name,
            units::count(hosts().count() as u64, "process"),
            units::count(components as u64, "component"),
            units::count(connections as u64, "connection")
        ));
        for (name, status) in hosts() {
            let at = status.address.as_deref().unwrap_or("nowhere");
            self.line(&format!("  process {name}  pid {}  {at}", status.pid));
        }
        for (path, stands) in &idle {
            self.complain("warning", &format!("{path} does not run, it is {stands}"));
        }
        self.line(&format!("  viewer {}", hosting::viewer(gcm)));
        if let Some(place) = &up.place {
            self.line(&format!("  what they print goes to {}", place.display()));
        }
        for (machine, folder) in &up.elsewhere {
            self.line(&format!("  on the machine {machine} to {folder}"));
        }
        self.line("  Ctrl-C takes it down, devices safe first");
    }

    /// Tells the differences.
    pub(super) fn tell(&self, before: &Statuses, now: &Statuses) {
        for (name, status) in now {
            let was = before.get(name).cloned().unwrap_or_default();
            if was == *status {
                continue;
            }
            if self.json && !self.quiet {
                self.object(&json!({
                    "process": name,
                    "phase": format!("{:?}", status.phase).to_uppercase(),
                    "pid": status.pid,
                    "restarts": status.restarts,
                    "last_exit": status.exit_text(),
                }));
                continue;
            }
            if let Some(text) = said(name, &was, status) {
                self.complain(if status.phase == Phase::Failed { "error" } else { "warning" }, &text);
            }
        }
    }

    /// Names the processes that did not end in order.
    pub(super) fn say_failed(&self, failed: &[String]) {
        if self.json && !self.quiet && !failed.is_empty() {
            return self.object(&json!({ "down": true, "not_in_order": failed }));
        }
        for failed in failed {
            self.complain("warning", failed);
        }
    }

    /// Tells the news of components.
    pub(super) fn tell_of(&self, news: &[News]) {
        for News { component: c, trouble } in news {
            if self.json && !self.quiet {
                self.object(&json!({
                    "component": c.path,
                    "state": c.state,
                    "health": c.health,
                    "fault": c.fault,
                }));
                continue;
            }
            let text = match trouble {
                Some(trouble) => format!("{} {trouble}", c.path),
                None => format!("{} is {} again", c.path, c.state),
            };
            self.complain("warning", &text);
        }
    }
}

/// Lines on their way out. A line that does not fit is dropped.
struct Mouth {
    lines: Option<SyncSender<(String, bool)>>,
    done: Receiver<()>,
}

/// Lines that may wait for a reader.
const WAITING: usize = 256;
/// Time that the last lines may take.
const LAST: Duration = Duration::from_millis(500);

impl Mouth {
    fn open() -> Mouth {
        let (lines, heard) = sync_channel::<(String, bool)>(WAITING);
        let (tell, done) = channel();
        let speak = move || {
            for (line, complains) in heard {
                out::news(&line, complains);
            }
            // The receiver has gone when this took too long.
            let _ = tell.send(());
        };
        // Without a thread the voice is dumb.
        let _ = house::spawn(std::thread::Builder::new().name("trocar-voice".into()), speak);
        Mouth { lines: Some(lines), done }
    }

    fn say(&self, line: String, complains: bool) {
        if let Some(lines) = &self.lines {
            // A full queue has a reader that is too slow.
            let _ = lines.try_send((line, complains));
        }
    }
}

impl Drop for Mouth {
    fn drop(&mut self) {
        self.lines = None;
        // A terminal that stands still does not hold up the end.
        let _ = self.done.recv_timeout(LAST);
    }
}

/// Returns a sentence for a person; the steps between an end and the next start are left out.
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
