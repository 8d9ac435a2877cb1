//! The handle on all lines of this process, and the threads that dial.
//!
//! Invariant: a process that is wanted is dialled until it answers, and again whenever its line is lost, by
//! one thread of its own.

use std::collections::BTreeMap;
use std::io;
use std::net::{SocketAddr, TcpStream, ToSocketAddrs};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use parking_lot::Mutex;
use rustls::pki_types::ServerName;
use rustls::{ClientConnection, Connection};
use trocar_rt::house;
use trocar_rt::os::now_ns;
use trocar_rt::wake::Waker;

use super::door::Door;
use super::greeting::{Refused, Who, call, call_beside};
use super::guests::Guests;
use super::wire::{Inbox, Wire};
use super::{Clock, Handler, Line, Track, run};
use crate::holder::Holder;
use crate::identity::Identity;
use crate::revoked::Revoked;
use crate::tls::{Client, Server};

/// Time for a connection and the greeting on it.
pub(super) const GREETING: Duration = Duration::from_secs(2);
/// Pause before a process that did not answer is dialled again, ns.
const REDIAL_NS: u64 = 20_000_000;
/// As above, for one that refused: it will hardly change its mind, ns.
const REFUSED_NS: u64 = 1_000_000_000;
/// Time between two lines of the log about callers that were turned away.
const TELL: Duration = Duration::from_secs(10);
/// The protocol of lines (ALPN).
const PROTOCOL: &str = "trocar-line";

/// A process of another machine, and where it listens.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Place {
    pub process: String,
    /// Which run of it.
    pub instance: String,
    /// `HOST:PORT`.
    pub address: String,
}

/// This process, as it is known at its ends of lines.
#[derive(Clone, Debug)]
pub struct Ends {
    pub who: Who,
    pub identity: Arc<Identity>,
    pub revoked: Option<Arc<Revoked>>,
    /// Bytes/s that a line sends at most of what is long.
    pub most_rate: Option<u64>,
}

/// All lines of this process.
pub struct Lines {
    shared: Arc<Shared>,
    door: Mutex<Option<Door>>,
}

pub(super) struct Shared {
    pub(super) ends: Ends,
    client: Client,
    pub(super) server: Server,
    handler: Box<dyn Handler>,
    wants: Mutex<BTreeMap<Place, Want>>,
    numbers: AtomicU64,
    pub(super) over: AtomicBool,
    /// Lines that live, to be ended at the end.
    lines: Mutex<Vec<Arc<Line>>>,
    /// Lines that other processes have begun.
    pub(super) guests: Guests,
    threads: Mutex<Vec<JoinHandle<()>>>,
    /// When the log was told last of somebody who was turned away, and how many were since.
    away: Mutex<(Option<Instant>, u64)>,
}

struct Want {
    times: usize,
    /// There is a thread that dials.
    dials: bool,
    /// Tells the thread that dials from one of an earlier want; rung when it is not wanted any more.
    bell: Arc<Waker>,
    line: Option<Arc<Line>>,
    failed: Option<Refused>,
}

impl Lines {
    /// Listens at an address; port 0 takes a free one.
    ///
    /// # Errors
    /// The address cannot be had, the identity is not taken, or the machine gives no more threads.
    pub fn start(listen: SocketAddr, ends: Ends, handler: impl Handler) -> io::Result<Lines> {
        let not = |why: String| io::Error::new(io::ErrorKind::InvalidInput, why);
        let (identity, revoked) = (&ends.identity, &ends.revoked);
        let client = Client::of_processes(identity.clone(), revoked.clone(), &[PROTOCOL]).map_err(not)?;
        let server = Server::new(identity.clone(), revoked.clone(), &[PROTOCOL]).map_err(not)?;
        let shared = Arc::new(Shared {
            ends,
            client,
            server,
            handler: Box::new(handler),
            wants: Mutex::default(),
            numbers: AtomicU64::new(1),
            over: AtomicBool::new(false),
            lines: Mutex::default(),
            guests: Guests::default(),
            threads: Mutex::default(),
            away: Mutex::default(),
        });
        let door = Door::open(listen, shared.clone())?;
        Ok(Lines { shared, door: Mutex::new(Some(door)) })
    }

    /// The port it listens at.
    pub fn port(&self) -> u16 {
        self.door.lock().as_ref().map_or(0, Door::port)
    }

