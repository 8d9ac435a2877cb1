//! Answers to a browser: texts, the list of streams, and a stream's pictures one after the other.
//!
//! Invariant: nothing may be kept, guessed at, or shown inside another page, and each piece has to be taken
//! within a bounded time, however slowly it is taken.

use std::io::{ErrorKind, Write};
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use trocar_imaging::pixels::Part;

use crate::mjpeg::Stream;

/// A picture, or another answer, that is not taken within so long ends its connection.
pub(crate) const PATIENCE: Duration = Duration::from_secs(2);
/// A viewer without pictures is checked so often for being still there.
const LOOKS: Duration = Duration::from_millis(200);
const BOUNDARY: &str = "trocar-frame";
/// Headers of every answer.
const HEADERS: &str = "Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\nCross-Origin-Resource-Policy: same-origin\r\n\
     Cross-Origin-Opener-Policy: same-origin\r\nX-Frame-Options: DENY\r\nReferrer-Policy: no-referrer\r\n\
     Content-Security-Policy: default-src 'none'; img-src 'self'; style-src 'unsafe-inline'; frame-ancestors 'none'\r\n\
     Connection: close\r\n";

/// Answers with a line of text.
pub(crate) fn text(to: &TcpStream, status: &str, text: &str) -> std::io::Result<()> {
    whole(to, status, "text/plain; charset=utf-8", text)
}

/// Answers with a page that shows all streams.
pub(crate) fn list<'a>(to: &TcpStream, names: impl Iterator<Item = &'a String>) -> std::io::Result<()> {
    // Names have letters, digits, `_` and `-` only: the component has seen to that.
    let row = |name: &String| {
        format!(
            "<h2>{name}</h2><p><a href=\"/stream/{name}\">both</a> <a href=\"/stream/{name}/left\">left</a> \
             <a href=\"/stream/{name}/right\">right</a></p>\
             <img src=\"/stream/{name}\" alt=\"{name}\" style=\"max-width:100%\">"
        )
    };
    let rows: String = names.map(row).collect();
    let rows =
        if rows.is_empty() { "<p>No display shows anything at the moment.</p>".to_owned() } else { rows };
    let page = format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>trocar</title><h1>Displays</h1>{rows}</html>\n"
    );
    whole(to, "200 OK", "text/html; charset=utf-8", &page)
}

fn whole(to: &TcpStream, status: &str, kind: &str, body: &str) -> std::io::Result<()> {
    let length = body.len();
    let answer = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {length}\r\n{HEADERS}\r\n{body}"
    );
    send(to, answer.as_bytes(), Instant::now() + PATIENCE)
}

/// Sends pictures until the viewer goes, is too slow, or the stream ends.
pub(crate) fn pictures(
    to: &TcpStream,
    stream: &Arc<Stream>,
    part: Part,
    ends: &AtomicBool,
) -> std::io::Result<()> {
    let begin = format!(
        "HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary={BOUNDARY}\r\n{HEADERS}\r\n--{BOUNDARY}\r\n"
    );
    send(to, begin.as_bytes(), Instant::now() + PATIENCE)?;
    let mut viewer = stream.look(part);
    while !ends.load(Ordering::Acquire) {
        let Ok(picture) = viewer.next(LOOKS) else { break };
        let Some(picture) = picture else {
            if is_gone(to) {
                break;
            }
            continue;
        };
        let until = Instant::now() + PATIENCE;
        let head = format!("Content-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n", picture.len());
        send(to, head.as_bytes(), until)?;
        send(to, &picture, until)?;
        // The boundary behind it lets a browser show it now and not with the next one.
        send(to, format!("\r\n--{BOUNDARY}\r\n").as_bytes(), until)?;
    }
    Ok(())
}

/// Sends all of it before a time: who takes a byte now and then is no better than who takes none.
fn send(mut to: &TcpStream, mut bytes: &[u8], until: Instant) -> std::io::Result<()> {
    while !bytes.is_empty() {
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(ErrorKind::TimedOut.into());
        }
        to.set_write_timeout(Some(left))?;
        match to.write(bytes) {
            Ok(0) => return Err(ErrorKind::WriteZero.into()),
            Ok(sent) => bytes = &bytes[sent..],
            Err(why) if why.kind() == ErrorKind::Interrupted => {}
            Err(why) => return Err(why),
        }
    }
    Ok(())
}

/// Whether a viewer to whom nothing is sent has closed its end.
fn is_gone(connection: &TcpStream) -> bool {
    let looked = connection.set_nonblocking(true).and_then(|()| connection.peek(&mut [0]));
    let back = connection.set_nonblocking(false);
    matches!(looked, Ok(0)) || back.is_err()
}
