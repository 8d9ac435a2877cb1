//! `trocar watch`: the graph as it changes.
//!
//! Invariant: the first message is the whole graph, so a reader needs nothing else.

use clap::Args;

use super::failure::{Done, Exit};
use super::out;
use super::session::Session;

/// Follows changes of the system: processes, components, connections.
#[derive(Args, Debug)]
pub(super) struct WatchArgs {
    /// Only changes after this revision.
    #[arg(long, default_value_t = 0, value_name = "N")]
    from_revision: u64,
}

pub(super) async fn run(args: WatchArgs, session: &Session) -> Done {
    let mut news = session.watch(args.from_revision).await?;
    while let Some(change) = news.next().await? {
        if session.json() {
            session.print_json(&change)?;
            continue;
        }
        for line in change.lines() {
            out::say(&format!("{}  {line}", change.revision));
        }
    }
    Ok(Exit::Ok)
}
