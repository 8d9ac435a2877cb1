//! One system of which an agent keeps processes, and the seat of its caller.
//!
//! Invariant: each process that is wanted has a status, also one that could not be started. A seat that was
//! taken by a later one of the same run orders nothing any more.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use parking_lot::Mutex;
use serde_json::json;
use tokio::sync::watch;
use tokio::time::Instant;
use trocar_model::{Name, Refusal};

use super::files::{make, unwritten};
use super::{Agent, Listed, Wanted};
use crate::processes::{Exit, Phase, Program, Status, Supervisor};
use crate::system_file::Place;

/// Time for a caller that has hung up to come again.
pub(super) const RETURN: Duration = Duration::from_secs(10);
/// A caller that says nothing for this long is not heard: another run may take its place.
const SILENCE: Duration = Duration::from_secs(2);

/// The processes of one system on this machine.
pub(super) struct System {
    folder: PathBuf,
    run: String,
    supervisor: Supervisor,
    /// Processes that could not be started, and why.
    refused: watch::Sender<BTreeMap<String, Status>>,
    caller: Mutex<Caller>,
}

struct Caller {
    name: String,
    /// Number of the seat that counts.
    seat: u64,
    /// Whoever had that seat has not hung up.
    is_there: bool,
    heard: Instant,
}

impl System {
    pub(super) fn new(folder: PathBuf, run: String) -> System {
        let caller = Caller { name: String::new(), seat: 0, is_there: false, heard: Instant::now() };
        System {
            folder,
            run,
            supervisor: Supervisor::default(),
            refused: watch::Sender::default(),
            caller: Mutex::new(caller),
        }
    }

    pub(super) fn run(&self) -> &str {
        &self.run
    }

    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    /// Gives the system's orders to this caller from now on.
    pub(super) fn seat(self: &Arc<Self>, agent: Agent, name: String) -> Seat {
        let mut caller = self.caller.lock();
        let seat = caller.seat + 1;
        *caller = Caller { name, seat, is_there: true, heard: Instant::now() };
        Seat { agent, system: self.clone(), number: seat, hangs_up: true }
    }

    /// Checks that another run may take the place of this one.
    ///
    /// # Errors
    /// Its caller is heard.
    pub(super) fn gives_way(&self, system: &Name) -> Result<(), Refusal> {
        let caller = self.caller.lock();
        match caller.is_there && caller.heard.elapsed() < SILENCE {
            true => Err(Refusal::SystemKept { system: system.clone(), caller: caller.name.clone() }),
            false => Ok(()),
        }
    }

    /// Tells whether the caller with this seat was the last one.
    pub(super) fn is_left_by(&self, seat: u64) -> bool {
        let caller = self.caller.lock();
        caller.seat == seat && !caller.is_there
    }

    /// Tells whether a process of it runs, or is to run again.
    pub(super) fn runs(&self) -> bool {
        let over = |status: &Status| matches!(status.phase, Phase::Ended | Phase::Failed);
        !self.supervisor.statuses().borrow().values().all(over)
    }

    /// Tells whether a process of it is known, be it as one that was given up.
    pub(super) fn has_processes(&self) -> bool {
        !self.supervisor.statuses().borrow().is_empty()
    }

    /// Ends all of its processes. Returns those that did not end in order.
    pub(super) async fn end(&self) -> Vec<(String, Exit)> {
        // Whoever has a seat orders nothing any more.
        self.caller.lock().seat += 1;
        let names: Vec<String> = self.supervisor.statuses().borrow().keys().cloned().collect();
        let failed = self.supervisor.end(&names).await;
        for (name, exit) in &failed {
            log::warn!("process {name} {exit}: what it moved may not be safe");
        }
        failed
    }

    pub(super) fn listed(&self, system: Name) -> Listed {
        let caller = self.caller.lock();
        let is_heard = caller.is_there && caller.heard.elapsed() < SILENCE;
        Listed { system, caller: caller.name.clone(), is_heard, statuses: self.statuses() }
    }

    fn statuses(&self) -> BTreeMap<String, Status> {
        let mut all = self.supervisor.statuses().borrow().clone();
        all.extend(self.refused.borrow().clone());
        all
    }

