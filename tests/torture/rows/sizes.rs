//! Rows about messages that are larger than allowed, or say so.

use std::io::{IoSlice, IoSliceMut};
use std::mem::MaybeUninit;
use std::os::fd::OwnedFd;
use std::path::Path;

use rustix::io::Errno;
use rustix::net::{
    AddressFamily, RecvAncillaryBuffer, RecvAncillaryMessage, RecvFlags, SendAncillaryBuffer, SendFlags,
    SocketAddrUnix, SocketFlags, SocketType,
};
use serde_json::json;
use trocar_proto::v1::ConnectOptions;

use crate::book::Book;
use crate::clock::{Witness, eventually, now_ns};
use crate::invariants::{Holdings, nothing_is_left};
use crate::json::number;
use crate::procfs;
use crate::program::Program;
use crate::rpc::Rpc;
use crate::run::{Row, Run, When};
use crate::world::World;

pub(crate) const ROWS: &[Row] = &[Row {
    name: "44",
    fault: "messages that are too long, or say that they are",
    when: When::Gate,
    run: oversize,
}];

/// Rounds before anything is measured: each thread of a runtime keeps what its first large request took.
const WARM: u64 = 30;
/// What memory in use may grow by, KiB.
const MOST_KIB: u64 = 1024;
/// Longest message between processes with the two bytes before it, B.
const MOST: usize = (128 << 10) + 2;
/// Longest message to the port, B.
const MOST_GRPC: u32 = 4 << 20;
/// Where the page two processes share has its number, B.
const NONCE_AT: u64 = 16;

fn oversize(run: &Run, book: &mut Book) -> Result<(), String> {
    let world = World::new(&["fixture_torture"])?;
    let mut gcm = Program::gcm(&world)?;
    let mut a = Program::host(&world, "a", Some(&gcm.address))?;
    let mut b = Program::host(&world, "b", Some(&gcm.address))?;
    let (rpc, own) = (Rpc::at(&gcm.address), Rpc::at(&b.address));
    eventually("a source and a sink", || {
        for (path, class) in [("a/source", "source"), ("b/sink", "sink")] {
            match rpc.create(path, &format!("fixture-torture/{class}"), json!({})) {
                Err(refused) if refused.reason != "COMPONENT_EXISTS" => return Err(refused.to_string()),
                _ => {}
            }
        }
        Ok(())
    })?;
    rpc.connect("b/sink/value", "a/source/value", ConnectOptions::default())?;
    for path in ["b/sink", "a/source"] {
        rpc.start(path)?;
    }
    let socket = world.path("state/a/links.sock");
    let gaps = number(&own.row("b/sink")?["books"]["gaps"]);
    // What comes with the first of each kind stays.
    for program in [&a, &gcm] {
        at_the_port(program, WARM)?;
    }
    at_the_socket(&socket, WARM)?;
    let held = Holdings::of(&[("a", a.pid()), ("b", b.pid()), ("gcm", gcm.pid())]);
    let before = [a.pid(), gcm.pid()].map(procfs::rss_kib);
    let (rounds, witness) = (run.times(5, 500), Witness::start());
    let began = now_ns();
    let tried = 2 * at_the_port(&a, rounds)?;
    at_the_port(&gcm, rounds)?;
    book.check("the port refuses each before it comes", tried, Ok(()));
    let tried = at_the_socket(&socket, rounds)?;
    book.check("the socket turns each away", tried, Ok(()));
    let each = witness.timed(began, now_ns(), 0.0);
    let each = crate::book::Timed { ms: each.ms / (3 * rounds) as f64, ..each };
    book.times("each round of them", &[each], 1_000.0);
    for (name, pid, before) in [("a", a.pid(), before[0]), ("the GCM", gcm.pid(), before[1])] {
        let grown = procfs::rss_kib(pid).saturating_sub(before);
        book.at_most(&format!("KiB more in use at {name}"), tried, grown, MOST_KIB);
    }
    book.check("no file, thread, socket, segment more (G5)", 1, held.have_not_grown());
    let books = own.row("b/sink")?["books"].take();
    book.at_most_in_time("samples lost meanwhile (G4)", tried, number(&books["gaps"]) - gaps, 0);
    let taken = number(&books["taken"]);
    let goes_on = eventually("samples flow", || match number(&own.row("b/sink")?["books"]["taken"]) {
        now if now > taken => Ok(()),
        now => Err(format!("{now}")),
    });
    book.check("both processes go on", 1, goes_on);
    for program in [&mut b, &mut a, &mut gcm] {
        program.terminate()?;
    }
    nothing_is_left(book, &world);
    Ok(())
}

