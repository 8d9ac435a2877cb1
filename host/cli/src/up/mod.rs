//! `trocar up FILE`: the processes of a system file as children, with a GCM of their own or another's.
//!
//! Invariant: any end of this program ends its children, devices safe first. A system that does not come up
//! is reported with the reason, and then nothing is left.

mod detach;
mod fill;
mod fleet;
mod isolated;
mod keep;
mod last_seen;
mod machines;
mod mend;
mod news;
pub(super) mod programs;
mod standing;
mod telling;
mod useless;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use clap::Args;
use tokio::net::UnixStream;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use trocar_model::Name;

use self::fleet::{Fleet, Hosted};
use self::programs::{GCM, Launch, Reached, Roster, called};
use self::standing::Standing;
use self::telling::{Up, Voice};
use super::failure::{Done, Exit, Failure};
use super::named::FileArgs;
use super::session::{self, Session};
use super::view::SystemView;
use super::{check, hosting, logging};
use trocar::gcm::{Fate, Told};
use trocar::host::{HostError, StateChoice, StateDir, StopRequest, state_home};
use trocar::processes::{Door, Exit as ProcessExit, Phase, Program, Status, keep_short};
use trocar::system_file::SystemFile;

/// Time that a whole system may take to come up.
const BRING_UP: Duration = Duration::from_secs(60);
/// Time that its components may take to stop in order; then their processes stop them all the same.
const STOP: Duration = Duration::from_secs(5);

/// Starts the processes of a system file and everything in them; stays until Ctrl-C or `trocar down`.
#[derive(Args, Debug)]
pub(super) struct UpArgs {
    #[command(flatten)]
    named: FileArgs,
    /// Address of the system's own GCM; port 0 takes a free one. With --gcm there is none.
    #[arg(long, default_value = session::DEFAULT_GCM, value_name = "ADDR")]
    listen: String,
    #[command(flatten)]
    machines: hosting::MachineArgs,
    /// What `trocar down` calls it [default: the file's name without its extension].
    #[arg(long, value_parser = hosting::name)]
    name: Option<Name>,
    /// Answer when everything is up, and leave it to `trocar down`.
    #[arg(long)]
    detach: bool,
    /// Print what would be done, and do nothing.
    #[arg(long, conflicts_with = "detach")]
    dry_run: bool,
    #[command(flatten)]
    port: hosting::PortArgs,
    /// This is what --detach left running.
    #[arg(long, hide = true)]
    detached: bool,
}

/// The GCM of a system.
pub(super) enum Gcm {
    Own(Box<Program>),
    /// One that this program did not start, at this address.
    Of(String),
}

/// A system on its way up, up, or on its way down.
pub(super) struct System {
    gcm: Gcm,
    launch: Launch,
    /// The way by which other machines reach its own GCM.
    reached: Option<Reached>,
    /// Address of the GCM for its processes, once there is one.
    told: String,
    /// Processes of the file.
    hosts: Vec<Hosted>,
    /// Processes of components that were isolated since.
    isolated: watch::Sender<Roster>,
    supervisor: Fleet,
    /// Session with its GCM, once there is one.
    session: Option<Session>,
    standing: watch::Receiver<Arc<Standing>>,
    /// Tasks that tell the GCM, and listen to it.
    talking: Vec<JoinHandle<()>>,
    is_up: bool,
}

