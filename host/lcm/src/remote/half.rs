//! One end of a connection between two processes, as long as the GCM wants the connection.
//!
//! Invariant: a half is linked to one session at a time, under one epoch; messages of any other are not for
//! it.

use std::sync::Arc;
use std::time::{Duration, Instant};

use parking_lot::{Mutex, MutexGuard};
use trocar_lcm_api::{HalfReport, LinkDetail};
use trocar_links::Card;
use trocar_model::{Connection, End, PortId, Ports, Proxy, Refusal};

use super::super::described::PortSet;
use super::super::ends::{Here, Role, SameClass, Tell};
use super::super::loss::Loss;
use super::super::passage::passing;
use super::client::ClientWires;
use super::medium::{Medium, Session, same};
use super::missed::Missed;
use super::server::ServerWires;
use super::stand_in::StandIn;
use super::terms::{Terms, Way};
use super::words::Ended;

/// Time a server's process may take to answer before it is asked again.
const ANSWER: Duration = Duration::from_secs(1);
pub(crate) struct Half {
    pub(super) connection: Connection,
    pub(super) role: Role,
    pub(crate) here: Here,
    /// True when the client cannot do without it.
    pub(super) required: bool,
    /// Ports of the component at the other end.
    pub(super) theirs: Arc<Ports>,
    /// The process of the other end.
    pub(super) card: Card,
    /// For a client: whether the code of the server's class is here.
    pub(super) same_class: SameClass,
    /// Carrier of the connection.
    carrier: &'static str,
    stage: Mutex<Stage>,
}

#[derive(Default)]
pub(super) struct Stage {
    pub(super) linked: Option<Linked>,
    /// Reason why it is not linked; empty at first.
    pub(super) why: String,
    /// Waits for the first link.
    pub(super) tell: Option<Tell>,
    /// The session over which the server's process was asked last, and when.
    asked: Option<(u64, Instant)>,
    /// Figures of earlier links of this connection.
    before: LinkDetail,
    /// For an output: its writes while it was not linked.
    missed: Missed,
    /// The last link of a stream whose ends shared no memory.
    ended: Option<Ended>,
}

pub(super) struct Linked {
    pub(super) session: Arc<dyn Session>,
    pub(super) epoch: u64,
    pub(super) wires: Wires,
    /// Whoever stands in for the other end here, over a medium without memory.
    pub(super) stand_in: Option<Arc<dyn StandIn>>,
}

pub(super) enum Wires {
    Client(ClientWires),
    Server(ServerWires),
}

impl Wires {
    fn is_stream(&self) -> bool {
        match self {
            Wires::Client(wires) => matches!(wires, ClientWires::Input { .. }),
            Wires::Server(wires) => wires.is_output(),
        }
    }
}

impl Half {
    pub(crate) fn new(
        (connection, role): (Connection, Role),
        here: Here,
        required: bool,
        (theirs, card, same_class): (Arc<Ports>, Card, SameClass),
        tell: Option<Tell>,
        carrier: &'static str,
    ) -> Arc<Half> {
        let stage = Mutex::new(Stage { tell, ..Stage::default() });
        Arc::new(Half { connection, role, here, required, theirs, card, same_class, carrier, stage })
    }

    pub(super) fn number(&self) -> u64 {
        self.connection.id.0
    }

    /// The process of the other end.
    pub(super) fn other(&self) -> &str {
        self.other_port().component.process.as_str()
    }

    pub(super) fn other_port(&self) -> &PortId {
        match self.role {
            Role::Client => &self.connection.server,
            Role::Server => &self.connection.client,
        }
    }

    /// Tells whether that session is with the run of the process this half was made for.
    pub(super) fn is_with(&self, session: &dyn Session) -> bool {
        session.process() == self.other() && session.instance() == self.card.instance
    }

    /// Tells whether the server's process is to be asked over this session: each is asked once, unless it
    /// never answers.
    pub(super) fn may_ask(&self, session: &dyn Session) -> bool {
        let stage = self.stage();
        let waits = |(number, since): (u64, Instant)| number == session.number() && since.elapsed() < ANSWER;
        stage.linked.is_none() && !stage.asked.is_some_and(waits)
    }

    pub(super) fn asked(&self, over: Option<&dyn Session>) {
        self.stage().asked = over.map(|session| (session.number(), Instant::now()));
    }

    /// Reason why it is not linked, when no reason was given yet.
    pub(super) fn unsaid(&self, medium: &dyn Medium) -> String {
        let other = self.other();
        match self.role {
            Role::Client => {
                medium.why_not(&self.card).unwrap_or_else(|| format!("process {other} has not answered yet"))
            }
            Role::Server => format!("process {other} has not asked for it yet"),
        }
    }

