//! `trocar up FILE`: the processes of a system file as children, with a GCM of their own or another's.
//!
//! Invariant: whatever ends it ends its children, devices safe first; what does not come up is named with the reason, and
//! then nothing is left.

mod detach;
mod mend;
mod programs;
mod telling;

use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use tokio::net::UnixStream;
use trocar_model::{ComponentId, Name, Request};

use self::mend::Mender;
use self::programs::GCM;
use self::telling::Voice;
use super::failure::{Done, Exit, Failure};
use super::mutation::Outcome;
use super::session::{self, Session};
use super::{hosting, logging};
use crate::gcm::Fate;
use crate::host::{HostError, StateChoice, StateDir, StopRequest, state_home};
use crate::processes::{Door, Phase, Program, Status, Supervisor};
use crate::system_file::SystemFile;

/// How long a whole system may take to come up.
const BRING_UP: Duration = Duration::from_secs(60);
/// How often everything is made once more when a process was lost meanwhile.
const AGAIN: u32 = 5;
/// Between two looks whether it is back.
const LOOK: Duration = Duration::from_millis(20);
/// How long its components may take to stop in order; then their processes stop them all the same.
const STOP: Duration = Duration::from_secs(5);

/// Starts the processes of a system file and everything in them; stays until Ctrl-C or `trocar down`.
#[derive(Args, Debug)]
pub(super) struct UpArgs {
    /// The system file (`trocar schema system` describes it).
    file: PathBuf,
    /// Another value for one setting: process/component.key=value; may be given several times.
    #[arg(long = "set", value_name = "ASSIGNMENT")]
    sets: Vec<String>,
    /// Plugin directories instead of the file's; may be given several times.
    #[arg(long, value_name = "DIR")]
    plugins: Vec<PathBuf>,
    /// Address of the system's own GCM; port 0 takes a free one. With --gcm there is none.
    #[arg(long, default_value = session::DEFAULT_GCM, value_name = "ADDR")]
    listen: String,
    /// What `trocar down` calls it [default: the file's name without its extension].
    #[arg(long, value_parser = hosting::name)]
    name: Option<Name>,
    /// Answer when everything is up, and leave it to `trocar down`.
    #[arg(long)]
    detach: bool,
    /// This is what --detach left running.
    #[arg(long, hide = true)]
    detached: bool,
}

/// Where its GCM is.
enum Gcm {
    Own(Program),
    /// Another's, at this address.
    Of(String),
}

/// A system on its way up, up, or on its way down.
struct System {
    hosts: Vec<Program>,
    supervisor: Supervisor,
    /// To its GCM, once there is one.
    session: Option<Session>,
    teller: Option<tokio::task::JoinHandle<()>>,
    is_up: bool,
}

pub(super) async fn run(args: UpArgs, session: &Session) -> Done {
    let name = name_of(args.name.as_ref(), &args.file)?;
    let place = directory(&name);
    if args.detach {
        return detach::run(&place, &name, session).await;
    }
    logging::install(log::LevelFilter::Warn);
    let file = read(&args)?;
    let mut stop = StopRequest::listen();
    let state = StateDir::open(&StateChoice::Durable(place), false)?;
    logging::to_file(state.path());
    let mut door = Door::open(state.path()).map_err(|e| HostError::StateUnwritable {
        dir: state.path().to_owned(),
        because: format!("no socket for `trocar down`: {e}"),
    })?;
    let gcm = match session.explicit_gcm() {
        Some(addr) => Gcm::Of(addr.to_owned()),
        None => Gcm::Own(programs::gcm(&args.listen, state.path())?),
    };
    let mut system = System {
        hosts: programs::hosts(&file, &args.file, &args.plugins, state.path())?,
        supervisor: Supervisor::default(),
        session: None,
        teller: None,
        is_up: false,
    };
    let voice = Voice { name, json: session.json(), quiet: args.detached };
    let mut asker: Option<UnixStream> = None;
    let failure = tokio::select! {
        failure = system.live(&gcm, &file, &voice) => Some(failure),
        () = stop.asked() => None,
        stream = door.asked() => {
            asker = Some(stream);
            None
        }
    };
    let interrupted = !system.is_up && asker.is_none();
    system.take_down(&gcm).await;
    door.answer(asker).await;
    match failure {
        Some(failure) => Err(failure),
        None if interrupted => Ok(Exit::Interrupted),
        None => Ok(Exit::Ok),
    }
}

