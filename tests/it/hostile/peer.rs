//! A peer behind an agreed connection: nonsense in the memory it shares, in what it says, in what it hands
//! over.

use std::os::fd::{AsFd, OwnedFd};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;

use rustix::fs::{FallocateFlags, MemfdFlags, SealFlags};
use serde_json::{Value, json};
use trocar_rt::region::{Layout, Region};
use trocar_rt::segment::{Agreed, Stream, StreamShape};
use trocar_rt::stream::{DropPolicy, Payload, Queue, RemotePools, StreamWriter};
use trocar_tests::{HostProcess, eventually, number};

use super::impostor::{Impostor, hash_in, length, open, opened, say};
use super::stranger::instance_of;
use super::{Lab, await_nothing_left, holds, lines};

/// Writes anything anywhere in memory the victim has mapped, until it goes.
struct Scribbler {
    over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Scribbler {
    fn on(file: OwnedFd) -> Scribbler {
        let bytes = length(file.as_fd());
        let region = Region::open(file, bytes).unwrap();
        let over = Arc::new(AtomicBool::new(false));
        let until = over.clone();
        let thread = std::thread::spawn(move || {
            let words = Layout::words(&region, bytes / 8);
            let mut random = fastrand::Rng::with_seed(bytes as u64);
            while !until.load(Ordering::Relaxed) {
                let word: &AtomicU64 = &words[random.usize(..words.len())];
                let was = word.load(Ordering::Relaxed);
                let value = match random.u8(..6) {
                    0 => random.u64(..),
                    1 => random.u64(..8),
                    2 => u64::MAX - random.u64(..8),
                    3 => was ^ (1 << random.u8(..64)),
                    4 => was.wrapping_add(random.u64(..9)).wrapping_sub(4),
                    _ => u64::from(random.u32(..)) << 32 | 1,
                };
                word.store(value, Ordering::Relaxed);
                if random.u8(..) == 0 {
                    std::thread::yield_now();
                }
            }
        });
        Scribbler { over, thread: Some(thread) }
    }
}

impl Drop for Scribbler {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// `left` with connections both ways to `right`, and to a bystander.
struct Scene {
    lab: Lab,
    left: HostProcess,
    bystander: HostProcess,
    right: Option<HostProcess>,
}

impl Scene {
    fn set() -> Scene {
        let lab = Lab::new();
        let (left, right, bystander) = (lab.host("left"), lab.host("right"), lab.host("mid"));
        for process in ["left", "right", "mid"] {
            lab.furnish(process);
        }
        lab.connect("right", "left");
        lab.connect("left", "right");
        // The bystander needs what left gives, and left's own clients are taken: one way only.
        lab.connect("mid", "left");
        for process in ["left", "right", "mid"] {
            lab.start_all(process);
        }
        let scene = Scene { lab, left, bystander, right: Some(right) };
        scene.all_flows();
        scene
    }

    fn all_flows(&self) {
        for process in ["left", "right", "mid"] {
            self.lab.await_flow(&format!("{process}/e/sample"));
            self.lab.await_flow(&format!("{process}/client/Required"));
        }
    }

    /// Right ends, and somebody else is in its place.
    fn impostor(&mut self) -> Impostor {
        let state = self.lab.world.state();
        let (socket, victim) = (state.join("right/links.sock"), state.join("left/links.sock"));
        let instance = instance_of(&socket);
        self.right.take();
        Impostor::as_process(("right", instance), &socket, &victim)
    }

    /// Left lives, and what has nothing to do with right goes on.
    fn undisturbed(&mut self) {
        assert!(self.left.is_alive() && self.bystander.is_alive());
        self.lab.await_flow("mid/e/sample");
        self.lab.await_flow("mid/client/Required");
        self.lab.await_steps("left/s", 20);
        let state = self.lab.grpc.state("left/server");
        assert_eq!(state, "ACTIVE", "whom right only sent commands to");
    }

