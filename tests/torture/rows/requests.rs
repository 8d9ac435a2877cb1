//! Rows about requests that are refused, asked again, or rest on what is not so any more.
//!
//! Invariant: what a refusal says is held against the list before and behind it, not against another refusal.

use std::sync::Barrier;
use std::thread;

use serde_json::json;
use tonic::Code;
use trocar_proto::v1::{ConnectOptions, CreateRequest, ForgetRequest};

use crate::book::{Book, Timed};
use crate::clock::{eventually, now_ns};
use crate::invariants::{Desired, agree};
use crate::rpc::{Answer, Refused, Rpc, done};
use crate::run::{Row, Run, When};
use crate::site::Site;

pub(crate) const ROWS: &[Row] = &[
    Row { name: "34", fault: "Connect of what does not fit", when: When::Gate, run: misfits },
    Row { name: "36", fault: "one request, asked a thousand times", when: When::Gate, run: same },
    Row { name: "37", fault: "a request for a revision that is gone", when: When::Gate, run: stale },
    Row { name: "39", fault: "Remove of what others use", when: When::Gate, run: used },
];

const THREADS: u64 = 16;

/// Some components of both processes, connected in part.
fn site() -> Result<Site, String> {
    let site = Site::new(&["fixture_torture"], &["a", "b"])?;
    for process in ["a", "b"] {
        for class in ["sink", "source", "server", "caller", "camera", "screen"] {
            let path = format!("{process}/{class}");
            site.rpc.create(&path, &format!("fixture-torture/{class}"), json!({}))?;
        }
    }
    for (client, server) in [("a/sink/value", "b/source/value"), ("a/caller/peer", "b/server/ctl")] {
        site.rpc.connect(client, server, ConnectOptions::default())?;
    }
    Ok(site)
}

/// Mistakes of a Connect: its ends, the reason of the refusal, and the part it names.
const MISFITS: [(&str, &str, &str, &str); 14] = [
    ("nowhere/sink/value", "b/source/value", "PROCESS_NOT_FOUND", "nowhere"),
    ("b/sink/value", "nowhere/source/value", "PROCESS_NOT_FOUND", "nowhere"),
    ("b/nobody/value", "b/source/value", "COMPONENT_NOT_FOUND", "b/nobody"),
    ("b/sink/value", "a/nobody/value", "COMPONENT_NOT_FOUND", "a/nobody"),
    ("b/sink/nothing", "b/source/value", "INTERFACE_NOT_FOUND", "nothing"),
    ("b/sink/value", "b/source/nothing", "INTERFACE_NOT_FOUND", "b/source"),
    ("b/sink/value", "b/camera/frame", "FORMAT_MISMATCH", "b/sink/value"),
    ("b/caller/peer", "b/source/value", "WRONG_DIRECTION", "b/caller/peer"),
    ("b/source/value", "b/sink/value", "WRONG_DIRECTION", "b/source/value"),
    ("b/sink/value", "a/sink/value", "WRONG_DIRECTION", "a/sink/value"),
    ("a/sink/value", "b/source/value", "CONNECTION_EXISTS", "a/sink/value"),
    ("a/sink/value", "a/source/value", "ALREADY_CONNECTED", "a/sink/value"),
    ("b/sink", "b/source/value", "BAD_PATH", "b/sink"),
    ("b/sink/value", "b/source/val ue", "BAD_PATH", "b/source/val ue"),
];

fn misfits(_: &Run, book: &mut Book) -> Result<(), String> {
    let site = site()?;
    let (desired, revision) = (Desired::now(&site.rpc)?, site.rpc.brief()?.revision);
    let mut took = Vec::new();
    for (client, server, reason, part) in MISFITS {
        let began = now_ns();
        let refused = site.rpc.connect(client, server, ConnectOptions::default());
        took.push(Timed { ms: (now_ns() - began) as f64 / 1e6, late_ms: 0.0 });
        let what = format!("{server} to {client}");
        let is = match refused {
            Ok(id) => Err(format!("{what} was connected as {id}")),
            Err(refused) if refused.reason == reason && refused.message.contains(part) => Ok(()),
            Err(refused) => Err(format!("{what}: {refused}")),
        };
        book.check("refused with its own reason, and the part that is wrong is named", 1, is);
        let same = match site.rpc.brief()?.revision {
            now if now == revision => Ok(()),
            now => Err(format!("{what}: revision {revision} became {now}")),
        };
        book.check("the revision is what it was", 1, same);
    }
    book.times("it is told", &took, 20.0);
    book.check("desired, observed and actual agree (G3)", 1, agree(&site.rpc, &desired));
    site.down(book)
}

