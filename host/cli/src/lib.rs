//! The command line: clap's tree, one file per subcommand.
//!
//! Invariant: the whole surface (names, flags, help) is compared with `host/cli/tests/cli-surface.txt`. A
//! subcommand only asks over gRPC what any client could ask, except those that are a process themselves
//! (`host`, `gcm`, `run`, `up`, `demo`).
#![forbid(unsafe_code)]

mod agent;
mod alike;
mod apply;
mod ca;
mod call;
mod check;
mod client;
mod completions;
mod configure;
mod connect;
mod convert;
mod create;
mod demo;
mod describe;
mod doctor;
mod down;
mod echo;
mod execution;
mod exit;
mod failure;
mod forget;
mod gcm;
mod graph;
mod help;
mod hosting;
mod hz;
mod journal;
mod logging;
mod logs;
mod ls;
mod mutation;
mod named;
mod offline;
mod out;
mod plugin;
mod plugin_check;
mod plugin_inspect;
mod plugin_new;
mod question;
mod recording;
mod restart;
mod run;
mod save;
mod schema;
mod screen;
mod session;
mod states;
mod style;
mod table;
mod token;
mod top;
mod typed;
mod units;
mod up;
mod vet;
mod view;
mod wait;
mod watch;

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use clap::{Args, CommandFactory, FromArgMatches, Parser, Subcommand};

use failure::{Done, Exit, Failure};
use session::Session;
use trocar_rt::house;

/// Component-based software for computer-assisted intervention.
///
/// First steps: `trocar demo`, then `trocar ls` in another terminal.
///
/// A host is a process that loads plugins and runs components of their classes. A GCM (Global Component
/// Manager) decides what is created, connected and started, and answers the other subcommands; a host has one
/// of its own unless told of another.
#[derive(Parser, Debug)]
#[command(
    name = "trocar",
    version,
    propagate_version = false,
    disable_help_subcommand = true,
    help_template = help::TEMPLATE,
    max_term_width = 110
)]
struct Cli {
    #[command(flatten)]
    global: Global,
    #[command(subcommand)]
    command: Command,
}

/// Position in the help of the flags that every subcommand takes.
const LAST: usize = 900;

/// Subcommands that ask no GCM. They take the flag but do not offer it, so that a subcommand that it might
/// seem to matter to can refuse it in a clear sentence.
const ASK_NO_GCM: [&str; 14] = [
    "agent",
    "demo",
    "run",
    "gcm",
    "down",
    "check",
    "info",
    "export",
    "journal",
    "doctor",
    "help",
    "token",
    "completions",
    "schema",
];
const PLUGIN_ASKS_NO_GCM: [&str; 3] = ["inspect", "check", "new"];

/// Flags every subcommand takes.
#[derive(Args, Debug)]
struct Global {
    /// Address of the GCM to ask, or those of several, A,B,C [default: $TROCAR_GCM or 127.0.0.1:50551];
    /// https://HOST:PORT for one of another machine.
    #[arg(long, global = true, value_name = "ADDR", display_order = LAST)]
    gcm: Option<String>,
    /// Identity that you show to other machines, as `trocar ca issue` made it [default: $TROCAR_IDENTITY].
    #[arg(long, global = true, value_name = "FILE", display_order = LAST)]
    identity: Option<PathBuf>,
    /// Answers and errors as JSON on stdout.
    #[arg(long, global = true, display_order = LAST)]
    json: bool,
}

