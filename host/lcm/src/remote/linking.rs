//! The thread `trocar-remote`: links halves when the other process is there, and removes the links when it is
//! not.
//!
//! Invariant: a half is linked only over a session with the very run of the process that the GCM named;
//! messages of any other run of that name are ignored. Each session is asked once for each link.

use std::collections::BTreeMap;
use std::os::fd::OwnedFd;
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

use trocar_lcm_api::HalfReport;
use trocar_links::Card;
use trocar_rt::os;
use trocar_rt::segment::Agreed;
use trocar_rt::stream::{RemotePools, RemoteViews};

use super::super::boundary::{ReadAnswer, RemoteServer};
use super::super::ends::Role;
use super::super::loss::Loss;
use super::asks::Asks;
use super::client::{ClientWires, Own};
use super::half::{Half, Linked, Wires};
use super::medium::{Medium, Message, Session, same};
use super::pools::{Untold, all_came, map};
use super::same_class::{code_of, rows_for};
use super::server::{Offer, ServerWires};
use super::serving::{Question, QuestionQueue};
use super::stand_in::{Link, Placed, StandIns};
use super::todo::{Halves, Todo, Todos, all, locked};
use super::words::{Pool, Words};

/// Time between looks at links of frames: for pools not announced to their other end yet, and for returned
/// frames.
const POOLS_LOOK: Duration = Duration::from_millis(10);
/// Time between attempts to make a failed link, while both processes live.
const RETRY: Duration = Duration::from_millis(200);
/// Most removed links of one session whose frames stay lent.
const MOST_LENT: usize = 32;
/// Time a session outlives the last connection that needed it.
const LINGER: Duration = Duration::from_secs(1);
/// Time between reports to clients about failed commands that they only sent.
const TELL_FAILURES: Duration = Duration::from_secs(1);

pub(super) struct Linking {
    medium: Arc<dyn Medium>,
    halves: Halves,
    todos: Arc<Todos>,
    /// Live sessions, dialled by this process or by the other one.
    sessions: Vec<Arc<dyn Session>>,
    /// Epoch of the newest link.
    epoch: u64,
    retried: Instant,
    told_failures: Instant,
    /// Removed links whose readers, over these sessions, still hold frames.
    lent: Vec<(Arc<dyn Session>, Arc<RemotePools>)>,
    /// Servers of connections that were cut, over these sessions, while calls in them were under way.
    leaving: Vec<(Arc<dyn Session>, Weak<RemoteServer>)>,
    /// Processes whose session is no longer needed, and since when: calls under way end first, and a new
    /// connection right after finds the session.
    left: Vec<(Card, Instant)>,
    /// State of each half as last reported.
    told: BTreeMap<u64, HalfReport>,
    news: Box<dyn Fn(HalfReport) + Send>,
}

/// Tells a server of its reads that panicked here, if there are new ones.
fn tell_panics(session: &dyn Session, (connection, epoch): (u64, u64), wires: &mut ClientWires) {
    if let Some((count, text)) = wires.untold_panics() {
        let _ = session.say(&Words::Panicked { connection, epoch, count }, text.as_bytes(), &[]);
    }
}

impl Linking {
    pub(super) fn new(
        medium: Arc<dyn Medium>,
        halves: Halves,
        todos: Arc<Todos>,
        news: impl Fn(HalfReport) + Send + 'static,
    ) -> Linking {
        Linking {
            medium,
            halves,
            todos,
            sessions: Vec::new(),
            epoch: 0,
            retried: Instant::now(),
            told_failures: Instant::now(),
            lent: Vec::new(),
            leaving: Vec::new(),
            left: Vec::new(),
            told: BTreeMap::new(),
            news: Box::new(news),
        }
    }

    pub(super) fn run(mut self) {
        loop {
            let pause_ns = self.pause().map(|pause| os::now_ns() + pause.as_nanos() as u64);
            self.todos.bell.wait(pause_ns);
            while let Some(todo) = self.todos.next() {
                if !self.follow(todo) {
                    return;
                }
                self.tell();
            }
            self.retry();
            self.look_at_frames();
            self.tell_failures();
            self.lent.retain(|(session, pools)| !session.is_lost() && !pools.are_back());
            self.leaving.retain(|(_, server)| server.strong_count() > 0);
            self.leave();
            self.tell();
        }
    }

