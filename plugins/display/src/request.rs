//! Requests of browsers: read within a time, and refused unless they come from this machine's user.
//!
//! Invariant: who shows an operating field to a page from elsewhere leaks it. A request must name this
//! machine (`Host`), so no foreign name can be made to lead here, and must not be part of another page, which
//! browsers tell (`Sec-Fetch-Site`, `Origin`). See W3C "Fetch Metadata Request Headers".

use std::io::{ErrorKind, Read};
use std::net::TcpStream;
use std::time::{Duration, Instant};

/// Longest request, bytes.
pub(crate) const LONGEST: usize = 8 << 10;

/// Why a request is not answered: status line and sentence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Refusal(pub(crate) &'static str, pub(crate) &'static str);

const NO_HTTP: Refusal = Refusal("400 Bad Request", "this is no request of HTTP/1\n");
const NO_HOST: Refusal =
    Refusal("400 Bad Request", "say once, in Host, whom you ask: 127.0.0.1 or localhost\n");
const SLOW: Refusal = Refusal("408 Request Timeout", "the request did not come whole in time\n");
const ONLY_GET: Refusal = Refusal("405 Method Not Allowed", "only GET is answered here\n");
const FOREIGN_HOST: Refusal = Refusal("403 Forbidden", "ask for 127.0.0.1 or localhost\n");
const FOREIGN_PAGE: Refusal =
    Refusal("403 Forbidden", "pictures are not shown inside other pages: open the address itself\n");

/// Reads a request; its path without what stands behind `?`, or why it is refused.
///
/// # Errors
/// The connection broke.
pub(crate) fn read(mut from: &TcpStream, within: Duration) -> std::io::Result<Result<String, Refusal>> {
    let until = Instant::now() + within;
    let (mut bytes, mut filled) = ([0; LONGEST], 0);
    loop {
        // However small the pieces are in which it comes: the time is for all of them.
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Ok(Err(SLOW));
        }
        from.set_read_timeout(Some(left))?;
        let more = match from.read(&mut bytes[filled..]) {
            Ok(more) => more,
            Err(why) if matches!(why.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => continue,
            Err(why) if why.kind() == ErrorKind::Interrupted => continue,
            Err(why) => return Err(why),
        };
        filled += more;
        match parsed(&bytes[..filled]) {
            Some(answer) => return Ok(answer),
            None if more > 0 && filled < bytes.len() => {}
            None => return Ok(Err(NO_HTTP)),
        }
    }
}

/// Returns what a request asks for, or its refusal; `None` while it is not whole.
fn parsed(bytes: &[u8]) -> Option<Result<String, Refusal>> {
    let mut headers = [httparse::EMPTY_HEADER; 64];
    let mut request = httparse::Request::new(&mut headers);
    match request.parse(bytes) {
        Ok(httparse::Status::Complete(_)) => Some(checked(&request)),
        Ok(httparse::Status::Partial) => None,
        Err(_) => Some(Err(NO_HTTP)),
    }
}

fn checked(request: &httparse::Request<'_, '_>) -> Result<String, Refusal> {
    let all = |name: &'static str| {
        let named = move |header: &&httparse::Header<'_>| header.name.eq_ignore_ascii_case(name);
        request.headers.iter().filter(named).map(|header| header.value)
    };
    let one = |name| all(name).next();
    if request.method != Some("GET") {
        return Err(ONLY_GET);
    }
    let (Some(host), 1) = (one("host"), all("host").count()) else { return Err(NO_HOST) };
    if !is_loopback(host) {
        return Err(FOREIGN_HOST);
    }
    if one("origin").is_some_and(|origin| !origin.strip_prefix(b"http://").is_some_and(is_loopback)) {
        return Err(FOREIGN_PAGE);
    }
    // Older browsers and other programs do not say; somebody who follows a link to here sees it in a page of
    // its own.
    let own = one("sec-fetch-site").is_none_or(|site| matches!(site, b"none" | b"same-origin"));
    let follows_link =
        one("sec-fetch-mode") == Some(b"navigate") && one("sec-fetch-dest") == Some(b"document");
    if !own && !follows_link {
        return Err(FOREIGN_PAGE);
    }
    let path = request.path.unwrap_or("/");
    Ok(path.split(['?', '#']).next().unwrap_or("/").to_owned())
}

/// Whether a host, with or without a port, is this machine under one of its own names.
fn is_loopback(host: &[u8]) -> bool {
    let host = String::from_utf8_lossy(host).to_ascii_lowercase();
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|b| b.is_ascii_digit()) => name,
        _ => &host,
    };
    matches!(name, "127.0.0.1" | "localhost" | "[::1]")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(headers: &str) -> Result<String, Refusal> {
        let text = format!("GET /stream/a?now HTTP/1.1\r\n{headers}\r\n");
        parsed(text.as_bytes()).expect("it is whole")
    }

    #[test]
    fn a_request_must_say_once_that_it_is_for_this_machine() {
        for own in ["127.0.0.1", "127.0.0.1:8099", "[::1]:9", "localhost", "LocalHost:1"] {
            assert_eq!(asked(&format!("Host: {own}\r\n")), Ok("/stream/a".into()), "{own}");
        }
        for foreign in ["evil.example", "127.0.0.1.evil.example", "localhost:80:evil", "10.0.0.1", "[::1", ""]
        {
            assert_eq!(asked(&format!("Host: {foreign}\r\n")), Err(FOREIGN_HOST), "{foreign}");
        }
        assert_eq!(asked(""), Err(NO_HOST));
        assert_eq!(asked("Host: localhost\r\nHost: evil.example\r\n"), Err(NO_HOST));
    }

    #[test]
    fn other_pages_may_lead_here_and_not_show_it_inside_them() {
        let with = |headers: &str| asked(&format!("Host: localhost\r\n{headers}"));
        for good in [
            "Sec-Fetch-Site: none\r\n",
            "Sec-Fetch-Site: same-origin\r\nSec-Fetch-Dest: image\r\n",
            "Sec-Fetch-Site: cross-site\r\nSec-Fetch-Mode: navigate\r\nSec-Fetch-Dest: document\r\n",
            "Origin: http://localhost:8099\r\n",
        ] {
            assert!(with(good).is_ok(), "{good}");
        }
        for bad in [
            "Sec-Fetch-Site: cross-site\r\nSec-Fetch-Mode: no-cors\r\nSec-Fetch-Dest: image\r\n",
            "Sec-Fetch-Site: same-site\r\n",
            "Sec-Fetch-Site: cross-site\r\nSec-Fetch-Mode: navigate\r\nSec-Fetch-Dest: iframe\r\n",
            "Origin: https://evil.example\r\n",
            "Origin: null\r\n",
        ] {
            assert_eq!(with(bad), Err(FOREIGN_PAGE), "{bad}");
        }
    }

    #[test]
    fn half_a_request_is_waited_for_and_nonsense_is_not() {
        assert_eq!(parsed(b"GET / HTTP/1.1\r\nHost: local"), None);
        assert_eq!(parsed(b"nonsense\r\n\r\n"), Some(Err(NO_HTTP)));
        assert_eq!(parsed(b"POST / HTTP/1.1\r\nHost: localhost\r\n\r\n"), Some(Err(ONLY_GET)));
    }
}