/// One variant per subcommand; its flags are in its file.
#[derive(Subcommand, Debug)]
enum Command {
    Demo(demo::DemoArgs),
    Run(run::RunArgs),
    Up(up::UpArgs),
    Down(down::DownArgs),
    Check(check::CheckArgs),
    Save(save::SaveArgs),
    Apply(apply::ApplyArgs),
    Diff(apply::DiffArgs),
    Host(hosting::HostArgs),
    Gcm(gcm::GcmArgs),
    Agent(agent::AgentArgs),
    Ls(ls::LsArgs),
    Describe(describe::DescribeArgs),
    Graph(graph::GraphArgs),
    Create(create::CreateArgs),
    Configure(configure::ConfigureArgs),
    Start(states::StartArgs),
    Stop(states::StopArgs),
    Resume(states::ResumeArgs),
    Reset(states::ResetArgs),
    Connect(connect::ConnectArgs),
    Disconnect(connect::DisconnectArgs),
    Rm(states::RmArgs),
    Forget(forget::ForgetArgs),
    Restart(restart::RestartArgs),
    Call(call::CallArgs),
    Echo(echo::EchoArgs),
    Hz(hz::HzArgs),
    Top(top::TopArgs),
    Record(recording::record::RecordArgs),
    Info(recording::info::InfoArgs),
    Export(recording::export::ExportArgs),
    Wait(wait::WaitArgs),
    Watch(watch::WatchArgs),
    Logs(logs::LogsArgs),
    Journal(journal::JournalArgs),
    Plugin(plugin::PluginArgs),
    Doctor(doctor::DoctorArgs),
    Help(help::HelpArgs),
    Token(token::TokenArgs),
    Ca(ca::CaArgs),
    Completions(completions::CompletionsArgs),
    Schema(schema::SchemaArgs),
    #[command(name = "__vet", hide = true)]
    Vet(vet::VetArgs),
}

/// The program: parses, does, prints, answers the exit code.
pub fn main() -> ExitCode {
    let cli = match command().try_get_matches().and_then(|typed| Cli::from_arg_matches(&typed)) {
        Ok(cli) => cli,
        Err(e) => return refused_by_clap(&e),
    };
    // The vetting child shares nothing with the rest: no runtime, no logger, no threads before the plugin is
    // opened.
    if let Command::Vet(args) = cli.command {
        return vet::run(&args);
    }
    let json = cli.global.json;
    match dispatch(cli) {
        Ok(exit) => ExitCode::from(exit as u8),
        Err(failure) => {
            failure.print(json);
            ExitCode::from(failure.exit as u8)
        }
    }
}

fn dispatch(cli: Cli) -> Done {
    session::show(cli.global.identity);
    let session = Session::new(cli.global.gcm, cli.global.json);
    match cli.command {
        Command::Demo(args) => process(demo::run(args, &session)),
        Command::Run(args) => process(run::run(args, &session)),
        Command::Up(args) => process(up::run(args, &session)),
        Command::Down(args) => ask(down::run(args, &session)),
        Command::Check(args) => check::run(&args, &session),
        Command::Save(args) => ask(save::run(args, &session)),
        Command::Apply(args) => ask(apply::apply(args, &session)),
        Command::Diff(args) => ask(apply::diff(args, &session)),
        Command::Host(args) => process(hosting::run(args, &session)),
        Command::Gcm(args) => process(gcm::run(args, &session)),
        Command::Agent(args) => process(agent::run(args, &session)),
        Command::Ls(args) => ask(ls::run(args, &session)),
        Command::Describe(args) => ask(describe::run(args, &session)),
        Command::Graph(args) => ask(graph::run(args, &session)),
        Command::Create(args) => ask(create::run(args, &session)),
        Command::Configure(args) => ask(configure::run(args, &session)),
        Command::Start(args) => ask(states::start(args, &session)),
        Command::Stop(args) => ask(states::stop(args, &session)),
        Command::Resume(args) => ask(states::resume(args, &session)),
        Command::Reset(args) => ask(states::reset(args, &session)),
        Command::Connect(args) => ask(connect::connect(args, &session)),
        Command::Disconnect(args) => ask(connect::disconnect(args, &session)),
        Command::Rm(args) => ask(states::remove(args, &session)),
        Command::Forget(args) => ask(forget::run(args, &session)),
        Command::Restart(args) => ask(restart::run(args, &session)),
        Command::Call(args) => ask(call::run(args, &session)),
        Command::Echo(args) => ask(echo::run(args, &session)),
        Command::Hz(args) => ask(hz::run(args, &session)),
        Command::Top(args) => ask(top::run(args, &session)),
        Command::Record(args) => process(recording::record::run(args, &session)),
        Command::Info(args) => recording::info::run(&args, &session),
        Command::Export(args) => recording::export::run(args, &session),
        Command::Wait(args) => ask(wait::run(args, &session)),
        Command::Watch(args) => ask(watch::run(args, &session)),
        Command::Logs(args) => ask(logs::run(args, &session)),
        Command::Journal(args) => journal::run(args, &session),
        Command::Plugin(args) => ask(plugin::run(args, &session)),
        Command::Doctor(args) => doctor::run(&args, &session),
        Command::Help(args) => help::run(&args, command()),
        Command::Token(args) => token::run(&args, &session),
        Command::Ca(args) => ca::run(args, &session),
        Command::Completions(args) => Ok(completions::run(&args)),
        Command::Schema(args) => Ok(schema::run(&args)),
        Command::Vet(_) => Ok(Exit::Ok),
    }
}