fn read(args: &UpArgs) -> Result<SystemFile, Failure> {
    let mut file = SystemFile::read(&args.file)?;
    for assignment in &args.sets {
        file.set(assignment)?;
    }
    if file.processes.is_empty() {
        return Err(Failure::usage(
            format!("{} names no process", args.file.display()),
            "add \"processes\", or components such as \"host/robot\"",
        ));
    }
    Ok(file)
}

/// What a system is called that nobody named: as its file.
pub(super) fn name_of(named: Option<&Name>, file: &Path) -> Result<String, Failure> {
    if let Some(name) = named {
        return Ok(name.to_string());
    }
    let stem = file.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
    Name::parse(stem).map(|name| name.to_string()).map_err(|_| {
        Failure::usage(
            format!("{:?} is no name for a system", file.display()),
            "give it one: --name NAME (letters, digits, '_', '-', '.')",
        )
    })
}

/// Where systems keep their state and their doors.
pub(super) fn directories() -> PathBuf {
    state_home().join("up")
}

pub(super) fn directory(name: &str) -> PathBuf {
    directories().join(name)
}

impl System {
    /// Brings it up and stays; ends only when it cannot come up, with the reason.
    async fn live(&mut self, gcm: &Gcm, file: &SystemFile, voice: &Voice) -> Failure {
        if let Err(failure) = self.come_up(gcm, file, voice).await {
            return failure;
        }
        self.is_up = true;
        let Some(session) = &self.session else { return std::future::pending().await };
        let mut all = self.supervisor.statuses();
        let mut before = all.borrow_and_update().clone();
        let mut mender = Mender::new(&before);
        loop {
            // The supervisor lives as long as this does.
            if mender.is_due(&before) {
                let _ = tokio::time::timeout(LOOK, all.changed()).await;
            } else {
                let _ = all.changed().await;
            }
            let now = all.borrow_and_update().clone();
            voice.tell(&before, &now);
            before = now;
            if mender.is_due(&before) {
                mender.mend(&before, file, session).await;
            }
        }
    }

    async fn come_up(&mut self, gcm: &Gcm, file: &SystemFile, voice: &Voice) -> Result<(), Failure> {
        let addr = match gcm {
            Gcm::Of(addr) => addr.clone(),
            Gcm::Own(program) => {
                self.supervisor.start(program.clone());
                self.serving(&[GCM.to_owned()]).await?.unwrap_or_default()
            }
        };
        let session = self.session.insert(Session::new(Some(addr.clone()), voice.json));
        // Whoever is asked to wait for a GCM waits for ever.
        session.list().await?;
        self.teller = Some(telling::keep_told(&addr, self.supervisor.statuses()));
        let names = self.names();
        for host in &mut self.hosts {
            host.args.extend(["--gcm".into(), addr.clone().into()]);
            self.supervisor.start(host.clone());
        }
        self.serving(&names).await?;
        let outcome = self.fill(file, &names).await?;
        let Some(session) = &self.session else { return Ok(()) };
        let standing = session.list().await?;
        voice.say_up(&addr, &self.supervisor.statuses().borrow(), &standing, file, &outcome.warnings);
        Ok(())
    }

    /// Makes everything of the file in its processes. One that crashes, or loses touch, meanwhile is started again by its
    /// supervisor; then all of it is made once more, until that gives up.
    async fn fill(&self, file: &SystemFile, names: &[String]) -> Result<Outcome, Failure> {
        let Some(session) = &self.session else { return Ok(Outcome::default()) };
        let requests = file.requests();
        let mut again = 0;
        loop {
            let failure = match session.apply(&requests, BRING_UP).await {
                Ok(outcome) => return Ok(outcome),
                Err(failure) if failure.reason == "PROCESS_LOST" && again < AGAIN => failure,
                Err(failure) => return Err(placed(file, failure)),
            };
            again += 1;
            log::warn!("{}; everything is made once more", failure.message);
            let settle = async {
                loop {
                    self.serving(names).await?;
                    let listed = session.list().await?;
                    let there = |name: &String| {
                        listed.processes.iter().any(|p| p.name == *name && p.state == "ATTACHED")
                    };
                    if names.iter().all(there) {
                        break Ok::<_, Failure>(listed);
                    }
                    tokio::time::sleep(LOOK).await;
                }
            };
            let listed = tokio::time::timeout(BRING_UP, settle).await.map_err(|_| failure)??;
            let ids = listed.components.iter().filter_map(|c| ComponentId::parse(&c.path).ok());
            let ours = ids.filter(|id| names.iter().any(|name| name == id.process.as_str()));
            let removes: Vec<Request> = ours.map(|id| Request::Remove { id, force: true }).collect();
            session.apply(&removes, BRING_UP).await?;
        }
    }

