//! Sessions between two handles in one process, and strangers that call.
#![allow(clippy::unwrap_used)]

mod death;
mod hostile;

use std::os::fd::{AsFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

use tempfile::TempDir;
use trocar_rt::pulse::Pulse;

use crate::card::Card;
use crate::greeting::{Greeting, Said, VERSION, parse};
use crate::socket::{Heard, receive, room, send};
use crate::watchdog::Watchdog;
use crate::{Handler, LAYOUT, Links, Lost, MOST_BYTES, MOST_FDS, Message, SendError, Session, address};

/// Time between two looks of the watchdog.
const LOOK: Duration = Duration::from_secs(1);

enum News {
    Met(Arc<Session>),
    Said(Message),
    Lost(u64, Lost),
}

struct Teller(Sender<News>);

impl Handler for Teller {
    fn met(&mut self, session: &Arc<Session>) {
        let _ = self.0.send(News::Met(session.clone()));
    }

    fn said(&mut self, _: &Arc<Session>, message: Message) {
        let _ = self.0.send(News::Said(message));
    }

    fn lost(&mut self, session: &Arc<Session>, why: &Lost) {
        let _ = self.0.send(News::Lost(session.number(), why.clone()));
    }
}

struct Process {
    links: Links,
    news: Receiver<News>,
}

fn process(dir: &Path, name: &str) -> Process {
    let (tell, news) = channel();
    let card = Card::own(name, dir.join(format!("{name}.sock"))).unwrap();
    Process { links: Links::start(card, Teller(tell)).unwrap(), news }
}

impl Process {
    fn socket(&self) -> &PathBuf {
        &self.links.card().socket
    }

    /// Returns the next news.
    fn next(&self) -> News {
        let mut watchdog = Watchdog::of("news");
        loop {
            match self.news.recv_timeout(LOOK) {
                Ok(news) => return news,
                Err(none) => watchdog.saw(none),
            }
        }
    }

    fn met(&self) -> Arc<Session> {
        match self.next() {
            News::Met(session) => session,
            News::Said(message) => panic!("said {message:?} before it met anybody"),
            News::Lost(number, why) => panic!("lost {number}: {why}"),
        }
    }

    fn said(&self) -> Message {
        match self.next() {
            News::Said(message) => message,
            News::Met(session) => panic!("met {session:?}"),
            News::Lost(number, why) => panic!("lost {number}: {why}"),
        }
    }

    fn lost(&self) -> (u64, Lost) {
        loop {
            if let News::Lost(number, why) = self.next() {
                return (number, why);
            }
        }
    }
}

/// A process without manners.
struct Stranger(OwnedFd);

impl Stranger {
    fn at(socket: &Path) -> Stranger {
        Stranger(address::dial(socket).unwrap())
    }

    fn say(&self, bytes: &[u8]) {
        send(self.0.as_fd(), &[bytes], &[]).unwrap();
    }

    fn greet(&self, greeting: &Greeting) {
        self.say(&greeting.encode());
    }

    /// The next greeting and the files with it; `None` at the end.
    fn hears(&self) -> Option<(Greeting, Vec<OwnedFd>)> {
        let mut room = room();
        loop {
            match receive(self.0.as_fd(), &mut room) {
                Heard::Nothing => std::thread::yield_now(),
                Heard::End => return None,
                Heard::TooLong => panic!("too long"),
                Heard::Message(bytes, files) => match parse(&room[..bytes]).unwrap() {
                    Said::Greeting(greeting) => return Some((greeting, files)),
                    Said::Data { .. } => panic!("data"),
                },
            }
        }
    }

    fn refused(&self) -> String {
        match self.hears() {
            Some((Greeting::Refused { why }, _)) => why,
            other => panic!("not refused: {other:?}"),
        }
    }
}

fn memfd(bytes: &[u8]) -> OwnedFd {
    let fd = rustix::fs::memfd_create("test", rustix::fs::MemfdFlags::CLOEXEC).unwrap();
    rustix::io::write(&fd, bytes).unwrap();
    fd
}

#[test]
fn two_processes_meet_speak_and_hand_memory_over() {
    let dir = TempDir::new().unwrap();
    let (a, b) = (process(dir.path(), "a"), process(dir.path(), "b"));
    a.links.want(b.socket());
    let (to_b, to_a) = (a.met(), b.met());
    assert_eq!((to_b.peer().process.as_str(), to_a.peer().process.as_str()), ("b", "a"));
    assert_eq!(to_b.peer().pid, std::process::id() as i32);
    assert_eq!(a.links.session(b.socket()).unwrap().number(), to_b.number());
    let memory = memfd(b"shared");
    to_b.send(b"here you are", &[memory.as_fd()]).unwrap();
    let message = b.said();
    assert_eq!((message.bytes.as_slice(), message.announced), (b"here you are".as_slice(), 1));
    let mut seen = [0; 6];
    rustix::io::pread(&message.files[0], &mut seen, 0).unwrap();
    assert_eq!(&seen, b"shared");
    to_a.send(b"thanks", &[]).unwrap();
    assert_eq!(a.said().bytes, b"thanks");
}

#[test]
fn a_process_that_ends_is_lost_and_the_next_one_at_its_place_is_met_anew() {
    let dir = TempDir::new().unwrap();
    let (a, b) = (process(dir.path(), "a"), process(dir.path(), "b"));
    let at = b.socket().clone();
    a.links.want(&at);
    let first = a.met();
    drop(b);
    assert_eq!(a.lost(), (first.number(), Lost::Closed));
    assert!(first.is_lost());
    assert_eq!(first.send(b"?", &[]), Err(SendError::Lost));
    assert!(a.links.session(&at).is_none());
    let b = process(dir.path(), "b");
    let second = a.met();
    assert_ne!(second.number(), first.number());
    assert_ne!(second.peer().instance, first.peer().instance, "another run of the process");
    assert_eq!(b.met().peer().process, "a");
    assert!(first.is_lost(), "it stays lost");
}

#[test]
fn a_process_is_awaited_and_the_reason_is_known_meanwhile() {
    let dir = TempDir::new().unwrap();
    let a = process(dir.path(), "a");
    let at = dir.path().join("b.sock");
    a.links.want(&at);
    let why = loop {
        match a.links.why_not(&at) {
            Some(why) => break why,
            None => std::thread::yield_now(),
        }
    };
    assert!(why.contains("nobody answers at") && why.contains("b.sock"), "{why}");
    let b = process(dir.path(), "b");
    assert_eq!(a.met().peer().process, "b");
    assert_eq!(a.links.why_not(&at), None);
    drop(b);
}

#[test]
fn who_is_wanted_twice_is_left_twice() {
    let dir = TempDir::new().unwrap();
    let (a, b) = (process(dir.path(), "a"), process(dir.path(), "b"));
    a.links.want(b.socket());
    a.links.want(b.socket());
    let session = a.met();
    b.met();
    a.links.leave(b.socket());
    session.send(b"still", &[]).unwrap();
    assert_eq!(b.said().bytes, b"still");
    a.links.leave(b.socket());
    assert_eq!(a.lost(), (session.number(), Lost::Ended));
    assert_eq!(b.lost().1, Lost::Closed);
    assert!(a.links.session(b.socket()).is_none());
}

#[test]
fn an_end_of_the_own_side_is_told_to_both() {
    let dir = TempDir::new().unwrap();
    let (a, b) = (process(dir.path(), "a"), process(dir.path(), "b"));
    a.links.want(b.socket());
    let (_, to_a) = (a.met(), b.met());
    to_a.end();
    assert_eq!(b.lost(), (to_a.number(), Lost::Ended));
    assert_eq!(a.lost().1, Lost::Closed);
    a.met();
    b.met();
}

#[test]
fn what_is_too_much_is_refused_where_it_is_said() {
    let dir = TempDir::new().unwrap();
    let (a, b) = (process(dir.path(), "a"), process(dir.path(), "b"));
    a.links.want(b.socket());
    let (session, _) = (a.met(), b.met());
    let long = vec![7; MOST_BYTES];
    session.send(&long, &[]).unwrap();
    assert_eq!(b.said().bytes, long);
    let longer = vec![7; MOST_BYTES + 1];
    assert_eq!(session.send(&longer, &[]), Err(SendError::TooLong { bytes: MOST_BYTES + 1 }));
    let file = memfd(b"x");
    let files = vec![file.as_fd(); MOST_FDS];
    session.send(b"all", &files).unwrap();
    assert_eq!(b.said().files.len(), MOST_FDS);
    let more = vec![file.as_fd(); MOST_FDS + 1];
    assert_eq!(session.send(b"more", &more), Err(SendError::TooManyFiles { files: MOST_FDS + 1 }));
}

#[test]
fn strangers_are_turned_away_with_a_sentence_and_disturb_nobody() {
    let dir = TempDir::new().unwrap();
    let (a, b) = (process(dir.path(), "a"), process(dir.path(), "b"));
    a.links.want(b.socket());
    let (to_b, _) = (a.met(), b.met());
    let card = |f: &dyn Fn(&mut Card)| {
        let mut card = Card::own("c", dir.path().join("c.sock")).unwrap();
        f(&mut card);
        Greeting::Hello { version: VERSION, card }
    };
    for (said, why) in [
        (b"GET / HTTP/1.1".to_vec(), "nothing of ours"),
        (b"g{".to_vec(), "no greeting of ours"),
        (b"d\0data".to_vec(), "data before the greeting"),
        (Greeting::Ready.encode(), "out of turn"),
        (Greeting::Echo { nonce: [0; 2] }.encode(), "out of turn"),
        (Greeting::Refused { why: "no".into() }.encode(), "out of turn"),
        (card(&|c| c.boot = "other".into()).encode(), "runs on another machine"),
        (card(&|c| c.uid += 1).encode(), "must run as the same user"),
        (card(&|c| c.layout = LAYOUT + 1).encode(), "same release"),
        (card(&|c| c.process = "x".repeat(MOST_BYTES)).encode(), "more than"),
    ] {
        let stranger = Stranger::at(b.socket());
        // Too long for one message of ours, but not for a socket.
        stranger.say(&said);
        let refused = stranger.refused();
        assert!(refused.contains(why), "{refused}");
        assert!(stranger.hears().is_none(), "it was closed");
    }
    let version =
        Greeting::Hello { version: VERSION + 1, card: Card::own("c", dir.path().join("c")).unwrap() };
    let stranger = Stranger::at(b.socket());
    stranger.greet(&version);
    assert!(stranger.refused().contains("greets in version 2"));
    // One that hangs up, one that says nothing.
    drop(Stranger::at(b.socket()));
    let silent = Stranger::at(b.socket());
    to_b.send(b"undisturbed", &[]).unwrap();
    assert_eq!(b.said().bytes, b"undisturbed");
    assert!(silent.hears().is_none(), "a greeting has its time");
}

#[test]
fn a_number_that_is_only_guessed_opens_nothing() {
    let dir = TempDir::new().unwrap();
    let b = process(dir.path(), "b");
    let hello =
        Greeting::Hello { version: VERSION, card: Card::own("c", dir.path().join("c.sock")).unwrap() };
    let forger = Stranger::at(b.socket());
    forger.greet(&hello);
    let (welcome, files) = forger.hears().unwrap();
    assert!(matches!(welcome, Greeting::Welcome { .. }), "{welcome:?}");
    let nonce = Pulse::open(files.into_iter().next().unwrap()).unwrap().nonce();
    forger.greet(&Greeting::Echo { nonce: [nonce[0], nonce[1] ^ 1] });
    assert!(forger.refused().contains("does not see the memory"));
    // A stranger that sees the page is met, and lost again as soon as it talks nonsense.
    let guest = Stranger::at(b.socket());
    guest.greet(&hello);
    let (_, files) = guest.hears().unwrap();
    let nonce = Pulse::open(files.into_iter().next().unwrap()).unwrap().nonce();
    guest.greet(&Greeting::Echo { nonce });
    assert!(matches!(guest.hears().unwrap().0, Greeting::Ready));
    assert_eq!(b.met().peer().process, "c");
    guest.greet(&hello);
    let why = b.lost().1;
    assert!(matches!(&why, Lost::Nonsense { what } if what.contains("in the middle")), "{why:?}");
}

#[test]
fn a_process_whose_heart_stands_is_lost_although_its_socket_is_open() {
    let dir = TempDir::new().unwrap();
    let b = process(dir.path(), "b");
    let hello =
        Greeting::Hello { version: VERSION, card: Card::own("c", dir.path().join("c.sock")).unwrap() };
    let guest = Stranger::at(b.socket());
    guest.greet(&hello);
    let (_, files) = guest.hears().unwrap();
    let pulse = Pulse::open(files.into_iter().next().unwrap()).unwrap();
    guest.greet(&Greeting::Echo { nonce: pulse.nonce() });
    b.met();
    // This very process runs, so the kernel does not call it stopped.
    assert!(matches!(b.lost().1, Lost::Silent { ms } if ms >= 300));
    pulse.beat(1);
    assert!(matches!(guest.hears(), Some((Greeting::Ready, _))));
    assert!(guest.hears().is_none(), "it was told by the end of its socket");
}

#[test]
fn a_crowd_at_the_door_does_not_keep_a_friend_out() {
    let dir = TempDir::new().unwrap();
    let (a, b) = (process(dir.path(), "a"), process(dir.path(), "b"));
    let crowd: Vec<Stranger> = (0..100).map(|_| Stranger::at(b.socket())).collect();
    a.links.want(b.socket());
    assert_eq!(a.met().peer().process, "b");
    drop(crowd);
}

#[test]
fn a_socket_left_behind_is_replaced_and_long_paths_have_room() {
    let dir = TempDir::new().unwrap();
    let deep = dir.path().join("a-folder-with-quite-a-long-name".repeat(4)).join("and-another-one".repeat(8));
    std::fs::create_dir_all(&deep).unwrap();
    std::fs::write(deep.join("a.sock"), "left behind").unwrap();
    let (a, b) = (process(&deep, "a"), process(&deep, "b"));
    b.links.want(a.socket());
    a.met();
    let at = a.socket().clone();
    drop(a);
    assert!(!at.exists(), "it goes with its process");
}
