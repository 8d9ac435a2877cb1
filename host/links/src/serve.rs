//! The thread of all sessions: accepts, dials, greets, listens, looks after the hearts.
//!
//! Invariant: the thread never waits for one process, and nothing a stranger does costs more than one
//! greeting's time and room.

use std::collections::BTreeMap;
use std::fs::File;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::PathBuf;
use std::sync::Arc;

use rustix::event::{PollFd, PollFlags, Timespec};
use rustix::io::Errno;
use rustix::net::SocketFlags;
use trocar_rt::os::{Unshared, now_ns, unshared};
use trocar_rt::pulse::{Life, Pulse};
use trocar_rt::robust_words::RobustWords;

use crate::address;
use crate::asked::{Ask, Failed, Shared};
use crate::card::Card;
use crate::door::{MOST_GREETINGS, MOST_GUESTS, MOST_OF_ONE, Seldom};
use crate::greeting::{Greeting, Said, VERSION, parse};
use crate::handler::Handler;
use crate::live::{BEAT_NS, Heart, kernel_says};
use crate::session::{Lost, Peer, Session};
use crate::socket::{Heard, MOST_BYTES, receive, room, send};
use crate::steps::{By, Refusal, Stage, Step, refuse, step};
use crate::watch::Watch;

/// A greeting takes this long at most, ns.
const GREETING_NS: u64 = 1_000_000_000;
/// Pause before a process that did not answer is dialled again, ns.
const REDIAL_NS: u64 = 20_000_000;
/// As above, for one that refused: it will hardly change its mind, ns.
const REFUSED_NS: u64 = 1_000_000_000;
/// Pause of listening where the process may open no more files, ns.
const NO_FILES_NS: u64 = 100_000_000;
/// Time between two looks at the place where it listens, ns.
const PLACE_NS: u64 = 1_000_000_000;
/// Messages one session may have read at once: others wait as well.
const AT_ONCE: usize = 16;

pub(crate) struct Server<H> {
    card: Card,
    /// Keeps the listener from forked children: a child that kept it would let others dial a process that has
    /// ended, and wait.
    _unshared: Unshared,
    listener: OwnedFd,
    /// A file kept so that a caller can be told when the process may open no more; `None` while that is so.
    spare: Option<OwnedFd>,
    /// No look at the listener before, ns.
    listen_ns: u64,
    /// When the listener's place is looked at next, ns.
    place_ns: u64,
    shared: Arc<Shared>,
    handler: H,
    ends: Vec<End>,
    wants: BTreeMap<PathBuf, Want>,
    room: Vec<u8>,
    sessions: u64,
    /// When the hearts were looked at last, ns.
    beat_ns: u64,
    /// Lets others hear at once that this process died; `None` where the kernel tells nobody.
    robust_words: Option<RobustWords>,
    /// Lets this process hear of the death of others.
    watch: Watch,
    turned_away: Seldom,
    unheard: Seldom,
    no_files: Seldom,
    no_place: Seldom,
}

struct Want {
    times: usize,
    next_ns: u64,
    /// The process is being dialled, or its session is there.
    busy: bool,
}

/// One socket.
enum End {
    Greeting { socket: OwnedFd, pid: i32, until_ns: u64, stage: Box<Stage> },
    Live { session: Arc<Session>, heart: Heart, watched: bool },
}

impl End {
    /// Tells whether this end greets the process that listens at `there`.
    fn is_dialled(&self, there: &PathBuf) -> bool {
        matches!(self, End::Greeting { stage, .. } if stage.at() == Some(there))
    }

    fn socket(&self) -> BorrowedFd<'_> {
        match self {
            End::Greeting { socket, .. } => socket.as_fd(),
            End::Live { session, .. } => session.socket(),
        }
    }
}

impl<H: Handler> Server<H> {
    /// Makes the server, on the thread that runs it.
    pub(crate) fn new(card: Card, listener: OwnedFd, shared: Arc<Shared>, handler: H) -> Server<H> {
        let told = |e: &std::io::Error| {
            log::info!("other processes hear of the end of this one by their sockets only: {e}")
        };
        Server {
            robust_words: RobustWords::of_this_thread().inspect_err(told).ok(),
            watch: Watch::new(shared.clone()),
            card,
            spare: None,
            _unshared: unshared(&listener),
            listener,
            listen_ns: 0,
            place_ns: now_ns() + PLACE_NS,
            shared,
            handler,
            ends: Vec::new(),
            wants: BTreeMap::new(),
            room: room(),
            sessions: 0,
            beat_ns: now_ns(),
            turned_away: Seldom::default(),
            unheard: Seldom::default(),
            no_files: Seldom::default(),
            no_place: Seldom::default(),
        }
    }

