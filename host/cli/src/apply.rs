//! `trocar apply FILE`: makes the running system what a system file says; `trocar diff FILE`: how it differs
//! from that.
//!
//! Invariant: what differs is found by the GCM, by one rule for both; nothing is started or ended but
//! components.

use std::time::Duration;

use clap::Args;
use serde_json::json;

use super::alike::folded;
use super::failure::{Done, Exit};
use super::mutation::{MutationArgs, show};
use super::named::{SystemArgs, placed};
use super::session::Session;
use super::{out, units};

/// A whole system may take longer than a single request.
const WITHIN: Duration = Duration::from_secs(60);

const APPLY_EXAMPLES: &str = "\
Examples:
  trocar apply system.json --dry-run   the plan, and nothing is changed
  trocar apply system.json --prune     also takes away what the file does not have
All is done, or nothing. Processes are not started: `trocar up` and `trocar host` do that.";

const DIFF_EXAMPLES: &str = "\
Example:
  trocar diff system.json
A line each: `+` is in the file alone, `-` in the system alone, `~` in both and not the same.
Exit code 0: they do not differ; 1: they do.";

/// Makes the running system what a system file says.
///
/// Components and connections are made, changed and started in the processes there are. What can change
/// while it runs does; what cannot is stopped for it, or made anew, and goes on after it. What the file does
/// not name stays.
#[derive(Args, Debug)]
#[command(after_help = APPLY_EXAMPLES)]
pub(super) struct ApplyArgs {
    #[command(flatten)]
    system: SystemArgs,
    /// Takes away what the file's processes have and the file does not.
    #[arg(long)]
    prune: bool,
    #[command(flatten)]
    mutation: MutationArgs,
}

/// Shows how the running system differs from a system file.
#[derive(Args, Debug)]
#[command(after_help = DIFF_EXAMPLES)]
pub(super) struct DiffArgs {
    #[command(flatten)]
    system: SystemArgs,
}

pub(super) async fn apply(mut args: ApplyArgs, session: &Session) -> Done {
    let file = args.system.read()?;
    args.mutation.timeout.get_or_insert(WITHIN.as_nanos() as u64);
    let outcome = session.apply_system(&file.text(), args.prune, &args.mutation).await;
    let outcome = outcome.map_err(|failure| placed(&file, failure))?;
    if outcome.plan.is_empty() && !session.json() {
        folded(outcome.warnings.clone()).iter().for_each(|warning| out::complain("warning", warning));
        out::say(&format!("nothing to do for {}", args.system.file.display()));
        return Ok(Exit::Ok);
    }
    show(session, &outcome, args.mutation.dry_run, "done")
}

pub(super) async fn diff(args: DiffArgs, session: &Session) -> Done {
    let file = args.system.read()?;
    let found = session.compare(&file.text()).await.map_err(|failure| placed(&file, failure))?;
    let exit = if found.differences.is_empty() { Exit::Ok } else { Exit::Refused };
    if session.json() {
        session.print_json(&json!({
            "file": args.system.file,
            "revision": found.revision,
            "differences": found.differences,
            "notes": found.notes,
        }))?;
        return Ok(exit);
    }
    found.differences.iter().for_each(|line| out::line(&out::harmless(line)));
    found.notes.iter().for_each(|note| out::complain("note", note));
    let file = args.system.file.display();
    match found.differences.len() as u64 {
        0 => out::say(&format!("the system is what {file} says")),
        n => out::say(&format!("{} to {file}", units::count(n, "difference"))),
    }
    Ok(exit)
}