    /// Takes over the counts of another half of the same connection.
    pub(super) fn go_on_from(&self, other: &Half) {
        let (before, missed, ended) = {
            let other = other.stage();
            (other.before.clone(), other.missed, other.ended)
        };
        let mut stage = self.stage();
        (stage.before, stage.missed, stage.ended) = (before, missed, ended);
    }

    /// The wires, if it is linked over this session in this epoch.
    pub(super) fn with_wires<R>(
        &self,
        session: &Arc<dyn Session>,
        epoch: u64,
        f: impl FnOnce(&Wires) -> R,
    ) -> Option<R> {
        let stage = self.stage();
        let linked = stage.linked.as_ref()?;
        (same(&linked.session, session) && linked.epoch == epoch).then(|| f(&linked.wires))
    }

    /// Warns the client that so many commands of this link that it only sent failed, and so many never ran.
    pub(super) fn tell_failures(&self, failed: u64, unexecuted: u64) {
        let other = &self.other_port().component;
        let tell = |what: &str, how: &str, count: u64| {
            if count > 0 {
                let stem = format!("commands it sent to {other} {what}");
                self.here.instance.warn_about(&stem, &format!(": {count} so far{how}"));
            }
        };
        tell("failed", "", failed);
        tell(
            "never ran",
            " were still queued when it stopped or was cut off, or had waited too long",
            unexecuted,
        );
    }