    pub(crate) fn run(&mut self) {
        while self.answer() {
            let now = now_ns();
            self.spare_a_file();
            self.keep_place(now);
            self.dial(now);
            self.look_at_hearts(now);
            let ready = self.wait(now_ns());
            let now = now_ns();
            // Handled from the back, since an end that is over is removed. New callers are let in after that,
            // since one may take the place of a greeting that said nothing.
            for at in (0..self.ends.len()).rev() {
                if ready.get(at + 1) == Some(&true) {
                    self.listen(at, now);
                }
            }
            if ready.first() == Some(&true) {
                self.accept(now);
            }
            self.end_late_greetings(now);
        }
        for end in std::mem::take(&mut self.ends) {
            if let End::Live { session, .. } = end {
                self.lose(&session, &Lost::Ended);
            }
        }
    }

    /// Answers what other threads asked; false: stop.
    fn answer(&mut self) -> bool {
        for ask in self.shared.take() {
            match ask {
                Ask::Want(at) => {
                    // A session that was left and wanted again at once may still be in its greeting.
                    let busy = self.ends.iter().any(|end| end.is_dialled(&at));
                    let want = self.wants.entry(at).or_insert(Want { times: 0, next_ns: 0, busy });
                    want.times += 1;
                }
                Ask::Unwant(at) => {
                    let Some(want) = self.wants.get_mut(&at) else { continue };
                    want.times -= 1;
                    if want.times > 0 {
                        continue;
                    }
                    self.wants.remove(&at);
                    let mut known = self.shared.known();
                    known.failed.remove(&at);
                    if let Some(session) = known.dialled.remove(&at) {
                        session.end();
                    }
                }
                Ask::Died(number) => self.died(number),
                Ask::Stop => return false,
            }
        }
        true
    }

    /// Sleeps until something is there. Returns that for the listener, then for the ends.
    fn wait(&mut self, now: u64) -> Vec<bool> {
        let listens = if now >= self.listen_ns { PollFlags::IN } else { PollFlags::empty() };
        let mut looked: Vec<PollFd<'_>> =
            vec![PollFd::new(&self.shared.bell, PollFlags::IN), PollFd::new(&self.listener, listens)];
        looked.extend(self.ends.iter().map(|end| match end {
            // A socket that never rings stands in its place: the heart of the session is looked at again
            // soon, and so is this.
            End::Live { session, .. } if session.is_full() => PollFd::new(&self.listener, PollFlags::empty()),
            end => PollFd::from_borrowed_fd(end.socket(), PollFlags::IN),
        }));
        let pause = self
            .until(now)
            .map(|until| until.saturating_sub(now))
            .map(|ns| Timespec { tv_sec: (ns / 1_000_000_000) as i64, tv_nsec: (ns % 1_000_000_000) as i64 });
        // Interrupted or refused: all are looked at, and none of these looks waits.
        if rustix::event::poll(&mut looked, pause.as_ref()).is_err() {
            return vec![true; looked.len() - 1];
        }
        let ready: Vec<bool> = looked.iter().map(|fd| !fd.revents().is_empty()).collect();
        if ready[0] {
            let _ = rustix::io::read(&self.shared.bell, &mut [0u8; 8]);
        }
        ready[1..].to_vec()
    }

    /// Returns the time when something is due although no message comes, ns.
    fn until(&self, now: u64) -> Option<u64> {
        let greetings = self.ends.iter().filter_map(|end| match end {
            End::Greeting { until_ns, .. } => Some(*until_ns),
            End::Live { .. } => None,
        });
        let wants = self.wants.values().filter(|want| !want.busy).map(|want| want.next_ns);
        let beat = self.is_live().then_some(self.beat_ns + BEAT_NS);
        let listen = (now < self.listen_ns).then_some(self.listen_ns);
        greetings.chain(wants).chain(beat).chain(listen).chain([self.place_ns]).min()
    }

    fn is_live(&self) -> bool {
        self.ends.iter().any(|end| matches!(end, End::Live { .. }))
    }

