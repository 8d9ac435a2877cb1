//! Common part of all changing subcommands: their flags, and how their outcome is shown.
//!
//! Invariant: an outcome is printed once, whole: what was done, what was left alone and why,
//! warnings, the revision.

use clap::Args;
use serde::Serialize;

use super::alike::folded;
use super::failure::{Done, Exit};
use super::session::Session;
use super::{out, units};

/// Flags of every change.
#[derive(Args, Clone, Debug, Default)]
pub(super) struct MutationArgs {
    /// Checks and shows the plan, changes nothing.
    #[arg(long)]
    pub(super) dry_run: bool,
    /// Refuse when the system has moved on from this revision.
    #[arg(long, value_name = "N")]
    pub(super) expected_revision: Option<u64>,
    /// Undo and give up after this time, e.g. 2s.
    #[arg(long, value_name = "TIME", value_parser = units::parse_time)]
    pub(super) timeout: Option<u64>,
}

/// Result of a change.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct Outcome {
    pub(super) revision: u64,
    /// One line per step: "+ create …", "~ configure …", "- stop …".
    pub(super) plan: Vec<String>,
    pub(super) components: Vec<Standing>,
    pub(super) skipped: Vec<Left>,
    pub(super) failed: Vec<Left>,
    pub(super) warnings: Vec<String>,
    /// The connection made, 0 = none.
    pub(super) connection: u64,
}

/// State of a component after the change.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct Standing {
    pub(super) path: String,
    pub(super) state: String,
    pub(super) health: String,
    pub(super) fault: String,
}

/// A component that was left alone or could not be changed, and why.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct Left {
    pub(super) path: String,
    pub(super) why: String,
}

/// Prints an outcome; `done` puts the request into words, for an outcome that lists no component.
pub(super) fn show(session: &Session, outcome: &Outcome, dry_run: bool, done: &str) -> Done {
    let is_said = outcome.components.is_empty() && outcome.skipped.is_empty();
    print(session, outcome, dry_run, is_said.then_some(done))
}

/// Prints an outcome after `done`: what its components do tells nothing of what was changed.
pub(super) fn show_after(session: &Session, outcome: &Outcome, dry_run: bool, done: &str) -> Done {
    print(session, outcome, dry_run, Some(done))
}

fn print(session: &Session, outcome: &Outcome, dry_run: bool, done: Option<&str>) -> Done {
    let exit = if outcome.failed.is_empty() { Exit::Ok } else { Exit::Partial };
    if session.json() {
        session.print_json(outcome)?;
        return Ok(exit);
    }
    if dry_run {
        for line in &outcome.plan {
            out::say(line);
        }
        out::line(if outcome.plan.is_empty() { "nothing to do" } else { "(dry run: nothing was changed)" });
        return Ok(exit);
    }
    done.into_iter().for_each(out::say);
    for c in &outcome.components {
        let extra = match (c.health.as_str(), c.fault.as_str()) {
            ("OK" | "", "") => String::new(),
            (health, "") => format!("  {health}"),
            (_, fault) => format!("  {fault}"),
        };
        out::say(&format!("{}  {}{extra}", c.path, c.state));
    }
    for left in &outcome.skipped {
        out::say(&format!("{}  left alone: {}", left.path, left.why));
    }
    for left in &outcome.failed {
        out::complain("error", &format!("{}: {}", left.path, left.why));
    }
    folded(outcome.warnings.clone()).iter().for_each(|warning| out::complain("warning", warning));
    Ok(exit)
}
