//! Processes that die, and how soon that is known; processes that only pretend to have died.

use std::io::Read;
use std::mem::ManuallyDrop;
use std::os::unix::process::ExitStatusExt;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::Ordering;

use rustix::process::{Pid, Resource, Rlimit, Signal};
use trocar_rt::pulse::Life;
use trocar_rt::robust_words::RobustWords;

use super::*;
use crate::asked::{Ask, Shared};
use crate::session::Peer;
use crate::watch::Watch;

/// Socket of the other process of a test; set in that process only.
const CHILD: &str = "TROCAR_LINKS_CHILD";

/// This program again as process `b`, until it is killed, or this one is.
fn child(dir: &Path) -> Child {
    let me = std::env::current_exe().unwrap();
    let mut command = Command::new(me);
    command.args(["--exact", "tests::death::the_other_process_of_the_tests_here", "--nocapture"]);
    command.env(CHILD, dir).stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null());
    command.spawn().unwrap()
}

/// Passes when it is run for itself.
#[test]
fn the_other_process_of_the_tests_here() {
    let Some(dir) = std::env::var_os(CHILD) else { return };
    let no_core = Rlimit { current: Some(0), maximum: Some(0) };
    rustix::process::setrlimit(Resource::Core, no_core).unwrap();
    let b = process(Path::new(&dir), "b");
    let to_a = b.met();
    // Held by the other one, it stays open whatever becomes of this process.
    to_a.send(b"my socket", &[to_a.socket()]).unwrap();
    if b.said().bytes == b"exit" {
        std::process::exit(7);
    }
    let _ = std::io::stdin().read(&mut [0]);
}

#[test]
fn a_process_that_dies_is_told_of_however_it_dies_and_though_its_socket_is_open() {
    let by_signal = [Signal::KILL, Signal::ILL, Signal::ABORT, Signal::TERM].map(Some);
    for (signal, socket_stays) in by_signal.into_iter().chain([None]).flat_map(|s| [(s, true), (s, false)]) {
        let dir = TempDir::new().unwrap();
        let a = process(dir.path(), "a");
        a.links.want(&dir.path().join("b.sock"));
        let mut child = child(dir.path());
        let session = a.met();
        let mut socket = a.said().files;
        assert_eq!(socket.len(), 1);
        // Without it either sign may come first, and the reason is the same.
        socket.truncate(usize::from(socket_stays));
        session.send(if signal.is_some() { b"stay" } else { b"exit" }, &[]).unwrap();
        if let Some(signal) = signal {
            rustix::process::kill_process(Pid::from_child(&child), signal).unwrap();
        }
        assert_eq!(a.lost(), (session.number(), Lost::Died), "after {signal:?}");
        assert!(session.is_lost());
        let status = child.wait().unwrap();
        assert_eq!(status.signal(), signal.map(Signal::as_raw), "{status}");
    }
}

#[test]
fn a_process_that_says_it_died_loses_its_own_session_only() {
    let dir = TempDir::new().unwrap();
    let (a, b) = (process(dir.path(), "a"), process(dir.path(), "b"));
    a.links.want(b.socket());
    let (to_b, to_a) = (a.met(), b.met());
    let (liar, pulse) = hostile::guest(&b, dir.path()).unwrap();
    let lied = b.met();
    // The maker of the page looks at the word of the guest itself.
    lied.pulse.life_word().store(DIED, Ordering::Release);
    assert_eq!(b.lost(), (lied.number(), Lost::Died));
    assert!(liar.hears().is_none(), "its socket was closed");
    // A guest that writes into the word of its host costs that host nothing.
    let (other, pulse_too) = hostile::guest(&b, dir.path()).unwrap();
    let second = b.met();
    pulse_too.life_word().store(DIED, Ordering::Release);
    to_b.send(b"undisturbed", &[]).unwrap();
    assert_eq!(b.said().bytes, b"undisturbed");
    assert!(!to_a.is_lost() && !to_b.is_lost() && !second.is_lost());
    drop((other, pulse, pulse_too));
}

