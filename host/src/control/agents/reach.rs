//! The way to an agent, from the side of `trocar up`.
//!
//! Invariant: an agent that comes again is told everything that is wanted anew, and what it keeps already
//! stays as it is. What is known of its processes stays known while it is not heard: they go on.

use std::collections::BTreeMap;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use serde_json::json;
use tokio::sync::{mpsc, watch};
use tokio::task::{JoinHandle, JoinSet};
use tokio_stream::wrappers::{ReceiverStream, UnboundedReceiverStream};
use tonic::{Status as Answer, Streaming};
use trocar_loader::Hash;
use trocar_proto::v1::agent_service_client::AgentServiceClient;
use trocar_proto::v1::{self, keep_request::Message};

use super::wire::{statuses_in, wanted_out};
use crate::agent::{PluginFile, Wanted};
use crate::control::caller::Tokened;
use crate::control::dial::Dialler;
use crate::host::PortRules;
use crate::processes::{Exit, Phase, Status};
use crate::system_file::ProcessSpec;

/// Time to connect.
const CONNECT: Duration = Duration::from_secs(3);
/// Time for the answer: the processes of an earlier run may have to end first.
const TAKEN_IN: Duration = Duration::from_secs(25);
/// Interval of beats.
const BEAT: Duration = Duration::from_millis(300);
/// An agent that says nothing for this long is not heard: it says something each second.
const SILENCE: Duration = Duration::from_millis(2500);
/// Pause before the way is looked for again.
const PAUSE: Duration = Duration::from_millis(500);
/// Part of a file in one message, bytes.
const PART: usize = 1 << 20;
/// Time for processes to end that were asked to: what an agent gives each, and then some.
const ENDING: Duration = Duration::from_secs(20);
/// The same where the agent is not heard.
const UNHEARD: Duration = Duration::from_secs(3);

/// A process that an agent is to keep, as this machine knows it.
#[derive(Clone, Debug)]
pub struct ToKeep {
    pub spec: ProcessSpec,
    /// Directories of plugin files here, which are brought; none: those of the agent's machine.
    pub plugins: Vec<PathBuf>,
    /// List of hashes of the plugin files that it takes, a file here.
    pub hashes: Option<PathBuf>,
    pub gcm: String,
    pub rules: PortRules,
}

/// What is known of an agent and its processes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Seen {
    /// Since when it is heard; `None`: it is not.
    pub heard_since: Option<Instant>,
    /// Why it is not.
    pub why: String,
    /// Folder of the system on its machine.
    pub folder: String,
    pub statuses: BTreeMap<String, Status>,
}

impl Seen {
    pub fn is_heard(&self) -> bool {
        self.heard_since.is_some()
    }
}

enum Ask {
    Start(Box<ToKeep>),
    PutDown { process: String, pid: u32, why: String },
    Again(String),
    End(String),
    Forget(String),
}

/// Keeps the way to an agent; dropped, it hangs up.
pub struct Reach {
    asks: mpsc::UnboundedSender<Ask>,
    seen: Arc<watch::Sender<Seen>>,
    task: JoinHandle<()>,
}

impl Reach {
    /// Begins to look for the agent at this address, which is to keep processes of a system. `run`: drawn by
    /// lot by this program.
    pub fn begin(dialler: Dialler, addr: String, system: String, run: String) -> Reach {
        let (asks, asked) = mpsc::unbounded_channel();
        let seen = Arc::new(watch::Sender::new(Seen::default()));
        let way = Way { dialler, addr, hello: v1::KeepHello { system, run } };
        let keeping = Keeping { way, asked, seen: seen.clone(), wanted: BTreeMap::new() };
        Reach { asks, seen, task: tokio::spawn(keeping.go_on()) }
    }

    /// Returns what is known, now and whenever it changes.
    pub fn seen(&self) -> watch::Receiver<Seen> {
        self.seen.subscribe()
    }

    fn ask(&self, ask: Ask) {
        // The task lives as long as this.
        let _ = self.asks.send(ask);
    }

