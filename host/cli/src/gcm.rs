//! `trocar gcm`: a GCM without components; hosts attach to it.
//!
//! Invariant: it is in no data path: ending it delays no sample between components.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use serde_json::json;

use super::failure::{Done, Failure};
use super::session::Session;
use super::{hosting, logging, out, session};
use trocar::host::{Among, Host, Predecessor, StateChoice, say_to_keeper, state_home};
use trocar::journal::{EtcdPlace, host_and_port};

const EXAMPLES: &str = "\
Example:
  trocar gcm
  trocar host --name left --gcm 127.0.0.1:50551 --listen 127.0.0.1:0   # in another terminal

Another trocar, in the place of the one that runs:
  /opt/trocar-new/trocar gcm --takeover

Several GCMs for one system, of which one leads, over an etcd cluster:
  trocar gcm --listen 127.0.0.1:50551 --store etcd://127.0.0.1:2379,127.0.0.1:2479/lab7 --state /var/lib/a
  trocar host --name left --gcm 127.0.0.1:50551,127.0.0.1:50552 --listen 127.0.0.1:0";

/// Runs a GCM without components, for several hosts: `trocar host --gcm ADDR`.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct GcmArgs {
    /// Address to listen on; port 0 takes a free one [default: 127.0.0.1:50551].
    #[arg(long, value_name = "ADDR")]
    listen: Option<String>,
    /// Where it keeps its state [default: trocar/gcm in the user's state directory].
    #[arg(long, value_name = "DIR")]
    state: Option<PathBuf>,
    /// Forget what an earlier run left in the state directory; only counters go on.
    #[arg(long, conflicts_with = "store")]
    fresh: bool,
    /// Go on in the place of the GCM that runs in that state directory, at its address. That one ends once
    /// this program can read its journal, and hosts run on. Where none runs this one just starts.
    #[arg(long, conflicts_with_all = ["store", "fresh"])]
    takeover: bool,
    /// Keep the journal in etcd, and lead its system only while no other GCM of that place does.
    #[arg(long, value_name = "etcd://HOST:PORT,.../NAME")]
    store: Option<EtcdPlace>,
    /// With --store: address at which others reach this GCM, where that is not the one it listens at (of
    /// --listen-tls, if there is one).
    #[arg(long, value_name = "ADDR", requires = "store", value_parser = host_and_port)]
    advertise: Option<String>,
    /// With --store: time after which another GCM leads when this one is not heard, s.
    #[arg(long, value_name = "S", default_value_t = 2, value_parser = clap::value_parser!(u64).range(2..=60), requires = "store")]
    lease: u64,
    #[command(flatten)]
    port: hosting::PortArgs,
    #[command(flatten)]
    machines: hosting::MachineArgs,
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
    let dir = args.state.unwrap_or_else(|| state_home().join("gcm"));
    let stop = args.tie.listen()?;
    let before = if args.takeover { Predecessor::of(&dir)? } else { None };
    if let (Some(before), Some(listen)) = (&before, &args.listen)
        && before.addr().to_string() != *listen
    {
        return Err(Failure::usage(
            format!(
                "the GCM that is taken over from listens at {}, where its hosts look for it",
                before.addr()
            ),
            "leave --listen out",
        ));
    }
    let its_address = before.as_ref().map(|before| before.addr().to_string());
    let listen = its_address.or(args.listen).unwrap_or_else(|| session::DEFAULT_GCM.to_owned());
    if let Some(before) = before {
        before.end().await?;
    }
    let (listen, state) = (&listen, StateChoice::Durable(dir));
    let machines = args.machines.machines();
    let rights = (args.port.rules(), &machines);
    let host = match args.store.clone() {
        Some(place) => {
            let (advertise, lease) = (args.advertise.clone(), Duration::from_secs(args.lease));
            let is_any = |addr: SocketAddr| addr.ip().is_unspecified();
            let reached = advertise.as_ref().or(machines.listen.as_ref()).unwrap_or(listen);
            if reached.parse().is_ok_and(is_any) {
                return Err(Failure::usage(
                    format!("others reach no GCM at {reached}"),
                    "say at which address they reach this one: --advertise HOST:PORT",
                ));
            }
            Host::start_candidate(listen, &state, &Among { place, advertise, lease }, rights).await?
        }
        None => Host::start_gcm(listen, &state, args.fresh, rights).await?,
    };
    logging::to_file(host.state_dir().path());
    logging::to_readers(host.own_lines());
    if session.json() {
        let mut line = json!({
            "listening": hosting::address(&host),
            "listening_tls": host.secured().map(|addr| addr.to_string()),
            "pid": std::process::id(),
            "state": host.state_dir().path(),
            "viewer": hosting::viewer(&hosting::address(&host)),
        });
        if let Some(place) = &args.store {
            line["store"] = place.to_string().into();
            if let Some(advertise) = &args.advertise {
                line["advertise"] = advertise.as_str().into();
            }
        }
        say_to_keeper(&line.to_string());
        out::line(&line.to_string());
    } else {
        out::line(&format!("gcm listening on {}", hosting::address(&host)));
        if let Some(addr) = host.secured() {
            out::line(&format!(
                "  for other machines: trocar host --gcm https://{addr} --identity FILE --listen 127.0.0.1:0 --name NAME"
            ));
        }
        if let Some(place) = &args.store {
            out::line(&format!("  one among several: the journal is at {place}"));
        }
        let reached = args.advertise.unwrap_or_else(|| hosting::address(&host));
        out::line(&format!("  attach hosts: trocar host --gcm {reached} --listen 127.0.0.1:0 --name NAME"));
        out::line(&format!("  viewer {}", hosting::viewer(&hosting::address(&host))));
    }
    hosting::until_stopped(host, stop).await
}
