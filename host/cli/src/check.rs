//! `trocar check FILE`: all problems of a system file, and `--dry-run`: what it would do.
//!
//! Invariant: nothing is started and no byte of a plugin runs; the messages are those of `run` and
//! `up`, all at once.

use std::path::Path;

use clap::Args;
use serde_json::{Value, json};
use trocar_model::Request;

use super::failure::{Done, Exit};
use super::named::FileArgs;
use super::offline::Offline;
use super::session::Session;
use super::{out, style, units};
use trocar::gcm::plan_lines;
use trocar::system_file::{Draft, Judged, Problem, SystemFile};

const EXAMPLES: &str = "\
Example:
  trocar check system.json
Exit code 0: nothing is wrong; 1: something is. Nothing is started and no plugin runs.";

/// Lists everything that is wrong with a system file, each with its place and what to do.
///
/// Syntax, names and values are judged, and by the plugin directories of its processes classes,
/// configurations, ports and types. A mistake that follows from another one is not listed.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct CheckArgs {
    #[command(flatten)]
    named: FileArgs,
}

pub(super) fn run(args: &CheckArgs, session: &Session) -> Done {
    answer(&args.named, Takes::Any, session, |file, _| {
        let word = style::paint("right", style::GOOD, style::stdout());
        out::say(&format!(
            "{} is {word}: {}, {}, {}",
            args.named.system.file.display(),
            units::count(file.processes.len() as u64, "process"),
            units::count(file.components.len() as u64, "component"),
            units::count(file.connections.len() as u64, "connection"),
        ));
    })
}

/// The processes that a subcommand takes in a file.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Takes {
    Any,
    One,
}

/// `--dry-run` of `run` and `up`: the plan, or all that is wrong.
pub(super) fn dry_run(named: &FileArgs, takes: Takes, session: &Session) -> Done {
    answer(named, takes, session, |_, plan| plan.iter().for_each(|line| out::line(line)))
}

/// Says all that is wrong; `right` tells people of a file that is right, and of its plan.
fn answer(
    named: &FileArgs,
    takes: Takes,
    session: &Session,
    right: impl FnOnce(&SystemFile, &[String]),
) -> Done {
    let mut draft = match Draft::read(&named.system.file) {
        Ok(draft) => draft,
        Err(problems) => return say(&named.system.file, &problems, &[], session),
    };
    for assignment in &named.system.sets {
        draft.set(assignment)?;
    }
    let base: &Path = named.system.file.parent().unwrap_or(Path::new(""));
    let offline = Offline::of(&mut draft, base, &named.plugins)?;
    let mut judged = draft.judge(&offline.graph);
    if takes == Takes::One {
        judged.problems.extend(draft.file().single_process().err());
    }
    if !judged.problems.is_empty() {
        // A class that is not there may be one of theirs.
        return say(&named.system.file, &judged.problems, &offline.refused, session);
    }
    let (plan, notes) = (plan_lines(&judged.plan), unknown(&judged));
    if session.json() {
        session.print_json(
            &json!({ "file": named.system.file, "problems": [], "notes": notes, "plan": plan }),
        )?;
        return Ok(Exit::Ok);
    }
    right(draft.file(), &plan);
    notes.iter().for_each(|note| out::complain("note", note));
    Ok(Exit::Ok)
}

/// Returns the connections whose ports are not known yet.
fn unknown(judged: &Judged) -> Vec<String> {
    let ends = judged.unknown.iter().filter_map(|(port, request)| match request {
        Request::Connect { client, server, .. } => Some(format!(
            "{server} → {client} is not judged: whether {port} is there is known once its component is configured"
        )),
        _ => None,
    });
    ends.collect()
}

fn say(file: &Path, problems: &[Problem], notes: &[String], session: &Session) -> Done {
    if session.json() {
        session.print_json(&json!({
            "file": file,
            "reason": "SYSTEM_FILE",
            "problems": problems.iter().map(for_programs).collect::<Vec<_>>(),
            "notes": notes,
        }))?;
        return Ok(Exit::Refused);
    }
    for problem in problems {
        out::complain("error", &problem.to_string());
        out::complain("help", &problem.help);
    }
    notes.iter().for_each(|note| out::complain("note", note));
    out::say(&format!("{}: {}", file.display(), units::count(problems.len() as u64, "problem")));
    Ok(Exit::Refused)
}

fn for_programs(problem: &Problem) -> Value {
    json!({
        "line": problem.line,
        "column": problem.column,
        "pointer": problem.pointer,
        "message": problem.what,
        "help": problem.help,
    })
}