    /// Has a process started and kept.
    pub fn start(&self, process: ToKeep) {
        let name = process.spec.name.to_string();
        self.seen.send_modify(|seen| _ = seen.statuses.entry(name).or_default());
        self.ask(Ask::Start(Box::new(process)));
    }

    /// Reports that an incarnation is of no use. While the agent is not heard, that is reported to nobody.
    pub fn put_down(&self, process: &str, pid: u32, why: String) {
        self.ask(Ask::PutDown { process: process.to_owned(), pid, why });
    }

    /// Has a process ended, if it runs, and started again. While the agent is not heard, nobody does so.
    pub fn again(&self, process: &str) {
        self.ask(Ask::Again(process.to_owned()));
    }

    /// Asks a process to end; its status says when it has.
    pub fn ask_to_end(&self, process: &str) {
        self.ask(Ask::End(process.to_owned()));
    }

    /// Forgets a process that has ended.
    pub fn forget(&self, process: &str) {
        self.seen.send_modify(|seen| _ = seen.statuses.remove(process));
        self.ask(Ask::Forget(process.to_owned()));
    }

    /// Asks these to end, all at once, and waits until they have. Returns those that did not end in order,
    /// those of an agent that does not answer among them.
    pub async fn end(&self, names: &[String]) -> Vec<(String, Exit)> {
        let before = self.seen.borrow().statuses.clone();
        names.iter().for_each(|name| self.ask_to_end(name));
        let is_over = |seen: &Seen, name: &String| {
            let phase = seen.statuses.get(name).map(|status| status.phase);
            phase.is_none_or(|phase| matches!(phase, Phase::Ended | Phase::Failed))
        };
        let mut following = self.seen();
        let all_over = async {
            // Its sender is held by this.
            let _ = following.wait_for(|seen| names.iter().all(|name| is_over(seen, name))).await;
        };
        let silent = async {
            let mut seen = self.seen();
            loop {
                let _ = seen.wait_for(|seen| !seen.is_heard()).await;
                if tokio::time::timeout(UNHEARD, seen.wait_for(|seen| seen.is_heard())).await.is_err() {
                    return;
                }
            }
        };
        tokio::select! {
            () = all_over => {}
            () = silent => {}
            () = tokio::time::sleep(ENDING) => {}
        }
        let seen = self.seen.borrow();
        let failed = names.iter().filter_map(|name| {
            if !is_over(&seen, name) {
                let why = match seen.is_heard() {
                    true => "it did not end".to_owned(),
                    false => format!("its agent does not answer: {}", seen.why),
                };
                return Some((name.clone(), Exit::Away(why)));
            }
            let ran = before.get(name).is_some_and(|was| !matches!(was.phase, Phase::Ended | Phase::Failed));
            let exit = seen.statuses.get(name).and_then(|status| status.last_exit.clone());
            exit.filter(|exit| ran && !exit.is_orderly()).map(|exit| (name.clone(), exit))
        });
        failed.collect()
    }
}