    /// Handles one task; false after the last one.
    fn follow(&mut self, todo: Todo) -> bool {
        match todo {
            Todo::Met(session) => self.met(session),
            Todo::Said(session, message) => self.said(&session, message),
            Todo::Lost(session, why) => self.lost(&session, &why),
            Todo::Added(half, before) => self.added(&half, before),
            Todo::Removed(half, how, tell) => {
                self.removed(&half, how);
                self.tell();
                let _ = tell.send(());
            }
            Todo::Stop => {
                let all = std::mem::take(&mut *locked(&self.halves));
                all.values().for_each(|half| self.removed(half, Loss::Cut));
                return false;
            }
        }
        true
    }

    /// Time until the next look, if no message comes before.
    fn pause(&self) -> Option<Duration> {
        let pause = |half: Arc<Half>| match (&half.stage().linked, half.role) {
            (Some(Linked { wires: Wires::Server(wires), .. }), _) if wires.lends() => Some(POOLS_LOOK),
            (Some(Linked { wires: Wires::Server(ServerWires::Calls { .. }), .. }), _) => Some(TELL_FAILURES),
            (Some(Linked { wires: Wires::Client(ClientWires::Calls { .. }), .. }), _) => Some(TELL_FAILURES),
            (None, Role::Client) => Some(RETRY),
            _ => None,
        };
        let lent = (!self.lent.is_empty()).then_some(POOLS_LOOK);
        let left = (!self.left.is_empty()).then_some(RETRY);
        all(&self.halves).into_iter().filter_map(pause).chain(lent).chain(left).min()
    }

    /// Reports the state of the halves that have changed.
    fn tell(&mut self) {
        let all = all(&self.halves);
        for half in &all {
            if self.told.get(&half.number()).is_some_and(|told| half.stands_as(told)) {
                continue;
            }
            let report = half.report(|| half.unsaid(&*self.medium));
            if self.told.get(&report.connection) != Some(&report) {
                (self.news)(report.clone());
                self.told.insert(report.connection, report);
            }
        }
        let gone = |number: &u64| !all.iter().any(|half| half.number() == *number);
        for (_, report) in self.told.extract_if(.., |number, _| gone(number)) {
            (self.news)(HalfReport { proxy: None, ..report });
        }
    }

    fn added(&mut self, half: &Arc<Half>, before: Option<Arc<Half>>) {
        if half.role == Role::Client {
            // Before the replaced half leaves, or their session would end in between.
            self.medium.want(&half.card);
        }
        if let Some(before) = before {
            self.removed(&before, Loss::Replaced);
            half.go_on_from(&before);
        }
        match half.role {
            Role::Client => self.open(half),
            Role::Server => {
                for session in self.sessions.iter().filter(|session| half.is_with(&***session)) {
                    let _ = session.say(&Words::Offered { connection: half.number() }, &[], &[]);
                }
            }
        }
    }

    fn removed(&mut self, half: &Arc<Half>, how: Loss) {
        self.unlink(half, None, "it was disconnected", how, true);
        half.fail("it was disconnected".into(), true);
        if half.role == Role::Client {
            self.left.push((half.card.clone(), Instant::now()));
        }
    }

    /// Ends sessions that are no longer needed.
    fn leave(&mut self) {
        let busy = !self.leaving.is_empty();
        let medium = &self.medium;
        self.left.retain(|(card, since)| {
            let stays = busy || since.elapsed() < LINGER;
            if !stays {
                medium.leave(card);
            }
            stays
        });
    }

    /// Removes the wires of a half, if it is linked (over this session, where one is named), and has the
    /// other end do the same if it cannot know. True if the half was linked.
    fn unlink(
        &mut self,
        half: &Half,
        of: Option<&Arc<dyn Session>>,
        why: &str,
        how: Loss,
        tell_other: bool,
    ) -> bool {
        let Some(Linked { session, epoch, mut wires, .. }) = half.unlink(of, why, how) else { return false };
        let connection = half.number();
        if let Some(stand_ins) = session.stand_ins() {
            stand_ins.leave(Link { connection, epoch });
        }
        if let Wires::Client(wires) = &mut wires {
            tell_panics(&*session, (connection, epoch), wires);
        }
        if tell_other {
            let _ = session.say(&Words::Close { connection, epoch }, &[], &[]);
        }
        match wires {
            _ if session.is_lost() => {}
            // Frames the reader still holds stay as they are until it lets go, or is gone.
            Wires::Server(ServerWires::Output { pools, .. }) => self.keep_lent(session, pools),
            // Calls that have begun there are carried to their end, unless that process ends first.
            Wires::Client(ClientWires::Calls { server, .. }) => {
                self.leaving.push((session, Arc::downgrade(&server)));
            }
            _ => {}
        }
        true
    }

