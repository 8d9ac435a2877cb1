//! Guard against other web pages: a browser asks only from pages this port served, under a name of this
//! machine.
//!
//! Invariant: a request with any sign of a browser is let in only when Host is a loopback name, or the
//! browser has compared it with the port's certificate, and Origin, if there is one, is that Host; there is
//! no CORS, so no other site's script ever reads an answer.

use std::net::IpAddr;

use axum::body::Body;
use axum::extract::Request;
use axum::http::header::{HOST, ORIGIN};
use axum::http::{HeaderMap, Method, StatusCode, Version};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use tonic::Status;

use crate::control::caller::Peer;
use crate::control::kind::{is_grpc, is_program, text};

/// Judges each request before the port serves it.
pub(super) async fn guard(request: Request, next: Next) -> Response {
    let way = if request.extensions().get::<Peer>().is_some_and(|peer| peer.holder().is_some()) {
        Way::Encrypted
    } else {
        Way::Loopback
    };
    match judge(way, request.method(), request.version(), host_of(&request), request.headers()) {
        Ok(()) => next.run(request).await,
        Err(why) => refuse(&request, &why),
    }
}

/// HTTP/2 carries it in the address, HTTP/1 in a header.
fn host_of(request: &Request) -> Option<&str> {
    request.uri().authority().map(|a| a.as_str()).or_else(|| text(request.headers(), HOST.as_str()))
}

/// The way by which a request came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    Loopback,
    /// Under TLS: a browser has compared the name it asked for with the certificate.
    Encrypted,
}

/// Browsers send Origin with every request but a plain GET, and Sec-Fetch-Site under TLS and on the loopback.
fn judge(
    way: Way,
    method: &Method,
    version: Version,
    host: Option<&str>,
    headers: &HeaderMap,
) -> Result<(), String> {
    let scheme = if way == Way::Encrypted { "https://" } else { "http://" };
    let origin = text(headers, ORIGIN.as_str());
    let site = text(headers, "sec-fetch-site");
    if is_program(version, headers) {
        return Ok(());
    }
    let host = host.unwrap_or_default();
    if way == Way::Loopback && !is_loopback(host) {
        return Err(format!(
            "it was asked for as \"{}\", which is no name of this machine's loopback: open it as http://localhost:PORT/ or \
             http://127.0.0.1:PORT/, from elsewhere through an SSH tunnel",
            shown(host)
        ));
    }
    if let Some(origin) = origin
        && !origin.strip_prefix(scheme).is_some_and(|from| from.eq_ignore_ascii_case(host))
    {
        return Err(format!(
            "a page of \"{}\" asked, and only the viewer's own page at {scheme}{host}/ may",
            shown(origin)
        ));
    }
    match site {
        None | Some("same-origin" | "none") => Ok(()),
        // A link from another site to the viewer: it opens our own page, which the other site cannot look
        // into.
        Some(_) if method == Method::GET && text(headers, "sec-fetch-dest") == Some("document") => Ok(()),
        Some(site) => Err(format!(
            "a {} page asked, and only the viewer's own page at {scheme}{host}/ may",
            shown(site)
        )),
    }
}

/// Returns a stranger's text, shortened and without characters that could be markup or control.
fn shown(text: &str) -> String {
    text.chars().filter(|c| c.is_ascii_graphic() && !"<>\"".contains(*c)).take(100).collect()
}