/// A Create by an id.
fn create(rpc: &Rpc, path: &str, id: &str, expected_revision: Option<u64>) -> Answer<u64> {
    let (path, class, request_id) = (path.into(), "fixture-torture/sink".into(), id.into());
    let request = CreateRequest { path, class, request_id, expected_revision, ..CreateRequest::default() };
    done(async { rpc.gcm().create(request).await }).map(|answer| answer.revision)
}

/// Answers to many who ask at the same time.
fn all_told<T: Send>(times: u64, ask: impl Fn(u64, &Rpc) -> T + Sync, address: &str) -> Vec<T> {
    let (barrier, ask) = (Barrier::new(THREADS as usize), &ask);
    thread::scope(|scope| {
        let one = |thread: u64| {
            let barrier = &barrier;
            scope.spawn(move || {
                let rpc = Rpc::at(address);
                barrier.wait();
                (0..times.div_ceil(THREADS)).map(|n| ask(n * THREADS + thread, &rpc)).collect::<Vec<T>>()
            })
        };
        let threads: Vec<_> = (0..THREADS).map(one).collect();
        threads.into_iter().filter_map(|thread| thread.join().ok()).flatten().collect()
    })
}

fn same(_: &Run, book: &mut Book) -> Result<(), String> {
    let mut site = Site::new(&["fixture_torture"], &["a"])?;
    let address = site.rpc.address.clone();
    site.rpc.create("a/there", "fixture-torture/sink", json!({}))?;
    let before = site.rpc.brief()?.revision;
    // One that is done and one that is refused.
    let told = |times| {
        let made = all_told(
            times,
            |_, rpc| create(rpc, "a/once", "once", None).map_err(|e| e.to_string()),
            &address,
        );
        let refused =
            all_told(times, |_, rpc| create(rpc, "a/there", "never", None).map_err(|e| e.reason), &address);
        (made, refused)
    };
    let (mut made, mut refused) = told(1_000);
    let first = made.first().cloned().ok_or("nobody was told anything")?;
    site.gcm.kill();
    site.gcm_again()?;
    site.await_all()?;
    let again = told(100);
    made.extend(again.0);
    refused.extend(again.1);
    let other = made.iter().find(|answer| **answer != first || **answer != Ok(before + 1));
    let is = other.map_or(Ok(()), |other| Err(format!("{first:?} and {other:?}")));
    book.check("each gets the same answer, also of the next GCM (G1)", made.len(), is);
    let other = refused.iter().find(|answer| **answer != Err("COMPONENT_EXISTS".to_owned()));
    let is = other.map_or(Ok(()), |other| Err(format!("{other:?}")));
    book.check("each is refused for the same reason, also by the next GCM", refused.len(), is);
    let list = site.rpc.brief()?;
    let once = list.revision == before + 1 && list.components.len() == 2;
    let is = if once { Ok(()) } else { Err(format!("revision {}, {:?}", list.revision, list.components)) };
    book.check("it was done once", made.len(), is);
    let journal = site.journal()?;
    let records = journal.by_request();
    for id in ["once", "never"] {
        let is = match records.get(id).map_or(0, Vec::len) {
            1 => Ok(()),
            n => Err(format!("`{id}` has {n} records")),
        };
        book.check("it is on record once (G6)", made.len(), is);
    }
    let other = create(&site.rpc, "a/other", "once", None);
    let is = match other {
        Err(Refused { reason, .. }) if reason == "ARGUMENT_INVALID" => Ok(()),
        other => Err(format!("{other:?}")),
    };
    book.check("the id is good for no other request", 1, is);
    site.down(book)
}

