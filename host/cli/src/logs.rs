//! `trocar logs [-f] [PATH]`.
//!
//! Invariant: lines lost on the way are counted and said.

use clap::{Args, ValueEnum};

use super::failure::{Done, Exit};
use super::session::Session;
use super::{out, units};

/// Shows what components and hosts log: also what was asked of the system and what came of it, and
/// refused plugin files.
#[derive(Args, Debug)]
pub(super) struct LogsArgs {
    /// Only this process, component or glob.
    #[arg(default_value = "", hide_default_value = true)]
    path: String,
    /// Go on with what comes.
    #[arg(long, short)]
    follow: bool,
    /// Only the newest N lines, and with --follow what comes after them; without it all that are
    /// kept, 1000 at most.
    #[arg(long, short = 'n', value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    last: Option<u32>,
    /// Most detailed level shown.
    #[arg(long, value_enum, default_value_t = Level::Info)]
    level: Level,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Level {
    Error,
    Warn,
    Info,
    Debug,
    Trace,
}

pub(super) async fn run(args: LogsArgs, session: &Session) -> Done {
    let level = format!("{:?}", args.level).to_lowercase();
    let mut lines = session.logs(&args.path, &level, args.follow, args.last).await?;
    while let Some(line) = lines.next().await? {
        if session.json() {
            session.print_json(&line)?;
            continue;
        }
        if line.skipped > 0 {
            out::line(&format!("({} lost)", units::count(line.skipped, "line")));
        }
        out::line(&format!(
            "{}  {:5}  {}  {}",
            clock(line.wall_ns),
            line.level.to_uppercase(),
            line.path,
            out::harmless(&line.message)
        ));
    }
    Ok(Exit::Ok)
}

/// Time of day in UTC, ms.
pub(super) fn clock(wall_ns: u64) -> String {
    let ms = wall_ns / 1_000_000;
    let (s, ms) = (ms / 1000, ms % 1000);
    format!("{:02}:{:02}:{:02}.{ms:03}", s / 3600 % 24, s / 60 % 60, s % 60)
}