    pub(super) fn stage(&self) -> MutexGuard<'_, Stage> {
        self.stage.lock()
    }

    /// Returns the terms by the ports that are here now, and those ports. `own`: the client computes reads
    /// itself.
    ///
    /// # Errors
    /// The ends do not fit together any more.
    pub(crate) fn terms(&self, own: bool) -> Result<(Arc<PortSet>, Terms), Refusal> {
        let set = self.here.instance.described.now();
        let (client, server) = match self.role {
            Role::Client => (&set.ports, &self.theirs),
            Role::Server => (&self.theirs, &set.ports),
        };
        let terms = Terms::of(&self.connection, client, server, own)?;
        if let (Role::Server, Way::Stream { input, output, .. }) = (self.role, &terms.way) {
            let (from, to) = (&server.outputs[*output].ty, &client.inputs[*input].ty);
            passing(&self.connection, from, to, set.slots.output(*output))?;
        }
        Ok((set, terms))
    }

    /// Tells whether it can stay as it is after the ports here changed, by the rule for connections inside
    /// the process.
    pub(super) fn still_fits(&self) -> bool {
        let Ok((set, terms)) = self.terms(false) else { return false };
        match (&self.stage().linked, &terms.way) {
            (_, Way::Stream { .. }) => false,
            (None, Way::Calls { .. }) => true,
            (Some(linked), Way::Calls { binding, .. }) => match &linked.wires {
                Wires::Client(wires) => wires.still_fit(binding, &set),
                Wires::Server(wires) => wires.still_fit(binding, &set),
            },
        }
    }

    /// The port of this end.
    pub(super) fn port(&self) -> &PortId {
        match self.role {
            Role::Client => &self.connection.client,
            Role::Server => &self.connection.server,
        }
    }

    /// Notes that the half is linked.
    pub(super) fn link(
        &self,
        session: &Arc<dyn Session>,
        epoch: u64,
        wires: Wires,
        stand_in: Option<Arc<dyn StandIn>>,
    ) {
        let mut stage = self.stage();
        stage.linked = Some(Linked { session: session.clone(), epoch, wires, stand_in });
        stage.why.clear();
        let tell = stage.tell.take();
        drop(stage);
        if self.role == Role::Client && self.required {
            self.here.instance.connected(self.connection.client.port.as_str());
        }
        if let Some(tell) = tell {
            // Fails when the caller has given up.
            let _ = tell.send(Ok(()));
        }
    }

    /// Notes why the half cannot be linked now; tells the waiting caller, if longer waiting is of no use.
    pub(super) fn fail(&self, why: String, for_good: bool) {
        let mut stage = self.stage();
        if for_good && let Some(tell) = stage.tell.take() {
            let _ = tell.send(Err(why.clone()));
        }
        stage.why = why;
    }

    /// Removes the wires, if it is linked (over this session, where one is named).
    pub(super) fn unlink(&self, of: Option<&Arc<dyn Session>>, why: &str, how: Loss) -> Option<Linked> {
        let mut stage = self.stage();
        let is_it = |linked: &mut Linked| of.is_none_or(|session| same(session, &linked.session));
        let linked = stage.linked.take_if(is_it)?;
        why.clone_into(&mut stage.why);
        drop(stage);
        if let Some(stand_in) = &linked.stand_in {
            stand_in.halt();
        }
        let (mut last, offered) = match &linked.wires {
            Wires::Client(wires) => {
                wires.disconnect(&self.here, how);
                (wires.detail(), None)
            }
            Wires::Server(wires) => wires.end(&self.connection, &self.here),
        };
        if let Some(stand_in) = &linked.stand_in {
            stand_in.correct(&mut last);
            if linked.session.is_lost() {
                last.unexecuted += stand_in.lost();
            }
        }
        let mut stage = self.stage();
        if linked.stand_in.is_some() && linked.wires.is_stream() {
            stage.ended = Some(Ended { epoch: linked.epoch, samples: last.sent.max(last.came) });
        }
        stage.before = std::mem::take(&mut stage.before).followed_by(&last);
        if let Some(offered) = offered {
            stage.missed.ended(offered);
        }
        drop(stage);
        if self.role == Role::Client && self.required {
            self.here.instance.disconnected(self.connection.client.port.as_str(), how);
        }
        Some(linked)
    }

    /// The last link of a stream that shared no memory, as this end has seen it.
    pub(super) fn ended(&self) -> Option<Ended> {
        self.stage().ended
    }

    /// Counts the samples of the last link that left this end and did not come to the other one.
    pub(super) fn lost_on_the_way(&self, came: Option<Ended>) {
        let mut stage = self.stage();
        if let Some((left, came)) = stage.ended.zip(came)
            && left.epoch == came.epoch
        {
            stage.ended = None;
            stage.before.dropped += left.samples.saturating_sub(came.samples);
        }
    }

    /// Handles the loss of the other process: waiting callers are answered now, inputs have no source; the
    /// rest follows. Any thread.
    pub(super) fn lose(&self, session: &Arc<dyn Session>) {
        if let Some(Linked { session: mine, wires: Wires::Client(wires), .. }) = &self.stage().linked
            && same(mine, session)
        {
            wires.lose();
        }
    }

    /// Tells whether nothing has changed since that report.
    pub(super) fn stands_as(&self, told: &HalfReport) -> bool {
        let stage = self.stage();
        let epoch = stage.linked.as_ref().map_or(0, |linked| linked.epoch);
        told.proxy.as_ref().is_some_and(|p| {
            p.peer == self.card.instance && p.epoch == epoch && (epoch > 0 || p.why == stage.why)
        })
    }

    /// Reports the state of the half; `unsaid` gives the reason why it is not linked, where no other is
    /// known.
    pub(super) fn report(&self, unsaid: impl FnOnce() -> String) -> HalfReport {
        let stage = self.stage();
        let (end, port) = match self.role {
            Role::Client => (End::Client, &self.connection.client),
            Role::Server => (End::Server, &self.connection.server),
        };
        let epoch = stage.linked.as_ref().map_or(0, |linked| linked.epoch);
        let why = match (epoch, stage.why.as_str()) {
            (0, "") => unsaid(),
            (0, why) => why.to_owned(),
            _ => String::new(),
        };
        let process = port.component.process.clone();
        let peer = self.card.instance.clone();
        let proxy = Some(Proxy { process, epoch, why, carrier: self.carrier.into(), peer });
        HalfReport { connection: self.number(), end, proxy }
    }

    pub(super) fn detail(&self) -> LinkDetail {
        let stage = self.stage();
        let mut now = match &stage.linked {
            Some(Linked { wires: Wires::Client(wires), .. }) => wires.detail(),
            Some(Linked { wires: Wires::Server(wires), .. }) => wires.detail(),
            None => LinkDetail::default(),
        };
        if let Some(Linked { stand_in: Some(stand_in), session, .. }) = &stage.linked {
            stand_in.correct(&mut now);
            if let (Role::Client, Some(stand_ins)) = (self.role, session.stand_ins()) {
                stand_ins.tell_of_line(&mut now);
            }
        }
        let mut all = stage.before.clone().followed_by(&now);
        let offered = match &stage.linked {
            Some(Linked { wires: Wires::Server(wires), .. }) => wires.offered(),
            _ => None,
        };
        all.dropped += stage.missed.so_far(offered);
        let mine = self.here.instance.wake_mode();
        let (client_wake, server_wake) = match &stage.linked {
            Some(Linked { wires: Wires::Server(wires), .. }) if !wires.is_output() => ("", mine),
            Some(Linked { wires: Wires::Client(_), .. }) => (mine, ""),
            _ => ("", ""),
        };
        LinkDetail {
            connection: self.number(),
            carrier: self.carrier.into(),
            client_wake,
            server_wake,
            ..all
        }
    }
}