    /// The program of a process, as this agent spawns it.
    fn program(&self, wanted: &Wanted, agent: &Agent) -> Result<Program, Refusal> {
        let (spec, name) = (&wanted.spec, wanted.spec.name.as_str());
        let settings = &agent.inner.settings;
        if spec.allow_exec && !settings.allow_exec {
            return Err(Refusal::ArgumentInvalid {
                what: format!("process {name}"),
                why: "its components may start programs, and the agent of its machine was started without --allow-exec".into(),
                field: "allow_exec".into(),
            });
        }
        let laid_out = self.folder.join("plugins").join(name);
        let plugins = match wanted.plugins.as_slice() {
            [] => settings.plugins.clone(),
            files => agent.inner.files.lay_out(files, &laid_out)?,
        };
        let hashes = self.folder.join("plugins").join(format!("{name}.hashes.json"));
        let hashes = match wanted.hashes.as_str() {
            "" => None,
            text => {
                let written = make(&self.folder.join("plugins")).and_then(|()| std::fs::write(&hashes, text));
                written.map_err(|e| unwritten(&hashes, &e))?;
                Some(hashes)
            }
        };
        let state = match &spec.state {
            Some(dir) => self.folder.join(dir),
            None => self.folder.join("processes").join(name),
        };
        let (folder, output) = (self.folder.clone(), self.folder.join(format!("{name}.output.log")));
        let place = Place { plugins, hashes, state, folder, output, rules: wanted.rules };
        let mut program = spec.program(place);
        program.args.extend(["--gcm".into(), wanted.gcm.clone().into()]);
        let files = [("--identity", &settings.identity), ("--revoked", &settings.revoked)];
        for (option, file) in files {
            program.args.extend(file.iter().flat_map(|file| [option.into(), file.into()]));
        }
        Ok(program)
    }
}

/// The seat of a caller: what it orders, and what becomes of it. Dropped, the caller has hung up, unless it
/// stays.
pub struct Seat {
    agent: Agent,
    system: Arc<System>,
    number: u64,
    /// Dropping it means that its caller has hung up.
    hangs_up: bool,
}

impl Seat {
    /// Leaves the system as it is: its caller cannot be heard, and may be there.
    pub fn stays(mut self) {
        self.hangs_up = false;
    }

    /// Folder of the system: what its processes print, and their state.
    pub fn folder(&self) -> &Path {
        self.system.folder()
    }

    /// Notes that the caller is heard; false: a later seat counts.
    pub fn beat(&self) -> bool {
        let mut caller = self.system.caller.lock();
        caller.heard = Instant::now();
        caller.seat == self.number
    }

    /// Starts a process and keeps it; one of that name that is kept stays as it is. What keeps it from being
    /// started is its status.
    pub fn start(&self, wanted: &Wanted) {
        let name = wanted.spec.name.as_str();
        let is_kept = self.system.supervisor.statuses().borrow().contains_key(name);
        if is_kept {
            return;
        }
        match self.system.program(wanted, &self.agent) {
            Ok(program) => {
                self.system.refused.send_if_modified(|refused| refused.remove(name).is_some());
                self.system.supervisor.start(program);
            }
            Err(refusal) => {
                let (reason, message, help) = (refusal.reason(), refusal.to_string(), refusal.help());
                let why = json!({ "reason": reason, "message": message, "help": help });
                let status = Status { phase: Phase::Failed, refused: Some(why), ..Status::default() };
                self.system.refused.send_modify(|refused| _ = refused.insert(name.to_owned(), status));
            }
        }
    }

    /// Reports that an incarnation is of no use, and why.
    pub fn put_down(&self, process: &str, pid: u32, why: String) {
        self.system.supervisor.put_down(process, pid, why);
    }

    /// Ends a process, if it runs, and starts it again with a clean record.
    pub fn again(&self, process: &str) {
        self.system.supervisor.again(process);
    }

    /// Asks a process to end.
    pub fn ask_to_end(&self, process: &str) {
        self.system.supervisor.ask_to_end(process);
    }

    /// Forgets a process that has ended.
    pub fn forget(&self, process: &str) {
        self.system.refused.send_if_modified(|refused| refused.remove(process).is_some());
        self.system.supervisor.forget(process);
    }

    /// Returns the status of all processes, and waits for the next change of any before it does so again.
    pub fn following(&self) -> Following {
        let (kept, refused) = (self.system.supervisor.statuses(), self.system.refused.subscribe());
        Following { system: self.system.clone(), kept, refused }
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        {
            let mut caller = self.system.caller.lock();
            if caller.seat != self.number || !self.hangs_up {
                return;
            }
            caller.is_there = false;
        }
        self.agent.hung_up(self.system.clone(), self.number);
    }
}

/// The statuses of a system's processes, as they change.
pub struct Following {
    system: Arc<System>,
    kept: watch::Receiver<BTreeMap<String, Status>>,
    refused: watch::Receiver<BTreeMap<String, Status>>,
}

impl Following {
    pub fn now(&mut self) -> BTreeMap<String, Status> {
        self.kept.mark_unchanged();
        self.refused.mark_unchanged();
        self.system.statuses()
    }

    pub async fn changed(&mut self) {
        // The system holds both senders.
        tokio::select! {
            _ = self.kept.changed() => {}
            _ = self.refused.changed() => {}
        }
    }
}
