//! Connections as clients make them that mean no good, and a port that is taken.

use super::*;
use std::io::{Read, Write};

use crate::watchdog::Watchdog;

fn connect(server: &Server) -> TcpStream {
    let connection = TcpStream::connect(("127.0.0.1", server.port)).unwrap();
    connection.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    connection
}

fn ask(server: &Server, path: &str) -> TcpStream {
    let mut connection = connect(server);
    write!(connection, "GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
    connection
}

fn answer(mut connection: TcpStream) -> String {
    let mut text = String::new();
    let _ = connection.read_to_string(&mut text);
    text
}

fn eventually(what: &str, mut holds: impl FnMut() -> bool) {
    let mut watchdog = Watchdog::of(what);
    while !holds() {
        watchdog.saw("it is not so");
        std::thread::yield_now();
    }
}

#[test]
fn requests_that_never_come_whole_are_left_and_keep_nobody_out() {
    let server = Server::at(0).unwrap();
    let trickle = |mut connection: &TcpStream| connection.write_all(b"G").is_ok();
    let idle: Vec<TcpStream> = (0..ASKING + 40).map(|_| connect(&server)).collect();
    idle.iter().for_each(|connection| _ = trickle(connection));
    assert!(answer(ask(&server, "/")).starts_with("HTTP/1.1 200"), "beside many that ask nothing");
    // Each byte comes long before a pause would be noticed; the whole request does not.
    let mut slow = connect(&server);
    slow.set_read_timeout(Some(Duration::from_millis(50))).unwrap();
    let mut told = [0; 12];
    eventually("a trickling request is left", || {
        trickle(&slow);
        match slow.read_exact(&mut told) {
            Err(why) => !matches!(why.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut),
            Ok(()) => true,
        }
    });
    assert_eq!(&told, b"HTTP/1.1 408");
    drop(idle);
    eventually("their threads end", || {
        held(&server.shared.connections).retain(|connection| !connection.thread.is_finished());
        held(&server.shared.connections).is_empty()
    });
}

#[test]
fn a_request_that_is_late_is_told_so() {
    let server = Server::at(0).unwrap();
    let mut slow = connect(&server);
    slow.write_all(b"GET / HTTP/1.1\r\n").unwrap();
    assert!(answer(slow).starts_with("HTTP/1.1 408"));
}

#[test]
fn every_answer_forbids_to_be_shown_in_other_pages() {
    let server = Server::at(0).unwrap();
    let stream = Arc::new(Stream::new("a"));
    let _place = server.show(stream).unwrap();
    let mut viewer = ask(&server, "/stream/a");
    let (mut shown, mut byte) = (String::new(), [0]);
    while !shown.ends_with("\r\n\r\n") {
        viewer.read_exact(&mut byte).unwrap();
        shown.push(byte[0].into());
    }
    for text in [answer(ask(&server, "/")), answer(ask(&server, "/none")), shown] {
        for header in [
            "Cross-Origin-Resource-Policy: same-origin\r\n",
            "X-Content-Type-Options: nosniff\r\n",
            "X-Frame-Options: DENY\r\n",
            "Cache-Control: no-store\r\n",
            "frame-ancestors 'none'",
        ] {
            assert!(text.contains(header), "{header} in {text}");
        }
    }
}

#[test]
fn viewers_beyond_the_most_are_refused_and_room_comes_back() {
    let server = Server::at(0).unwrap();
    let _place = server.show(Arc::new(Stream::new("a"))).unwrap();
    let many: Vec<TcpStream> = (0..VIEWERS).map(|_| ask(&server, "/stream/a")).collect();
    eventually("all look", || server.shared.viewers.load(Ordering::Acquire) == VIEWERS);
    let refused = answer(ask(&server, "/stream/a"));
    assert!(refused.starts_with("HTTP/1.1 503") && refused.contains("close one"), "{refused}");
    assert!(answer(ask(&server, "/")).starts_with("HTTP/1.1 200"), "the list is still there");
    drop(many);
    eventually("all have gone", || server.shared.viewers.load(Ordering::Acquire) == 0);
}

#[test]
fn a_port_that_is_freed_is_had_and_one_that_is_kept_is_told() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    let server = Server::at(port).unwrap();
    let place = server.show(Arc::new(Stream::new("a"))).unwrap();
    assert_eq!(place.serving(), (Serving::WAITING, 0));
    drop(taken);
    eventually("the port is had", || place.serving() == (Serving::LISTENING, port));
    assert!(answer(ask(&server, "/")).contains("/stream/a"));
    drop((place, server));

    let taken = TcpListener::bind(("127.0.0.1", port)).unwrap();
    let place = Server::at(port).unwrap().show(Arc::new(Stream::new("a"))).unwrap();
    eventually("it is given up", || place.serving() == (Serving::REFUSED, 0));
    assert_eq!(place.port(), port);
    assert!(refusal(port).starts_with(&format!("mjpeg_port: {port} on 127.0.0.1 cannot be had")));
    // Another start tries anew, though the one that was refused is still there.
    drop(taken);
    let again = Server::at(port).unwrap().show(Arc::new(Stream::new("a"))).unwrap();
    assert_eq!(again.serving(), (Serving::LISTENING, port));
}