impl Drop for Reach {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// The way to an agent.
#[derive(Clone)]
struct Way {
    dialler: Dialler,
    addr: String,
    hello: v1::KeepHello,
}

/// An open way.
struct Open {
    client: AgentServiceClient<Tokened>,
    orders: mpsc::UnboundedSender<v1::KeepRequest>,
    inbound: Streaming<v1::KeepResponse>,
}

impl Open {
    /// False: the way is cut.
    fn order(&self, message: Message) -> bool {
        self.orders.send(v1::KeepRequest { message: Some(message) }).is_ok()
    }
}

impl Way {
    /// # Errors
    /// Nobody answers, or the agent refuses.
    async fn open(&self) -> Result<Open, String> {
        let channel = self.dialler.dial_agent(&self.addr, CONNECT).await.map_err(|e| innermost(&*e))?;
        let mut client = AgentServiceClient::new(channel);
        let (orders, outbound) = mpsc::unbounded_channel();
        // Its receiver is beside it.
        let _ = orders.send(v1::KeepRequest { message: Some(Message::Hello(self.hello.clone())) });
        let asked = client.keep(UnboundedReceiverStream::new(outbound));
        let answer = tokio::time::timeout(TAKEN_IN, asked).await;
        let answer = answer.map_err(|_| "it does not answer".to_owned())?;
        let inbound = answer.map_err(|status| said(&status))?.into_inner();
        Ok(Open { client, orders, inbound })
    }
}

/// A process that is wanted.
struct Kept {
    process: ToKeep,
    is_leaving: bool,
    /// Restarts that the agent counted, or that were those of the agent itself, before it came anew.
    restarts: u32,
    /// The agent has started it, as far as was heard.
    is_there: bool,
    /// It could not be brought.
    failed: Option<Status>,
}

struct Keeping {
    way: Way,
    asked: mpsc::UnboundedReceiver<Ask>,
    seen: Arc<watch::Sender<Seen>>,
    wanted: BTreeMap<String, Kept>,
}

/// A process whose files were brought, or why not.
type Brought = (String, Result<Wanted, String>);

impl Keeping {
    async fn go_on(mut self) {
        // A connection that says nothing is not ended before there is another: its end would tell the agent
        // that this program has hung up.
        let mut last = None;
        loop {
            let why = match self.way.open().await {
                Ok(open) => self.follow(last.insert(open)).await,
                Err(why) => why,
            };
            log::debug!("the agent at {}: {why}", self.way.addr);
            self.seen.send_modify(|seen| (seen.heard_since, seen.why) = (None, why));
            if !self.waits().await {
                return;
            }
        }
    }

    /// Waits before the next attempt, and takes in what is asked meanwhile; false: nobody can ask any more.
    async fn waits(&mut self) -> bool {
        let pause = tokio::time::sleep(PAUSE);
        tokio::pin!(pause);
        loop {
            tokio::select! {
                () = &mut pause => return true,
                ask = self.asked.recv() => match ask {
                    Some(ask) => _ = self.take(ask),
                    None => return false,
                },
            }
        }
    }

    /// Notes what is wanted; returns what is to be said to an agent that is heard.
    fn take(&mut self, ask: Ask) -> Option<Message> {
        match ask {
            Ask::Start(process) => {
                let (name, process) = (process.spec.name.to_string(), *process);
                let kept = Kept { process, is_leaving: false, restarts: 0, is_there: false, failed: None };
                self.wanted.entry(name).or_insert(kept);
                // Its files are brought first.
                None
            }
            Ask::End(process) => {
                self.wanted.get_mut(&process)?.is_leaving = true;
                Some(Message::End(process))
            }
            Ask::Forget(process) => {
                self.wanted.remove(&process)?;
                Some(Message::Forget(process))
            }
            // A network that is cut is not the process's fault.
            Ask::PutDown { process, pid, why } => {
                let is_heard = self.seen.borrow().is_heard();
                is_heard.then_some(Message::PutDown(v1::PutDown { process, pid, why }))
            }
            Ask::Again(process) => {
                let is_heard = self.seen.borrow().is_heard();
                if !is_heard {
                    let addr = &self.way.addr;
                    log::warn!("process {process} is not started again: the agent at {addr} is not heard");
                }
                is_heard.then_some(Message::Again(process))
            }
        }
    }

    /// Follows an agent until it is not heard any more; returns why.
    async fn follow(&mut self, open: &mut Open) -> String {
        let mut bringing: JoinSet<Brought> = JoinSet::new();
        let mut beats = tokio::time::interval(BEAT);
        let mut is_first = true;
        let silence = tokio::time::sleep(SILENCE);
        tokio::pin!(silence);
        loop {
            let is_open = tokio::select! {
                told = open.inbound.message() => match told {
                    Ok(Some(told)) => {
                        silence.as_mut().reset(tokio::time::Instant::now() + SILENCE);
                        self.hear(told, is_first);
                        if std::mem::take(&mut is_first) {
                            self.tell_all(open, &mut bringing);
                        }
                        true
                    }
                    Ok(None) => return "it has hung up".into(),
                    Err(status) => return said(&status),
                },
                // Before its first answer it is told nothing: what it has is not known.
                ask = self.asked.recv(), if !is_first => match ask {
                    Some(Ask::Start(process)) => {
                        let name = process.spec.name.to_string();
                        self.take(Ask::Start(process));
                        self.bring(&name, open, &mut bringing);
                        true
                    }
                    Some(ask) => self.take(ask).is_none_or(|message| open.order(message)),
                    None => return "nobody wants it any more".into(),
                },
                Some(brought) = bringing.join_next() => match brought {
                    Ok((name, brought)) => self.brought(&name, brought, open),
                    Err(e) => return e.to_string(),
                },
                _ = beats.tick() => open.order(Message::Beat(v1::KeepBeat {})),
                () = &mut silence => return format!("it has said nothing for {} s", SILENCE.as_secs_f64()),
            };
            if !is_open {
                return "the connection was cut".into();
            }
        }
    }

