//! Keepers of the processes of a system: this program for those of its own machine, agents for the others.
//!
//! Invariant: one board shows all of them, and each process has one keeper.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::sync::Arc;
use std::task::Poll;
use std::time::Duration;

use parking_lot::Mutex;
use tokio::sync::watch;
use tokio::task::JoinHandle;

use crate::failure::Failure;
use crate::session;
use trocar::control::{Dialler, Reach, Seen, ToKeep};
use trocar::processes::{Exit, Policy, Program, Status, Supervisor};
use trocar::system_file::MachineSpec;

pub(super) type Statuses = BTreeMap<String, Status>;

/// Time to reach an agent that does not answer at once.
const REACHED: Duration = Duration::from_secs(5);
/// The same where it answers late: an earlier run of the system may have to end there first.
const TAKEN_IN: Duration = Duration::from_secs(30);

/// A process of a system, and where it is kept.
#[derive(Clone, Debug)]
pub(super) enum Hosted {
    Here(Box<Program>),
    There { machine: String, process: Box<ToKeep> },
}

impl Hosted {
    pub(super) fn name(&self) -> &str {
        match self {
            Hosted::Here(program) => &program.name,
            Hosted::There { process, .. } => process.spec.name.as_str(),
        }
    }

    pub(super) fn policy(&self) -> Policy {
        match self {
            Hosted::Here(program) => program.policy,
            Hosted::There { process, .. } => process.spec.restart,
        }
    }

    /// File for everything that it prints here; `None`: its agent has it.
    pub(super) fn output(&self) -> Option<&Path> {
        match self {
            Hosted::Here(program) => Some(&program.output),
            Hosted::There { .. } => None,
        }
    }

    /// The same process under the GCM at this address; it believes none of `revoked`.
    pub(super) fn under(mut self, gcm: &str, revoked: Option<&Path>) -> Hosted {
        match &mut self {
            Hosted::Here(program) => {
                program.args.extend(["--gcm".into(), gcm.into()]);
                let files = [("--identity", session::identity()), ("--revoked", revoked.map(Path::to_owned))];
                for (option, file) in files {
                    let named = file.into_iter().flat_map(|file| [OsString::from(option), file.into()]);
                    program.args.extend(named);
                }
            }
            Hosted::There { process, .. } => gcm.clone_into(&mut process.gcm),
        }
        self
    }
}

/// The keepers. Dropped, they let go of what they keep, which then ends by itself, devices safe first.
pub(super) struct Fleet {
    local: Supervisor,
    agents: BTreeMap<String, Agent>,
    /// Machine of each process that an agent keeps.
    homes: Mutex<BTreeMap<String, String>>,
    board: Arc<watch::Sender<Statuses>>,
    merging: Vec<JoinHandle<()>>,
}

/// The way to an agent.
struct Agent {
    reach: Reach,
    addr: String,
}

impl Fleet {
    /// Begins to look for the agents of these machines, which are to keep processes of the system `name`.
    ///
    /// # Errors
    /// The identity, or the list of revoked certificates, cannot be read.
    pub(super) fn new(
        machines: &[MachineSpec],
        name: &str,
        revoked: Option<&Path>,
    ) -> Result<Fleet, Failure> {
        let dialler = match machines {
            [] => Dialler::local(),
            _ => session::dialler_with(revoked)?,
        };
        let (run, board) = (run_id(), Arc::new(watch::Sender::default()));
        let (local, mut agents, mut merging) = (Supervisor::default(), BTreeMap::new(), Vec::new());
        merging.push(tokio::spawn(merge(local.statuses(), Statuses::clone, board.clone())));
        for MachineSpec { name: machine, agent: addr } in machines {
            let (dialler, addr) = (dialler.clone(), addr.clone());
            let reach = Reach::begin(dialler, addr.clone(), name.to_owned(), run.clone());
            let statuses = |seen: &Seen| seen.statuses.clone();
            merging.push(tokio::spawn(merge(reach.seen(), statuses, board.clone())));
            agents.insert(machine.to_string(), Agent { reach, addr });
        }
        Ok(Fleet { local, agents, homes: Mutex::default(), board, merging })
    }

    /// Waits until all agents are heard.
    ///
    /// # Errors
    /// One is not, in time.
    pub(super) async fn reached(&self) -> Result<(), Failure> {
        for (machine, Agent { reach, addr }) in &self.agents {
            let mut seen = reach.seen();
            let begun = tokio::time::Instant::now();
            loop {
                let why = {
                    let seen = seen.borrow_and_update();
                    if seen.is_heard() {
                        break;
                    }
                    seen.why.clone()
                };
                let within = if why.is_empty() { TAKEN_IN } else { REACHED };
                // The sender lives as long as this.
                if tokio::time::timeout_at(begun + within, seen.changed()).await.is_err() {
                    let why = if why.is_empty() { "it does not answer" } else { &why };
                    return Err(Failure::local(
                        "NO_AGENT",
                        format!(
                            "the agent of the machine {machine} does not keep processes of this system: {addr}: {why}"
                        ),
                        match addr.strip_prefix("https://") {
                            Some(bare) => format!(
                                "start it on that machine: `trocar agent --identity FILE --listen-tls {bare}`, and compare the \
                                 address with \"machines\" of the system file; `trocar ca ls` says which certificates hold"
                            ),
                            None => format!("start it: `trocar agent --listen {addr}`"),
                        },
                    ));
                }
            }
        }
        Ok(())
    }