/// A message that says it has so many bytes, and what comes of it.
fn message(says: u32, comes: usize) -> Option<String> {
    let mut bytes = vec![0];
    bytes.extend(says.to_be_bytes());
    bytes.resize(5 + comes, b'\n');
    // All of them are letters, or there is no such body.
    String::from_utf8(bytes).ok()
}

/// Each is refused for its length: no other reason counts. Answers how many there were.
fn at_the_port(program: &Program, rounds: u64) -> Result<usize, String> {
    let rpc = Rpc::at(&program.address);
    let mut methods = vec!["GcmService/Create", "InteractService/Invoke", "PluginService/DescribePlugin"];
    if program.name == "gcm" {
        methods.push("AttachService/Attach");
    }
    let mut tried = 0;
    for _ in 0..rounds {
        for method in &methods {
            for (says, comes) in [(1 << 30, 16), (1 << 30, 1 << 20), (MOST_GRPC + 1, 16), (0x7f7f_7f7f, 0)] {
                let body = message(says, comes).ok_or("no such body")?;
                let (status, why) = rpc.raw(&format!("/trocar.v1.{method}"), body)?;
                tried += 1;
                // OUT_OF_RANGE is what gRPC libraries say; RESOURCE_EXHAUSTED what its specification does.
                // A first message of Attach that cannot be read is no hello.
                let no_hello = status == "3" && why.contains("hello");
                if !matches!(status.as_str(), "11" | "8") && !no_hello {
                    return Err(format!("{method}, {says} B said, {comes} B sent: status {status}: {why}"));
                }
            }
        }
    }
    Ok(tried)
}

/// A socket of the right kind, and no manners.
struct Stranger(OwnedFd);

impl Stranger {
    fn at(socket: &Path) -> Result<Stranger, String> {
        eventually("there is room at the socket", || {
            let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
            let own = rustix::net::socket_with(AddressFamily::UNIX, SocketType::SEQPACKET, flags, None);
            let own = own.map_err(|e| e.to_string())?;
            let address = SocketAddrUnix::new(socket).map_err(|e| e.to_string())?;
            rustix::net::connect(&own, &address).map_err(|e| format!("{}: {e}", socket.display()))?;
            Ok(Stranger(own))
        })
    }

    fn say(&self, bytes: &[u8]) {
        let mut none = SendAncillaryBuffer::default();
        // Whoever was turned away already is not heard.
        let _ = rustix::net::sendmsg(&self.0, &[IoSlice::new(bytes)], &mut none, SendFlags::NOSIGNAL);
    }

