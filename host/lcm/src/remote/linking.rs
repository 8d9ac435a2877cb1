//! The thread `trocar-remote`: links halves when the other process is there, and removes the links when it is
//! not.
//!
//! Invariant: a half is linked only over a session with the very run of the process that the GCM named;
//! messages of any other run of that name are ignored. Each session is asked once for each link.

mod opening;

use std::collections::BTreeMap;
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

use trocar_lcm_api::HalfReport;
use trocar_links::Card;
use trocar_rt::os;
use trocar_rt::stream::RemotePools;

use super::super::boundary::{ReadAnswer, RemoteServer};
use super::super::ends::Role;
use super::super::loss::Loss;
use super::client::ClientWires;
use super::half::{Half, Linked, Wires};
use super::medium::{Medium, Message, Session, same};
use super::pools::Untold;
use super::same_class::code_of;
use super::server::ServerWires;
use super::serving::Question;
use super::stand_in::Link;
use super::todo::{Halves, Todo, Todos, all, locked};
use super::words::Words;

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
        let words = Words::Open { connection: half.number(), hash, code, before: half.ended() };
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
            match words {
                Words::Open { .. } => {
                    let why = format!("connection {connection} is not known there yet");
                    let _ = session.say(&Words::Declined { connection, why, later: true }, &[], &[]);
                }
                // It was removed meanwhile.
                Words::Opened { epoch, .. } => opening::forgo(session, Link { connection, epoch }, false),
                _ => {}
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
                let stamp_ns = session.stand_ins().map_or(stamp_ns, |there| there.here(stamp_ns));
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
            Words::Open { hash, code, before, .. } => self.opens(session, half, (hash, code), before),
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