    fn reach(&self, process: &str) -> Option<&Reach> {
        let homes = self.homes.lock();
        homes.get(process).and_then(|machine| self.agents.get(machine)).map(|agent| &agent.reach)
    }

    /// Starts a process and keeps it. A name that is kept already stays as it is.
    pub(super) fn start(&self, process: Hosted) {
        match process {
            Hosted::Here(program) => self.local.start(*program),
            Hosted::There { machine, process } => {
                let Some(agent) = self.agents.get(&machine) else { return };
                self.homes.lock().insert(process.spec.name.to_string(), machine);
                agent.reach.start(*process);
            }
        }
    }

    /// Returns the status of all processes, now and whenever something changes; a slow reader sees the
    /// newest.
    pub(super) fn statuses(&self) -> watch::Receiver<Statuses> {
        self.board.subscribe()
    }

    /// Tells whether the keeper of a process has been heard for so long: what is not heard of a process
    /// before that may be the network's fault.
    pub(super) fn is_heard_for(&self, process: &str, time: Duration) -> bool {
        let Some(reach) = self.reach(process) else { return true };
        let since = reach.seen().borrow().heard_since;
        since.is_some_and(|since| since.elapsed() >= time)
    }

    /// Returns the folder of the system on each machine.
    pub(super) fn folders(&self) -> Vec<(String, String)> {
        let folder = |agent: &Agent| agent.reach.seen().borrow().folder.clone();
        self.agents.iter().map(|(machine, agent)| (machine.clone(), folder(agent))).collect()
    }

    /// Reports that the incarnation with this number is of no use, and why.
    pub(super) fn put_down(&self, name: &str, pid: u32, why: String) {
        match self.reach(name) {
            Some(reach) => reach.put_down(name, pid, why),
            None => self.local.put_down(name, pid, why),
        }
    }

    /// Ends the process, if it runs, and starts it again with a clean record.
    pub(super) fn again(&self, name: &str) {
        match self.reach(name) {
            Some(reach) => reach.again(name),
            None => self.local.again(name),
        }
    }

    /// Asks the process to end and does not wait: its status says when it has.
    pub(super) fn ask_to_end(&self, name: &str) {
        match self.reach(name) {
            Some(reach) => reach.ask_to_end(name),
            None => self.local.ask_to_end(name),
        }
    }

    /// Forgets a process that has ended or was given up.
    pub(super) fn forget(&self, name: &str) {
        match self.reach(name) {
            Some(reach) => reach.forget(name),
            None => self.local.forget(name),
        }
        self.homes.lock().remove(name);
    }

    /// Asks these to end, all at once, and waits until they have. Returns those that did not end in order.
    pub(super) async fn end(&self, names: &[String]) -> Vec<(String, Exit)> {
        let (mut here, mut there) = (Vec::new(), BTreeMap::<String, Vec<String>>::new());
        for name in names {
            match self.homes.lock().get(name) {
                Some(machine) => there.entry(machine.clone()).or_default().push(name.clone()),
                None => here.push(name.clone()),
            }
        }
        let mut failed = Vec::new();
        let afar = async {
            // All at once: each looks at what runs before it asks.
            let mut ending: Vec<Ending<'_>> = Vec::new();
            for (machine, names) in &there {
                let Some(agent) = self.agents.get(machine) else { continue };
                ending.push(Box::pin(agent.reach.end(names)));
            }
            let mut failed = Vec::new();
            std::future::poll_fn(|cx| {
                ending.retain_mut(|end| match end.as_mut().poll(cx) {
                    Poll::Ready(of_it) => {
                        failed.extend(of_it);
                        false
                    }
                    Poll::Pending => true,
                });
                if ending.is_empty() { Poll::Ready(()) } else { Poll::Pending }
            })
            .await;
            failed
        };
        let (of_here, of_there) = tokio::join!(self.local.end(&here), afar);
        failed.extend(of_here);
        failed.extend(of_there);
        failed
    }
}

impl Drop for Fleet {
    fn drop(&mut self) {
        self.merging.iter().for_each(JoinHandle::abort);
    }
}

type Ending<'a> = Pin<Box<dyn Future<Output = Vec<(String, Exit)>> + Send + 'a>>;

/// Shows what one keeper says on the board of all.
async fn merge<T>(
    mut said: watch::Receiver<T>,
    of: impl Fn(&T) -> Statuses,
    board: Arc<watch::Sender<Statuses>>,
) {
    let mut mine = Statuses::new();
    loop {
        let now = of(&said.borrow_and_update());
        board.send_if_modified(|all| {
            if now == mine {
                return false;
            }
            all.retain(|name, _| !mine.contains_key(name));
            all.extend(now.clone());
            true
        });
        mine = now;
        if said.changed().await.is_err() {
            return;
        }
    }
}

/// Name of this run, which no other has.
fn run_id() -> String {
    let drawn = std::fs::read_to_string("/proc/sys/kernel/random/uuid").unwrap_or_default();
    match drawn.trim() {
        "" => {
            let since =
                std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
            format!("{}-{:x}", std::process::id(), since.as_nanos())
        }
        drawn => drawn.to_owned(),
    }
}

/// Absolute directories of plugin files, for agents: where the file is written counts, not where this runs.
pub(super) fn absolute(dirs: Vec<PathBuf>) -> Vec<PathBuf> {
    dirs.into_iter().map(|dir| std::path::absolute(&dir).unwrap_or(dir)).collect()
}