    /// What it is answered, and the file that comes along; empty when that is nothing and the end.
    fn hears(&self) -> Result<(String, Option<OwnedFd>), String> {
        eventually("it is answered", || {
            let mut room = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(4))];
            let (mut files, mut bytes) = (RecvAncillaryBuffer::new(&mut room), [0; 4096]);
            let flags = RecvFlags::DONTWAIT | RecvFlags::CMSG_CLOEXEC;
            match rustix::net::recvmsg(&self.0, &mut [IoSliceMut::new(&mut bytes)], &mut files, flags) {
                Ok(heard) => {
                    let file = files.drain().find_map(|message| match message {
                        RecvAncillaryMessage::ScmRights(mut fds) => fds.next(),
                        _ => None,
                    });
                    Ok((String::from_utf8_lossy(&bytes[..heard.bytes]).into_owned(), file))
                }
                Err(Errno::AGAIN) => Err("nothing yet".into()),
                Err(_) => Ok((String::new(), None)),
            }
        })
    }

    /// The first words of a greeting, and the answer to them.
    fn says_hello(&self, layout: u64) -> Result<(String, Option<OwnedFd>), String> {
        let boot = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").map_err(|e| e.to_string())?;
        let card = json!({
            "process": "guest", "instance": "0123456789abcdef", "boot": boot.trim(), "layout": layout,
            "uid": rustix::process::geteuid().as_raw(), "socket": "/nowhere/links.sock",
        });
        self.say(format!("g{}", json!({ "Hello": { "version": 1, "card": card } })).as_bytes());
        self.hears()
    }

    /// The whole greeting: from then on it is a process like any other.
    fn greets(&self, layout: u64) -> Result<(), String> {
        let (heard, page) = self.says_hello(layout)?;
        let page = page.ok_or(format!("no page came along: {heard}"))?;
        let mut nonce = [0; 16];
        rustix::io::pread(&page, &mut nonce, NONCE_AT).map_err(|e| e.to_string())?;
        let (one, two) = nonce.split_at(8);
        let words: Vec<u64> =
            [one, two].iter().filter_map(|w| (*w).try_into().ok()).map(u64::from_ne_bytes).collect();
        self.say(format!("g{}", json!({ "Echo": { "nonce": words } })).as_bytes());
        match self.hears()?.0 {
            ready if ready == "g\"Ready\"" => Ok(()),
            other => Err(format!("after the greeting: {other}")),
        }
    }

    /// Waits until it is hung up on.
    fn ends(&self) -> Result<(), String> {
        eventually("it is hung up on", || match self.hears()?.0 {
            nothing if nothing.is_empty() => Ok(()),
            more => Err(more.chars().take(60).collect()),
        })
    }
}

/// The layout of shared memory of the process at a socket: it says it to a stranger of another one.
fn layout_of(socket: &Path) -> Result<u64, String> {
    let (heard, _) = Stranger::at(socket)?.says_hello(0)?;
    let said = heard.split("in version 0, this process in ").nth(1);
    let number = said.and_then(|rest| rest.split(':').next()).and_then(|number| number.parse().ok());
    number.ok_or(format!("another layout was answered {heard:?}"))
}

/// Strangers, and one that greets as it should and then says too much. Answers how many there were.
fn at_the_socket(socket: &Path, rounds: u64) -> Result<usize, String> {
    let length = (1_u32 << 30).to_le_bytes();
    let said: [(&[u8], &str); 4] = [
        (&[&b"g"[..], &vec![b' '; MOST]].concat(), "more than"),
        (&[&b"d\0"[..], &length, b"hello"].concat(), "data before the greeting"),
        (&[&length[..], b"hello"].concat(), "nothing of ours"),
        (&vec![b'['; MOST + 20_000], "more than"),
    ];
    let layout = layout_of(socket)?;
    let mut tried = 0;
    for _ in 0..rounds {
        for (bytes, why) in said {
            let stranger = Stranger::at(socket)?;
            stranger.say(bytes);
            let (heard, _) = stranger.hears()?;
            if !heard.contains(why) {
                return Err(format!("{} B were answered {heard:?}", bytes.len()));
            }
            tried += 1;
        }
        let late = [&[&b"d\0"[..], &length, b"{}"].concat()[..], &vec![b'd'; MOST + 20_000]];
        for bytes in late {
            let guest = Stranger::at(socket)?;
            guest.greets(layout)?;
            guest.say(bytes);
            guest.ends()?;
            tried += 1;
        }
    }
    Ok(tried)
}
