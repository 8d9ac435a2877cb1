//! A small HTTP server on the loopback address: a list of what there is, and each stream as MJPEG.
//!
//! Invariant: it answers this machine only, takes a bounded number of connections, gives none of them more
//! than a bounded time, and has ended all its threads when it is dropped. Displays with the same port share
//! one server.

use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::net::{Ipv4Addr, Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU16, AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use trocar_imaging::pixels::Part;
use trocar_imaging::side;
use trocar_sdk::prelude::*;

use crate::mjpeg::Stream;
use crate::{reply, request};

/// Viewers at a time.
const VIEWERS: u32 = 16;
/// Connections whose request is not there yet; beyond them the oldest is closed. Many, for honest ones may
/// come in a burst.
const ASKING: usize = 64;
/// Longest time that a request may take to come.
const REQUEST: Duration = Duration::from_secs(2);
/// The server looks so often for new connections.
const LOOKS: Duration = Duration::from_millis(20);
/// A port that somebody has is tried for so long, and so often: a process that dies keeps its own for a
/// while.
const TRIES: Duration = Duration::from_secs(if cfg!(test) { 1 } else { 5 });
const TRIED_EVERY: Duration = Duration::from_millis(50);

named_values! {
    /// Whether browsers can see a display.
    pub struct Serving: u32 {
        /// Nobody asked for it.
        OFF = 0,
        /// Somebody else has the port; it is tried again for a while.
        WAITING = 1,
        /// The server answers.
        LISTENING = 2,
        /// Somebody else kept the port.
        REFUSED = 3,
    }
}

/// The servers of this process.
static SERVERS: Mutex<Vec<Weak<Server>>> = Mutex::new(Vec::new());

/// A server; dropped, it ends.
pub(crate) struct Server {
    /// As asked for; 0 was made the port that was free.
    port: u16,
    shared: Arc<Shared>,
    accepting: Option<JoinHandle<()>>,
}

#[derive(Default)]
struct Shared {
    streams: Mutex<BTreeMap<String, Arc<Stream>>>,
    ends: AtomicBool,
    connections: Mutex<Vec<Connection>>,
    viewers: AtomicU32,
    /// A value of [`Serving`].
    serving: AtomicU16,
}

/// A connection, and the thread that answers it.
struct Connection {
    end: TcpStream,
    thread: JoinHandle<()>,
    /// Its request is not there yet.
    asks: Arc<AtomicBool>,
}

/// A stream's place on a server; dropped, it is free again.
pub(crate) struct Place {
    server: Arc<Server>,
    name: String,
}

impl Shared {
    fn is(&self, serving: Serving) -> bool {
        u32::from(self.serving.load(Ordering::Acquire)) == serving.0
    }

    fn becomes(&self, serving: Serving) {
        self.serving.store(serving.0 as u16, Ordering::Release);
    }
}

impl Server {
    /// The server at a port of the loopback address; 0 makes one at a free port. Where somebody else has the
    /// port, it is tried again for a while by the server's thread.
    ///
    /// # Errors
    /// The system refuses the port for another reason, or has no thread.
    pub(crate) fn at(port: u16) -> Result<Arc<Server>> {
        let mut servers = held(&SERVERS);
        servers.retain(|server| server.strong_count() > 0);
        let same = |s: &Arc<Server>| port != 0 && s.port == port && !s.shared.is(Serving::REFUSED);
        if let Some(there) = servers.iter().filter_map(Weak::upgrade).find(same) {
            return Ok(there);
        }
        let listener = match listen(port) {
            Ok(listener) => Some(listener),
            Err(why) if why.kind() == ErrorKind::AddrInUse && port != 0 => {
                log::info!(
                    "mjpeg_port: another program has {port} at the moment; it is tried again for {TRIES:?}"
                );
                None
            }
            Err(why) => {
                return Err(format!(
                    "mjpeg_port: {port} on 127.0.0.1 cannot be had: {why}; choose another one, or 0 for any free one"
                )
                .into());
            }
        };
        let port = listener.as_ref().map_or(Ok(port), |l| l.local_addr().map(|at| at.port()))?;
        let shared = Arc::new(Shared::default());
        shared.becomes(if listener.is_some() { Serving::LISTENING } else { Serving::WAITING });
        let serving = shared.clone();
        // The thread serves all displays at this port, so it has the name of none.
        let accepting = side::spawn("trocar-http", move || {
            let listener = listener.or_else(|| wait_for(port, &serving.ends));
            let Some(listener) = listener else {
                serving.becomes(Serving::REFUSED);
                if !serving.ends.load(Ordering::Acquire) {
                    log::warn!("{}", refusal(port));
                }
                return;
            };
            serving.becomes(Serving::LISTENING);
            accept(&listener, &serving);
        })
        .map_err(|why| format!("no thread for the server: {why}"))?;
        let server = Arc::new(Server { port, shared, accepting: Some(accepting) });
        servers.push(Arc::downgrade(&server));
        Ok(server)
    }

    /// Shows a stream under its name.
    ///
    /// # Errors
    /// Another display has the name.
    pub(crate) fn show(self: &Arc<Self>, stream: Arc<Stream>) -> Result<Place> {
        let mut streams = held(&self.shared.streams);
        let name = stream.name.clone();
        if streams.contains_key(&name) {
            let port = self.port;
            return Err(format!(
                "name: another display at port {port} is called {name}; choose another name"
            )
            .into());
        }
        streams.insert(name.clone(), stream);
        Ok(Place { server: self.clone(), name })
    }
}

impl Place {
    /// Whether browsers can come, and by which port; 0 while they cannot.
    pub(crate) fn serving(&self) -> (Serving, u16) {
        let serving = Serving(self.server.shared.serving.load(Ordering::Acquire).into());
        (serving, if serving == Serving::LISTENING { self.port() } else { 0 })
    }

    /// The port of its server, whether it can be had or not.
    pub(crate) fn port(&self) -> u16 {
        self.server.port
    }
}

/// Why browsers cannot come; said once, by the server's thread.
fn refusal(port: u16) -> String {
    format!(
        "mjpeg_port: {port} on 127.0.0.1 cannot be had: another program kept it for {TRIES:?}; no browser sees what is shown \
         there. Choose another one, or 0 for any free one, and start again"
    )
}

impl Drop for Place {
    fn drop(&mut self) {
        if let Some(stream) = held(&self.server.shared.streams).remove(&self.name) {
            stream.close();
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.shared.ends.store(true, Ordering::Release);
        if let Some(accepting) = self.accepting.take() {
            let _ = accepting.join();
        }
        for connection in held(&self.shared.connections).drain(..) {
            let _ = connection.end.shutdown(Shutdown::Both);
            let _ = connection.thread.join();
        }
    }
}

fn held<T>(lock: &Mutex<T>) -> MutexGuard<'_, T> {
    lock.lock().unwrap_or_else(PoisonError::into_inner)
}

fn listen(port: u16) -> std::io::Result<TcpListener> {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port))?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