pub(super) async fn run(args: UpArgs, session: &Session) -> Done {
    if args.dry_run {
        return check::dry_run(&args.named, check::Takes::Any, session);
    }
    let name = name_of(args.name.as_ref(), &args.named.system.file)?;
    let place = directory(&name);
    if args.detach {
        return detach::run(&args, &place, &name, session).await;
    }
    logging::install(log::LevelFilter::Warn);
    let file = read(&args)?;
    let reached = machines::reached(&file, &args.machines, session)?;
    let mut stop = StopRequest::listen();
    if args.detached {
        stop.tie_until_heard().map_err(|e| HostError::Threads { because: e.to_string() })?;
    }
    let state = StateDir::open(&StateChoice::Durable(place), false).map_err(|e| not_kept(&e, &name))?;
    logging::to_file(state.path());
    let mut door = Door::open(state.path()).map_err(|e| no_door(state.path(), &e))?;
    let gcm = match session.explicit_gcm() {
        Some(addr) => Gcm::Of(addr.to_owned()),
        None => {
            let own = programs::gcm(&args.listen, state.path(), args.port, reached.as_ref());
            Gcm::Own(Box::new(own))
        }
    };
    let launch = Launch::new(&file, &args.named.system.file, &args.named.plugins, state.path(), args.port);
    let fleet = Fleet::new(&file.machines, &name, args.machines.revoked.as_deref())?;
    let mut system = System::new(gcm, launch, reached, fleet);
    let voice = Voice::new(&name, session.json(), args.detached);
    let mut asker: Option<UnixStream> = None;
    let own_log = detach::log(state.path());
    let failure = tokio::select! {
        failure = system.live(&file, &voice) => Some(failure),
        () = stop.asked() => None,
        stream = door.asked() => {
            asker = Some(stream);
            None
        }
        never = keep_short(&own_log), if args.detached => match never {},
    };
    let interrupted = !system.is_up && asker.is_none();
    let failed = system.take_down().await;
    door.answer(asker, &failed).await;
    match failure {
        Some(mut failure) => {
            if !failed.is_empty() {
                failure.metadata.insert("not_in_order".to_owned(), failed.join("; "));
            }
            return Err(failure);
        }
        None => voice.say_failed(&failed),
    }
    Ok(match failed.is_empty() {
        _ if interrupted => Exit::Interrupted,
        true => Exit::Ok,
        false => Exit::Partial,
    })
}

/// Puts the error in the words of `up`, which has no --state.
fn not_kept(e: &HostError, name: &str) -> Failure {
    let help = match e {
        HostError::StateInUse { .. } | HostError::StateHeld { .. } => {
            format!(
                "`trocar down {name}` takes it down; --name NAME and --listen 127.0.0.1:0 bring another one up beside it"
            )
        }
        HostError::StateUnwritable { .. } => "set XDG_STATE_HOME to a directory you may write to".to_owned(),
        other => other.help(),
    };
    Failure::local(e.reason(), e.to_string(), help)
}

fn no_door(dir: &Path, e: &std::io::Error) -> Failure {
    let because = format!("no socket for `trocar down`: {e}");
    let e = HostError::StateUnwritable { dir: dir.to_owned(), because };
    Failure::local(e.reason(), e.to_string(), "set XDG_STATE_HOME to a directory of a local disk")
}

fn read(args: &UpArgs) -> Result<SystemFile, Failure> {
    let file = args.named.read()?;
    if file.processes.is_empty() {
        return Err(Failure::usage(
            format!("{} names no process", args.named.system.file.display()),
            "add \"processes\", or components such as \"host/robot\"",
        ));
    }
    Ok(file)
}

/// Returns the name of a system: the given one, else that of its file.
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

/// Returns the voice that tells people what becomes of the processes of a system.
pub(super) fn voice(name: &str) -> Voice {
    Voice::new(name, false, false)
}

/// Returns the directory of the states and the doors of systems.
pub(super) fn directories() -> PathBuf {
    state_home().join("up")
}

pub(super) fn directory(name: &str) -> PathBuf {
    directories().join(name)
}

impl System {
    pub(super) fn of_this_machine(gcm: Gcm, launch: Launch) -> Result<System, Failure> {
        Ok(System::new(gcm, launch, None, Fleet::new(&[], "", None)?))
    }

    fn new(gcm: Gcm, launch: Launch, reached: Option<Reached>, supervisor: Fleet) -> System {
        System {
            gcm,
            reached,
            told: String::new(),
            hosts: launch.hosts(),
            launch,
            isolated: watch::Sender::default(),
            supervisor,
            session: None,
            // No GCM is heard yet.
            standing: watch::channel(Arc::default()).1,
            talking: Vec::new(),
            is_up: false,
        }
    }

    /// Brings the system up and stays; returns only when it cannot come up, with the reason.
    async fn live(&mut self, file: &SystemFile, voice: &Voice) -> Failure {
        match self.come_up(file).await {
            Ok(up) => voice.say_up(&up, &self.supervisor.statuses().borrow(), file),
            Err(failure) => return failure,
        }
        match self.keep(file, Some(voice)).await {}
    }

