//! `trocar echo PATH…`: follows outputs, events and component states, or shows one row of a state table.
//!
//! Invariant: what could not be shown in time is counted and said, never silently left out.

use std::time::Duration;

use clap::Args;

use super::failure::{Done, Exit};
use super::question::Row;
use super::session::Session;
use super::{out, units};

/// After this long without a first item, it is said that one is waited for.
const QUIET: Duration = Duration::from_secs(1);

/// Follows outputs, events and lifecycle states: `trocar echo host/robot/arm/operating_state`.
///
/// A row of a component's state table, its newest values, is shown by --delayed 0 and the other flags
/// of that group.
#[derive(Args, Debug)]
pub(super) struct EchoArgs {
    /// process/component (its lifecycle state and health, as they change), …/interface/event, or …/output.
    #[arg(value_name = "PATH", required = true)]
    paths: Vec<String>,
    /// Most items per second of an output, Hz.
    #[arg(long, default_value = "10", value_name = "HZ", value_parser = units::parse_rate, allow_negative_numbers = true)]
    rate_hz: f64,
    /// End after this many items; of a component one item is how it stands, the next a change.
    #[arg(long, short = 'n', value_name = "N")]
    count: Option<u64>,
    #[command(flatten)]
    row: RowArgs,
}

/// Which row of a component's state table to show, once, instead of following it.
#[derive(Args, Clone, Copy, Debug)]
#[command(next_help_heading = "One row of a component's state table")]
#[group(multiple = false)]
struct RowArgs {
    /// The values at this time of the host's monotonic clock, interpolated between two rows, e.g. 12.5s.
    #[arg(long, value_name = "TIME", value_parser = units::parse_time, conflicts_with = "count")]
    at: Option<u64>,
    /// The row nearest to this time of the host's monotonic clock.
    #[arg(long, value_name = "TIME", value_parser = units::parse_time, conflicts_with = "count")]
    nearest: Option<u64>,
    /// The row of this tick.
    #[arg(long, value_name = "N", conflicts_with = "count")]
    tick: Option<u64>,
    /// The row this many rows before the newest; 0 is the newest.
    #[arg(long, value_name = "N", conflicts_with = "count")]
    delayed: Option<u64>,
}

impl RowArgs {
    fn asked(&self) -> Option<Row> {
        let at = self.at.map(Row::At).or(self.nearest.map(Row::Nearest));
        at.or(self.tick.map(Row::Tick)).or(self.delayed.map(Row::Delayed))
    }
}

pub(super) async fn run(args: EchoArgs, session: &Session) -> Done {
    if let Some(row) = args.row.asked() {
        return one_row(&args.paths, row, session).await;
    }
    let mut items = session.subscribe(&args.paths, args.rate_hz).await?;
    let mut left = args.count.unwrap_or(u64::MAX);
    let mut told = session.json();
    while left > 0 {
        let next = items.next();
        tokio::pin!(next);
        let item = tokio::select! {
            item = &mut next => item,
            () = tokio::time::sleep(QUIET), if !told => {
                out::complain("note", "nothing has come yet: the next sample, event or change is shown; Ctrl-C ends it");
                next.await
            }
        };
        told = true;
        let Some(item) = item? else {
            eprintln!("warning: nothing more comes: what was followed is gone or made anew");
            break;
        };
        if session.json() {
            session.print_json(&item)?;
        } else {
            let skipped =
                if item.skipped > 0 { format!("  ({} skipped)", item.skipped) } else { String::new() };
            let seconds = item.stamp_ns as f64 / 1e9;
            let value = units::cut(&out::without_padding(&item.value).to_string(), out::LONG);
            out::say(&format!("{seconds:.6} s  {}  {value}{skipped}", item.path));
        }
        left -= 1;
    }
    Ok(Exit::Ok)
}

async fn one_row(paths: &[String], row: Row, session: &Session) -> Done {
    for path in paths {
        let row = session.read(path, Some(row)).await?;
        if session.json() {
            session.print_json(&row)?;
            continue;
        }
        let seconds = row.stamp_ns as f64 / 1e9;
        let value = units::cut(&out::without_padding(&row.value).to_string(), out::LONG);
        out::say(&format!("{seconds:.6} s  {path}  tick {}  {value}", row.tick));
    }
    Ok(Exit::Ok)
}