/// Runs a question on one thread: starting more would cost most of the 50 ms a listing may take.
fn ask(question: impl Future<Output = Done>) -> Done {
    block_on(tokio::runtime::Builder::new_current_thread(), async {
        tokio::select! {
            done = question => done,
            _ = tokio::signal::ctrl_c() => Ok(Exit::Interrupted),
        }
    })
}

/// Runs a process that holds components; it handles its own signals.
fn process(main: impl Future<Output = Done>) -> Done {
    trocar::lcm::own_process();
    trocar::lcm::ends_by(hosting::end_broken);
    block_on(tokio::runtime::Builder::new_multi_thread(), main)
}

/// Idle time after which a thread for blocking work ends.
const IDLE: Duration = Duration::from_secs(2);

fn block_on(mut builder: tokio::runtime::Builder, main: impl Future<Output = Done>) -> Done {
    let runtime = builder.enable_all().thread_name("trocar-io").thread_keep_alive(IDLE);
    let runtime = runtime.on_thread_start(house::begin).on_thread_stop(house::end).build();
    let runtime = runtime.map_err(|e| {
        Failure::local(
            "IO",
            format!("cannot start threads: {e}"),
            "raise the limit on processes and files (ulimit -u, -n)",
        )
    })?;
    let done = runtime.block_on(main);
    // A plugin's blocking call may never return; the process ends all the same.
    runtime.shutdown_background();
    done
}

/// Clap's words in the program's own shape.
fn refused_by_clap(e: &clap::Error) -> ExitCode {
    use clap::error::ErrorKind;
    if !e.use_stderr() {
        out::text(&e.render().to_string());
        return ExitCode::SUCCESS;
    }
    let json = std::env::args_os().any(|a| a == "--json");
    if e.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand && !json {
        eprint!("{}", e.render());
        return ExitCode::from(Exit::Usage as u8);
    }
    let text = e.render().to_string();
    let sentence: Vec<&str> = text.lines().take_while(|l| !l.trim().is_empty()).map(str::trim).collect();
    let sentence = sentence.join(" ");
    let line = |start: &str| text.lines().find_map(|l| l.trim().strip_prefix(start)).map(str::to_owned);
    let usage = line("Usage: ").map(|u| format!("usage: {u}"));
    let asked = asked_for(std::env::args().skip(1));
    let all = asked == "trocar stop" && e.kind() == ErrorKind::MissingRequiredArgument;
    let all = all.then(|| "everything: `trocar stop --all`".to_owned());
    let more = format!("see `{asked} --help`");
    let tip = suggested(e).or_else(|| line("tip: "));
    // Clap's advice for a flag that is meant as a value is of no use here.
    let tip = tip.filter(|tip| !tip.starts_with("to pass "));
    let help: Vec<String> = [tip, all, usage, Some(more)].into_iter().flatten().collect();
    Failure::usage(middle_cut(sentence.trim_start_matches("error: ")), help.join("; ")).print(json);
    ExitCode::from(Exit::Usage as u8)
}

/// The subcommands that are like the one that was typed, the nearest first: clap has it last.
fn suggested(e: &clap::Error) -> Option<String> {
    use clap::error::{ContextKind, ContextValue};
    let Some(ContextValue::Strings(names)) = e.get(ContextKind::SuggestedSubcommand) else { return None };
    let Some(ContextValue::String(typed)) = e.get(ContextKind::InvalidSubcommand) else { return None };
    let mut left: Vec<&str> = names.iter().rev().map(String::as_str).collect();
    // A slip of the fingers comes before letters in common.
    if let Some(slip) = trocar_model::nearest(typed, left.iter().copied()) {
        left.retain(|name| *name != slip);
        left.insert(0, slip);
    }
    match left.as_slice() {
        [] => None,
        [one] => Some(format!("a similar subcommand exists: '{one}'")),
        several => Some(format!("similar subcommands exist: '{}'", several.join("', '"))),
    }
}

/// The subcommand that was typed, as far as there is one.
fn asked_for(typed: impl Iterator<Item = String>) -> String {
    let mut at = command();
    let mut name = "trocar".to_owned();
    for word in typed {
        if let Some(sub) = at.find_subcommand(&word).cloned() {
            name = format!("{name} {word}");
            at = sub;
        }
    }
    name
}

