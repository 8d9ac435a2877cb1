//! `trocar start|stop|resume|reset|rm`: what changes a component's state.
//!
//! Invariant: `stop --all` reaches every process it can, with or without a GCM, before it reports the first
//! failure.

use clap::Args;

use super::failure::{Done, Exit, Failure};
use super::forget::forget;
use super::mutation::{MutationArgs, Outcome, show};
use super::session::Session;
use super::{out, style};
use trocar::host::announce;

/// Which components.
#[derive(Args, Debug)]
pub(super) struct PathArgs {
    /// Components or globs: host/robot, host/**, '*/robot'.
    #[arg(value_name = "PATH", required = true)]
    pub(super) paths: Vec<String>,
    #[command(flatten)]
    pub(super) mutation: MutationArgs,
}

/// Starts components, servers before clients.
#[derive(Args, Debug)]
pub(super) struct StartArgs {
    #[command(flatten)]
    of: PathArgs,
}

/// Stops components; their devices are brought to their safe condition.
#[derive(Args, Debug)]
pub(super) struct StopArgs {
    /// Components or globs: host/robot, host/**, '*/robot'.
    #[arg(value_name = "PATH", required_unless_present = "all")]
    paths: Vec<String>,
    /// Everything, also when no GCM answers (then: every process of this user on this machine). A software
    /// stop.
    #[arg(long, conflicts_with = "paths")]
    all: bool,
    #[command(flatten)]
    mutation: MutationArgs,
}

/// Resumes stopped components with the state they had.
#[derive(Args, Debug)]
pub(super) struct ResumeArgs {
    #[command(flatten)]
    of: PathArgs,
}

/// Makes new instances of components, e.g. after a FAULT.
#[derive(Args, Debug)]
pub(super) struct ResetArgs {
    #[command(flatten)]
    of: PathArgs,
}

/// Removes components; one that is ACTIVE is stopped first, and what it moves made safe. All or nothing. A
/// process that has ended goes with all that was in it, as by `trocar forget`.
#[derive(Args, Debug)]
pub(super) struct RmArgs {
    #[command(flatten)]
    of: PathArgs,
    /// Also what is connected, or has others in its thread: disconnect and stop those first.
    #[arg(long)]
    force: bool,
}

/// A verb of the state table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verb {
    Start,
    Stop,
    Resume,
    Reset,
}

pub(super) async fn start(args: StartArgs, session: &Session) -> Done {
    verb(session, Verb::Start, &args.of.paths, &args.of.mutation).await
}

pub(super) async fn resume(args: ResumeArgs, session: &Session) -> Done {
    verb(session, Verb::Resume, &args.of.paths, &args.of.mutation).await
}

pub(super) async fn reset(args: ResetArgs, session: &Session) -> Done {
    verb(session, Verb::Reset, &args.of.paths, &args.of.mutation).await
}

pub(super) async fn stop(args: StopArgs, session: &Session) -> Done {
    if !args.all {
        return verb(session, Verb::Stop, &args.paths, &args.mutation).await;
    }
    let everything = ["**".to_owned()];
    match session.verb(Verb::Stop, &everything, &args.mutation).await {
        Ok(outcome) => show(session, &outcome, args.mutation.dry_run, "nothing was active"),
        // An empty system has nothing to stop: that is what was asked for.
        Err(f) if f.exit == Exit::Refused && f.code == "NOT_FOUND" => {
            show(session, &Outcome::default(), args.mutation.dry_run, "nothing was active")
        }
        Err(f) if args.mutation.dry_run => Err(f),
        Err(f) => stop_without_gcm(session, f).await,
    }
}

async fn verb(session: &Session, verb: Verb, paths: &[String], mutation: &MutationArgs) -> Done {
    let outcome = session.verb(verb, paths, mutation).await?;
    show(session, &outcome, mutation.dry_run, "nothing to do")
}

/// Asks every process of this user on this machine by its own socket. `why` is what the GCM answered, if
/// anything.
async fn stop_without_gcm(session: &Session, why: Failure) -> Done {
    let answers = announce::stop_everything().await;
    if answers.is_empty() {
        return Err(why);
    }
    let failed = answers.iter().any(|a| a.result.is_err());
    if session.json() {
        let list: Vec<_> = answers
            .iter()
            .map(|a| serde_json::json!({ "pid": a.pid, "stopped": a.result.is_ok(), "text": a.text() }))
            .collect();
        session.print_json(&serde_json::json!({ "gcm": why.to_json(), "processes": list }))?;
    } else {
        out::complain("warning", &why.message);
        for answer in &answers {
            let (word, colour) =
                if answer.result.is_ok() { ("stopped", style::GOOD) } else { ("failed", style::BAD) };
            let word = style::paint(word, colour, style::stdout());
            out::line(&format!("process {}  {word}: {}", answer.pid, out::harmless(answer.text())));
        }
    }
    Ok(if failed { Exit::Partial } else { Exit::Ok })
}

pub(super) async fn remove(args: RmArgs, session: &Session) -> Done {
    let mutation = &args.of.mutation;
    // A name alone is a process.
    if args.of.paths.iter().all(|path| !path.contains(['/', '*'])) {
        return forget(&args.of.paths, mutation, session).await;
    }
    let paths = named(&args.of.paths, session).await?;
    let outcome = session.remove(&paths, args.force, mutation).await?;
    if !session.json() && !mutation.dry_run {
        // A component that is removed cannot be asked later, so its stop is reported here.
        outcome.plan.iter().filter_map(|line| line.strip_prefix("- stop ")).for_each(|what| {
            out::say(&format!("stopped {what}"));
        });
    }
    show(session, &outcome, mutation.dry_run, &format!("removed {}", paths.join(", ")))
}

/// The components that paths and globs name, each once.
async fn named(asked: &[String], session: &Session) -> Result<Vec<String>, Failure> {
    let mut paths: Vec<String> = Vec::new();
    for path in asked {
        let found = match path.contains('*') {
            true => session.list_of(path).await?.components.into_iter().map(|c| c.path).collect(),
            false => vec![path.clone()],
        };
        found.into_iter().for_each(|path| {
            if !paths.contains(&path) {
                paths.push(path);
            }
        });
    }
    if paths.is_empty() {
        return Err(Failure::refused(
            "NOTHING_MATCHES",
            "there are no components",
            "nothing is left to remove",
        ));
    }
    Ok(paths)
}