fn stale(run: &Run, book: &mut Book) -> Result<(), String> {
    let site = Site::new(&["fixture_torture"], &["a"])?;
    let address = site.rpc.address.clone();
    let (rounds, mut went, mut took) = (run.times(5, 100), Ok(()), Vec::new());
    for round in 0..rounds {
        let expected = site.rpc.brief()?.revision;
        let path = |n: u64| format!("a/r{round}n{n}");
        let told = all_told(
            THREADS,
            |n, rpc| {
                let began = now_ns();
                let answer = create(rpc, &path(n), "", Some(expected));
                (answer, (now_ns() - began) as f64 / 1e6)
            },
            &address,
        );
        took.extend(told.iter().map(|(_, ms)| Timed { ms: *ms, late_ms: 0.0 }));
        let passed: Vec<u64> = told.iter().filter_map(|(answer, _)| answer.as_ref().ok()).copied().collect();
        let now = format!("{}", expected + 1);
        let wrong = told.iter().filter_map(|(answer, _)| answer.as_ref().err()).find(|refused| {
            let says = refused.message.contains(&now);
            (refused.code, refused.reason.as_str(), says) != (Code::Aborted, "REVISION_CONFLICT", true)
        });
        let list = site.rpc.brief()?;
        let made = list.components.iter().filter(|c| c.path.starts_with(&format!("a/r{round}n"))).count();
        if passed != [expected + 1] || wrong.is_some() || made != 1 || list.revision != expected + 1 {
            went = Err(format!("round {round}, revision {expected}: {told:?}; {made} made"));
            break;
        }
    }
    let tried = (rounds * THREADS) as usize;
    book.check(
        "of all that expect one revision one passes, the others are told the present one",
        tried,
        went,
    );
    book.times("it is told, of sixteen at once", &took, 160.0);
    site.down(book)
}

fn used(_: &Run, book: &mut Book) -> Result<(), String> {
    let mut site = site()?;
    let (desired, revision) = (Desired::now(&site.rpc)?, site.rpc.brief()?.revision);
    for path in ["a/sink", "b/source", "a/caller", "b/server"] {
        let is = match site.rpc.remove(path, false) {
            Err(refused) if refused.reason == "IN_USE" && refused.message.contains("→") => Ok(()),
            answer => Err(format!("{path}: {answer:?}")),
        };
        book.check("what is connected is not removed, and by what is told", 1, is);
    }
    book.check("nothing has changed", 1, agree(&site.rpc, &desired));
    let now = site.rpc.brief()?.revision;
    book.at_most("revisions that this took", 4, now - revision, 0);
    site.rpc.remove("b/source", true)?;
    let list = site.rpc.brief()?;
    let left: Vec<_> = list.connections.iter().map(|c| &c.server).collect();
    let is = if left == ["b/server/ctl"] { Ok(()) } else { Err(format!("{left:?}")) };
    book.check("by force its connections go with it, and no others", 1, is);
    book.check("each process has what is listed (G3)", 1, agree(&site.rpc, &Desired::now(&site.rpc)?));
    let forget = |rpc: &Rpc| {
        let request = ForgetRequest { process: "b".into(), ..ForgetRequest::default() };
        done(async { rpc.gcm().forget(request).await }).map(drop)
    };
    let is = match forget(&site.rpc) {
        Err(refused) if refused.reason == "PROCESS_RUNS" => Ok(()),
        answer => Err(format!("{answer:?}")),
    };
    book.check("a process that runs is not forgotten", 1, is);
    site.host("b")?.kill();
    eventually("b can be forgotten", || Ok(forget(&site.rpc)?))?;
    let list = site.rpc.brief()?;
    let of_b = list.components.iter().any(|c| c.path.starts_with("b/")) || !list.connections.is_empty();
    let is = if of_b { Err(format!("{:?} {:?}", list.components, list.connections)) } else { Ok(()) };
    book.check("what is forgotten takes all of it along, no connection dangles", 1, is);
    book.check("what is left is whole (G3)", 1, agree(&site.rpc, &Desired::now(&site.rpc)?));
    // Its ends are free for another one.
    site.host_again("b")?;
    site.await_all()?;
    eventually("it comes back empty, and can be used", || {
        site.rpc.create("b/source", "fixture-torture/source", json!({}))?;
        Ok(site.rpc.connect("a/sink/value", "b/source/value", ConnectOptions::default())?)
    })?;
    book.check("desired, observed and actual agree (G3)", 1, agree(&site.rpc, &Desired::now(&site.rpc)?));
    site.down(book)
}