    /// The right one comes back, and everything is as it was.
    fn right_returns(&mut self) {
        self.right = Some(self.lab.host("right"));
        eventually("right has its components again", || {
            let list = self.lab.grpc.ok("GcmService/List", json!({}));
            let missing = list["components"].as_array().into_iter().flatten().find(|c| {
                c["path"].as_str().unwrap_or_default().starts_with("right/")
                    && c["state"] != "COMPONENT_STATE_ACTIVE"
            });
            missing.map_or(Ok(()), |c| Err(c.to_string()))
        });
        self.all_flows();
    }
}

const SAMPLE: StreamShape = StreamShape {
    payload: Payload::Plain { bytes: 16 },
    queue: Queue::Fifo { depth: 64, drop: DropPolicy::DropOldest },
};

fn stream(hash: u64, epoch: u64) -> Stream<StreamWriter> {
    Stream::<StreamWriter>::create(SAMPLE, Agreed { hash, epoch }, &Arc::new(RemotePools::default())).unwrap()
}

fn memfd(bytes: u64, seals: SealFlags) -> OwnedFd {
    let fd = rustix::fs::memfd_create("hostile", MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING).unwrap();
    rustix::fs::ftruncate(&fd, bytes).unwrap();
    rustix::fs::fallocate(&fd, FallocateFlags::empty(), 0, bytes.clamp(1, 1 << 20)).unwrap();
    if bytes > 0 {
        rustix::fs::fcntl_add_seals(&fd, seals).unwrap();
    }
    fd
}

#[test]
fn nonsense_in_shared_memory_harms_its_own_connection_only() {
    let mut scene = Scene::set();
    let before = holds(scene.left.pid());
    let stream_to_left = number(&scene.lab.connection("left/e/sample")["id"]);
    let mut impostor = scene.impostor();
    let mut scribblers = Vec::new();
    let (mut serves, mut reads) = (false, 0);
    eventually("its victim asks for the stream, and offers its own stream and its commands", || {
        while (!serves || reads < 2)
            && let Some(words) = impostor.hears()
        {
            let connection = number(&words.body["connection"]);
            match words.verb.as_str() {
                "Offered" => say(&words.session, &open(connection, 0), &[]),
                "Declined" => {
                    let why = words.body["why"].as_str().unwrap_or_default();
                    assert!(why.contains("the types of left/"), "{why}");
                    let hash = hash_in(why).unwrap_or_else(|| panic!("no hash in {why}"));
                    say(&words.session, &open(connection, hash), &[]);
                }
                "Opened" => {
                    scribblers.extend(words.files.into_iter().take(1).map(Scribbler::on));
                    reads += 1;
                }
                "Open" if connection == stream_to_left && !serves => {
                    let (hash, epoch) = (number(&words.body["hash"]), 1);
                    let out = stream(hash, epoch);
                    let file = out.fd().unwrap();
                    say(&words.session, &opened(connection, epoch, json!([])), &[file]);
                    scribblers.push(Scribbler::on(file.try_clone_to_owned().unwrap()));
                    serves = true;
                }
                _ => {}
            }
        }
        if serves && reads >= 2 { Ok(()) } else { Err(format!("it serves: {serves}; it reads {reads}")) }
    });
    for _ in 0..3 {
        scene.undisturbed();
        // Figures of what is scribbled on are figures, too.
        scene.lab.connections();
        scene.lab.grpc.ok("GcmService/GetState", json!({ "path": "left/e" }));
        scene.lab.grpc.ok("GcmService/GetState", json!({ "path": "left/server" }));
    }
    let printed = scene.left.printed().lines().count();
    assert!(printed < 100, "{printed} lines: {}", scene.left.printed());
    drop(scribblers);
    drop(impostor);
    scene.right_returns();
    await_nothing_left(&scene.left, before);
    assert!(!scene.left.printed().contains("panicked"), "{}", scene.left.printed());
}

#[test]
fn whatever_is_handed_over_for_the_memory_of_a_link_is_refused_with_a_sentence() {
    let mut scene = Scene::set();
    let before = holds(scene.left.pid());
    let (to_stream, to_calls) = (
        number(&scene.lab.connection("left/e/sample")["id"]),
        number(&scene.lab.connection("left/client/Required")["id"]),
    );
    let mut impostor = scene.impostor();
    let both = SealFlags::SHRINK | SealFlags::GROW;
    let bytes = length(stream(1, 1).fd().unwrap()) as u64;
    let file = |path: &str| OwnedFd::from(std::fs::File::open(path).unwrap());
    let (pipe, _other) = std::io::pipe().unwrap();
    let absurd =
        json!([{ "place": 0, "slots": u32::MAX, "header_bytes": 1u64 << 40, "max_bytes": 1u64 << 62 }]);
    let tebibyte = json!([{ "place": 0, "slots": 1, "header_bytes": 64, "max_bytes": (1u64 << 40) - 64 }]);
    let many: Vec<Value> =
        (0..30).map(|n| json!({ "place": n, "slots": 1, "header_bytes": 0, "max_bytes": 4096 })).collect();
    let pages = || memfd(4096, both | SealFlags::FUTURE_WRITE);
    let good = |hash: u64| stream(hash, 7).fd().unwrap().try_clone_to_owned().unwrap();
    type Given<'a> = Box<dyn Fn(u64) -> Vec<OwnedFd> + 'a>;
    let mut given: Vec<(Value, Given<'_>, &str)> = vec![
        (json!([]), Box::new(|_| Vec::new()), "no memory came along"),
        (json!([]), Box::new(|_| vec![pipe.try_clone().unwrap().into()]), "no memfd"),
        (json!([]), Box::new(|_| vec![file("/dev/zero")]), "no memfd"),
        (json!([]), Box::new(|_| vec![file("/")]), "no memfd"),
        (json!([]), Box::new(|_| vec![memfd(bytes, SealFlags::SHRINK)]), "no memfd"),
        (json!([]), Box::new(|_| vec![memfd(bytes - 64, both)]), "bytes instead of"),
        (json!([]), Box::new(|_| vec![memfd(1 << 40, both)]), "bytes instead of"),
        (json!([]), Box::new(|_| vec![memfd(bytes, both)]), "its first word"),
        (json!([]), Box::new(|hash| vec![good(hash ^ 1)]), "the hash of its types"),
        (absurd, Box::new(|hash| vec![good(hash), pages()]), "cannot exist"),
        (
            tebibyte,
            Box::new(|hash| vec![good(hash), memfd(1 << 40, both | SealFlags::FUTURE_WRITE)]),
            "are there",
        ),
        (json!([many[0]]), Box::new(|hash| vec![good(hash), memfd(4096, both)]), "takes new writers"),
        (
            json!(many),
            Box::new(|hash| std::iter::once(good(hash)).chain((0..30).map(|_| pages())).collect()),
            "place",
        ),
        (json!([many[3], many[3]]), Box::new(|hash| vec![good(hash), pages(), pages()]), "is taken"),
        (json!([many[0]]), Box::new(|hash| vec![good(hash)]), "did not come along"),
    ];
    given.reverse();
    let why_not = |scene: &Scene, client: &str| {
        let proxies = scene.lab.connection(client)["proxies"].clone();
        let half = proxies.as_array().into_iter().flatten().find(|half| half["process"] == "left").cloned();
        half.map_or_else(String::new, |half| half["why"].to_string() + &half.to_string())
    };
    let mut rows = false;
    eventually("everything that is handed over is refused", || {
        let Some((pools, files, why)) = given.last() else { return Ok(()) };
        let left = format!("{} are left, the next one: {why}", given.len());
        let Some(words) = impostor.hears() else { return Err(left) };
        let connection = number(&words.body["connection"]);
        match (words.verb.as_str(), connection) {
            ("Open", connection) if connection == to_stream => {
                let files = files(number(&words.body["hash"]));
                let files: Vec<_> = files.iter().map(AsFd::as_fd).collect();
                say(&words.session, &opened(connection, 7, pools.clone()), &files);
                eventually(&format!("left says why: {why}"), || {
                    let said = why_not(&scene, "left/e/sample");
                    if said.contains(why) { Ok(()) } else { Err(said) }
                });
                given.pop();
            }
            // Memory of another connection, then rows that do not come along.
            ("Open", connection) if connection == to_calls => {
                let hash = number(&words.body["hash"]);
                let mut opened = opened(connection, 7, json!([]));
                say(&words.session, &opened, &[good(hash).as_fd()]);
                opened["Opened"]["rows"] = json!(true);
                say(&words.session, &opened, &[good(hash).as_fd()]);
                rows |= why_not(&scene, "left/client/Required").contains("no rows came along");
            }
            _ => {}
        }
        Err(left)
    });
    assert!(rows, "rows that did not come along were not refused");
    scene.undisturbed();
    drop(given);
    drop(impostor);
    scene.right_returns();
    await_nothing_left(&scene.left, before);
}

#[test]
fn words_that_are_none_and_words_out_of_place_change_nothing_of_anybody_else() {
    let mut scene = Scene::set();
    let before = holds(scene.left.pid());
    let id = |client: &str| number(&scene.lab.connection(client)["id"]);
    let (own, others) = (id("right/client/Required"), id("mid/e/sample"));
    let served = id("left/client/Required");
    let impostor = scene.impostor();
    let victim = scene.lab.world.state().join("left/links.sock");
    for connection in [own, others, served, 0, u64::MAX] {
        let session = impostor.session(&victim);
        for words in [
            json!({ "Open": { "connection": connection, "hash": u64::MAX } }),
            json!({ "Open": { "connection": connection, "hash": 0, "code": "\u{1b}[2J".repeat(1000) } }),
            json!({ "Opened": { "connection": connection, "epoch": u64::MAX, "pools": [] } }),
            json!({ "Opened": { "connection": connection, "epoch": 1, "rows": true, "pools": [] } }),
            json!({ "Panicked": { "connection": connection, "epoch": 0, "count": u64::MAX } }),
            json!({ "Offered": { "connection": connection } }),
            json!({ "Declined": { "connection": connection, "why": "\u{1b}[2J".repeat(1000), "later": true } }),
            json!({ "Close": { "connection": connection, "epoch": u64::MAX } }),
            json!({ "Toll": { "connection": connection, "epoch": 0, "failed": u64::MAX, "unexecuted": u64::MAX } }),
            json!({ "Pools": { "connection": connection, "epoch": 1, "pools": [
                { "place": usize::MAX, "slots": 1, "header_bytes": 0, "max_bytes": 1 }] } }),
            json!({ "Ask": { "connection": connection, "epoch": 0, "number": 1, "index": u32::MAX, "left_ns": u64::MAX } }),
            json!({ "Told": { "connection": connection, "epoch": 0, "number": 1, "outcome": 0, "stamp_ns": 0,
                "value_bytes": u32::MAX } }),
        ] {
            (0..20).for_each(|_| say(&session, &words, &[]));
        }
    }
    // What is no words at all ends the session, again and again.
    let mut ended = 0;
    while ended < 50 {
        let session = impostor.session(&victim);
        let nonsense: &[u8] = match ended % 5 {
            0 => b"",
            1 => &[0xff; 100],
            2 => b"\xff\xff\xff\x7f{}",
            3 => b"\x02\0\0\0{}",
            _ => b"\x06\0\0\0\"Word\"",
        };
        // A victim that is behind with reading takes nothing for a while: it is said until it was heard.
        let mut said = false;
        eventually("that session is over", || {
            said = said || session.send(nonsense, &[]).is_ok();
            if session.is_lost() { Ok(()) } else { Err(format!("it is not; nonsense was sent: {said}")) }
        });
        ended += 1;
    }
    scene.undisturbed();
    let told = lines(&scene.left, "not listened to");
    assert!((1..=10).contains(&told), "{told} lines for {ended} sessions:\n{}", scene.left.printed());
    assert!(!scene.left.printed().contains('\u{1b}'), "what a peer says is shown as it is");
    drop(impostor);
    scene.right_returns();
    await_nothing_left(&scene.left, before);
}
