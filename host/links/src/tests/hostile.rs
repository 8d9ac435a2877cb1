//! Strangers that call, and peers with a session, that mean ill.

use std::fs::Permissions;
use std::io;
use std::os::unix::fs::PermissionsExt;

use proptest::prelude::*;
use rustix::fs::{MemfdFlags, SealFlags};
use rustix::net::{AddressFamily, Shutdown, SocketAddrUnix, SocketFlags, SocketType};
use rustix::process::Resource;

use super::*;
use crate::door::MOST_OF_ONE;

fn hello(dir: &Path) -> Greeting {
    Greeting::Hello { version: VERSION, card: Card::own("c", dir.join("c.sock")).unwrap() }
}

/// A guest that was let in, and its heart.
pub(super) fn guest(of: &Process, dir: &Path) -> Result<(Stranger, Pulse), String> {
    let stranger = Stranger::at(of.socket());
    stranger.greet(&hello(dir));
    match stranger.hears() {
        Some((Greeting::Welcome { .. }, files)) => {
            let pulse = Pulse::open(files.into_iter().next().unwrap()).unwrap();
            stranger.greet(&Greeting::Echo { nonce: pulse.nonce() });
            assert!(matches!(stranger.hears(), Some((Greeting::Ready, _))));
            Ok((stranger, pulse))
        }
        Some((Greeting::Refused { why }, _)) => Err(why),
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_thousand_who_say_nothing_keep_no_friend_out() {
    let mut limit = rustix::process::getrlimit(Resource::Nofile);
    limit.current = limit.maximum;
    rustix::process::setrlimit(Resource::Nofile, limit).unwrap();
    let dir = TempDir::new().unwrap();
    let (a, b) = (process(dir.path(), "a"), process(dir.path(), "b"));
    let mut crowd = Vec::new();
    while crowd.len() < 1000 {
        match address::dial(b.socket()) {
            Ok(socket) => crowd.push(socket),
            // As many wait as may.
            Err(e) if e.kind() == io::ErrorKind::WouldBlock => std::thread::yield_now(),
            Err(e) => panic!("after {}: {e}", crowd.len()),
        }
    }
    a.links.want(b.socket());
    let (to_b, _) = (a.met(), b.met());
    to_b.send(b"let in", &[]).unwrap();
    assert_eq!(b.said().bytes, b"let in");
    drop(crowd);
}

#[test]
fn whoever_hangs_up_at_any_step_is_forgotten() {
    let dir = TempDir::new().unwrap();
    let (a, b) = (process(dir.path(), "a"), process(dir.path(), "b"));
    for step in (0..5).cycle().take(200) {
        let stranger = Stranger::at(b.socket());
        if step > 0 {
            let whole = hello(dir.path()).encode();
            stranger.say(if step == 1 { &whole[..whole.len() / 2] } else { &whole });
        }
        if step > 2 {
            let (_, files) = stranger.hears().unwrap();
            let pulse = Pulse::open(files.into_iter().next().unwrap()).unwrap();
            if step > 3 {
                stranger.greet(&Greeting::Echo { nonce: pulse.nonce() });
                assert_eq!(b.met().peer().process, "c");
                drop(stranger);
                assert_eq!(b.lost().1, Lost::Closed);
            }
        }
    }
    a.links.want(b.socket());
    assert_eq!(a.met().peer().process, "b");
    assert_eq!(b.met().peer().process, "a");
}

#[test]
fn a_card_that_is_none_is_refused_and_nothing_of_it_is_repeated() {
    let dir = TempDir::new().unwrap();
    let b = process(dir.path(), "b");
    let long = "x".repeat(100_000);
    type Lie<'a> = (&'a dyn Fn(&mut Card), &'a str);
    let lies: [Lie<'_>; 5] = [
        (&|c: &mut Card| c.process = "evil\n\u{1b}[31m".into(), "a name that is none"),
        (&|c: &mut Card| c.process = String::new(), "a name that is none"),
        (&|c: &mut Card| c.instance = "x".repeat(100_000), "a name that is none"),
        (&|c: &mut Card| c.boot = "\0".into(), "a name that is none"),
        (&|c: &mut Card| c.socket = "/x".repeat(10_000).into(), "more than 4096 bytes"),
    ];
    for (change, why) in lies {
        let mut card = Card::own("c", dir.path().join("c.sock")).unwrap();
        change(&mut card);
        let stranger = Stranger::at(b.socket());
        stranger.greet(&Greeting::Hello { version: VERSION, card });
        let refused = stranger.refused();
        assert!(refused.contains(why) && refused.len() < 500, "{refused}");
        assert!(!refused.contains(char::is_control), "{refused:?}");
    }
    for said in [format!("g\"{long}\""), format!("g{{\"{long}\":1}}"), "g".to_owned() + &"[".repeat(100_000)]
    {
        let stranger = Stranger::at(b.socket());
        stranger.say(said.as_bytes());
        let refused = stranger.refused();
        assert!(refused.contains("no greeting of ours") && refused.len() < 500, "{refused}");
    }
}

/// A stranger that listens where a process should.
struct Impostor(OwnedFd);

impl Impostor {
    fn at(socket: &Path) -> Impostor {
        Impostor(address::listen(socket).unwrap())
    }

    fn called(&self) -> Stranger {
        loop {
            match rustix::net::accept_with(&self.0, SocketFlags::CLOEXEC | SocketFlags::NONBLOCK) {
                Ok(socket) => return Stranger(socket),
                Err(_) => std::thread::yield_now(),
            }
        }
    }
}

/// Waits until `a` has no session there for a reason that holds `part`; returns the reason.
fn awaits(a: &Process, at: &Path, part: &str) -> String {
    loop {
        let why = a.links.why_not(at).unwrap_or_default();
        if why.contains(part) {
            return why;
        }
        std::thread::yield_now();
    }
}

fn sealed(bytes: u64, present: bool, seals: SealFlags) -> OwnedFd {
    let fd = rustix::fs::memfd_create("test", MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING).unwrap();
    rustix::fs::ftruncate(&fd, bytes).unwrap();
    if present {
        rustix::fs::fallocate(&fd, rustix::fs::FallocateFlags::empty(), 0, bytes).unwrap();
    }
    rustix::fs::fcntl_add_seals(&fd, seals).unwrap();
    fd
}

#[test]
fn whatever_an_impostor_hands_over_for_memory_is_looked_at_first() {
    let dir = TempDir::new().unwrap();
    let a = process(dir.path(), "a");
    let at = dir.path().join("b.sock");
    let impostor = Impostor::at(&at);
    let card = Card::own("b", at.clone()).unwrap();
    let both = SealFlags::SHRINK | SealFlags::GROW;
    let open = |path: &str| OwnedFd::from(std::fs::File::open(path).unwrap());
    let (pipe, _other) = io::pipe().unwrap();
    let given: Vec<(Vec<OwnedFd>, &str)> = vec![
        (Vec::new(), "no memory came along"),
        (vec![pipe.into()], "no memfd"),
        (vec![open("/dev/zero")], "no memfd"),
        (vec![open("/")], "no memfd"),
        (vec![open("/proc/self/exe")], "no memfd"),
        (vec![sealed(4096, true, SealFlags::empty())], "no memfd"),
        (vec![sealed(4096, true, SealFlags::SHRINK)], "no memfd"),
        (vec![sealed(0, false, both)], "0 bytes instead of"),
        (vec![sealed(1 << 40, false, both)], "bytes instead of"),
        (vec![sealed(192, false, both)], "only 0 are there"),
    ];
    a.links.want(&at);
    for (files, why) in given {
        let files: Vec<_> = files.iter().map(AsFd::as_fd).collect();
        let welcome = Greeting::Welcome { card: card.clone() }.encode();
        let refused = loop {
            let caller = impostor.called();
            // Its time may be over on a busy machine: then it calls again.
            let Some((Greeting::Hello { .. }, _)) = caller.hears() else { continue };
            if send(caller.0.as_fd(), &[&welcome], &files).is_ok()
                && let Some((Greeting::Refused { why }, _)) = caller.hears()
            {
                break why;
            }
        };
        assert!(refused.contains(why), "{refused}");
        awaits(&a, &at, why);
    }
    assert!(a.links.refused(&at).is_some(), "to wait is of little use");
    let never = Greeting::Refused { why: format!("\u{1b}[2J\n{}", "never ".repeat(10_000)) };
    let why = loop {
        let caller = impostor.called();
        let _ = send(caller.0.as_fd(), &[&never.encode()], &[]);
        // Until it ends, whichever way.
        while caller.hears().is_some() {}
        if let Some(why) = a.links.why_not(&at).filter(|why| why.contains("never")) {
            break why;
        }
    };
    assert!(why.chars().count() < 400 && !why.contains(char::is_control), "{why:?}");
    let caller = impostor.called();
    caller.hears().unwrap();
    caller.say(b"d\0already");
    awaits(&a, &at, "data before the greeting was over");
    assert_eq!(a.links.refused(&at), None, "it may yet answer");
    // A peer that hangs up in the middle, since its time is over, has refused nothing.
    let caller = impostor.called();
    caller.hears().unwrap();
    rustix::net::shutdown(&caller.0, Shutdown::Read).unwrap();
    let page = Pulse::create([1, 2]).unwrap();
    let welcome = Greeting::Welcome { card: card.clone() }.encode();
    send(caller.0.as_fd(), &[&welcome], &[page.fd().unwrap()]).unwrap();
    awaits(&a, &at, "it cannot be answered");
    assert_eq!(a.links.refused(&at), None, "it may yet answer");
    // A process that was patient with the impostor meets the right one in the end.
    drop(impostor);
    let b = process(dir.path(), "b");
    assert_eq!(a.met().peer().process, "b");
    drop(b);
}

#[test]
fn a_flood_is_read_as_fast_as_it_is_dealt_with_and_takes_no_more_files_than_that() {
    let dir = TempDir::new().unwrap();
    let (a, b) = (process(dir.path(), "a"), process(dir.path(), "b"));
    a.links.want(b.socket());
    let (to_b, _to_a) = (a.met(), b.met());
    let file = memfd(b"x");
    let files = vec![file.as_fd(); MOST_FDS];
    let flood = || (0..100_000).take_while(|_| to_b.send(b"flood", &files).is_ok()).count();
    let first = flood();
    assert!(first < 100_000, "it is told that nobody listens: {:?}", to_b.send(b"?", &files));
    // Nothing was dealt with: what was read stays within bounds however long this goes on.
    let beats = to_b.pulse.theirs();
    while to_b.pulse.theirs() == beats {
        flood();
    }
    let held: Vec<Message> = b
        .news
        .try_iter()
        .filter_map(|news| match news {
            News::Said(message) => Some(message),
            _ => None,
        })
        .collect();
    let open: usize = held.iter().map(|message| message.files.len()).sum();
    assert!(open <= 160, "{open} files are open for {} messages", held.len());
    assert!(!to_b.is_lost(), "it is slow, not lost");
    drop(held);
    assert_eq!(b.said().bytes, b"flood", "it goes on where it was");
}

#[test]
fn whoever_is_not_listened_to_any_more_is_lost_for_that_reason() {
    let dir = TempDir::new().unwrap();
    let (a, b) = (process(dir.path(), "a"), process(dir.path(), "b"));
    a.links.want(b.socket());
    let (to_b, to_a) = (a.met(), b.met());
    to_b.send(b"nonsense", &[]).unwrap();
    assert_eq!(b.said().bytes, b"nonsense");
    to_a.condemn("no words\nof ours");
    let why = b.lost().1;
    assert!(matches!(&why, Lost::Nonsense { what } if what == "no words\u{fffd}of ours"), "{why:?}");
    assert_eq!(a.lost().1, Lost::Closed);
    a.met();
}

#[test]
fn one_process_has_so_many_sessions_and_no_more() {
    let dir = TempDir::new().unwrap();
    let b = process(dir.path(), "b");
    let mut guests: Vec<(Stranger, Pulse)> = Vec::new();
    let refused = loop {
        guests.iter().for_each(|(_, pulse)| pulse.beat(trocar_rt::now_ns()));
        match guest(&b, dir.path()) {
            Ok(guest) => guests.push(guest),
            Err(why) => break why,
        }
    };
    assert!(guests.len() >= MOST_OF_ONE, "{} were let in", guests.len());
    assert!(refused.contains("has 64 sessions with this process already"), "{refused}");
    drop(guests.pop());
    let again = loop {
        guests.iter().for_each(|(_, pulse)| pulse.beat(trocar_rt::now_ns()));
        if let Ok(again) = guest(&b, dir.path()) {
            break again;
        }
    };
    drop(again);
}

#[test]
fn whoever_is_wanted_and_left_again_and_again_is_met_once_in_the_end() {
    let dir = TempDir::new().unwrap();
    let (a, b) = (process(dir.path(), "a"), process(dir.path(), "b"));
    for _ in 0..300 {
        a.links.want(b.socket());
        std::thread::yield_now();
        a.links.leave(b.socket());
    }
    a.links.want(b.socket());
    // Sessions that are still being left say nothing for long; in the end one is there, and heard. The other
    // end may have met this session before this process knows of it, so the message is sent again until it is
    // heard.
    let (mut live, mut heard) = (0, false);
    let mut watchdog = Watchdog::of("one is there in the end, and heard");
    while !heard || live != 1 {
        if let Some(session) = a.links.session(b.socket()) {
            let _ = session.send(b"still here", &[]);
        }
        match b.news.recv_timeout(Duration::from_millis(10)) {
            Ok(News::Met(_)) => (live, heard) = (live + 1, false),
            Ok(News::Lost(..)) => (live, heard) = (live - 1, false),
            Ok(News::Said(_)) => heard = true,
            Err(_) => watchdog.saw(format_args!("{live} are there, heard: {heard}")),
        }
    }
}

/// Only where tests may change their user.
#[test]
fn a_process_of_another_user_is_turned_away_by_what_the_kernel_says() {
    if !rustix::process::geteuid().is_root() {
        return;
    }
    let dir = TempDir::new().unwrap();
    let b = process(dir.path(), "b");
    std::fs::set_permissions(dir.path(), Permissions::from_mode(0o755)).unwrap();
    std::fs::set_permissions(b.socket(), Permissions::from_mode(0o777)).unwrap();
    let at = b.socket().clone();
    let card = Card::own("c", dir.path().join("c.sock")).unwrap();
    let refused = std::thread::spawn(move || {
        let nobody = rustix::process::Uid::from_raw(65_534);
        // The user changes for this thread alone.
        rustix::thread::set_thread_res_uid(nobody, nobody, nobody).unwrap();
        let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
        let socket =
            rustix::net::socket_with(AddressFamily::UNIX, SocketType::SEQPACKET, flags, None).unwrap();
        rustix::net::connect(&socket, &SocketAddrUnix::new(&at).unwrap()).unwrap();
        let stranger = Stranger(socket);
        // Its card says what it likes.
        let _ = send(stranger.0.as_fd(), &[&Greeting::Hello { version: VERSION, card }.encode()], &[]);
        stranger.refused()
    });
    let refused = refused.join().unwrap();
    assert!(refused.contains("user 65534 is not the user of this process, 0"), "{refused}");
}

/// The same the other way round: a listener that would tell any card is told nothing.
#[test]
fn a_listener_of_another_user_is_not_greeted_whatever_its_card_would_say() {
    if !rustix::process::geteuid().is_root() {
        return;
    }
    let dir = TempDir::new().unwrap();
    let a = process(dir.path(), "a");
    std::fs::set_permissions(dir.path(), Permissions::from_mode(0o777)).unwrap();
    let at = dir.path().join("b.sock");
    let listens = at.clone();
    let (begun, begins) = channel();
    let heard = std::thread::spawn(move || {
        let nobody = rustix::process::Uid::from_raw(65_534);
        // The user changes for this thread alone.
        rustix::thread::set_thread_res_uid(nobody, nobody, nobody).unwrap();
        let kind = (AddressFamily::UNIX, SocketType::SEQPACKET);
        let listener = rustix::net::socket_with(kind.0, kind.1, SocketFlags::CLOEXEC, None).unwrap();
        rustix::net::bind(&listener, &SocketAddrUnix::new(&listens).unwrap()).unwrap();
        rustix::net::listen(&listener, 64).unwrap();
        begun.send(()).unwrap();
        let caller = rustix::net::accept_with(&listener, SocketFlags::CLOEXEC | SocketFlags::NONBLOCK);
        let heard = Stranger(caller.unwrap()).hears();
        (heard, listener)
    });
    begins.recv().unwrap();
    a.links.want(&at);
    // Still there when it is called again.
    let (heard, _listener) = heard.join().unwrap();
    assert!(heard.is_none(), "it was told {heard:?}");
    let why = loop {
        match a.links.why_not(&at) {
            Some(why) => break why,
            None => std::thread::yield_now(),
        }
    };
    assert!(why.contains("user 65534 is not the user of this process, 0") && why.contains("b.sock"), "{why}");
    assert!(a.links.session(&at).is_none() && a.news.try_recv().is_err(), "it was met");
}

#[test]
fn nobody_listens_where_it_cannot_and_the_sentence_says_where() {
    let dir = TempDir::new().unwrap();
    let listen = |path: PathBuf| address::listen(&path).unwrap_err().to_string();
    let missing = dir.path().join("missing/a.sock");
    assert!(listen(missing.clone()).contains("missing/a.sock"), "{}", listen(missing));
    let folder = dir.path().join("folder");
    std::fs::create_dir(&folder).unwrap();
    assert!(listen(folder.clone()).contains("cannot be replaced"), "{}", listen(folder));
    let long = dir.path().join("x".repeat(120));
    assert!(listen(long.clone()).contains("80 bytes at most"), "{}", listen(long));
}

proptest! {
    /// Bytes of any kind are a message of ours or none.
    #[test]
    fn any_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        if let Err(why) = parse(&bytes) {
            prop_assert!(why.len() < 2000 && !why.contains(char::is_control), "{why:?}");
        }
    }

    /// So is a greeting of which some bytes are others.
    #[test]
    fn a_damaged_greeting_is_read_or_refused(at in 0usize..200, with in any::<u8>(), cut in 0usize..200) {
        let card = Card::own("c", "/run/c.sock".into()).unwrap();
        let mut bytes = Greeting::Hello { version: VERSION, card }.encode();
        let last = bytes.len() - 1;
        bytes[at.min(last)] = with;
        bytes.truncate(bytes.len() - cut.min(last));
        if let Err(why) = parse(&bytes) {
            prop_assert!(why.len() < 2000 && !why.contains(char::is_control), "{why:?}");
        }
    }
}
