//! `trocar host`: a process with an LCM, plugin directories, and a GCM of its own or elsewhere.
//!
//! Invariant: the first line on stdout says where it listens; it ends on Ctrl-C with its devices safe.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;
use trocar_loader::Trust;
use trocar_model::{Name, Refusal};
use trocar_rt::os;

use super::failure::{Done, Exit, Failure};
use super::session::Session;
use super::{logging, out, session};
use trocar::host::{
    Host, HostConfig, HostError, Machines, MemoryBounds, PortRules, StateChoice, StopRequest, Viewer,
    say_to_keeper, state_home,
};
use trocar::system_file::{ProcessSpec, flags};

const EXAMPLES: &str = "\
Examples:
  trocar host --plugins DIR
      A host that is a whole system by itself; `trocar ls` and `trocar create` find it.
  trocar host --name left --gcm 127.0.0.1:50551 --listen 127.0.0.1:0
      One more host under the GCM that is there already: its components are left/NAME.";

/// Runs a host: loads plugins and runs components, with a GCM of its own unless --gcm names another.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct HostArgs {
    /// Name of the process, the first part of its components' paths.
    #[arg(long, default_value = "host", value_parser = name)]
    name: Name,
    /// Directory of plugin files, watched; may be given several times [default: ./plugins, else where this
    /// program lies].
    #[arg(long, value_name = "DIR")]
    plugins: Vec<PathBuf>,
    /// Address to listen on; port 0 takes a free one.
    #[arg(long, default_value = session::DEFAULT_GCM, value_name = "ADDR")]
    listen: String,
    /// Where it keeps its state [default: trocar/NAME in the user's state directory].
    #[arg(long, value_name = "DIR")]
    state: Option<PathBuf>,
    /// Forget what an earlier run left in the state directory; only counters go on.
    #[arg(long)]
    fresh: bool,
    /// Which plugin files are taken: dev (your own and root's) or allowlist:FILE (sha256 listed).
    #[arg(long, default_value = "dev", value_name = "MODE")]
    trust: String,
    /// Keep all memory of this process from being swapped out; where that is not allowed it is said and
    /// it runs without.
    #[arg(long)]
    lock_memory: bool,
    /// Let components start programs, as you: classes that do (`trocar describe CLASS` says so) are
    /// refused otherwise.
    #[arg(long)]
    allow_exec: bool,
    #[command(flatten)]
    memory: MemoryArgs,
    #[command(flatten)]
    port: PortArgs,
    #[command(flatten)]
    machines: MachineArgs,
    /// Address at which components of other machines connect to those here [default: a free port where a
    /// GCM of another machine is reached, or beside --listen-tls].
    #[arg(long, value_name = "ADDR")]
    listen_lines: Option<String>,
    /// Mbit/s that frames and other large samples take at most on the way to one process of another
    /// machine, so that what is urgent need not wait behind them: some 94 of 100 of the slowest link
    /// [default: as many as it takes].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    line_mbps: Option<u32>,
    #[command(flatten)]
    tie: Tie,
}

/// The way by which other machines reach a program.
#[derive(Args, Clone, Debug)]
pub(super) struct MachineArgs {
    /// Address for other machines, beside the other one; both sides show certificates there, this one that
    /// of --identity.
    #[arg(long, value_name = "ADDR")]
    pub(super) listen_tls: Option<String>,
    /// Certificates that are believed no more, as the authority lists them: `trocar ca` says where. The file
    /// is looked at again and again.
    #[arg(long, value_name = "FILE")]
    pub(super) revoked: Option<PathBuf>,
}

impl MachineArgs {
    pub(super) fn machines(self) -> Machines {
        let MachineArgs { listen_tls: listen, revoked } = self;
        Machines { identity: session::identity(), listen, lines: None, line_mbps: None, revoked }
    }
}

/// Rights of callers at a program's address.
#[derive(Args, Clone, Copy, Debug)]
pub(super) struct PortArgs {
    /// The viewer's page changes nothing: what it asks for is refused. `trocar` and grpcurl go on as ever.
    #[arg(long = "viewer-read-only")]
    only_reads: bool,
    /// Let every user of this machine change things, not only yourself and root. Without it others read,
    /// unless they send what `trocar token` prints.
    #[arg(long)]
    open_loopback: bool,
}