    /// Index of the caller's greeting that gives way to a new one: the oldest of those that said nothing yet,
    /// else the oldest. `None` while there is room.
    fn gives_way(&self) -> Option<usize> {
        let guests = self.ends.iter().enumerate().filter_map(|(at, end)| match end {
            End::Greeting { until_ns, stage, .. } => Some((stage.is_guest()?, *until_ns, at)),
            End::Live { .. } => None,
        });
        let guests: Vec<_> = guests.collect();
        (guests.len() >= MOST_GREETINGS).then(|| guests.iter().min().map(|(.., at)| *at)).flatten()
    }

    fn dial(&mut self, now: u64) {
        let due: Vec<PathBuf> = self
            .wants
            .iter()
            .filter(|(_, want)| !want.busy && want.next_ns <= now)
            .map(|(at, _)| at.clone())
            .collect();
        for at in due {
            let said = Greeting::Hello { version: VERSION, card: self.card.clone() };
            let dialled = address::dial(&at).and_then(|socket| {
                let (pid, uid) = other_end(&socket)?;
                let foreign = self.foreign(uid);
                // A listener of another user learns nothing of this process.
                if foreign.is_none() {
                    send(socket.as_fd(), &[&said.encode()], &[])?;
                }
                Ok((pid, socket, foreign))
            });
            match dialled {
                Ok((_, _, Some(why))) => {
                    let why = format!("another user's process listens at {}: {why}", at.display());
                    self.failed(&at, Failed { why, refused: true }, now);
                }
                Ok((pid, socket, None)) => {
                    if let Some(want) = self.wants.get_mut(&at) {
                        want.busy = true;
                    }
                    let until_ns = now + GREETING_NS;
                    self.ends.push(End::Greeting {
                        socket,
                        pid,
                        until_ns,
                        stage: Box::new(Stage::Calling { at }),
                    });
                }
                Err(e) => {
                    let why = format!("nobody answers at {}: {e}", at.display());
                    self.failed(&at, Failed { why, refused: false }, now);
                }
            }
        }
    }

    fn failed(&mut self, at: &PathBuf, failed: Failed, now: u64) {
        if let Some(want) = self.wants.get_mut(at) {
            want.busy = false;
            want.next_ns = now + if failed.refused { REFUSED_NS } else { REDIAL_NS };
            self.shared.known().failed.insert(at.clone(), failed);
        }
    }

    /// Accepts as many at a time as may greet at once, so that each of them is listened to.
    fn accept(&mut self, now: u64) {
        for _ in 0..MOST_GREETINGS {
            match rustix::net::accept_with(&self.listener, SocketFlags::CLOEXEC | SocketFlags::NONBLOCK) {
                Ok(socket) => self.admit(socket, now),
                Err(Errno::INTR | Errno::CONNABORTED) => {}
                Err(Errno::AGAIN) => return,
                // The spare file makes room: the caller hears why it is not let in.
                Err(Errno::MFILE | Errno::NFILE) if self.spare.take().is_some() => {}
                Err(e) => {
                    self.no_files
                        .warn(now, &format!("no other process can reach this one for a moment: {e}"));
                    self.listen_ns = now + NO_FILES_NS;
                    return;
                }
            }
        }
    }

    fn spare_a_file(&mut self) {
        if self.spare.is_none() {
            // No second number of the listener: that one would count as lasting (`trocar_rt::os::Lasting`).
            self.spare = File::open("/dev/null").map(OwnedFd::from).ok();
        }
    }

    /// Listens anew where the socket's path was removed, as by emptying a state directory. Processes find
    /// each other by that path: a later one would not find this process.
    fn keep_place(&mut self, now: u64) {
        if now < self.place_ns {
            return;
        }
        self.place_ns = now + PLACE_NS;
        let path = &self.card.socket;
        if !address::is_gone(path) {
            return;
        }
        match address::listen_anew(&mut self.listener, path) {
            Ok(()) => log::warn!("{} was removed, and was made again", path.display()),
            Err(e) => self.no_place.warn(now, &format!("no other process can reach this one: {e}")),
        }
    }

    /// Reason why this process greets no process of this user, at either end. The card's user comes later and
    /// does not count here.
    fn foreign(&self, uid: u32) -> Option<String> {
        let own = self.card.uid;
        (uid != own).then(|| format!("user {uid} is not the user of this process, {own}"))
    }

    /// Admits a caller: only processes of the same user may greet, as the kernel tells it.
    fn admit(&mut self, socket: OwnedFd, now: u64) {
        let Ok((pid, uid)) = other_end(&socket) else { return };
        if let Some(why) = self.foreign(uid) {
            self.turn_away(pid, &why, now);
            refuse(&socket, why);
            return;
        }
        if let Some(at) = self.gives_way() {
            // The greeting ends untold: a friend among the crowd calls again sooner than one that was
            // refused.
            self.ends.swap_remove(at);
        }
        self.ends.push(End::Greeting {
            socket,
            pid,
            until_ns: now + GREETING_NS,
            stage: Box::new(Stage::Knocking),
        });
    }

