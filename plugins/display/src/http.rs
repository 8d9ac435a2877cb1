//! A small HTTP server on the loopback address: a list of what there is, and each stream as MJPEG.
//!
//! Invariant: it answers this machine only, takes a bounded number of connections, gives none of them more than a bounded
//! time, and has ended all its threads when it is dropped. Displays with the same port share one server.

use std::collections::BTreeMap;
use std::io::{ErrorKind, Read, Write};
use std::net::{Ipv4Addr, Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::thread::JoinHandle;
use std::time::Duration;

use trocar_sdk::Result;

use crate::mjpeg::Stream;
use trocar_imaging::pixels::Part;

/// Connections at a time.
const MOST: usize = 16;
/// A viewer that takes nothing for so long is left.
const PATIENCE: Duration = Duration::from_secs(2);
/// Longest request, bytes.
const REQUEST: usize = 8 << 10;
/// How often it looks for new connections, and a viewer without pictures for the end of its stream.
const LOOKS: Duration = Duration::from_millis(20);
const BOUNDARY: &str = "trocar-frame";

/// The servers of this process.
static SERVERS: Mutex<Vec<Weak<Server>>> = Mutex::new(Vec::new());

/// A server; dropped, it ends.
pub(crate) struct Server {
    port: u16,
    shared: Arc<Shared>,
    accepting: Option<JoinHandle<()>>,
}

#[derive(Default)]
struct Shared {
    streams: Mutex<BTreeMap<String, Arc<Stream>>>,
    ends: AtomicBool,
    connections: Mutex<Vec<(TcpStream, JoinHandle<()>)>>,
}

/// A stream's place on a server; dropped, it is free again.
pub(crate) struct Place {
    server: Arc<Server>,
    name: String,
}

impl Server {
    /// The server at a port of the loopback address; 0 makes one at a free port.
    ///
    /// # Errors
    /// Somebody else has the port.
    pub(crate) fn at(port: u16) -> Result<Arc<Server>> {
        let mut servers = held(&SERVERS);
        servers.retain(|server| server.strong_count() > 0);
        if let Some(there) = servers.iter().filter_map(Weak::upgrade).find(|s| port != 0 && s.port == port) {
            return Ok(there);
        }
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port)).map_err(|why| {
            format!("mjpeg_port: {port} on 127.0.0.1 cannot be had: {why}; choose another one, or 0 for any free one")
        })?;
        listener.set_nonblocking(true)?;
        let port = listener.local_addr()?.port();
        let shared = Arc::new(Shared::default());
        let serving = shared.clone();
        let accepting = std::thread::Builder::new()
            .name("trocar-http".into())
            .spawn(move || accept(&listener, &serving))
            .map_err(|why| format!("no thread for the server: {why}"))?;
        let server = Arc::new(Server { port, shared, accepting: Some(accepting) });
        servers.push(Arc::downgrade(&server));
        Ok(server)
    }

    pub(crate) fn port(&self) -> u16 {
        self.port
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
    pub(crate) fn port(&self) -> u16 {
        self.server.port()
    }
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
        for (connection, thread) in held(&self.shared.connections).drain(..) {
            let _ = connection.shutdown(Shutdown::Both);
            let _ = thread.join();
        }
    }
}

fn held<T>(lock: &Mutex<T>) -> MutexGuard<'_, T> {
    lock.lock().unwrap_or_else(PoisonError::into_inner)
}

fn accept(listener: &TcpListener, shared: &Arc<Shared>) {
    while !shared.ends.load(Ordering::Acquire) {
        let connection = match listener.accept() {
            Ok((connection, _)) => connection,
            Err(why) => {
                // Nobody there; or no descriptors, which may pass.
                std::thread::sleep(if why.kind() == ErrorKind::WouldBlock { LOOKS } else { PATIENCE / 10 });
                continue;
            }
        };
        let mut connections = held(&shared.connections);
        connections.retain(|(_, thread)| !thread.is_finished());
        let full = connections.len() >= MOST;
        let (Ok(()), Ok(end)) = (prepare(&connection), connection.try_clone()) else { continue };
        if full {
            let _ = answer(
                &connection,
                "503 Service Unavailable",
                &format!("{MOST} connections are open: close one\n"),
            );
            continue;
        }
        let serving = shared.clone();
        let thread = std::thread::Builder::new().name("trocar-viewer".into()).spawn(move || {
            // A viewer that went away is nobody's trouble.
            let _ = serve(&connection, &serving);
            let _ = connection.shutdown(Shutdown::Both);
        });
        if let Ok(thread) = thread {
            connections.push((end, thread));
        }
    }
}

fn prepare(connection: &TcpStream) -> std::io::Result<()> {
    connection.set_nonblocking(false)?;
    connection.set_nodelay(true)?;
    connection.set_read_timeout(Some(PATIENCE))?;
    connection.set_write_timeout(Some(PATIENCE))
}

