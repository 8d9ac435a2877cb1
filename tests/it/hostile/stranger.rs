//! Strangers at a host's socket.

use std::io::IoSlice;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::{Path, PathBuf};

use rustix::io::Errno;
use rustix::net::{
    AddressFamily, RecvFlags, SendAncillaryBuffer, SendAncillaryMessage, SendFlags, SocketAddrUnix,
    SocketFlags, SocketType,
};
use serde_json::{Value, json};
use trocar_links::Card;
use trocar_tests::eventually;

use super::{Lab, await_nothing_left, holds, lines};

/// A socket of the right kind, and no manners.
pub(super) struct Stranger(OwnedFd);

impl Stranger {
    /// `None` while as many wait there as may.
    pub(super) fn try_at(socket: &Path) -> Option<Stranger> {
        let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
        let own = rustix::net::socket_with(AddressFamily::UNIX, SocketType::SEQPACKET, flags, None).unwrap();
        match rustix::net::connect(&own, &SocketAddrUnix::new(socket).unwrap()) {
            Ok(()) => Some(Stranger(own)),
            Err(Errno::AGAIN) => None,
            Err(e) => panic!("{}: {e}", socket.display()),
        }
    }

    pub(super) fn at(socket: &Path) -> Stranger {
        eventually("there is room to wait at the socket", || Stranger::try_at(socket).ok_or("full"))
    }

    pub(super) fn say(&self, bytes: &[u8], files: &[BorrowedFd<'_>]) {
        let mut room = [std::mem::MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(32))];
        let mut control = SendAncillaryBuffer::new(&mut room);
        assert!(files.is_empty() || control.push(SendAncillaryMessage::ScmRights(files)));
        // Whoever was turned away already is not heard.
        let _ = rustix::net::sendmsg(&self.0, &[IoSlice::new(bytes)], &mut control, SendFlags::NOSIGNAL);
    }

    /// What it is answered; empty when that is nothing and the end.
    pub(super) fn hears(&self) -> String {
        eventually("the host answers or hangs up", || {
            let mut room = [0; 4096];
            match rustix::net::recv(&self.0, &mut room, RecvFlags::DONTWAIT) {
                Ok((bytes, _)) => Ok(String::from_utf8_lossy(&room[..bytes]).into_owned()),
                Err(Errno::AGAIN) => Err("nothing yet"),
                Err(_) => Ok(String::new()),
            }
        })
    }
}

pub(super) fn hello(card: &Card) -> Vec<u8> {
    let words = json!({ "Hello": { "version": 1, "card": card } });
    [b"g".to_vec(), words.to_string().into_bytes()].concat()
}

/// Of this run of a process, as it tells whoever greets it.
pub(super) fn instance_of(socket: &Path) -> String {
    let stranger = Stranger::at(socket);
    stranger.say(&hello(&Card::own("guest", socket.with_extension("guest")).unwrap()), &[]);
    let heard = stranger.hears();
    let welcome: Value = serde_json::from_str(heard.trim_start_matches('g')).unwrap();
    welcome["Welcome"]["card"]["instance"].as_str().unwrap_or_else(|| panic!("{heard}")).to_owned()
}

#[test]
fn a_stranger_at_the_socket_is_turned_away_and_nothing_stays_of_it() {
    let lab = Lab::new();
    let mut host = lab.host("left");
    lab.furnish("left");
    lab.start("left");
    let socket: PathBuf = lab.world.state().join("left/links.sock");
    let card = Card::own("guest", lab.world.path("guest.sock")).unwrap();
    lab.await_steps("left/s", 10);
    let before = holds(host.pid());

    for (said, why) in [
        (&b"GET / HTTP/1.1\r\n"[..], "nothing of ours"),
        (b"\xff\xfe\0\0", "nothing of ours"),
        (b"g", "no greeting of ours"),
        (b"g{\"Hello\":", "no greeting of ours"),
        (b"d\0hello", "data before the greeting"),
        (b"g{\"Echo\":{\"nonce\":[1,2]}}", "out of turn"),
        (b"g\"Ready\"", "out of turn"),
    ] {
        let stranger = Stranger::at(&socket);
        stranger.say(said, &[]);
        let heard = stranger.hears();
        assert!(heard.contains(why), "{said:?} was answered {heard:?}");
    }
    let other = |change: &dyn Fn(&mut Card)| {
        let mut card = card.clone();
        change(&mut card);
        let stranger = Stranger::at(&socket);
        stranger.say(&hello(&card), &[]);
        stranger.hears()
    };
    for (heard, why) in [
        (other(&|c| c.boot = "11111111-2222-3333-4444-555555555555".into()), "another machine"),
        (other(&|c| c.layout += 1), "same release"),
        (other(&|c| c.uid += 1), "same user"),
        (other(&|c| c.process = "a\nb".into()), "a name that is none"),
    ] {
        assert!(heard.contains(why), "{heard}");
    }
    // A number that was not read from the memory it was given.
    let forger = Stranger::at(&socket);
    forger.say(&hello(&card), &[]);
    assert!(forger.hears().contains("Welcome"));
    forger.say(b"g{\"Echo\":{\"nonce\":[1,2]}}", &[]);
    assert!(forger.hears().contains("does not see the memory"));

    // Too long for a message, and with files nobody asked for.
    let loud = Stranger::at(&socket);
    loud.say(&vec![b'g'; 150_000], &[]);
    let heard = loud.hears();
    assert!(heard.contains("more than"), "{heard}");
    let file = std::fs::File::open("/dev/null").unwrap();
    for said in [&b"x"[..], b"g\"Ready\"", &hello(&card)] {
        let bearer = Stranger::at(&socket);
        bearer.say(said, &[file.as_fd(); 32]);
        bearer.hears();
    }
    await_nothing_left(&host, before);

    // A thousand of them, one step further each time, and gone again.
    for n in 0..1000 {
        let stranger = Stranger::at(&socket);
        match n % 4 {
            0 => {}
            1 => stranger.say(&hello(&card)[..20], &[]),
            2 => stranger.say(&hello(&card), &[]),
            _ => {
                stranger.say(&hello(&card), &[file.as_fd()]);
                stranger.say(b"g{\"Echo\":{\"nonce\":[0,0]}}", &[]);
            }
        }
    }
    await_nothing_left(&host, before);
    assert!(host.is_alive());
    lab.await_steps("left/s", 10);
    let told = lines(&host, "was turned away");
    assert!((1..=20).contains(&told), "{told} lines for a thousand strangers");
}

#[test]
fn a_thousand_silent_connections_keep_no_process_out() {
    let lab = Lab::new();
    let (mut left, right) = (lab.host("left"), lab.host("right"));
    lab.furnish("left");
    lab.furnish("right");
    let socket = lab.world.state().join("left/links.sock");
    let before = holds(left.pid());
    let crowd: Vec<Stranger> = (0..1000).map(|_| Stranger::at(&socket)).collect();
    let during = holds(left.pid());
    assert!(during.files <= before.files + 80, "{during:?}, before {before:?}");
    lab.connect("right", "left");
    lab.start("left");
    lab.start_all("right");
    lab.await_flow("right/e/sample");
    lab.await_flow("right/client/Required");
    drop(crowd);
    assert!(left.is_alive());
    drop(right);
}