    fn names(&self) -> Vec<String> {
        self.hosts.iter().map(|host| host.name.clone()).collect()
    }

    /// Waits until these serve; answers where the last of them does.
    async fn serving(&self, names: &[String]) -> Result<Option<String>, Failure> {
        let mut all = self.supervisor.statuses();
        let wait = async {
            loop {
                let now = all.borrow_and_update().clone();
                let stands = |name: &String| now.get(name).cloned().unwrap_or_default();
                let settled =
                    |s: &Status| matches!(s.phase, Phase::Failed | Phase::Ended) || s.refused.is_some();
                if let Some((name, status)) = names.iter().map(|n| (n, stands(n))).find(|(_, s)| settled(s)) {
                    return Err(not_up(name, &status));
                }
                if names.iter().all(|name| stands(name).phase == Phase::Running) {
                    return Ok(names.last().and_then(|name| stands(name).address));
                }
                // The supervisor lives as long as this does.
                let _ = all.changed().await;
            }
        };
        if let Ok(done) = tokio::time::timeout(BRING_UP, wait).await {
            return done;
        }
        let now = self.supervisor.statuses().borrow().clone();
        let missing = names.iter().filter(|n| now.get(*n).is_none_or(|s| s.phase != Phase::Running));
        let missing: Vec<&str> = missing.map(|name| called(name)).collect();
        Err(Failure::local(
            "PROCESS_NOT_UP",
            format!("not up within {} s: {}", BRING_UP.as_secs(), missing.join(", ")),
            "look into its log: trocar.log in its state directory",
        ))
    }

    /// Clients before servers while the GCM is there to know them, then every process, its GCM last.
    async fn take_down(&mut self, gcm: &Gcm) {
        let names = self.names();
        if let (Some(session), true) = (&self.session, self.is_up) {
            let everything: Vec<String> = names.iter().map(|name| format!("{name}/**")).collect();
            match tokio::time::timeout(STOP + STOP / 5, session.stop_all_of(&everything, STOP)).await {
                Ok(Ok(())) => {}
                Ok(Err(failure)) => log::warn!("not stopped in order: {}", failure.message),
                Err(_) => log::warn!("not stopped in order: the GCM does not answer"),
            }
        }
        self.supervisor.end(&names).await;
        if let Some(teller) = self.teller.take() {
            teller.abort();
        }
        if let (Some(session), Gcm::Of(_)) = (&self.session, gcm) {
            let gone = telling::fates(&self.supervisor.statuses().borrow(), Some(Fate::Dismissed));
            if let Err(failure) = session.tell(&gone).await {
                log::warn!("the GCM still lists the processes: {}", failure.message);
            }
        }
        self.supervisor.end(&[GCM.to_owned()]).await;
    }
}

/// A process as people call it.
fn called(name: &str) -> &str {
    if name == GCM { "the GCM" } else { name }
}

fn not_up(name: &str, status: &Status) -> Failure {
    let who = if name == GCM { "the GCM".to_owned() } else { format!("process {name}") };
    let said = |key: &str| status.refused.as_ref().and_then(|r| r[key].as_str()).unwrap_or_default();
    let (reason, help) = match said("reason") {
        "" => ("PROCESS_NOT_UP", "look into its log: trocar.log in its state directory"),
        reason => (reason, said("help")),
    };
    let why = match said("message") {
        "" => format!("it {}", status.exit_text()),
        message => message.to_owned(),
    };
    let restarts = match status.restarts {
        0 => String::new(),
        n => format!(" after {n} restarts"),
    };
    let mut failure = Failure::local(reason, format!("{who} did not come up{restarts}: {why}"), help);
    failure.metadata.insert("process".to_owned(), name.to_owned());
    failure
}

/// With the place in the file it comes from.
fn placed(file: &SystemFile, failure: Failure) -> Failure {
    match file.locate_told(&failure.reason, &failure.message, &failure.help, &failure.metadata) {
        Some(place) => failure.at(&place),
        None => failure,
    }
}