/// Tries a port until it is free; `None` when that takes too long.
fn wait_for(port: u16, ends: &AtomicBool) -> Option<TcpListener> {
    let until = Instant::now() + TRIES;
    while !ends.load(Ordering::Acquire) && Instant::now() < until {
        if let Ok(listener) = listen(port) {
            return Some(listener);
        }
        std::thread::sleep(TRIED_EVERY);
    }
    None
}

fn accept(listener: &TcpListener, shared: &Arc<Shared>) {
    while !shared.ends.load(Ordering::Acquire) {
        match listener.accept() {
            Ok((connection, _)) => take(connection, shared),
            // Nobody there; or no descriptors, which may pass.
            Err(why) if why.kind() == ErrorKind::WouldBlock => std::thread::sleep(LOOKS),
            Err(_) => std::thread::sleep(10 * LOOKS),
        }
    }
}

fn take(connection: TcpStream, shared: &Arc<Shared>) {
    let prepared = connection.set_nonblocking(false).and_then(|()| connection.set_nodelay(true));
    let (Ok(()), Ok(end)) = (prepared, connection.try_clone()) else { return };
    let mut connections = held(&shared.connections);
    connections.retain(|connection| !connection.thread.is_finished());
    // Connections that ask nothing make room for others: the oldest has had its time.
    let asking = |connection: &&Connection| connection.asks.load(Ordering::Acquire);
    if connections.iter().filter(asking).count() >= ASKING
        && let Some(oldest) = connections.iter().find(asking)
    {
        oldest.asks.store(false, Ordering::Release);
        let _ = oldest.end.shutdown(Shutdown::Both);
    }
    let (serving, asks) = (shared.clone(), Arc::new(AtomicBool::new(true)));
    let asked = asks.clone();
    let thread = side::spawn("trocar-viewer", move || {
        // A viewer that went away is nobody's trouble.
        let _ = serve(&connection, &serving, &asked);
        let _ = connection.shutdown(Shutdown::Both);
    });
    if let Ok(thread) = thread {
        connections.push(Connection { end, thread, asks });
    }
}

/// One request, and its answer.
fn serve(connection: &TcpStream, shared: &Shared, asks: &AtomicBool) -> std::io::Result<()> {
    let asked = request::read(connection, REQUEST)?;
    asks.store(false, Ordering::Release);
    let path = match asked {
        Ok(path) => path,
        Err(request::Refusal(status, why)) => return reply::text(connection, status, why),
    };
    if path == "/" {
        let names: Vec<String> = held(&shared.streams).keys().cloned().collect();
        return reply::list(connection, names.iter());
    }
    let mut pieces = path.trim_start_matches('/').split('/');
    let wanted = (pieces.next(), pieces.next(), pieces.next().unwrap_or("both"), pieces.next());
    let (Some("stream"), Some(name), part, None) = wanted else {
        return reply::text(connection, "404 Not Found", "there is / and /stream/NAME\n");
    };
    let stream = held(&shared.streams).get(name).cloned();
    let part = Part::ALL.into_iter().find(|p| p.name() == part);
    let (Some(stream), Some(part)) = (stream, part) else {
        let there: Vec<String> = held(&shared.streams).keys().map(|name| format!("/stream/{name}")).collect();
        let there = if there.is_empty() { "no stream".to_owned() } else { there.join(", ") };
        let why = format!("there is {there}; each also with /left, /right or /both behind it\n");
        return reply::text(connection, "404 Not Found", &why);
    };
    let room = |viewers: u32| (viewers < VIEWERS).then_some(viewers + 1);
    if shared.viewers.fetch_update(Ordering::AcqRel, Ordering::Acquire, room).is_err() {
        let why = format!("{VIEWERS} viewers look already: close one\n");
        return reply::text(connection, "503 Service Unavailable", &why);
    }
    let shown = reply::pictures(connection, &stream, part, &shared.ends);
    shared.viewers.fetch_sub(1, Ordering::AcqRel);
    shown
}

#[cfg(test)]
#[path = "server_tests.rs"]
mod tests;
