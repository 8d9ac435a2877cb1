//! `trocar echo PATH…`: follows outputs, events and component states.
//!
//! Invariant: what could not be shown in time is counted and said, never silently left out.

use clap::Args;

use super::failure::{Done, Exit};
use super::session::Session;
use super::{out, units};

/// Follows outputs, events and states: `trocar echo host/robot/arm/operating_state`.
#[derive(Args, Debug)]
pub(super) struct EchoArgs {
    /// process/component (its state), …/interface/event, or …/output.
    #[arg(value_name = "PATH", required = true)]
    paths: Vec<String>,
    /// Most items per second of an output, Hz.
    #[arg(long, default_value = "10", value_name = "HZ", value_parser = units::parse_rate)]
    rate_hz: f64,
    /// End after this many items.
    #[arg(long, short = 'n', value_name = "N")]
    count: Option<u64>,
}

pub(super) async fn run(args: EchoArgs, session: &Session) -> Done {
    let mut items = session.subscribe(&args.paths, args.rate_hz).await?;
    let mut left = args.count.unwrap_or(u64::MAX);
    while left > 0
        && let Some(item) = items.next().await?
    {
        if session.json() {
            session.print_json(&item)?;
        } else {
            let skipped =
                if item.skipped > 0 { format!("  ({} skipped)", item.skipped) } else { String::new() };
            let seconds = item.stamp_ns as f64 / 1e9;
            out::line(&format!("{seconds:.6} s  {}  {}{skipped}", item.path, item.value));
        }
        left -= 1;
    }
    Ok(Exit::Ok)
}