    /// Keeps the frames that the reader of a removed link still holds; only for a limited number of links.
    fn keep_lent(&mut self, session: Arc<dyn Session>, pools: Arc<RemotePools>) {
        let of = |(over, _): &(Arc<dyn Session>, _)| same(over, &session);
        if self.lent.iter().filter(|kept| of(kept)).count() >= MOST_LENT
            && let Some(oldest) = self.lent.iter().position(of)
        {
            self.lent.remove(oldest);
        }
        self.lent.push((session, pools));
    }

    fn met(&mut self, session: Arc<dyn Session>) {
        self.sessions.retain(|s| !s.is_lost());
        self.sessions.push(session.clone());
        for half in all(&self.halves).iter().filter(|half| half.is_with(&*session)) {
            match half.role {
                Role::Client => self.open(half),
                Role::Server => {
                    let _ = session.say(&Words::Offered { connection: half.number() }, &[], &[]);
                }
            }
        }
    }

    /// Asks the server's process for the memory, if there is a session with it that was not asked.
    fn open(&self, half: &Half) {
        let Some(session) = self.medium.session(&half.card) else {
            if let Some(why) = self.medium.refused(&half.card) {
                half.fail(format!("process {} and this one do not come together: {why}", half.other()), true);
            }
            return;
        };
        if !half.is_with(&*session) {
            let why = "another run of it listens there than the one this connection was made with: the GCM has to be asked";
            return half.fail(why.into(), false);
        }
        if !half.may_ask(&*session) {
            return;
        }
        let hash = match half.terms(false) {
            Ok((_, terms)) => terms.hash,
            Err(refusal) => return half.fail(refusal.to_string(), true),
        };
        let code = (half.same_class)().and_then(|own| code_of(&own.info));
        let words = Words::Open { connection: half.number(), hash, code };
        match session.say(&words, &[], &[]) {
            Ok(()) => half.asked(Some(&*session)),
            Err(why) => half.fail(why, false),
        }
    }

    fn lost(&mut self, session: &Arc<dyn Session>, why: &str) {
        self.sessions.retain(|s| !same(s, session));
        for (_, server) in self.leaving.extract_if(.., |(over, _)| same(over, session)) {
            if let Some(server) = server.upgrade() {
                server.lose();
            }
        }
        let why_not = format!("process {}: {why}", session.process());
        let unlink =
            |half: Arc<Half>| half.unlink(Some(session), &why_not, Loss::Peer).map(|cut| (half, cut));
        let cut: Vec<_> = all(&self.halves).into_iter().filter_map(unlink).collect();
        for (half, _) in &cut {
            let (here, other) = (half.port().port.as_str(), half.other_port());
            half.here.instance.warn_about(&format!("{here} has lost {other}"), &format!(": {why}"));
        }
        // The memory of all these links is freed last: nothing should wait for that.
        drop(cut);
    }

    fn said(&mut self, session: &Arc<dyn Session>, mut message: Message) {
        let bytes = std::mem::take(&mut message.bytes);
        let (words, behind) = match Words::decode(&bytes) {
            Ok(said) => said,
            Err(why) => return session.condemn(&why),
        };
        let connection = words.connection();
        // Only the process of the other end, in the run that is meant, may send messages about a connection.
        let half = locked(&self.halves).get(&connection).filter(|half| half.is_with(&**session)).cloned();
        let Some(half) = half else {
            if let Words::Open { .. } = words {
                let why = format!("connection {connection} is not known there yet");
                let _ = session.say(&Words::Declined { connection, why, later: true }, &[], &[]);
            }
            return;
        };
        // A message about an earlier link says nothing new.
        if let Words::Close { epoch, .. } = words {
            if half.with_wires(session, epoch, |_| ()).is_some() {
                let why = format!("process {} has disconnected it", half.other());
                self.unlink(&half, Some(session), &why, Loss::Cut, false);
            }
            return;
        }
        match half.role {
            Role::Client => self.said_by_server(session, &half, words, behind, message),
            Role::Server => self.said_by_client(session, &half, words, behind),
        }
    }