    /// Wants a line with that process: it is dialled until it answers, and again whenever the line is lost.
    /// Each call needs one call to leave it.
    pub fn want(&self, place: &Place) {
        let mut wants = self.shared.wants.lock();
        let want = wants.entry(place.clone()).or_insert_with(Want::new);
        want.times += 1;
        if want.dials {
            return;
        }
        let (shared, there, mine) = (self.shared.clone(), place.clone(), want.bell.clone());
        let thread = std::thread::Builder::new().name("trocar-dial".into());
        match house::spawn(thread, move || shared.dial(&there, &mine)) {
            Ok(thread) => {
                want.dials = true;
                self.shared.keep(thread);
            }
            // The next call tries again.
            Err(e) => want.failed = Some(format!("this process gets no thread to dial it: {e}").into()),
        }
    }

    /// Leaves the line: this caller does not need it any more.
    pub fn leave(&self, place: &Place) {
        let mut wants = self.shared.wants.lock();
        let Some(want) = wants.get_mut(place) else { return };
        want.times -= 1;
        if want.times == 0
            && let Some(want) = wants.remove(place)
        {
            drop(wants);
            want.end();
        }
    }

    /// The live line that was wanted.
    pub fn line(&self, place: &Place) -> Option<Arc<Line>> {
        self.shared.wants.lock().get(place)?.line.clone().filter(|line| !line.is_lost())
    }

    /// Returns why there is no line with that process, as it was found last.
    pub fn why_not(&self, place: &Place) -> Option<String> {
        self.shared.wants.lock().get(place)?.failed.as_ref().map(|failed| failed.why.clone())
    }

    /// As [`Lines::why_not`], where one end said no: to wait for it is of little use.
    pub fn refused(&self, place: &Place) -> Option<String> {
        let wants = self.shared.wants.lock();
        wants.get(place)?.failed.as_ref().filter(|failed| failed.for_long).map(|failed| failed.why.clone())
    }

    /// Ends all lines and threads.
    pub fn stop(&self) {
        self.shared.over.store(true, Ordering::Release);
        // Nobody comes in any more before the lines are ended.
        drop(self.door.lock().take());
        let wants = std::mem::take(&mut *self.shared.wants.lock());
        wants.into_values().for_each(Want::end);
        for line in std::mem::take(&mut *self.shared.lines.lock()) {
            line.end("ended from here");
        }
        for thread in std::mem::take(&mut *self.shared.threads.lock()) {
            if thread.join().is_err() {
                log::error!("a thread of the lines to other machines panicked");
            }
        }
    }
}

impl Drop for Lines {
    fn drop(&mut self) {
        self.stop();
    }
}

impl Want {
    fn new() -> Want {
        Want { times: 0, dials: false, bell: Arc::new(Waker::new()), line: None, failed: None }
    }

    fn end(self) {
        if let Some(line) = &self.line {
            line.end("ended from here");
        }
        self.bell.notify();
    }
}

impl Shared {
    /// Keeps the handle of a thread until the end; those that have ended go.
    pub(super) fn keep(&self, thread: JoinHandle<()>) {
        let mut threads = self.threads.lock();
        threads.retain(|thread| !thread.is_finished());
        threads.push(thread);
    }

    /// Tells of a caller that was turned away: a line every ten seconds at most.
    pub(super) fn turned_away(&self, from: SocketAddr, why: &str) {
        let mut away = self.away.lock();
        away.1 += 1;
        if away.0.is_none_or(|told| told.elapsed() >= TELL) {
            let (_, count) = std::mem::replace(&mut *away, (Some(Instant::now()), 0));
            log::warn!("a caller at {from} was turned away, {count} since the last such line: {why}");
        }
    }

    /// Dials a process until it is wanted no more.
    fn dial(&self, place: &Place, mine: &Arc<Waker>) {
        while self.is_wanted(place, mine) {
            let pause_ns = match self.call(place) {
                Ok((line, inboxes)) => {
                    if self.note(place, mine, |want| (want.line, want.failed) = (Some(line.clone()), None)) {
                        self.serve(&line, inboxes);
                        let why = format!("the line with it was lost: {}", line.why());
                        let failed = Some(Refused { why, for_long: false });
                        self.note(place, mine, |want| (want.line, want.failed) = (None, failed));
                    }
                    REDIAL_NS
                }
                Err(refused) => {
                    let pause_ns = if refused.for_long { REFUSED_NS } else { REDIAL_NS };
                    self.note(place, mine, |want| want.failed = Some(refused));
                    pause_ns
                }
            };
            mine.wait(Some(now_ns() + pause_ns));
        }
    }

