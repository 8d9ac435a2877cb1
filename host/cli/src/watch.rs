//! `trocar watch`: the graph as it changes.
//!
//! Invariant: the first message is the whole graph, or what has changed since the cursor that was given.

use clap::Args;

use super::failure::{Done, Exit};
use super::out;
use super::session::Session;

/// Follows changes of the system: processes, components, connections.
#[derive(Args, Debug)]
pub(super) struct WatchArgs {
    /// First what has changed since this `cursor` of a `trocar watch --json`, in place of the whole system.
    #[arg(long, default_value = "", value_name = "CURSOR", hide_default_value = true)]
    after: String,
}

pub(super) async fn run(args: WatchArgs, session: &Session) -> Done {
    let mut news = session.watch(&args.after).await?;
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
