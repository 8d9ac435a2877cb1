//! A link's making: the server's process offers memory, the client's process is wired to it, or to memory
//! of its own where a line is between them.
//!
//! Invariant: a link that is not made to its end leaves nothing, and its other end is told why.

use std::os::fd::OwnedFd;
use std::sync::Arc;

use trocar_rt::os;
use trocar_rt::segment::Agreed;
use trocar_rt::stream::RemoteViews;

use super::super::super::loss::Loss;
use super::super::asks::Asks;
use super::super::client::{ClientWires, Own};
use super::super::half::{Half, Wires};
use super::super::medium::{Message, Session};
use super::super::pools::{Untold, all_came, map};
use super::super::same_class::rows_for;
use super::super::server::{Offer, ServerWires};
use super::super::serving::QuestionQueue;
use super::super::stand_in::{Link, Placed, StandIns};
use super::super::terms::Terms;
use super::super::words::{Ended, Pool, Words};
use super::Linking;

/// A message about memory that was made, with the bytes behind it and the files that go along.
struct Offered {
    words: Words,
    state: Vec<u8>,
    files: Vec<OwnedFd>,
}

/// # Errors
/// The client sees other types than the server has.
fn agree(half: &Half, terms: &Terms, hash: u64) -> Result<(), String> {
    let mine = terms.hash;
    if hash == mine {
        return Ok(());
    }
    let (server, other) = (&half.connection.server, half.other());
    Err(format!(
        "the types of {server} are others in the two processes (hash {mine:#018x} in {}, {hash:#018x} in {other}): both must have \
         the same version of its plugin",
        server.component.process
    ))
}

impl Linking {
    /// Handles the request of the client's process for the memory.
    pub(super) fn opens(
        &mut self,
        session: &Arc<dyn Session>,
        half: &Arc<Half>,
        (hash, code): (u64, Option<String>),
        before: Option<Ended>,
    ) {
        let connection = half.number();
        // A client that asks again has lost its end.
        self.unlink(half, None, "its client asked anew", Loss::Cut, true);
        half.lost_on_the_way(before);
        let offered = match self.offer(session, half, hash, code) {
            Ok(offered) => offered,
            Err(why) => {
                half.fail(why.clone(), false);
                let _ = session.say(&Words::Declined { connection, why, later: false }, &[], &[]);
                return;
            }
        };
        if let Err(why) = session.say(&offered.words, &offered.state, &offered.files) {
            self.unlink(half, None, &why, Loss::Cut, false);
            let _ = session.say(&Words::Declined { connection, why, later: true }, &[], &[]);
        }
    }

    /// Makes the memory and wires the server to it.
    ///
    /// # Errors
    /// The sentence why that cannot be.
    fn offer(
        &mut self,
        session: &Arc<dyn Session>,
        half: &Arc<Half>,
        hash: u64,
        code: Option<String>,
    ) -> Result<Offered, String> {
        let connection = half.number();
        let (_, terms) = half.terms(false).map_err(|refusal| refusal.to_string())?;
        agree(half, &terms, hash)?;
        // Rows are memory, and stay on their machine.
        let code = code.filter(|_| session.stand_ins().is_none());
        let rows = rows_for(half, code);
        let (set, terms) = half.terms(rows.is_some()).map_err(|refusal| refusal.to_string())?;
        self.epoch = os::now_ns().max(self.epoch + 1);
        let epoch = self.epoch;
        let agreed = Agreed { hash: terms.hash, epoch };
        let offer = Offer::make(&terms.way, agreed, &self.todos.bell);
        let mut offer = offer.map_err(|e| format!("no memory for it: {e}"))?;
        let memory = offer.fd().map_err(|e| e.to_string())?;
        let stand_ins = session.stand_ins();
        let server = (&half.here.instance, &*set.ports);
        let stand_in = stand_ins.map(|all| all.for_client(&mut offer, &terms.way, server, agreed));
        let stand_in = stand_in.transpose()?;
        offer.expect_pools(&terms.way, &set);
        let (rows, rows_file) = rows.unzip();
        let questions =
            |served| QuestionQueue::open(&half.here.instance, session, (connection, epoch), served);
        let here = (&half.here, &*set);
        let wires = ServerWires::connect(offer, &terms.way, &half.connection, here, rows, questions);
        let mut wires = wires.map_err(|e| e.to_string())?;
        let Untold { pools, files, told } = Untold::of(&wires);
        Untold::note(told, &mut wires);
        half.link(session, epoch, Wires::Server(wires), stand_in.clone());
        let rows = rows_file.is_some();
        let files = std::iter::once(memory).chain(rows_file).chain(files).collect();
        let state = stand_in.as_ref().map(|stand_in| stand_in.state()).unwrap_or_default();
        if let Some((all, stand_in)) = stand_ins.zip(stand_in) {
            all.add(Link { connection, epoch }, &terms.way, stand_in);
        }
        Ok(Offered { words: Words::Opened { connection, epoch, rows, pools }, state, files })
    }

