//! Callers that connect and stay: those that say nothing, more of them than a process may have files, and
//! those that have asked something, more than a port serves.

use std::io::{self, Read, Write};
use std::net::TcpStream;

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use serde_json::json;
use trocar_tests::{HostProcess, Trocar, World, eventually, skip};

use super::holds;

pub(super) const CALLERS: u64 = 1100;
const FILES: u64 = 1024;
/// Connections that programs of the host's own user may have.
const SERVED: usize = 768;

/// So many files for this program, which holds the other ends.
fn may_open(files: u64) -> bool {
    let now = getrlimit(Resource::Nofile);
    let wanted = Rlimit { current: Some(files.max(now.current.unwrap_or(files))), maximum: now.maximum };
    now.maximum.is_none_or(|most| most >= files) && setrlimit(Resource::Nofile, wanted).is_ok()
}

/// A host with a running component and few files for all its callers; `None` where this program may not have
/// as many callers as it plays.
pub(super) fn few_files() -> Option<(World, HostProcess)> {
    if !may_open(4 * CALLERS) {
        return None;
    }
    let world = World::with_plugins(&["example"]);
    let host = HostProcess::start_with(&world, "host", &[]);
    super::limits::limit(&host, "nofile", &format!("{FILES}:4096"));
    let grpc = host.grpcurl();
    grpc.await_class("host", "Server");
    grpc.create("host/server", "Server", json!({}));
    grpc.start("host/server");
    Some((world, host))
}

/// Callers that say nothing, until they are dropped.
pub(super) struct Crowd(Vec<TcpStream>);

impl Crowd {
    pub(super) fn at(host: &HostProcess) -> Crowd {
        Crowd((0..CALLERS).map(|_| TcpStream::connect(host.address()).unwrap()).collect())
    }
}

#[test]
fn a_thousand_silent_callers_keep_nobody_away_and_are_let_go() {
    let Some((world, host)) = few_files() else {
        skip("this machine lets a program open too few files to play so many callers");
        return;
    };
    let (grpc, trocar) = (host.grpcurl(), Trocar::at(&world, host.address()));
    let before = holds(host.pid());
    let crowd = Crowd::at(&host);
    trocar.run(&["stop", "host/server"]).ends_with(0);
    trocar.run(&["start", "host/server"]).ends_with(0);
    // Its socket is not the port's, whose callers waited in turn; those who say nothing gave way.
    grpc.ok("GcmService/Stop", json!({ "path": "host/server" }));
    let most = usize::try_from(FILES).unwrap();
    let now = holds(host.pid());
    assert!(now.files + 32 < most, "no files are left for plugins and links: {now:?} of {most}");
    eventually("they are let go", || {
        let now = holds(host.pid());
        // A caller of a moment ago may be closing.
        if now.files <= before.files + 2 { Ok(()) } else { Err(format!("{now:?}, before {before:?}")) }
    });
    assert_eq!(crowd.0.len() as u64, CALLERS, "they held on until now");
}

#[test]
fn callers_that_only_open_http2_are_let_go_as_those_that_say_nothing() {
    let world = World::new();
    let host = HostProcess::start_with(&world, "host", &[]);
    let before = holds(host.pid());
    // The text that opens HTTP/2, with empty settings (RFC 9113, sections 3.4 and 6.5).
    let opening = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0";
    let mut callers: Vec<TcpStream> = (0..20).map(|_| TcpStream::connect(host.address()).unwrap()).collect();
    for caller in &mut callers {
        caller.write_all(opening).unwrap();
        assert!(caller.read(&mut [0; 9]).unwrap() > 0, "the host's own settings come back");
        caller.set_nonblocking(true).unwrap();
    }
    assert!(holds(host.pid()).files >= before.files + callers.len());
    eventually("they are let go", || {
        callers.iter_mut().for_each(answer_ping);
        let now = holds(host.pid());
        if now.files <= before.files + 2 { Ok(()) } else { Err(format!("{now:?}, before {before:?}")) }
    });
}

/// Answers the host that looks whether its caller is still there (RFC 9113, section 6.7).
fn answer_ping(caller: &mut TcpStream) {
    let mut heard = [0; 64];
    let heard = caller.read(&mut heard).map_or(&[][..], |read| &heard[..read]);
    let ping = b"\0\0\x08\x06\0\0\0\0\0";
    if let Some(at) = heard.windows(ping.len()).position(|bytes| bytes == ping)
        && let Some(said) = heard.get(at + ping.len()..at + ping.len() + 8)
    {
        // It may have been let go meanwhile.
        let _ = caller.write_all(&[b"\0\0\x08\x06\x01\0\0\0\0", said].concat());
    }
}

/// A connection of a program that asks for something and stays.
struct Asking(TcpStream);

impl Asking {
    /// The begin of an answer comes back; nothing, or an error, where it was sent away.
    fn ask(host: &HostProcess) -> io::Result<Asking> {
        let mut asking = Asking(TcpStream::connect(host.address())?);
        write!(asking.0, "GET /healthz HTTP/1.1\r\nHost: {}\r\n\r\n", host.address())?;
        if asking.0.read(&mut [0; 64])? > 0 { Ok(asking) } else { Err(io::ErrorKind::UnexpectedEof.into()) }
    }
}

#[test]
fn more_callers_than_a_port_serves_are_sent_away_with_the_limit_and_stop_has_a_way_of_its_own() {
    if !may_open(4 * CALLERS) {
        skip("this machine lets a program open too few files to play so many callers");
        return;
    }
    let world = World::with_plugins(&["example"]);
    let host = HostProcess::start_with(&world, "host", &[]);
    super::limits::limit(&host, "nofile", "4096:4096");
    let (grpc, trocar) = (host.grpcurl(), Trocar::at(&world, host.address()));
    grpc.await_class("host", "Server");
    grpc.create("host/server", "Server", json!({}));
    grpc.start("host/server");
    let mut callers = Vec::new();
    let sent_away = loop {
        match Asking::ask(&host) {
            Ok(caller) => callers.push(caller),
            Err(sent_away) => break sent_away,
        }
        assert!(
            callers.len() <= SERVED,
            "{} callers have a connection, and no more than {SERVED} may",
            callers.len()
        );
    };
    // Connections of the calls before may be closing.
    assert!(callers.len() + 8 >= SERVED, "only {} were served, then: {sent_away}", callers.len());
    let said = host.printed();
    assert!(
        said.contains("was sent away: this user's programs have 768 connections here, which is the most"),
        "{said}"
    );
    assert!(said.contains("`ss -tnp` names them"), "what to do: {said}");
    trocar.run(&["stop", "host/server"]).ends_with(0);
    trocar.run(&["start", "host/server"]).ends_with(0);
    callers.drain(..8);
    eventually("there is room again where callers have gone", || {
        grpc.call("GcmService/Stop", json!({ "path": "host/server" })).map(|_| ()).map_err(|e| e.to_string())
    });
    // Callers that asked and are within the limit keep their connections.
    let all = callers.len();
    let kept = callers.iter_mut().filter_map(|caller| {
        let asked = write!(caller.0, "GET /healthz HTTP/1.1\r\nHost: {}\r\n\r\n", host.address());
        let answered = asked.is_ok() && caller.0.read(&mut [0; 64]).is_ok_and(|read| read > 0);
        answered.then_some(())
    });
    assert_eq!(kept.count(), all, "nobody that was served is sent away for another");
}