    fn turn_away(&mut self, pid: i32, why: &str, now: u64) {
        self.turned_away.warn(now, &format!("process {pid} was turned away: {why}"));
    }

    /// Reads what one socket has.
    fn listen(&mut self, at: usize, now: u64) {
        for _ in 0..AT_ONCE {
            if matches!(&self.ends[at], End::Live { session, .. } if session.is_full()) {
                return;
            }
            let heard = receive(self.ends[at].socket(), &mut self.room);
            match heard {
                Heard::Nothing => return,
                Heard::End => return self.close(at, Lost::Closed, now),
                Heard::TooLong => {
                    let what = format!("a message of more than {} bytes", MOST_BYTES);
                    return self.close(at, Lost::Nonsense { what }, now);
                }
                Heard::Message(bytes, files) => {
                    if !self.hear(at, bytes, files, now) {
                        return;
                    }
                }
            }
        }
    }

    /// Returns true while there may be more from this socket.
    fn hear(&mut self, at: usize, bytes: usize, files: Vec<OwnedFd>, now: u64) -> bool {
        let said = match parse(&self.room[..bytes]) {
            Ok(said) => said,
            Err(what) => {
                self.close(at, Lost::Nonsense { what }, now);
                return false;
            }
        };
        match (said, &self.ends[at]) {
            (Said::Data { files: announced, bytes }, End::Live { session, .. }) => {
                let message = session.message(bytes, files, announced);
                self.handler.said(&session.clone(), message);
                true
            }
            (Said::Greeting(said), End::Greeting { .. }) => self.greet(at, said, files, now),
            (said, _) => {
                let what = match said {
                    Said::Data { .. } => "data before the greeting was over",
                    Said::Greeting(_) => "a greeting in the middle of a session",
                };
                self.close(at, Lost::Nonsense { what: what.into() }, now);
                false
            }
        }
    }

    /// Takes the next step of a greeting.
    fn greet(&mut self, at: usize, said: Greeting, files: Vec<OwnedFd>, now: u64) -> bool {
        let End::Greeting { socket, pid, until_ns, stage } = self.ends.swap_remove(at) else { return false };
        let dialled = stage.at().cloned();
        let next = match (&*stage, self.guests_of(pid)) {
            (Stage::Knocking, (all, of_one)) if all >= MOST_GUESTS || of_one >= MOST_OF_ONE => {
                let why =
                    format!("it has {of_one} sessions with this process already, others {}", all - of_one);
                Err(Refusal::told(why))
            }
            (Stage::Knocking, _) if self.spare.is_none() => {
                Err(Refusal::told(format!("it has no room for a session: {}", Errno::MFILE)))
            }
            _ => step(&self.card, &socket, *stage, said, files),
        };
        match next {
            Ok(Step::On(stage)) => {
                let stage = Box::new(stage);
                self.ends.push(End::Greeting { socket, pid, until_ns, stage });
            }
            Ok(Step::Met(card, pulse)) => self.meet(socket, pid, card, pulse, dialled, now),
            Err(Refusal { why, by }) => {
                if by == By::Us {
                    refuse(&socket, why.clone());
                }
                match &dialled {
                    Some(at) => self.failed(at, Failed { why, refused: by != By::Nobody }, now),
                    None => self.turn_away(pid, &why, now),
                }
            }
        }
        // The socket now stands elsewhere in the list; the next look finds it.
        false
    }

    /// Returns the number of sessions that others began, and how many of them this process began.
    fn guests_of(&self, pid: i32) -> (usize, usize) {
        let guests = self.ends.iter().filter_map(|end| match end {
            End::Live { session, .. } => session.is_guest().then_some(session.peer().pid),
            End::Greeting { .. } => None,
        });
        guests.fold((0, 0), |(all, of_one), of| (all + 1, of_one + usize::from(of == pid)))
    }