/// A sentence that repeats a huge argument, without its middle.
fn middle_cut(sentence: &str) -> String {
    const HEAD: usize = 200;
    const TAIL: usize = 240;
    let all = sentence.chars().count();
    if all <= HEAD + TAIL + 40 {
        return sentence.to_owned();
    }
    let head: String = sentence.chars().take(HEAD).collect();
    let tail: String = sentence.chars().skip(all - TAIL).collect();
    format!("{head}… ({} characters left out) …{tail}", all - HEAD - TAIL)
}

/// Returns the tree that is parsed, completed, and compared with the surface's golden file.
pub fn command() -> clap::Command {
    let gcm = |help: &'static str| {
        clap::Arg::new("gcm").long("gcm").value_name("ADDR").display_order(LAST).help(help)
    };
    let unused = |sub: clap::Command| sub.arg(gcm("Not used here").global(true).hide(true));
    let of_host = gcm("Attach to the GCM at this address instead of having one; $TROCAR_GCM does not count");
    let of_plugin = |sub: clap::Command| match PLUGIN_ASKS_NO_GCM.contains(&sub.get_name()) {
        true => unused(sub),
        false => sub,
    };
    let program = Cli::command();
    let tasks = help::by_task(&program);
    program.after_help(tasks).mut_subcommands(|sub| match sub.get_name() {
        "host" | "up" => sub.arg(of_host.clone()),
        "plugin" => sub.mut_subcommands(of_plugin),
        name if ASK_NO_GCM.contains(&name) => unused(sub),
        _ => sub,
    })
}

#[cfg(test)]
mod tests {
    use clap::FromArgMatches;

    use super::{Cli, asked_for, command, middle_cut, suggested};

    #[test]
    fn a_usage_error_points_to_the_subcommand() {
        let named = |line: &str| asked_for(line.split(' ').map(str::to_owned));
        assert_eq!(named("--json plugin inspect --nonsense"), "trocar plugin inspect");
        assert_eq!(named("create host/a --rate-hz"), "trocar create");
        assert_eq!(named("lss"), "trocar");
    }

    #[test]
    fn the_nearest_subcommand_is_suggested_first() {
        let tip = |line: &str| {
            let error = command().try_get_matches_from(line.split(' ')).expect_err("no subcommand");
            suggested(&error)
        };
        let similar = |names: &str| Some(format!("similar subcommands exist: {names}"));
        assert_eq!(tip("trocar strat"), similar("'start', 'restart', 'create'"));
        assert_eq!(tip("trocar plugin lss"), Some("a similar subcommand exists: 'ls'".to_owned()));
        assert_eq!(tip("trocar xyzzy"), None);
        assert_eq!(tip("trocar ls --nonsense"), None);
    }

    #[test]
    fn a_gcm_is_offered_where_one_is_asked_and_taken_before_or_after_any_subcommand() {
        let shown = |line: &str| {
            let error = command().try_get_matches_from(line.split(' ')).expect_err("help is no match");
            error.to_string().contains("--gcm <ADDR>")
        };
        assert!(shown("trocar ls --help") && shown("trocar plugin ls --help") && shown("trocar host --help"));
        for line in ["trocar run --help", "trocar demo --help", "trocar plugin check --help"] {
            assert!(!shown(line), "{line} offers --gcm");
        }
        for line in [
            "trocar --gcm a:1 run f",
            "trocar run f --gcm a:1",
            "trocar host --gcm a:1",
            "trocar ls --gcm a:1",
        ] {
            let typed = command().try_get_matches_from(line.split(' ')).expect(line);
            let cli = Cli::from_arg_matches(&typed).expect(line);
            assert_eq!(cli.global.gcm.as_deref(), Some("a:1"), "{line}");
        }
    }

    #[test]
    fn a_huge_argument_is_not_repeated_whole() {
        let sentence = format!("invalid value '{}' for '--config <JSON>': not JSON", "x".repeat(100_000));
        let cut = middle_cut(&sentence);
        assert!(cut.len() < 600 && cut.ends_with("for '--config <JSON>': not JSON"), "{cut}");
    }

    #[test]
    fn the_tree_has_no_contradictions() {
        command().debug_assert();
    }
}