    /// Handles what the server's process says to a client here; what only a client says is ignored.
    fn said_by_server(
        &mut self,
        session: &Arc<dyn Session>,
        half: &Arc<Half>,
        words: Words,
        behind: &[u8],
        message: Message,
    ) {
        match words {
            Words::Offered { .. } => self.open(half),
            Words::Opened { epoch, rows, pools, .. } => {
                self.opened(session, half, (epoch, rows, &pools), (behind, message));
            }
            Words::Declined { why, later, .. } => {
                half.asked(None);
                let why = trocar_model::plain::sentence(why.as_bytes());
                half.fail(format!("process {} declines: {why}", half.other()), !later);
            }
            Words::Pools { epoch, pools, .. } => self.pools(session, half, epoch, &pools, message),
            Words::Told { epoch, number, outcome, stamp_ns, value_bytes, .. } => {
                let (value, text) = behind.split_at(behind.len().min(value_bytes as usize));
                let text = trocar_model::plain::sentence(text);
                let answer = ReadAnswer { outcome, stamp_ns, value: value.to_vec(), text };
                half.with_wires(session, epoch, |wires| {
                    if let Wires::Client(ClientWires::Calls { asks, .. }) = wires {
                        asks.answer(number, answer);
                    }
                });
            }
            Words::Failures { epoch, failed, unexecuted, .. }
                if half.with_wires(session, epoch, |_| ()).is_some() =>
            {
                half.tell_failures(failed, unexecuted);
            }
            _ => {}
        }
    }

    /// Handles what the client's process says to a server here; what only a server says is ignored.
    fn said_by_client(&mut self, session: &Arc<dyn Session>, half: &Arc<Half>, words: Words, behind: &[u8]) {
        match words {
            Words::Open { hash, code, .. } => self.opens(session, half, hash, code),
            Words::Panicked { epoch, count, .. } => {
                half.with_wires(session, epoch, |wires| {
                    if let Wires::Server(wires) = wires {
                        wires.panicked(count, behind, (&half.here, half.other()));
                    }
                });
            }
            Words::Ask { epoch, number, index, left_ns, .. } => {
                let until_ns = os::now_ns().saturating_add(left_ns);
                let question = Question { number, index, until_ns, arg: behind.to_vec() };
                half.with_wires(session, epoch, |wires| {
                    if let Wires::Server(ServerWires::Calls { questions, .. }) = wires {
                        questions.ask(question);
                    }
                });
            }
            _ => {}
        }
    }

    /// Handles the request of the client's process for the memory.
    fn opens(&mut self, session: &Arc<dyn Session>, half: &Arc<Half>, hash: u64, code: Option<String>) {
        let connection = half.number();
        let decline = |why: String| {
            half.fail(why.clone(), false);
            let _ = session.say(&Words::Declined { connection, why, later: false }, &[], &[]);
        };
        let (_, terms) = match half.terms(false) {
            Ok(both) => both,
            Err(refusal) => return decline(refusal.to_string()),
        };
        if hash != terms.hash {
            let (mine, theirs) = (terms.hash, hash);
            return decline(format!(
                "the types of {} are others in the two processes (hash {mine:#018x} in {}, {theirs:#018x} in {}): both must have \
                 the same version of its plugin",
                half.connection.server,
                half.connection.server.component.process,
                half.other()
            ));
        }
        // A client that asks again has lost its end.
        self.unlink(half, None, "its client asked anew", Loss::Cut, true);
        // Rows are memory, and stay on their machine.
        let code = code.filter(|_| session.stand_ins().is_none());
        let rows = rows_for(half, code);
        let (set, terms) = match half.terms(rows.is_some()) {
            Ok(both) => both,
            Err(refusal) => return decline(refusal.to_string()),
        };
        self.epoch = os::now_ns().max(self.epoch + 1);
        let epoch = self.epoch;
        let mut offer = match Offer::make(&terms.way, Agreed { hash: terms.hash, epoch }, &self.todos.bell) {
            Ok(offer) => offer,
            Err(e) => return decline(format!("no memory for it: {e}")),
        };
        let memory = match offer.fd() {
            Ok(fd) => fd,
            Err(e) => return decline(e.to_string()),
        };
        let agreed = Agreed { hash: terms.hash, epoch };
        let stand_ins = session.stand_ins();
        let stand_in = stand_ins
            .map(|all| all.for_client(&mut offer, &terms.way, (&half.here.instance, &set.ports), agreed));
        let stand_in = match stand_in.transpose() {
            Ok(stand_in) => stand_in,
            Err(why) => return decline(why),
        };
        offer.expect_pools(&terms.way, &set);
        let (rows, rows_file) = rows.unzip();
        let questions =
            |served| QuestionQueue::open(&half.here.instance, session, (connection, epoch), served);
        let here = (&half.here, &*set);
        let mut wires = match ServerWires::connect(offer, &terms.way, &half.connection, here, rows, questions)
        {
            Ok(wires) => wires,
            Err(e) => return decline(e.to_string()),
        };
        let Untold { pools, files, told } = Untold::of(&wires);
        Untold::note(told, &mut wires);
        half.link(session, epoch, Wires::Server(wires), stand_in.clone());
        let rows = rows_file.is_some();
        let files: Vec<OwnedFd> = std::iter::once(memory).chain(rows_file).chain(files).collect();
        let state = stand_in.as_ref().map(|stand_in| stand_in.state()).unwrap_or_default();
        if let Some((all, stand_in)) = stand_ins.zip(stand_in) {
            all.add(Link { connection, epoch }, stand_in);
        }
        if let Err(why) = session.say(&Words::Opened { connection, epoch, rows, pools }, &state, &files) {
            self.unlink(half, None, &why, Loss::Cut, false);
            let _ = session.say(&Words::Declined { connection, why, later: true }, &[], &[]);
        }
    }