    /// Starts its processes, and makes the components of the file in them.
    pub(super) async fn come_up(&mut self, file: &SystemFile) -> Result<Up, Failure> {
        self.supervisor.reached().await?;
        let addr = match &self.gcm {
            Gcm::Of(addr) => addr.clone(),
            Gcm::Own(program) => {
                self.supervisor.start(Hosted::Here(program.clone()));
                self.in_time(&[GCM.to_owned()]).await?.unwrap_or_default()
            }
        };
        let afar = self.reached.as_ref().map(|reached| format!("https://{}", reached.listen));
        self.told = afar.unwrap_or_else(|| addr.clone());
        let names = self.names();
        let session = self.session.insert(Session::new(Some(addr.clone()), false));
        // The GCM must be there now: a process that is told to wait for it waits for ever.
        let listed = session.standing().await?;
        // Components that a killed system of these names left would be made anew in the new processes.
        let own = matches!(self.gcm, Gcm::Own(_));
        let left = leftovers(&listed, |process| own || names.contains(process));
        if !left.is_empty() {
            session.tell(&left).await?;
        }
        let (standing, following) = standing::follow(&addr);
        self.standing = standing;
        self.talking = vec![telling::keep_told(&addr, self.supervisor.statuses()), following];
        for host in &self.hosts {
            self.supervisor.start(self.under_gcm(host.clone()));
        }
        self.in_time(&names).await?;
        let fill::Filled { standing, warnings, waiting } = self.fill(file, &names).await?;
        let statuses = self.supervisor.statuses().borrow().clone();
        let whole =
            |s: &Arc<Standing>| names.iter().all(|n| statuses.get(n).is_some_and(|p| s.is_whole(n, p.pid)));
        // A process that ends in this moment is mended later.
        let _ = tokio::time::timeout(STOP, self.standing.wait_for(whole)).await;
        self.is_up = true;
        let place = self.hosts.iter().find_map(|host| host.output()?.parent().map(Path::to_owned));
        let elsewhere = self.supervisor.folders();
        Ok(Up { addr, warnings, standing, waiting, place, elsewhere })
    }

    /// A process of this system, under its GCM.
    fn under_gcm(&self, host: Hosted) -> Hosted {
        let revoked = self.reached.as_ref().and_then(|reached| reached.revoked.as_deref());
        host.under(&self.told, revoked)
    }

    /// Returns the names of all its processes but its GCM.
    fn names(&self) -> Vec<String> {
        let isolated = self.isolated.borrow();
        self.hosts.iter().chain(isolated.values()).map(|host| host.name().to_owned()).collect()
    }

    /// Waits until these serve, for as long as a system may take; returns the address of the last one.
    async fn in_time(&self, names: &[String]) -> Result<Option<String>, Failure> {
        match tokio::time::timeout(BRING_UP, self.serving(names)).await {
            Ok(done) => done,
            Err(_) => Err(self.not_all_up(names)),
        }
    }

    /// Waits until these serve; returns the address of the last one.
    async fn serving(&self, names: &[String]) -> Result<Option<String>, Failure> {
        let mut all = self.supervisor.statuses();
        loop {
            let now = all.borrow_and_update().clone();
            let stands = |name: &String| now.get(name).cloned().unwrap_or_default();
            let settled = |s: &Status| matches!(s.phase, Phase::Failed | Phase::Ended) || s.refused.is_some();
            if let Some((name, status)) = names.iter().map(|n| (n, stands(n))).find(|(_, s)| settled(s)) {
                return Err(self.not_up(name, &status));
            }
            if names.iter().all(|name| stands(name).phase == Phase::Running) {
                return Ok(names.last().and_then(|name| stands(name).address));
            }
            // The supervisor lives as long as this does.
            let _ = all.changed().await;
        }
    }

    fn not_all_up(&self, names: &[String]) -> Failure {
        let now = self.supervisor.statuses().borrow().clone();
        let missing = names.iter().filter(|n| now.get(*n).is_none_or(|s| s.phase != Phase::Running));
        let missing: Vec<String> = missing
            .map(|name| match now.get(name).map(Status::exit_text).unwrap_or_default() {
                exit if exit.is_empty() => called(name).to_owned(),
                exit => format!("{}, which {exit}", called(name)),
            })
            .collect();
        let what = match missing.as_slice() {
            // All serve, but the GCM has not taken all of them.
            [] => names.join(", "),
            missing => missing.join("; "),
        };
        Failure::local(
            "PROCESS_NOT_UP",
            format!("not up within {} s: {what}", BRING_UP.as_secs()),
            self.logs(names.first().map_or("", String::as_str)),
        )
    }

