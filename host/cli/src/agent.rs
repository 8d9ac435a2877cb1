//! `trocar agent`: keeps processes on this machine for systems that are brought up on another one.
//!
//! Invariant: any end of this program ends what it keeps, devices safe first.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use super::failure::{Done, Exit, Failure};
use super::session::Session;
use super::{hosting, logging, out};
use trocar::host::{AgentHost, StateChoice, StopRequest, state_home};

/// Address that an agent listens at by default.
const DEFAULT: &str = "127.0.0.1:50550";

const EXAMPLES: &str = "\
Example, on the machine `cart`, 10.0.0.2, with the certificate of a host that names the process oct:
  trocar agent --identity cart.pem --listen-tls 10.0.0.2:50550 --plugins /opt/trocar/plugins

and in the system file of the machine that brings the system up:
  \"machines\": { \"cart\": { \"agent\": \"https://10.0.0.2:50550\" } },
  \"processes\": { \"oct\": { \"machine\": \"cart\" } }

`trocar doctor --unit` prints a systemd unit for it.";

/// Keeps processes on this machine for systems that `trocar up` brings up on another one.
///
/// A process that ends is started again here, whether the other machine is heard or not. What `up` has
/// brought up ends when that takes it down, or has hung up for 10 s.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct AgentArgs {
    /// Address to listen on, for `trocar up` of this machine; port 0 takes a free one.
    #[arg(long, default_value = DEFAULT, value_name = "ADDR")]
    listen: String,
    /// Directory of plugin files, for processes whose system brings none; may be given several times
    /// [default: ./plugins, else where this program lies].
    #[arg(long, value_name = "DIR")]
    plugins: Vec<PathBuf>,
    /// Where it keeps what its processes print, their state, and plugin files that were brought [default:
    /// trocar/agent in the user's state directory].
    #[arg(long, value_name = "DIR")]
    state: Option<PathBuf>,
    /// Take processes whose components may start programs, as you: those with "allow_exec": true in their
    /// system file are refused otherwise.
    #[arg(long)]
    allow_exec: bool,
    #[command(flatten)]
    machines: hosting::MachineArgs,
    /// Let every user of this machine have processes kept, not only yourself and root.
    #[arg(long)]
    open_loopback: bool,
}

pub(super) async fn run(args: AgentArgs, session: &Session) -> Done {
    if session.explicit_gcm().is_some() {
        return Err(Failure::usage(
            "an agent attaches to no GCM: `trocar up` says which one each process has",
            "leave --gcm out",
        ));
    }
    logging::install(log::LevelFilter::Info);
    let mut stop = StopRequest::listen();
    let dir = args.state.unwrap_or_else(|| state_home().join("agent"));
    let plugins = hosting::plugin_dirs(args.plugins);
    let machines = args.machines.machines();
    let rules = trocar::host::PortRules { open_loopback: args.open_loopback, ..Default::default() };
    let state = StateChoice::Durable(dir);
    let agent =
        AgentHost::start(&args.listen, &state, (plugins.clone(), args.allow_exec), (rules, &machines))
            .await?;
    logging::to_file(agent.state_dir().path());
    say_listening(&agent, &plugins, session);
    stop.asked().await;
    let failed = agent.shutdown().await;
    for (name, exit) in &failed {
        out::complain("warning", &format!("process {name} {exit}: what it moved may not be safe"));
    }
    Ok(if failed.is_empty() { Exit::Ok } else { Exit::Partial })
}

fn say_listening(agent: &AgentHost, plugins: &[PathBuf], session: &Session) {
    let (dirs, state) = (plugins.iter().map(|dir| dir.display().to_string()), agent.state_dir().path());
    let (dirs, secured) = (dirs.collect::<Vec<_>>(), agent.secured().map(|addr| addr.to_string()));
    if session.json() {
        let line = json!({
            "listening": agent.addr().to_string(),
            "listening_tls": secured,
            "pid": std::process::id(),
            "state": state,
            "plugins": dirs,
        });
        out::line(&line.to_string());
        return;
    }
    out::line(&format!("agent listening on {}", agent.addr()));
    if let Some(addr) = secured {
        out::line(&format!("  for other machines: https://{addr}"));
    }
    out::line(&format!("  plugins {}, state {}", dirs.join(" "), state.display()));
    out::line("  Ctrl-C ends what it keeps, devices safe first");
}