/// Tells whether `host` is `localhost`, `NAME.localhost` or a loopback address, with or without a port. Such
/// names are not looked up in DNS.
fn is_loopback(host: &str) -> bool {
    let name = match host.strip_prefix('[') {
        Some(rest) => match rest.split_once(']') {
            Some((address, port)) if port.is_empty() || is_port(port) => address,
            _ => return false,
        },
        None => match host.split_once(':') {
            Some((name, port)) if port.bytes().all(|b| b.is_ascii_digit()) => name,
            Some(_) => return false,
            None => host,
        },
    };
    let name = name.to_ascii_lowercase();
    name == "localhost"
        || name.ends_with(".localhost")
        || name.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

fn is_port(text: &str) -> bool {
    text.strip_prefix(':').is_some_and(|digits| digits.bytes().all(|b| b.is_ascii_digit()))
}

fn refuse(request: &Request, why: &str) -> Response {
    log::warn!("a browser's request for {} was refused: {why}", shown(request.uri().path()));
    let said = format!("refused: {why}");
    if is_grpc(request.headers()) {
        let mut response = Status::permission_denied(said).into_http::<Body>();
        // gRPC reports everything under 200; a client that looks only at the HTTP status sees the refusal,
        // too.
        *response.status_mut() = StatusCode::FORBIDDEN;
        return response;
    }
    (StatusCode::FORBIDDEN, said + "\n").into_response()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn asked(version: Version, host: &str, headers: &[(&str, &str)]) -> Result<(), String> {
        let mut map = HeaderMap::new();
        for (name, value) in headers {
            let name = axum::http::HeaderName::from_bytes(name.as_bytes()).unwrap();
            map.append(name, value.parse().unwrap());
        }
        judge(Way::Loopback, &Method::POST, version, Some(host), &map)
    }

    #[test]
    fn names_of_the_loopback_are_let_in_and_no_name_that_dns_could_lend() {
        for host in
            ["localhost", "localhost:50551", "LocalHost:1", "eye.localhost:8", "127.0.0.1:50551", "[::1]:9"]
        {
            assert_eq!(asked(Version::HTTP_11, host, &[]), Ok(()), "{host}");
        }
        for host in [
            "",
            "evil.example:50551",
            "localhost.evil.example",
            "127.0.0.1.evil.example:50551",
            "evillocalhost",
            "192.168.1.2:50551",
            "0.0.0.0:50551",
            "[::1",
            "[::1]evil",
            "localhost:evil",
            "user@localhost:1",
        ] {
            let why = asked(Version::HTTP_11, host, &[]).unwrap_err();
            assert!(why.contains("loopback") && why.contains("localhost:PORT"), "{host}: {why}");
        }
    }

    #[test]
    fn only_the_page_of_this_very_port_may_ask() {
        let host = "127.0.0.1:50551";
        assert_eq!(asked(Version::HTTP_11, host, &[("origin", "http://127.0.0.1:50551")]), Ok(()));
        for origin in [
            "http://evil.example",
            "https://127.0.0.1:50551",
            "http://127.0.0.1:8080",
            "http://localhost:50551",
            "null",
            "",
        ] {
            let why = asked(Version::HTTP_11, host, &[("origin", origin)]).unwrap_err();
            assert!(why.contains("the viewer's own page"), "{origin}: {why}");
        }
    }

    #[test]
    fn under_tls_a_page_of_that_very_port_may_ask_and_no_other() {
        let asked = |origin: &str, site: &str| {
            let mut map = HeaderMap::new();
            map.insert(ORIGIN, origin.parse().unwrap());
            map.insert("sec-fetch-site", site.parse().unwrap());
            judge(Way::Encrypted, &Method::POST, Version::HTTP_2, Some("or1.local:50552"), &map)
        };
        assert_eq!(asked("https://or1.local:50552", "same-origin"), Ok(()));
        for (origin, site) in [
            ("https://evil.example", "cross-site"),
            ("http://or1.local:50552", "same-origin"),
            ("https://or1.local", "same-site"),
            ("https://or1.local:50552", "cross-site"),
            ("null", "none"),
        ] {
            let why = asked(origin, site).unwrap_err();
            assert!(why.contains("https://or1.local:50552/ may"), "{origin} {site}: {why}");
        }
    }

    #[test]
    fn a_program_that_speaks_grpc_is_asked_nothing_and_one_that_shows_a_page_behind_it_is() {
        assert_eq!(asked(Version::HTTP_2, "any.name", &[]), Ok(()));
        assert!(asked(Version::HTTP_2, "localhost:1", &[("origin", "http://evil.example")]).is_err());
        assert!(asked(Version::HTTP_11, "localhost:1", &[("sec-fetch-site", "cross-site")]).is_err());
        assert!(asked(Version::HTTP_11, "localhost:1", &[("sec-fetch-site", "same-site")]).is_err());
    }

    #[test]
    fn a_link_elsewhere_opens_the_page_and_loads_nothing_else() {
        let from = |dest: &str| {
            let mut map = HeaderMap::new();
            map.insert("sec-fetch-site", "cross-site".parse().unwrap());
            map.insert("sec-fetch-dest", dest.parse().unwrap());
            judge(Way::Loopback, &Method::GET, Version::HTTP_11, Some("localhost:1"), &map)
        };
        assert_eq!(from("document"), Ok(()));
        for dest in ["image", "script", "iframe", "empty"] {
            assert!(from(dest).is_err(), "{dest}");
        }
    }

    #[test]
    fn what_a_stranger_wrote_is_told_without_markup_and_cut() {
        let why = asked(Version::HTTP_11, &"<script>\u{7}".repeat(100), &[]);
        let why = why.err().unwrap_or_default();
        assert!(!why.contains('<') && why.len() < 400, "{why}");
    }
}