    /// Tells an agent that has come, or come again, all that is wanted.
    fn tell_all(&mut self, open: &Open, bringing: &mut JoinSet<Brought>) {
        let names: Vec<(String, bool)> =
            self.wanted.iter().map(|(n, kept)| (n.clone(), kept.is_leaving)).collect();
        for (name, is_leaving) in names {
            match is_leaving {
                true => _ = open.order(Message::End(name)),
                false => self.bring(&name, open, bringing),
            }
        }
    }

    /// Has the files of a process brought that the agent does not keep yet.
    fn bring(&self, name: &str, open: &Open, bringing: &mut JoinSet<Brought>) {
        let Some(kept) = self.wanted.get(name).filter(|kept| !kept.is_there) else { return };
        let (name, process, client) = (name.to_owned(), kept.process.clone(), open.client.clone());
        bringing.spawn(async move { (name, brought(process, client).await) });
    }

    /// Has a process started whose files are there; false: the way is cut.
    fn brought(&mut self, name: &str, brought: Result<Wanted, String>, open: &Open) -> bool {
        let Some(kept) = self.wanted.get_mut(name).filter(|kept| !kept.is_leaving) else { return true };
        match brought {
            Ok(wanted) => {
                kept.failed = None;
                open.order(Message::Start(wanted_out(&wanted)))
            }
            Err(why) => {
                let help = "see that the plugin directories and the list of hashes can be read here, and that the agent's \
                            machine has room on its disk";
                let said = json!({ "reason": "PLUGIN_NOT_BROUGHT", "message": why, "help": help });
                let status = Status { phase: Phase::Failed, refused: Some(said), ..Status::default() };
                kept.failed = Some(status.clone());
                self.seen.send_modify(|seen| _ = seen.statuses.insert(name.to_owned(), status));
                true
            }
        }
    }

