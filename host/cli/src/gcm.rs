//! `trocar gcm`: a GCM without components; hosts attach to it.
//!
//! Invariant: it is in no data path: ending it delays no sample between components.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use super::failure::{Done, Failure};
use super::session::Session;
use super::{hosting, logging, out, session};
use trocar::host::{Host, StateChoice, say_to_keeper, state_home};

const EXAMPLES: &str = "\
Example:
  trocar gcm
  trocar host --name left --gcm 127.0.0.1:50551 --listen 127.0.0.1:0   # in another terminal";

/// Runs a GCM without components, for several hosts: `trocar host --gcm ADDR`.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct GcmArgs {
    /// Address to listen on; port 0 takes a free one.
    #[arg(long, default_value = session::DEFAULT_GCM, value_name = "ADDR")]
    listen: String,
    /// Where it keeps its state [default: trocar/gcm in the user's state directory].
    #[arg(long, value_name = "DIR")]
    state: Option<PathBuf>,
    /// Forget what an earlier run left in the state directory; only counters go on.
    #[arg(long)]
    fresh: bool,
    #[command(flatten)]
    port: hosting::PortArgs,
    #[command(flatten)]
    tie: hosting::Tie,
}

pub(super) async fn run(args: GcmArgs, session: &Session) -> Done {
    hosting::heard(serve(args, session).await)
}

async fn serve(args: GcmArgs, session: &Session) -> Done {
    if session.explicit_gcm().is_some() {
        return Err(Failure::usage(
            "`trocar gcm` is a GCM itself and attaches to none",
            "leave --gcm out; use --listen",
        ));
    }
    logging::install(log::LevelFilter::Info);
    let state = StateChoice::Durable(args.state.unwrap_or_else(|| state_home().join("gcm")));
    let stop = args.tie.listen()?;
    let host = Host::start_gcm(&args.listen, &state, args.fresh, args.port.rules()).await?;
    logging::to_file(host.state_dir().path());
    logging::to_readers(host.own_lines());
    if session.json() {
        let line = json!({
            "listening": hosting::address(&host),
            "pid": std::process::id(),
            "state": host.state_dir().path(),
            "viewer": hosting::viewer(&hosting::address(&host)),
        });
        say_to_keeper(&line.to_string());
        out::line(&line.to_string());
    } else {
        out::line(&format!("gcm listening on {}", hosting::address(&host)));
        out::line(&format!(
            "  attach hosts: trocar host --gcm {} --listen 127.0.0.1:0 --name NAME",
            hosting::address(&host)
        ));
        out::line(&format!("  viewer {}", hosting::viewer(&hosting::address(&host))));
    }
    hosting::until_stopped(host, stop).await
}