    fn meet(
        &mut self,
        socket: OwnedFd,
        pid: i32,
        card: Card,
        pulse: Pulse,
        dialled: Option<PathBuf>,
        now: u64,
    ) {
        self.sessions += 1;
        pulse.beat(now);
        let peer = Peer { process: card.process, instance: card.instance, pid };
        let session =
            Arc::new(Session::new(self.sessions, peer, (card.socket, dialled.is_none()), socket, pulse));
        if let Some(at) = dialled {
            // The session is not wanted any more.
            if !self.wants.contains_key(&at) {
                return;
            }
            let mut known = self.shared.known();
            known.failed.remove(&at);
            known.dialled.insert(at, session.clone());
        }
        if !self.is_live() {
            self.beat_ns = now;
        }
        if let Some(robust_words) = &mut self.robust_words
            && let Err(e) = robust_words.add(&session.pulse)
        {
            let process = &session.peer().process;
            log::info!("process {process} hears of the end of this one by its socket only: {e}");
        }
        let watched = self.watch.add(&session);
        self.ends.push(End::Live { session: session.clone(), heart: Heart::new(now), watched });
        self.handler.met(&session);
    }

    /// Ends the session of a process that died: its last messages are heard, nothing else is awaited of it.
    fn died(&mut self, number: u64) {
        let now = now_ns();
        let is_it = |end: &End| matches!(end, End::Live { session, .. } if session.number() == number);
        if let Some(at) = self.ends.iter().position(is_it) {
            self.listen(at, now);
        }
        if let Some(at) = self.ends.iter().position(is_it) {
            self.close(at, Lost::Died, now);
        }
    }

    fn close(&mut self, at: usize, why: Lost, now: u64) {
        match self.ends.swap_remove(at) {
            End::Live { session, .. } => {
                let why = match session.why_ended().unwrap_or(why) {
                    // The end of the socket may be seen first, on a busy machine.
                    Lost::Closed if session.pulse.life() == Life::Died => Lost::Died,
                    why => why,
                };
                if let Lost::Nonsense { what } = &why {
                    let process = &session.peer().process;
                    self.unheard.warn(now, &format!("process {process} is not listened to any more: {what}"));
                }
                self.lose(&session, &why);
            }
            End::Greeting { stage, pid, socket, .. } => match stage.at() {
                Some(at) => {
                    let why = format!("{} does not greet: {why}", at.display());
                    self.failed(at, Failed { why, refused: false }, now);
                }
                None => {
                    if let Lost::Nonsense { what } = why {
                        self.turn_away(pid, &what, now);
                        refuse(&socket, what);
                    }
                }
            },
        }
    }

    fn lose(&mut self, session: &Arc<Session>, why: &Lost) {
        session.give_up();
        let now = now_ns();
        let mut wanted = Vec::new();
        self.shared.known().dialled.retain(|at, known| {
            let keep = !Arc::ptr_eq(known, session);
            if !keep {
                wanted.push(at.clone());
            }
            keep
        });
        for at in wanted {
            self.failed(&at, Failed { why: why.to_string(), refused: false }, now);
        }
        self.handler.lost(session, why);
        self.watch.remove(session);
        if let Some(robust_words) = &mut self.robust_words {
            robust_words.remove(&session.pulse);
        }
    }

    fn look_at_hearts(&mut self, now: u64) {
        let due = self.beat_ns + BEAT_NS;
        if now < due {
            return;
        }
        self.beat_ns = now;
        let mut gone = Vec::new();
        for (at, end) in self.ends.iter_mut().enumerate() {
            let End::Live { session, heart, watched } = end else { continue };
            session.pulse.beat(now);
            let pid = session.peer().pid;
            // The word may come after the process was met.
            *watched = *watched || self.watch.add(session);
            if session.pulse.life() == Life::Died {
                gone.push((at, Lost::Died));
            } else if let Some(why) = heart.look(session.pulse.theirs(), now, now - due, || kernel_says(pid))
            {
                gone.push((at, why));
            }
        }
        for (at, why) in gone.into_iter().rev() {
            self.close(at, why, now);
        }
    }

    fn end_late_greetings(&mut self, now: u64) {
        for at in (0..self.ends.len()).rev() {
            let End::Greeting { until_ns, .. } = &self.ends[at] else { continue };
            if *until_ns <= now {
                self.close(at, Lost::Silent { ms: GREETING_NS / 1_000_000 }, now);
            }
        }
    }
}

/// Returns process and user of the other end, as the kernel tells it; of a listener, those at the time it
/// began to listen.
fn other_end(socket: &OwnedFd) -> rustix::io::Result<(i32, u32)> {
    let who = rustix::net::sockopt::socket_peercred(socket)?;
    Ok((who.pid.as_raw_nonzero().get(), who.uid.as_raw()))
}