/// One request, and its answer.
fn serve(connection: &TcpStream, shared: &Shared) -> std::io::Result<()> {
    let path = match request(connection)? {
        Ok(path) => path,
        Err((status, why)) => return answer(connection, status, why),
    };
    if path == "/" {
        let list = list(&held(&shared.streams));
        return respond(connection, "200 OK", "text/html; charset=utf-8", list.as_bytes());
    }
    let mut pieces = path.trim_start_matches('/').split('/');
    let wanted = (pieces.next(), pieces.next(), pieces.next().unwrap_or("both"), pieces.next());
    let (Some("stream"), Some(name), part, None) = wanted else {
        return answer(connection, "404 Not Found", "there is / and /stream/NAME\n");
    };
    let stream = held(&shared.streams).get(name).cloned();
    let part = Part::ALL.into_iter().find(|p| p.name() == part);
    let (Some(stream), Some(part)) = (stream, part) else {
        let there: Vec<String> = held(&shared.streams).keys().map(|name| format!("/stream/{name}")).collect();
        let there = if there.is_empty() { "no stream".to_owned() } else { there.join(", ") };
        let why = format!("there is {there}; each also with /left, /right or /both behind it\n");
        return answer(connection, "404 Not Found", &why);
    };
    show(connection, &stream, part, &shared.ends)
}

/// The path of a request, or why it is refused.
fn request(
    mut connection: &TcpStream,
) -> std::io::Result<std::result::Result<String, (&'static str, &'static str)>> {
    let (mut bytes, mut filled) = ([0; REQUEST], 0);
    loop {
        let more = connection.read(&mut bytes[filled..])?;
        filled += more;
        let mut headers = [httparse::EMPTY_HEADER; 64];
        let mut request = httparse::Request::new(&mut headers);
        match request.parse(&bytes[..filled]) {
            Ok(httparse::Status::Complete(_)) => {
                let host = request.headers.iter().find(|header| header.name.eq_ignore_ascii_case("host"));
                return Ok(if request.method != Some("GET") {
                    Err(("405 Method Not Allowed", "only GET is answered here\n"))
                } else if host.is_some_and(|host| !is_loopback(host.value)) {
                    // A page from elsewhere whose name was made to lead here must not see the operating field.
                    Err(("403 Forbidden", "ask for 127.0.0.1 or localhost\n"))
                } else {
                    let path = request.path.unwrap_or("/");
                    Ok(path.split(['?', '#']).next().unwrap_or("/").to_owned())
                });
            }
            Ok(httparse::Status::Partial) if more > 0 && filled < bytes.len() => {}
            _ => return Ok(Err(("400 Bad Request", "this is no request of HTTP/1\n"))),
        }
    }
}

fn is_loopback(host: &[u8]) -> bool {
    let host = String::from_utf8_lossy(host);
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|b| b.is_ascii_digit()) => name,
        _ => &host,
    };
    matches!(name, "127.0.0.1" | "localhost" | "[::1]")
}

/// Sends pictures until the viewer goes, is too slow, or the stream ends.
fn show(
    mut connection: &TcpStream,
    stream: &Arc<Stream>,
    part: Part,
    ends: &AtomicBool,
) -> std::io::Result<()> {
    write!(
        connection,
        "HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary={BOUNDARY}\r\nCache-Control: no-store\r\n\
         Connection: close\r\n\r\n--{BOUNDARY}\r\n"
    )?;
    let mut viewer = stream.look(part);
    while !ends.load(Ordering::Acquire) {
        let Ok(picture) = viewer.next(10 * LOOKS) else { break };
        let Some(picture) = picture else {
            if is_gone(connection) {
                break;
            }
            continue;
        };
        write!(connection, "Content-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n", picture.len())?;
        connection.write_all(&picture)?;
        // The boundary behind it lets a browser show it now and not with the next one.
        write!(connection, "\r\n--{BOUNDARY}\r\n")?;
    }
    Ok(())
}

/// Whether a viewer to whom nothing is sent has closed its end.
fn is_gone(connection: &TcpStream) -> bool {
    let looked = connection.set_nonblocking(true).and_then(|()| connection.peek(&mut [0]));
    let back = connection.set_nonblocking(false);
    matches!(looked, Ok(0)) || back.is_err()
}

fn list(streams: &BTreeMap<String, Arc<Stream>>) -> String {
    let rows: String = streams
        .keys()
        .map(|name| {
            // Names have letters, digits, `_` and `-` only: the component has seen to that.
            format!(
                "<h2>{name}</h2><p><a href=\"/stream/{name}\">both</a> <a href=\"/stream/{name}/left\">left</a> \
                 <a href=\"/stream/{name}/right\">right</a></p>\
                 <img src=\"/stream/{name}\" alt=\"{name}\" style=\"max-width:100%\">"
            )
        })
        .collect();
    let rows =
        if rows.is_empty() { "<p>No display shows anything at the moment.</p>".to_owned() } else { rows };
    format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>trocar</title><h1>Displays</h1>{rows}</html>\n"
    )
}

fn answer(connection: &TcpStream, status: &str, text: &str) -> std::io::Result<()> {
    respond(connection, status, "text/plain; charset=utf-8", text.as_bytes())
}

fn respond(mut connection: &TcpStream, status: &str, kind: &str, body: &[u8]) -> std::io::Result<()> {
    write!(
        connection,
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nX-Content-Type-Options: nosniff\r\n\
         Connection: close\r\n\r\n",
        body.len()
    )?;
    connection.write_all(body)
}