    /// Tells which logs to look into.
    fn logs(&self, name: &str) -> String {
        let isolated = self.isolated.borrow();
        let host = self.hosts.iter().chain(isolated.values()).find(|host| host.name() == name);
        let printed = match (host, &self.gcm) {
            (Some(Hosted::Here(program)), _) => {
                format!("; what it printed is in {}", program.output.display())
            }
            (Some(Hosted::There { machine, .. }), _) => {
                let folders = self.supervisor.folders();
                let folder = folders.iter().find(|(of, _)| of == machine).map_or("", |(_, folder)| folder);
                format!("; what it printed is in {folder}/{name}.output.log on the machine {machine}")
            }
            (None, Gcm::Own(program)) if name == GCM => {
                format!("; what it printed is in {}", program.output.display())
            }
            (None, _) => String::new(),
        };
        format!("look into its log: trocar.log in its state directory{printed}")
    }

    fn not_up(&self, name: &str, status: &Status) -> Failure {
        let who = if name == GCM { "the GCM".to_owned() } else { format!("process {name}") };
        let said = |key: &str| status.refused.as_ref().and_then(|r| r[key].as_str()).unwrap_or_default();
        let (reason, help) = match said("reason") {
            "" => ("PROCESS_NOT_UP", self.logs(name)),
            // The process advises its own flags, which cannot be given to `trocar up`.
            reason @ ("STATE_IN_USE" | "STATE_UNWRITABLE") => (
                reason,
                format!("another directory: \"state\" of {name} in the system file, or XDG_STATE_HOME"),
            ),
            // It has no --fresh.
            reason @ ("JOURNAL_DAMAGED" | "JOURNAL_NEWER") => (
                reason,
                "move the file away: `trocar up` makes the system as its file says, and begins a new journal"
                    .to_owned(),
            ),
            reason => (reason, said("help").to_owned()),
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

    /// Stops its components in order while the GCM is there to do it, then ends every process, its GCM last.
    /// Returns a sentence for each process that did not end in order.
    pub(super) async fn take_down(&mut self) -> Vec<String> {
        let names = self.names();
        if let (Some(session), true) = (&self.session, self.is_up) {
            let standing = self.standing.borrow().clone();
            let filled = names.iter().filter(|name| standing.within(name).next().is_some());
            let everything: Vec<String> = filled.map(|name| format!("{name}/**")).collect();
            match tokio::time::timeout(STOP + STOP / 5, session.stop_all_of(everything, STOP)).await {
                Ok(Ok(())) => {}
                Ok(Err(failure)) => log::warn!("not stopped in order: {}", failure.message),
                Err(_) => log::warn!("not stopped in order: the GCM does not answer"),
            }
        }
        let mut failed = self.supervisor.end(&names).await;
        self.talking.drain(..).for_each(|task| task.abort());
        if let Some(session) = &self.session {
            let mut gone = telling::fates(&self.supervisor.statuses().borrow(), Some(Fate::Dismissed));
            // What may still run stays listed: a Stop has to be told that.
            let may_run = |name: &str| {
                failed.iter().any(|(of, exit)| {
                    of == name && matches!(exit, ProcessExit::Away(_) | ProcessExit::Stuck(_))
                })
            };
            gone.retain(|told| !may_run(told.process.as_str()));
            if let Err(failure) = session.tell(&gone).await {
                log::warn!("the GCM still lists the processes: {}", failure.message);
            }
        }
        failed.extend(self.supervisor.end(&[GCM.to_owned()]).await);
        let sentence = |(name, exit): (String, trocar::processes::Exit)| match name == GCM {
            true => format!("the GCM {exit}"),
            false => format!("process {name} {exit}: what it moved may not be safe"),
        };
        failed.into_iter().map(sentence).collect()
    }
}

/// Returns the processes of its own that are listed and not there, to be reported as gone. A process that is
/// there after all is protected by its number.
fn leftovers(listed: &SystemView, is_own: impl Fn(&String) -> bool) -> Vec<Told> {
    let gone = listed.processes.iter().filter(|p| p.state != "ATTACHED" && is_own(&p.name));
    let told = gone.filter_map(|p| {
        let pid = if p.state == "RESTARTING" { 0 } else { p.pid };
        let process = Name::parse(&p.name).ok()?;
        Some(Told { process, fate: Fate::Dismissed, pid, last_exit: String::new(), restarts: 0 })
    });
    told.collect()
}