impl PortArgs {
    pub(super) fn rules(self) -> PortRules {
        let viewer = if self.only_reads { Viewer::ReadOnly } else { Viewer::Full };
        PortRules { viewer, open_loopback: self.open_loopback }
    }

    /// The same for a program that is started.
    pub(super) fn flags(self) -> impl Iterator<Item = &'static str> {
        flags(self.rules())
    }
}

/// Bounds of the memory that a process may use.
#[derive(Args, Clone, Copy, Debug)]
struct MemoryArgs {
    /// List this process with a warning while it has more memory than this in use, MiB.
    #[arg(long, value_name = "MIB", value_parser = clap::value_parser!(u32).range(1..))]
    memory_warn: Option<u32>,
    /// Give this process no more memory of its own than this, MiB: asking for more ends it.
    #[arg(long, value_name = "MIB", value_parser = clap::value_parser!(u32).range(1..))]
    memory_limit: Option<u32>,
}

impl MemoryArgs {
    fn bounds(self) -> Result<MemoryBounds, Failure> {
        MemoryBounds::new(self.memory_warn, self.memory_limit)
            .map_err(|why| Failure::usage(why, "give a --memory-warn below --memory-limit"))
    }
}

/// Tie of a process to its supervisor.
#[derive(Args, Clone, Copy, Debug)]
pub(super) struct Tie {
    /// End, devices safe first, when standard input is closed; wait for a GCM that is not there yet.
    /// For supervisors.
    #[arg(long)]
    tied: bool,
}

impl Tie {
    /// Listens for requests to end this process, from any source.
    pub(super) fn listen(self) -> Result<StopRequest, Failure> {
        let stop = StopRequest::listen();
        if self.tied {
            stop.tie_to_stdin().map_err(|e| HostError::Threads { because: e.to_string() })?;
        }
        Ok(stop)
    }
}

/// Tells the keeper of this process why it does not run, or not any more.
pub(super) fn heard(done: Done) -> Done {
    if let Err(failure) = &done {
        say_to_keeper(&out::json(&failure.to_json().to_string()));
    }
    done
}

pub(super) async fn run(args: HostArgs, session: &Session) -> Done {
    heard(serve(args, session).await)
}

async fn serve(args: HostArgs, session: &Session) -> Done {
    logging::install(log::LevelFilter::Info);
    let state = args.state.unwrap_or_else(|| state_home().join(args.name.as_str()));
    let config = HostConfig {
        plugins: plugin_dirs(args.plugins),
        listen: Some(args.listen),
        rules: args.port.rules(),
        machines: Machines {
            lines: args.listen_lines,
            line_mbps: args.line_mbps,
            ..args.machines.machines()
        },
        state: StateChoice::Durable(state),
        fresh: args.fresh,
        gcm: session.explicit_gcm().map(str::to_owned),
        trust: trust(&args.trust)?,
        lock_memory: args.lock_memory,
        allow_exec: args.allow_exec,
        memory: args.memory.bounds()?,
        await_gcm: args.tie.tied,
        vet_with: std::env::current_exe().ok(),
        ..HostConfig::new(args.name)
    };
    let mut stop = args.tie.listen()?;
    let host = tokio::select! {
        host = config.clone().start() => host?,
        // The host takes back everything that it has made by now.
        () = stop.asked() => return Ok(Exit::Interrupted),
    };
    logging::to_file(host.state_dir().path());
    logging::to_readers(host.own_lines());
    say_listening(&config, &host, session);
    until_stopped(host, stop).await
}

/// Ends this process, which cannot go on: tells people and its keeper why. No runtime is left that could
/// be counted on.
pub(super) fn end_broken(why: &str) {
    let help = "start it again. A component must close only what it opened itself (no closefrom, no second close); one that \
                does not is kept apart by \"isolated\": true. Where a thread broke down, trocar has a fault: report it";
    let failure = Failure::local("BROKEN", format!("the process cannot go on: {why}"), help);
    // Readers of the log hear by a runtime. A closed stderr changes nothing.
    let _ = writeln!(std::io::stderr(), "error: {}\n help: {}", failure.message, failure.help);
    say_to_keeper(&out::json(&failure.to_json().to_string()));
    os::end_at_once(1);
}

/// clap's parser of a process name.
pub(super) fn name(text: &str) -> Result<Name, String> {
    Name::parse(text).map_err(|e| e.to_string())
}