    /// Handles the memory that the server's process gave.
    pub(super) fn opened(
        &mut self,
        session: &Arc<dyn Session>,
        half: &Arc<Half>,
        (epoch, rows, pools): (u64, bool, &[Pool]),
        (state, message): (&[u8], Message),
    ) {
        half.asked(None);
        self.unlink(half, None, "its server opened it anew", Loss::Cut, false);
        let linked = match session.stand_ins() {
            Some(stand_ins) => link_apart(session, stand_ins, half, epoch, state),
            None => link(session, half, (epoch, rows, pools), message),
        };
        if let Err(why) = linked {
            // It may be linked, and its other end may not know.
            let was_linked = self.unlink(half, Some(session), &why, Loss::Cut, false);
            half.fail(why, true);
            forgo(session, Link { connection: half.number(), epoch }, was_linked);
        }
    }

    /// Handles the pools that the server's process announced.
    pub(super) fn pools(
        &mut self,
        session: &Arc<dyn Session>,
        half: &Half,
        epoch: u64,
        pools: &[Pool],
        message: Message,
    ) {
        let parts = half.with_wires(session, epoch, |wires| match wires {
            Wires::Client(ClientWires::Input { views, bell, .. }) => Some((views.clone(), bell.clone())),
            _ => None,
        });
        let Some(Some((views, bell))) = parts else { return };
        // Mapping takes its time: other users of the half do not wait for it.
        match all_came(&message).and_then(|()| map(&views, pools, message.files)) {
            // A frame may wait for this pool.
            Ok(()) => _ = bell.notify(),
            Err(why) => {
                self.unlink(half, Some(session), &why, Loss::Cut, true);
            }
        }
    }
}

/// Tells the server's end of a link that nobody comes to it. One that was linked says by itself that it has
/// left, behind its commands.
pub(super) fn forgo(session: &Arc<dyn Session>, link: Link, was_linked: bool) {
    let Link { connection, epoch } = link;
    let _ = session.say(&Words::Close { connection, epoch }, &[], &[]);
    if let Some(stand_ins) = session.stand_ins().filter(|_| !was_linked) {
        let _ = stand_ins.forgo(link);
    }
}

/// Wires a client to the memory that came along.
fn link(
    session: &Arc<dyn Session>,
    half: &Arc<Half>,
    (epoch, rows, pools): (u64, bool, &[Pool]),
    message: Message,
) -> Result<(), String> {
    all_came(&message)?;
    let mut files = message.files.into_iter();
    let memory = files.next().ok_or("no memory came along")?;
    let own = if rows {
        let rows = files.next().ok_or("no rows came along")?;
        let class = (half.same_class)().ok_or("it shows rows to this process, which has not their class")?;
        Some(Own { class, rows })
    } else {
        None
    };
    let (set, terms) = half.terms(own.is_some()).map_err(|refusal| refusal.to_string())?;
    let views = RemoteViews::new(terms.way.header_bytes());
    map(&views, pools, files)?;
    let wires = ClientWires::connect(
        (memory, Agreed { hash: terms.hash, epoch }, None),
        &terms.way,
        &half.connection,
        (&half.here, &set),
        (&half.theirs, Asks::new(session, half.number(), epoch), own),
        views,
    );
    half.link(session, epoch, Wires::Client(wires.map_err(|e| e.to_string())?), None);
    Ok(())
}

/// Wires a client to memory of its own process, where somebody stands in for its server.
fn link_apart(
    session: &Arc<dyn Session>,
    stand_ins: &StandIns,
    half: &Arc<Half>,
    epoch: u64,
    state: &[u8],
) -> Result<(), String> {
    let connection = half.number();
    let (set, terms) = half.terms(false).map_err(|refusal| refusal.to_string())?;
    let agreed = Agreed { hash: terms.hash, epoch };
    let Placed { stand_in, memory, views } = stand_ins.for_server(&terms.way, agreed, state)?;
    let wires = ClientWires::connect(
        (memory, agreed, Some(stand_ins.bell().clone())),
        &terms.way,
        &half.connection,
        (&half.here, &set),
        (&half.theirs, Asks::new(session, connection, epoch), None),
        views,
    );
    let wires = Wires::Client(wires.map_err(|e| e.to_string())?);
    let link = Link { connection, epoch };
    half.link(session, epoch, wires, Some(stand_in.clone()));
    stand_ins.add(link, &terms.way, stand_in);
    stand_ins.ready(link)
}