    fn is_wanted(&self, place: &Place, mine: &Arc<Waker>) -> bool {
        self.note(place, mine, |_| ())
    }

    /// Changes the want that this thread dials for; false when it is gone.
    fn note(&self, place: &Place, mine: &Arc<Waker>, change: impl FnOnce(&mut Want)) -> bool {
        let mut wants = self.wants.lock();
        let want = wants.get_mut(place).filter(|want| Arc::ptr_eq(&want.bell, mine));
        let is_wanted = want.is_some() && !self.over.load(Ordering::Acquire);
        if let Some(want) = want {
            change(want);
        }
        is_wanted
    }

    /// Begins a line with both its connections.
    fn call(&self, place: &Place) -> Result<(Arc<Line>, [Inbox; 2]), Refused> {
        let until = Instant::now() + GREETING;
        let (mut wire, holder, inbox) = self.connect(place, until)?;
        let met = call((&mut wire, inbox), &holder, &self.ends.who, until)?;
        let (wanted, found) = ((&place.process, &place.instance), (&met.who.process, &met.who.instance));
        if wanted != found {
            let why = format!(
                "{} answers at {}, in place of the run of {} that was meant",
                found.0, place.address, wanted.0
            );
            return Err(Refused { why, for_long: true });
        }
        let (mut beside, its, inbox) = self.connect(place, until)?;
        let second = call_beside((&mut beside, inbox), &its, &self.ends.who, (&met, until))?;
        let line = self.line(met.who, (self.number(), holder), [wire, beside], met.clock);
        Ok((line, [met.inbox, second]))
    }

    fn connect(&self, place: &Place, until: Instant) -> Result<(Wire, Holder, Inbox), Refused> {
        let at = format!("{} at {}", place.process, place.address);
        let stream = connect(&place.address, until).map_err(|why| format!("{at}: {why}"))?;
        // The name is not looked at: a process is known by its certificate.
        let name = ServerName::IpAddress(std::net::IpAddr::from([127, 0, 0, 1]).into());
        let tls = ClientConnection::new(self.client.config(), name).map_err(|e| e.to_string())?;
        Wire::greeted(stream, Connection::Client(tls), until).map_err(|refused| refused.by(&at))
    }

    /// A number that no other line of this process has.
    pub(super) fn number(&self) -> u64 {
        self.numbers.fetch_add(1, Ordering::Relaxed)
    }

    pub(super) fn line(
        &self,
        who: Who,
        (number, holder): (u64, Holder),
        [prompt, bulk]: [Wire; 2],
        clock: Clock,
    ) -> Arc<Line> {
        Arc::new(Line {
            number,
            who,
            holder,
            clock,
            said: Mutex::default(),
            prompt: Track::new(prompt),
            bulk: Track::new(bulk),
            most_rate: self.ends.most_rate,
            lost: AtomicBool::new(false),
            why: Mutex::default(),
        })
    }

    /// Lets in a line that the other end has begun, and serves it until it is lost.
    pub(super) fn let_in(&self, line: &Arc<Line>, inboxes: [Inbox; 2]) -> Result<(), Refused> {
        self.guests.add(line)?;
        self.serve(line, inboxes);
        self.guests.remove(line);
        Ok(())
    }

    /// Serves a line on this thread until it is lost.
    fn serve(&self, line: &Arc<Line>, inboxes: [Inbox; 2]) {
        self.lines.lock().push(line.clone());
        if self.over.load(Ordering::Acquire) {
            line.end("ended from here");
        }
        let traffic = self.handler.met(line);
        run::run(line, &traffic, inboxes, self.ends.revoked.clone());
        self.lines.lock().retain(|other| !Arc::ptr_eq(other, line));
        self.handler.lost(line, &line.why());
    }
}

fn connect(address: &str, until: Instant) -> Result<TcpStream, String> {
    let mut why = "its name has no address".to_owned();
    for at in address.to_socket_addrs().map_err(|e| e.to_string())? {
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() {
            break;
        }
        match TcpStream::connect_timeout(&at, left) {
            Ok(stream) => return Ok(stream),
            Err(e) => why = e.to_string(),
        }
    }
    Err(why)
}
