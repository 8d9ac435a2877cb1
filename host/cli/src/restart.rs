//! `trocar restart`: a process that a supervisor keeps, ended and started again.

use std::time::Duration;

use clap::Args;
use serde_json::json;

use super::failure::{Done, Exit};
use super::session::Session;
use super::{out, units};

/// Longer than a process is given to end in order, and to come back.
const WITHIN: Duration = Duration::from_secs(30);

/// Ends a process that `trocar up` keeps and starts it again, also one that is FAILED. What moves something
/// comes back STOPPED.
#[derive(Args, Debug)]
pub(super) struct RestartArgs {
    /// Name of the process.
    #[arg(value_name = "PROCESS")]
    process: String,
    /// Give up waiting after this time, e.g. 10s [default: 30s].
    #[arg(long, value_name = "TIME", value_parser = units::parse_time)]
    timeout: Option<u64>,
}

pub(super) async fn run(args: RestartArgs, session: &Session) -> Done {
    let within = args.timeout.map_or(WITHIN, Duration::from_nanos);
    let (revision, epoch) = session.restart(&args.process, within).await?;
    if session.json() {
        session.print_json(&json!({ "process": args.process, "revision": revision, "epoch": epoch }))?;
    } else {
        out::say(&format!("process {} was started again (revision {revision})", args.process));
    }
    Ok(Exit::Ok)
}
