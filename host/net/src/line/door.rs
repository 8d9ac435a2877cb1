//! The place where other machines' processes come in.
//!
//! Invariant: a stranger costs one thread for the time of a greeting, and so many of them at once and no
//! more; whoever comes while all places are taken is turned away at once.

use std::io;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, poll};
use rustls::{Connection, ServerConnection};
use trocar_rt::house;

use super::greeting::{Refused, answer, asked, turn_away};
use super::guests::Second;
use super::lines::{GREETING, Shared};
use super::wire::Wire;

/// Greetings that may be under way at once.
const MOST_GREETINGS: usize = 64;
/// Pause of listening where the process may open no more files.
const NO_FILES: Duration = Duration::from_millis(100);

pub(super) struct Door {
    port: u16,
    thread: Option<JoinHandle<()>>,
    /// Dropping it ends the thread.
    bell: Option<UnixStream>,
}

impl Door {
    pub(super) fn open(listen: SocketAddr, shared: Arc<Shared>) -> io::Result<Door> {
        let listener = TcpListener::bind(listen)?;
        listener.set_nonblocking(true)?;
        let port = listener.local_addr()?.port();
        let (bell, rung) = UnixStream::pair()?;
        let thread = std::thread::Builder::new().name("trocar-lines".into());
        let thread = house::spawn(thread, move || listen_at(&listener, &rung, &shared))?;
        Ok(Door { port, thread: Some(thread), bell: Some(bell) })
    }

    pub(super) fn port(&self) -> u16 {
        self.port
    }
}

impl Drop for Door {
    fn drop(&mut self) {
        drop(self.bell.take());
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            log::error!("the thread that lets lines in panicked");
        }
    }
}

fn listen_at(listener: &TcpListener, rung: &UnixStream, shared: &Arc<Shared>) {
    let guests = Arc::new(AtomicUsize::new(0));
    while !shared.over.load(Ordering::Acquire) {
        let mut looked = [
            PollFd::from_borrowed_fd(listener.as_fd(), PollFlags::IN),
            PollFd::from_borrowed_fd(rung.as_fd(), PollFlags::IN),
        ];
        // Interrupted: both are looked at again.
        let _ = poll(&mut looked, None);
        if !looked[1].revents().is_empty() {
            return;
        }
        match listener.accept() {
            Ok((stream, from)) => let_in(stream, from, &guests, shared),
            Err(e) if e.kind() == io::ErrorKind::WouldBlock => {}
            Err(e) => {
                log::warn!("no other machine reaches this process for a moment: {e}");
                std::thread::sleep(NO_FILES);
            }
        }
    }
}

/// A guest's place, given back when its greeting is over.
struct Seat(Arc<AtomicUsize>);

impl Drop for Seat {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

fn let_in(stream: TcpStream, from: SocketAddr, guests: &Arc<AtomicUsize>, shared: &Arc<Shared>) {
    let seat = Seat(guests.clone());
    if guests.fetch_add(1, Ordering::Relaxed) >= MOST_GREETINGS || stream.set_nonblocking(false).is_err() {
        return;
    }
    let mine = shared.clone();
    let thread = std::thread::Builder::new().name("trocar-greet".into());
    match house::spawn(thread, move || greet(stream, from, seat, &mine)) {
        Ok(thread) => shared.keep(thread),
        Err(e) => log::warn!("a process at {from} is not let in: no thread for it: {e}"),
    }
}

fn greet(stream: TcpStream, from: SocketAddr, seat: Seat, shared: &Shared) {
    if let Err(refused) = meet(stream, seat, shared) {
        shared.turned_away(from, &refused.why);
    }
}

/// Greets a caller, and serves the line that it begins.
fn meet(stream: TcpStream, seat: Seat, shared: &Shared) -> Result<(), Refused> {
    let until = Instant::now() + GREETING;
    let tls = ServerConnection::new(shared.server.config()).map_err(|e| e.to_string())?;
    let (mut wire, holder, mut inbox) = Wire::greeted(stream, Connection::Server(tls), until)?;
    let (who, line) = asked((&mut wire, &mut inbox), &holder, until)?;
    let own = &shared.ends.who;
    if line != 0 {
        let second = Second { who, serial: holder.serial, wire, inbox };
        return shared.guests.join(line, second, own);
    }
    let line = shared.number();
    let awaited = shared.guests.await_second(line, &who, &holder).inspect_err(|no| turn_away(&wire, no))?;
    let met = answer((&mut wire, inbox), (own, who), line, until)?;
    // The second connection takes a place, too: nobody keeps it out.
    drop(seat);
    let Some(second) = awaited.wait(until) else {
        return Err(format!("{} began a line and did not go on", met.who.process).into());
    };
    let line = shared.line(met.who, (line, holder), [wire, second.wire], met.clock);
    shared.let_in(&line, [met.inbox, second.inbox])
}