    /// Takes in what the agent says. `is_first`: it has come, or come again.
    fn hear(&mut self, told: v1::KeepResponse, is_first: bool) {
        let now = statuses_in(told.statuses);
        let before = self.seen.borrow().statuses.clone();
        let mut statuses = BTreeMap::new();
        for (name, kept) in &mut self.wanted {
            let known = now.get(name);
            if is_first && kept.is_there && known.is_none() {
                // The agent was started anew: its processes had ended with it.
                kept.restarts = before.get(name).map_or(0, |status| status.restarts) + 1;
            }
            kept.is_there = known.is_some();
            // One that was never started there has nothing to end.
            let never = kept.is_leaving.then(|| Status { phase: Phase::Ended, ..Status::default() });
            let status = known.cloned().or(never).or_else(|| kept.failed.clone()).unwrap_or_default();
            statuses.insert(name.clone(), Status { restarts: status.restarts + kept.restarts, ..status });
        }
        self.seen.send_if_modified(|seen| {
            let heard_since = seen.heard_since.or_else(|| Some(Instant::now()));
            let now = Seen { heard_since, why: String::new(), folder: told.folder, statuses };
            let is_news = *seen != now;
            *seen = now;
            is_news
        });
    }
}

/// Brings the plugin files of a process that the agent has not.
async fn brought(process: ToKeep, mut client: AgentServiceClient<Tokened>) -> Result<Wanted, String> {
    let ToKeep { spec, plugins, hashes, gcm, rules } = process;
    let read = tokio::task::spawn_blocking(move || {
        let hashes = hashes.map(|file| std::fs::read_to_string(&file).map_err(|e| unread(&file, &e)));
        let (files, hashes) = (files_of(&plugins)?, hashes.transpose()?);
        // Nothing would stand for what the agent's machine has, and for trust in every file.
        if files.is_empty() && !plugins.is_empty() {
            return Err(format!("no plugin file is in {}", shown(&plugins)));
        }
        if hashes.as_ref().is_some_and(|text| text.trim().is_empty()) {
            return Err("the list of hashes of the plugin files that it takes is empty".to_owned());
        }
        Ok::<_, String>((files, hashes.unwrap_or_default()))
    });
    let (files, hashes) = read.await.map_err(|e| e.to_string())??;
    let sha256 = files.iter().map(|(_, file)| file.hash.to_string()).collect();
    let missing = client.missing(v1::MissingRequest { sha256 }).await.map_err(|status| said(&status))?;
    for sha256 in missing.into_inner().sha256 {
        let Some((path, _)) = files.iter().find(|(_, file)| file.hash.to_string() == sha256) else {
            continue;
        };
        let (send, parts) = mpsc::channel(2);
        let (from, named) = (path.clone(), sha256.clone());
        let reading = tokio::task::spawn_blocking(move || parts_of(&from, &named, &send));
        let taken = client.bring(ReceiverStream::new(parts)).await;
        let read = reading.await.map_err(|e| e.to_string())?;
        taken.map_err(|status| format!("{} was not taken: {}", path.display(), said(&status)))?;
        read.map_err(|e| unread(path, &e))?;
    }
    let plugins = files.into_iter().map(|(_, file)| file).collect();
    Ok(Wanted { spec, plugins, hashes, gcm, rules })
}

/// Returns the plugin files in these directories, and the libraries beside them.
fn files_of(dirs: &[PathBuf]) -> Result<Vec<(PathBuf, PluginFile)>, String> {
    let mut files = Vec::new();
    for (directory, dir) in (0..).zip(dirs) {
        let entries = std::fs::read_dir(dir).map_err(|e| unread(dir, &e))?;
        for entry in entries {
            let path = entry.map_err(|e| unread(dir, &e))?.path();
            let Some(name) = path.file_name().and_then(|name| name.to_str()) else { continue };
            if !PluginFile::is_name(name) || !path.is_file() {
                continue;
            }
            let hash = Hash::of(&std::fs::read(&path).map_err(|e| unread(&path, &e))?);
            files.push((path.clone(), PluginFile { name: name.to_owned(), hash, directory }));
        }
    }
    Ok(files)
}

/// Sends a file in parts.
fn parts_of(path: &Path, sha256: &str, send: &mpsc::Sender<v1::BringRequest>) -> io::Result<()> {
    let mut file = std::fs::File::open(path)?;
    let mut sha256 = sha256.to_owned();
    loop {
        let mut bytes = Vec::with_capacity(PART);
        (&mut file).take(PART as u64).read_to_end(&mut bytes)?;
        let is_last = bytes.len() < PART;
        // The agent may have refused it meanwhile, and says why.
        let sent = send.blocking_send(v1::BringRequest { sha256: std::mem::take(&mut sha256), bytes });
        if is_last || sent.is_err() {
            return Ok(());
        }
    }
}

fn shown(dirs: &[PathBuf]) -> String {
    let dirs: Vec<String> = dirs.iter().map(|dir| dir.display().to_string()).collect();
    dirs.join(", ")
}

fn unread(path: &Path, e: &io::Error) -> String {
    format!("{} cannot be read: {e}", path.display())
}

/// The innermost cause.
fn innermost(e: &(dyn std::error::Error + 'static)) -> String {
    let mut at = e;
    while let Some(cause) = at.source() {
        at = cause;
    }
    at.to_string()
}

fn said(status: &Answer) -> String {
    match std::error::Error::source(status) {
        Some(cause) => innermost(cause),
        None => status.message().to_owned(),
    }
}
