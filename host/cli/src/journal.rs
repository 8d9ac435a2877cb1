//! `trocar journal verify|show`: what a GCM decided, from its file.
//!
//! Invariant: the file is only read, also beside a GCM that writes it.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use serde_json::json;

use super::failure::{Done, Exit, Failure};
use super::session::Session;
use super::{out, units};
use trocar::gcm::{Record, Unusable};
use trocar::host::state_home;
use trocar::journal::{Fault, Kept, Verified, View, lines, time};

const EXAMPLES: &str = "\
Examples:
  trocar journal verify                  # are all records whole, and in their order?
  trocar journal show --last 20
  trocar journal show --from 118 --json | jq -c '[.time, .asked.identity, .plan]'";

/// Checks and shows the journal of a GCM: who changed what, and when.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct JournalArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand, Debug)]
enum What {
    /// Checks that each record is whole and follows the one before it, and shows the hash of the newest.
    ///
    /// Keep that hash elsewhere: a later journal that goes on from it holds the record with this hash.
    Verify {
        #[command(flatten)]
        place: Place,
    },
    /// Shows records, the oldest first: time (UTC), term, revision, caller, request and result, and below it
    /// what was changed.
    Show {
        #[command(flatten)]
        place: Place,
        /// Only from the first record on that led to this revision or a later one.
        #[arg(long, value_name = "REV")]
        from: Option<u64>,
        /// Only the newest N records.
        #[arg(long, short = 'n', value_name = "N", conflicts_with = "from",
              value_parser = clap::value_parser!(u64).range(1..))]
        last: Option<u64>,
    },
}

#[derive(Args, Debug)]
struct Place {
    /// State directory of the GCM [default: trocar/gcm in the user's state directory].
    #[arg(long, value_name = "DIR")]
    state: Option<PathBuf>,
}

impl Place {
    fn look(self) -> Result<View, Failure> {
        let dir = self.state.unwrap_or_else(|| state_home().join("gcm"));
        let file = dir.join(trocar::journal::FILE);
        if matches!(file.try_exists(), Ok(false)) {
            let help = "name the directory of the GCM: --state DIR";
            return Err(Failure::refused(
                "JOURNAL_MISSING",
                format!("no journal in {}", dir.display()),
                help,
            ));
        }
        View::open(&dir).map_err(failure)
    }
}

pub(super) fn run(args: JournalArgs, session: &Session) -> Done {
    match args.what {
        What::Verify { place } => verify(&place.look()?, session),
        What::Show { place, from, last } => show(&place.look()?, from, last, session),
    }
}

fn verify(view: &View, session: &Session) -> Done {
    let Verified { identity, records, first, last, first_revision, last_revision, snapshot, head } =
        view.verify().map_err(failure)?;
    let id = format!("{:032x}", identity.id);
    if session.json() {
        return session.print_json(&json!({
            "file": view.file(),
            "id": id,
            "created": time(identity.created_ns),
            "records": records,
            "first": first,
            "last": last,
            "first_revision": first_revision,
            "last_revision": last_revision,
            "snapshot": snapshot,
            "head": head.to_string(),
        }));
    }
    out::say(&format!("{}: whole", view.file().display()));
    out::line(&format!("  journal    {id}, made {}", time(identity.created_ns)));
    let range = |from: u64, to: u64| if from == to { to.to_string() } else { format!("{from} to {to}") };
    let revisions = first_revision.zip(last_revision);
    let revisions = revisions.map(|(from, to)| format!(", revision {}", range(from, to))).unwrap_or_default();
    let numbers = if records == 0 { String::new() } else { format!(" ({})", range(first, last)) };
    out::line(&format!("  records    {}{numbers}{revisions}", units::count(records, "record")));
    if let Some(number) = snapshot {
        out::line(&format!("  snapshot   of record {number}"));
    }
    out::line(&format!("  head       {head}"));
    Ok(Exit::Ok)
}

fn show(view: &View, from: Option<u64>, last: Option<u64>, session: &Session) -> Done {
    let first = last.map_or(0, |last| view.last().saturating_sub(last - 1));
    let mut is_early = from.is_some();
    let mut printed = Ok(Exit::Ok);
    let walked = view.records(first, &mut |kept| {
        is_early &= kept.record.entry.revision() < from;
        if !is_early {
            printed = print(&kept, session);
        }
        printed.is_ok()
    });
    printed.and_then(|exit| walked.map(|()| exit).map_err(failure))
}

fn print(kept: &Kept, session: &Session) -> Done {
    if session.json() {
        return session.print_json(&trocar::journal::json(kept));
    }
    out::say(&headline(&kept.record));
    for line in lines(&kept.record) {
        out::say(&format!("    {line}"));
    }
    Ok(Exit::Ok)
}

/// Time, term, revision, caller, request and result.
fn headline(record: &Record) -> String {
    let revision = record.entry.revision().map_or("-".to_owned(), |revision| revision.to_string());
    let mut line = format!("{}  term {}  revision {revision}", time(record.wall_ns), record.term);
    if let Some(asked) = &record.asked {
        line += &format!("  {}  {}", asked.identity, asked.text);
    }
    match &record.answer {
        Some(Ok(done)) if done.failed.is_empty() => line += "  ok",
        Some(Ok(done)) => line += &format!("  ok, {} failed", done.failed.len()),
        Some(Err(refusal)) => line += &format!("  refused: {} {refusal}", refusal.reason()),
        None => {}
    }
    line
}

fn failure(fault: Fault) -> Failure {
    let (reason, help) = match fault.error.unusable {
        Unusable::Damaged => (
            "JOURNAL_DAMAGED",
            "keep the file as it is for those who look into it; then put the last good copy in its place, or move \
             it away: a GCM begins a new journal where there is none",
        ),
        Unusable::Newer => ("JOURNAL_NEWER", "use the release of trocar that wrote it; the file is unharmed"),
        Unusable::Now | Unusable::InUse | Unusable::NotSynced | Unusable::NotLeading => (
            "JOURNAL_UNREADABLE",
            "look at the file and the rights of its directory, or name another one: --state DIR",
        ),
    };
    let mut failure = Failure::local(reason, fault.error.to_string(), help);
    failure.metadata.insert("file".to_owned(), fault.error.file.display().to_string());
    if let Some(record) = fault.record {
        failure.metadata.insert("record".to_owned(), record.to_string());
    }
    failure
}