/// Reads `--trust`.
pub(super) fn trust(text: &str) -> Result<Trust, Failure> {
    text.parse().map_err(|e| Failure::from(HostError::Store(e)))
}

/// Returns the named directories, else `./plugins`, else the program's own directory (where cargo puts built
/// plugins). A `./plugins` that holds other things and no library, such as sources, is not taken.
pub(super) fn plugin_dirs(named: Vec<PathBuf>) -> Vec<PathBuf> {
    if !named.is_empty() {
        return named;
    }
    let here = Path::new("plugins");
    let mut held = std::fs::read_dir(here).into_iter().flatten().flatten().peekable();
    let is_library = |e: std::fs::DirEntry| e.path().extension().is_some_and(|x| x == "so");
    if here.is_dir() && (held.peek().is_none() || held.any(is_library)) {
        return vec![here.to_owned()];
    }
    let own = std::env::current_exe().ok().and_then(|exe| exe.parent().map(Path::to_owned));
    own.into_iter().collect()
}

/// Returns the directories `given`, else those of a process of a system file, which are relative to `base`,
/// else those of any host.
pub(super) fn plugins_of(process: &ProcessSpec, base: &Path, given: Vec<PathBuf>) -> Vec<PathBuf> {
    match (given.is_empty(), process.plugins.is_empty()) {
        (false, _) => given,
        (true, false) => process.plugins.iter().map(|dir| base.join(dir)).collect(),
        (true, true) => plugin_dirs(Vec::new()),
    }
}

/// Waits for the end and ends in order.
pub(super) async fn until_stopped(mut host: Host, mut stop: StopRequest) -> Done {
    let ended = host.until_asked_to_stop(&mut stop).await;
    host.shutdown().await;
    match ended {
        Ok(()) => Ok(Exit::Ok),
        Err(e @ HostError::Refused(Refusal::ProcessExists { .. })) => {
            Err(Failure { exit: Exit::Replaced, ..e.into() })
        }
        Err(e) => Err(e.into()),
    }
}

/// Returns the address that the host listens on, for people and scripts.
pub(super) fn address(host: &Host) -> String {
    host.addr().map_or_else(|| "nowhere".to_owned(), |addr| addr.to_string())
}

/// Returns the page on which a browser sees the system of the GCM at this address, the first of several.
pub(super) fn viewer(gcm: &str) -> String {
    let first = gcm.split(',').next().unwrap_or(gcm);
    if first.contains("://") { format!("{first}/") } else { format!("http://{first}/") }
}

fn say_listening(config: &HostConfig, host: &Host, session: &Session) {
    let dirs: Vec<String> = config.plugins.iter().map(|d| d.display().to_string()).collect();
    if session.json() {
        let line = json!({
            "listening": address(host),
            "listening_tls": host.secured().map(|addr| addr.to_string()),
            "process": config.name.as_str(),
            "pid": std::process::id(),
            "state": host.state_dir().path(),
            "plugins": dirs,
            "gcm": config.gcm,
            "viewer": viewer(config.gcm.as_deref().unwrap_or(&address(host))),
        });
        say_to_keeper(&line.to_string());
        out::line(&line.to_string());
        return;
    }
    let gcm = config.gcm.as_ref().map_or_else(|| "its own GCM".to_owned(), |addr| format!("GCM {addr}"));
    out::line(&format!("host {} listening on {}", config.name, address(host)));
    if let Some(addr) = host.secured() {
        out::line(&format!("  for other machines: https://{addr}"));
    }
    out::line(&format!("  {gcm}, plugins {}, state {}", dirs.join(" "), host.state_dir().path().display()));
    out::line(&format!("  viewer {}", viewer(config.gcm.as_deref().unwrap_or(&address(host)))));
    out::line(&format!("  trocar ls --gcm {}", config.gcm.as_deref().unwrap_or(&address(host))));
    out::line("  Ctrl-C stops it, devices safe first");
}

impl From<HostError> for Failure {
    fn from(e: HostError) -> Self {
        match &e {
            HostError::Refused(refusal) => Failure::from(refusal),
            HostError::NoGcm { addr, because } => {
                Failure { help: e.help(), ..Failure::no_gcm(addr, because) }
            }
            _ => Failure::local(e.reason(), e.to_string(), e.help()),
        }
    }
}
