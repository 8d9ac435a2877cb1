//! `trocar wait host/robot`: until a component is in a state; `trocar wait host/echo/ctl/done`: until it
//! sends an event.
//!
//! Invariant: it always ends by its deadline; with `--call` it listens for the event before it
//! calls the command.

use clap::Args;
use serde_json::Value;

use super::failure::{Done, Exit, Failure};
use super::question::{Awaited, For, Waiting};
use super::session::Session;
use super::typed::json_value;
use super::{out, units};

/// Longest time that a GCM lets a caller wait, ns.
const MOST_NS: u64 = 60_000_000_000;

/// Waits for a state or an event: `trocar wait host/robot`,
/// `trocar wait host/bscan/scan/bscan_done --deadline 30s`.
///
/// An event that says false, as `goal_reached` of a move that was held on its way, ends it with exit code 1.
#[derive(Args, Debug)]
pub(super) struct WaitArgs {
    /// process/component, or process/component/interface/event.
    path: String,
    /// Until the component is in this state; may be given several times [default: ACTIVE].
    #[arg(long, value_enum, ignore_case = true, conflicts_with = "call")]
    state: Vec<Awaited>,
    /// How long at most, up to 60s.
    #[arg(long, default_value = "5s", value_name = "TIME", value_parser = deadline)]
    deadline: u64,
    /// Call this command as soon as the event is listened for, so that what it brings about is not missed.
    #[arg(long, value_name = "PATH")]
    call: Option<String>,
    /// The argument of --call as JSON.
    #[arg(long, value_name = "JSON", requires = "call", allow_hyphen_values = true)]
    arg: Option<String>,
}

fn deadline(text: &str) -> Result<u64, String> {
    match units::parse_time(text)? {
        ns if ns <= MOST_NS => Ok(ns),
        _ => Err("a GCM waits for 60s at most; ask again after that".to_owned()),
    }
}

pub(super) async fn run(args: WaitArgs, session: &Session) -> Done {
    let is_event = args.path.split('/').count() == 4;
    if is_event && !args.state.is_empty() {
        return Err(Failure::usage(
            format!("{} is an event, and events have no states", args.path),
            "`trocar wait PROCESS/COMPONENT --state STATE`, or the event without --state",
        ));
    }
    let what = match (is_event, args.call) {
        (false, None) => For::States(args.state),
        (false, Some(_)) => {
            return Err(Failure::usage(
                format!("--call goes with an event, and {} is none", args.path),
                "`trocar wait PROCESS/COMPONENT/INTERFACE/EVENT --call PROCESS/COMPONENT/INTERFACE/COMMAND`",
            ));
        }
        (true, call) => {
            let arg = args.arg.as_deref().map(json_value).transpose()?;
            For::Event(call.map(|path| (path, arg)))
        }
    };
    let seen = session.wait_for(&Waiting { path: args.path, deadline_ns: args.deadline, what }).await?;
    // `trocar wait …/goal_reached --call … && next` goes on after a success only.
    let failed = seen.value == Some(Value::Bool(false));
    let exit = if failed { Exit::Refused } else { Exit::Ok };
    if session.json() {
        return session.print_json(&seen).map(|_| exit);
    }
    out::say(&match &seen.value {
        Some(value) => {
            let seconds = seen.stamp_ns as f64 / 1e9;
            let value = out::without_padding(value);
            let payload = if value.is_null() { String::new() } else { format!("  {value}") };
            format!("{seconds:.6} s  {}{}", seen.path, units::cut(&payload, out::LONG))
        }
        None => format!("{}  {}", seen.path, seen.state),
    });
    if failed {
        out::complain("warning", "the event says false: what was waited for has ended without success");
    }
    Ok(exit)
}