    /// Handles the memory that the server's process gave.
    fn opened(
        &mut self,
        session: &Arc<dyn Session>,
        half: &Arc<Half>,
        (epoch, rows, pools): (u64, bool, &[Pool]),
        (state, message): (&[u8], Message),
    ) {
        let connection = half.number();
        half.asked(None);
        self.unlink(half, None, "its server opened it anew", Loss::Cut, false);
        let link = || -> Result<(), String> {
            if let Some(stand_ins) = session.stand_ins() {
                return Self::open_apart(session, stand_ins, half, epoch, state);
            }
            all_came(&message)?;
            let mut files = message.files.into_iter();
            let memory = files.next().ok_or("no memory came along")?;
            let own = if rows {
                let rows = files.next().ok_or("no rows came along")?;
                let class =
                    (half.same_class)().ok_or("it shows rows to this process, which has not their class")?;
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
                (&half.theirs, Asks::new(session, connection, epoch), own),
                views,
            );
            half.link(session, epoch, Wires::Client(wires.map_err(|e| e.to_string())?), None);
            Ok(())
        };
        if let Err(why) = link() {
            half.fail(why, true);
            let _ = session.say(&Words::Close { connection, epoch }, &[], &[]);
        }
    }

    /// Links a client to whoever stands in for its server here.
    fn open_apart(
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
        stand_ins.add(link, stand_in);
        stand_ins.ready(link)
    }

    /// Handles the pools that the server's process announced.
    fn pools(
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

    /// Asks again for links that failed.
    fn retry(&mut self) {
        if self.retried.elapsed() < RETRY {
            return;
        }
        self.retried = Instant::now();
        for half in all(&self.halves).iter().filter(|half| half.role == Role::Client) {
            self.open(half);
        }
    }

    /// Announces pools to the clients whose frames wait for them, and takes back frames; a link that has seen
    /// too many pools is made anew.
    fn look_at_frames(&mut self) {
        for half in all(&self.halves) {
            let (connection, mut stage) = (half.number(), half.stage());
            let Some(Linked { session, epoch, wires: Wires::Server(wires), .. }) = &mut stage.linked else {
                continue;
            };
            wires.collect();
            let (session, overflowed) = (session.clone(), wires.has_overflowed());
            let Untold { pools, files, told } = Untold::of(wires);
            // A stand-in finds the pools itself.
            if !pools.is_empty() && session.stand_ins().is_none() {
                match session.say(&Words::Pools { connection, epoch: *epoch, pools }, &[], &files) {
                    Ok(()) => Untold::note(told, wires),
                    Err(why) => {
                        log::debug!("connection {connection}: its client is told of a pool later: {why}")
                    }
                }
            }
            drop(stage);
            if overflowed {
                self.unlink(&half, None, "its frames came from too many pools", Loss::Cut, true);
                let _ = session.say(&Words::Offered { connection }, &[], &[]);
            }
        }
    }

    /// Tells clients of commands that they only sent and that failed or never ran here, and servers of their
    /// reads that panicked here.
    fn tell_failures(&mut self) {
        if self.told_failures.elapsed() < TELL_FAILURES {
            return;
        }
        self.told_failures = Instant::now();
        for half in all(&self.halves) {
            let (connection, mut stage) = (half.number(), half.stage());
            let Some(Linked { session, epoch, wires, .. }) = &mut stage.linked else { continue };
            match wires {
                Wires::Server(wires) => {
                    if let Some((failed, unexecuted)) = wires.untold_failures() {
                        let words = Words::Failures { connection, epoch: *epoch, failed, unexecuted };
                        let _ = session.say(&words, &[], &[]);
                    }
                }
                Wires::Client(wires) => tell_panics(&**session, (connection, *epoch), wires),
            }
        }
    }
}
