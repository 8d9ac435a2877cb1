//! `trocar connect CLIENT SERVER` and `trocar disconnect`.
//!
//! Invariant: client = input or required interface, server = output or provided interface; the GCM
//! checks everything.

use clap::Args;

use super::failure::{Done, Failure};
use super::mutation::{MutationArgs, show_after};
use super::session::Session;
use super::units;
use super::view::ConnectionView;

/// Connects a client end to a server end: `trocar connect host/tracking/c host/sine/value`.
#[derive(Args, Debug)]
pub(super) struct ConnectArgs {
    /// Input or required interface: process/component/port.
    pub(super) client: String,
    /// Output or provided interface: process/component/port.
    pub(super) server: String,
    /// Queue this many samples instead of the port's default.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..), conflicts_with = "latest")]
    pub(super) fifo: Option<u32>,
    /// When the queue is full, overwrite the oldest instead of dropping the newest.
    #[arg(long, requires = "fifo")]
    pub(super) drop_oldest: bool,
    /// Keep the latest value only.
    #[arg(long)]
    pub(super) latest: bool,
    /// Older samples are stale, e.g. 5ms; unset: of an actuator three periods of its source, of others none.
    #[arg(long, value_name = "TIME", value_parser = units::parse_time)]
    pub(super) max_age: Option<u64>,
    /// Default deadline of waiting calls, e.g. 100ms; goals that were only sent and waited longer are
    /// not carried out.
    #[arg(long, value_name = "TIME", value_parser = units::parse_time)]
    pub(super) deadline: Option<u64>,
    /// Depth of the queue of commands or events.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) mailbox: Option<u32>,
    /// Copy by name when the layouts differ.
    #[arg(long)]
    pub(super) adapt: bool,
    /// The client may step before the server in a period of both and take its samples one period later: cuts
    /// a circle of components.
    #[arg(long)]
    pub(super) delay: bool,
    /// Take the place of the client's present connection.
    #[arg(long)]
    pub(super) replace: bool,
    /// Pin how data travel: inline or heap (within a process), memfd (of one machine) or net (between two
    /// processes of any machines); unset: the best there is.
    #[arg(long, value_name = "NAME")]
    pub(super) carrier: Option<String>,
    #[command(flatten)]
    pub(super) mutation: MutationArgs,
}

/// Cuts a connection: `trocar disconnect 4`, or one of its ends where that is enough, or both.
#[derive(Args, Debug)]
pub(super) struct DisconnectArgs {
    /// The connection's id (`trocar ls`), or its client end; or its server end where that has no other.
    #[arg(value_name = "ID|PORT")]
    pub(super) which: String,
    /// Its server end, when the first is the client end.
    pub(super) server: Option<String>,
    #[command(flatten)]
    pub(super) mutation: MutationArgs,
}

/// Connection that a Disconnect names.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Cut {
    Id(u64),
    Pair { client: String, server: String },
}

pub(super) async fn connect(args: ConnectArgs, session: &Session) -> Done {
    let outcome = session.connect(&args).await?;
    let id = outcome.connection;
    let done = format!("connected {} → {} (id {id})", args.server, args.client);
    show_after(session, &outcome, args.mutation.dry_run, &done)
}

pub(super) async fn disconnect(args: DisconnectArgs, session: &Session) -> Done {
    let cut = cut(&args, session).await?;
    let outcome = session.disconnect(&cut, &args.mutation).await?;
    let done = match &cut {
        Cut::Id(id) => format!("disconnected {id}"),
        Cut::Pair { client, server } => format!("disconnected {server} → {client}"),
    };
    show_after(session, &outcome, args.mutation.dry_run, &done)
}

async fn cut(args: &DisconnectArgs, session: &Session) -> Result<Cut, Failure> {
    match (args.which.parse::<u64>(), &args.server) {
        (Ok(id), None) => Ok(Cut::Id(id)),
        (Err(_), Some(server)) => Ok(Cut::Pair { client: args.which.clone(), server: server.clone() }),
        (Ok(_), Some(_)) => Err(Failure::usage("a connection id stands alone", "trocar disconnect ID")),
        (Err(_), None) => {
            let found = only_one(&args.which, &session.list().await?.connections);
            if found.is_err() {
                // A name that is not there is told as such.
                session.path(&args.which).await?;
            }
            found
        }
    }
}

/// The one connection that ends at `port`.
fn only_one(port: &str, connections: &[ConnectionView]) -> Result<Cut, Failure> {
    let here: Vec<_> = connections.iter().filter(|c| c.client == port || c.server == port).collect();
    let listed = |of: &[&ConnectionView]| {
        let lines: Vec<_> = of.iter().map(|c| format!("{}: {} → {}", c.id, c.server, c.client)).collect();
        lines.join(", ")
    };
    match here.as_slice() {
        [one] => Ok(Cut::Id(one.id)),
        [] => {
            let all: Vec<&ConnectionView> = connections.iter().take(8).collect();
            let help = if all.is_empty() {
                "there are no connections".to_owned()
            } else {
                let (is, s) = if all.len() == 1 { ("is", "") } else { ("are", "s") };
                format!("there {is} connection{s} {}; `trocar ls` lists all", listed(&all))
            };
            Err(Failure::refused("CONNECTION_NOT_FOUND", format!("nothing is connected to {port}"), help))
        }
        several => Err(Failure::refused(
            "CONNECTION_NOT_FOUND",
            format!("{port} has {} connections", several.len()),
            format!("say which one by its number: {}", listed(several)),
        )),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn one_end_is_enough_where_it_has_one_connection() {
        let link = |id, client: &str, server: &str| ConnectionView {
            id,
            client: client.into(),
            server: server.into(),
            ..ConnectionView::default()
        };
        let there = [link(1, "h/a/x", "h/s/out"), link(2, "h/b/x", "h/s/out")];
        assert_eq!(only_one("h/b/x", &there).unwrap(), Cut::Id(2));
        let several = only_one("h/s/out", &there).unwrap_err();
        assert!(several.help.contains("2: h/s/out → h/b/x"), "{several:?}");
        let nobody = only_one("h/c/x", &there).unwrap_err();
        assert!(nobody.message.contains("h/c/x") && nobody.help.contains("1: "), "{nobody:?}");
        assert!(only_one("h/c/x", &[]).unwrap_err().help.contains("no connections"));
    }
}