/// The death wakes no watcher and the socket does not tell it: as where the kernel cannot sleep on several
/// words.
#[test]
fn whoever_died_before_it_was_watched_is_found_with_the_next_heartbeat() {
    let dir = TempDir::new().unwrap();
    let b = process(dir.path(), "b");
    let guest = Stranger::at(b.socket());
    let card = Card::own("c", dir.path().join("c.sock")).unwrap();
    guest.greet(&Greeting::Hello { version: VERSION, card });
    let (_, files) = guest.hears().unwrap();
    let pulse = Pulse::open(files.into_iter().next().unwrap()).unwrap();
    let nonce = pulse.nonce();
    lives(pulse)();
    guest.greet(&Greeting::Echo { nonce });
    let session = b.met();
    assert_eq!(b.lost(), (session.number(), Lost::Died));
}

/// Bit the kernel writes into the word of a thread that died.
const DIED: u32 = 0x4000_0000;

/// A session whose other end is a thread of this process, and that end of its page.
fn session(number: u64) -> (Arc<Session>, Pulse) {
    let pulse = Pulse::create([number, 0]).unwrap();
    let theirs = Pulse::open(pulse.fd().unwrap().try_clone_to_owned().unwrap()).unwrap();
    let peer = Peer { process: "p".into(), instance: "i".into(), pid: 1 };
    let socket = memfd(b"");
    (Arc::new(Session::new(number, peer, ("/p".into(), true), socket, pulse)), theirs)
}

/// A thread that lives until it is let go, and leaves its marks.
fn lives(pulse: Pulse) -> impl FnOnce() {
    let (ready, is_ready) = channel();
    let (go, gone) = channel::<()>();
    let thread = std::thread::spawn(move || {
        let mut robust_words = ManuallyDrop::new(RobustWords::of_this_thread().unwrap());
        robust_words.add(&pulse).unwrap();
        ready.send(()).unwrap();
        let _ = gone.recv();
    });
    is_ready.recv().unwrap();
    move || {
        drop(go);
        thread.join().unwrap();
    }
}

/// Collects the numbers of the sessions whose process died, until there are `count`.
fn died(shared: &Shared, count: usize) -> Vec<u64> {
    let mut died = Vec::new();
    while died.len() < count {
        died.extend(shared.take().into_iter().map(|ask| match ask {
            Ask::Died(number) => number,
            _ => panic!("nobody asked"),
        }));
        std::thread::yield_now();
    }
    died
}

#[test]
fn a_death_is_told_at_once_and_those_that_play_with_their_word_do_not_hide_it() {
    let shared = Arc::new(Shared::new().unwrap());
    let mut watch = Watch::new(shared.clone());
    let silent = session(0);
    assert!(!watch.add(&silent.0), "it has written no word");
    let (honest, end) = session(1);
    let dies = lives(end);
    assert!(watch.add(&honest));
    let mut players = Vec::new();
    for number in 2..8 {
        let (player, end) = session(number);
        let ends = lives(end);
        assert!(watch.add(&player));
        players.push((player, ends));
    }
    // Some change it, and some ring although nothing changed: both without end, if they were listened to.
    for (at, (player, _)) in players.iter().enumerate() {
        let word = player.pulse.life_word();
        for n in 0..200 {
            if at % 2 == 0 {
                word.store(0x8000_0001 + n % 2, Ordering::Release);
            }
            trocar_rt::os::futex_wake(word, 1, trocar_rt::os::Scope::Machine);
        }
    }
    dies();
    assert_eq!(died(&shared, 1), [1]);
    assert_eq!(honest.pulse.life(), Life::Died);
    // One that is not watched any more is not told of.
    watch.remove(&players[1].0);
    for (_, ends) in players {
        ends();
    }
    drop(watch);
    assert!(
        shared.take().iter().all(|ask| matches!(ask, Ask::Died(5 | 7))),
        "the others had changed their word"
    );
}

#[test]
fn as_many_are_watched_as_the_kernel_lets_and_one_more_finds_its_place_later() {
    let shared = Arc::new(Shared::new().unwrap());
    let mut watch = Watch::new(shared.clone());
    let mut all: Vec<_> = (1..=127)
        .map(|number| {
            let (session, end) = session(number);
            let dies = lives(end);
            assert!(watch.add(&session), "{number}");
            (session, dies)
        })
        .collect();
    let (one_more, end) = session(128);
    let dies = lives(end);
    assert!(!watch.add(&one_more));
    let (last, its_end) = all.pop().unwrap();
    its_end();
    assert_eq!(died(&shared, 1), [last.number()]);
    assert!(watch.add(&one_more));
    dies();
    assert_eq!(died(&shared, 1), [128]);
    all.into_iter().for_each(|(_, dies)| dies());
    assert_eq!(died(&shared, 126).len(), 126);
}
