//! Rows about requests that change the graph: done so often that whatever is left behind shows.

use serde_json::{Value, json};
use trocar_proto::v1::ConnectOptions;

use crate::book::Book;
use crate::clock::{Witness, eventually, now_ns};
use crate::invariants::{Desired, Holdings, agree, nothing_is_left};
use crate::procfs;
use crate::rig::Rig;
use crate::run::{Row, Run, When};
use crate::world::World;

pub(crate) const ROWS: &[Row] = &[Row {
    name: "40",
    fault: "Connect and Disconnect, Create and Remove, again and again",
    when: When::Gate,
    run: again,
}];

/// What memory in use may grow by, KiB.
const MOST_KIB: u64 = 1024;

/// Time the last may take beyond 1.2 × the first, ms: as much as parts that follow each other differ, and a
/// little where those are alike by chance; never more than the other.
const LEAST_MS: f64 = 0.2;
const MOST_MS: f64 = 1.0;

/// What a kind is called, its carrier, its clients with their servers.
type Kind = (&'static str, &'static str, &'static [(&'static str, &'static str)]);

const PAIRS: [Kind; 4] = [
    ("inline", "inline", &[("a/inside/value", "a/source/value")]),
    (
        "heap",
        "heap",
        &[
            ("a/sink/value", "a/source/value"),
            ("a/screen/frame", "a/camera/frame"),
            ("a/caller/peer", "a/server/ctl"),
        ],
    ),
    (
        "memfd inside one process",
        "memfd",
        &[
            ("a/sink/value", "a/source/value"),
            ("a/screen/frame", "a/camera/frame"),
            ("a/caller/peer", "a/server/ctl"),
        ],
    ),
    (
        "memfd",
        "memfd",
        &[
            ("a/sink/value", "b/source/value"),
            ("a/screen/frame", "b/camera/frame"),
            ("a/caller/peer", "b/server/ctl"),
        ],
    ),
];

fn rig() -> Result<Rig, String> {
    let class = |name: &str| json!({ "class": format!("fixture-torture/{name}") });
    let mut components = serde_json::Map::new();
    for process in ["a", "b"] {
        for name in ["source", "camera", "server"] {
            components.insert(format!("{process}/{name}"), class(name));
        }
    }
    for name in ["sink", "screen", "caller"] {
        components.insert(format!("a/{name}"), class(name));
    }
    let mut inside = class("sink");
    inside["execution"] = json!({ "model": "exec_out", "inside": "a/source" });
    components.insert("a/inside".into(), inside);
    let process = json!({ "plugins": ["plugins"] });
    let system = json!({
        "version": 1, "processes": { "a": process, "b": process }, "components": Value::Object(components),
        "connections": [],
    });
    Rig::of(World::new(&["fixture_torture"])?, &system)
}

/// Every process, by name.
fn processes(rig: &Rig) -> Result<Vec<(String, u32)>, String> {
    let mut all: Vec<(String, u32)> = rig.pids()?.into_iter().collect();
    all.push(("up".into(), rig.up.pid()));
    Ok(all)
}

fn again(run: &Run, book: &mut Book) -> Result<(), String> {
    let (warm, times) = (run.times(60, 1_000), run.times(120, 10_000));
    let mut rig = rig()?;
    let desired = Desired::now(&rig.rpc)?;
    for (what, carrier, pairs) in PAIRS {
        let options = ConnectOptions { carrier: carrier.into(), ..ConnectOptions::default() };
        let mut n = 0;
        let once = |rig: &Rig| {
            let (client, server) = pairs[n % pairs.len()];
            n += 1;
            rig.rpc.connect(client, server, options.clone())?;
            Ok(rig.rpc.disconnect(client, server)?)
        };
        grows(&rig, book, &format!("{what}: Connect and Disconnect"), warm, times, once)?;
    }
    let (mut n, times) = (0, run.times(40, 1_000));
    let once = |rig: &Rig| {
        let path = ["a/new", "b/new"][n % 2];
        n += 1;
        rig.rpc.create(path, "fixture-torture/camera", json!({}))?;
        rig.rpc.start(path)?;
        Ok(rig.rpc.remove(path, true)?)
    };
    grows(&rig, book, "Create, Start and Remove", run.times(20, 200), times, once)?;
    book.check("desired, observed and actual agree (G3)", 1, agree(&rig.rpc, &desired));
    rig.up.terminate()?;
    nothing_is_left(book, &rig.world);
    Ok(())
}

/// A client may look at what it was given last until it is given something else, so what was cut stays with
/// it: here each is given something of its own process.
fn let_go(rig: &Rig) -> Result<(), String> {
    for (sink, client, server) in
        [("a/sink", "a/sink/value", "a/source/value"), ("a/screen", "a/screen/frame", "a/camera/frame")]
    {
        let before = rig.book(sink, "taken")?;
        rig.rpc.connect(client, server, ConnectOptions::default())?;
        eventually("it is given something", || match rig.book(sink, "taken")? {
            taken if taken > before => Ok(()),
            taken => Err(format!("{sink} has taken {taken}")),
        })?;
        rig.rpc.disconnect(client, server)?;
    }
    Ok(())
}

/// Does something often; then as much is held as before, and it takes as long as before.
fn grows(
    rig: &Rig,
    book: &mut Book,
    what: &str,
    warm: u64,
    times: u64,
    mut once: impl FnMut(&Rig) -> Result<(), String>,
) -> Result<(), String> {
    for _ in 0..warm {
        once(rig)?;
    }
    let_go(rig)?;
    let all = processes(rig)?;
    let named: Vec<(&str, u32)> = all.iter().map(|(name, pid)| (name.as_str(), *pid)).collect();
    let (held, before): (_, Vec<u64>) =
        (Holdings::of(&named), named.iter().map(|(_, pid)| procfs::rss_kib(*pid)).collect());
    let witness = Witness::start();
    let mut took = Vec::new();
    for n in 0..times {
        witness.forget();
        let began = now_ns();
        once(rig).map_err(|why| format!("{what}, time {n}: {why}"))?;
        let timed = witness.timed(began, now_ns(), 0.0);
        // What the machine was late itself is not theirs.
        took.push((timed.ms - timed.late_ms).max(0.0));
    }
    let tried = times as usize;
    let_go(rig)?;
    let rest = held.have_not_grown();
    book.check(&format!("{what}: no file, thread, socket, segment more (G5)"), tried, rest);
    let grown = eventually("memory in use is what it was", || {
        let most = named
            .iter()
            .zip(&before)
            .map(|((name, pid), before)| (procfs::rss_kib(*pid).saturating_sub(*before), *name));
        match most.max() {
            Some((kib, name)) if kib > MOST_KIB => Err(format!("{name} has {kib} KiB more")),
            most => Ok(most.map_or(0, |(kib, _)| kib)),
        }
    });
    match grown {
        Ok(kib) => book.at_most(&format!("{what}: KiB more in use"), tried, kib, MOST_KIB),
        Err(why) => book.check(&format!("{what}: at most 1 MiB more in use"), tried, Err(why)),
    }
    // A percentile of a short run would be its largest.
    let (hundredths, name) = if times >= 1_000 { (99, "p99") } else { (50, "p50") };
    let typical = |part: &[f64]| {
        let mut part = part.to_vec();
        part.sort_by(f64::total_cmp);
        part.get(part.len() * hundredths / 100).copied().unwrap_or(f64::NAN)
    };
    let part = if times >= 1_000 { tried / 10 } else { tried / 2 };
    let (first, last) = (typical(&took[..part]), typical(&took[tried - part..]));
    // Two parts that follow each other differ by chance, at either end; a short run has only halves. What
    // grows shows little there.
    let of = if times >= 1_000 { part } else { part / 2 };
    let chance = |n: usize| (typical(&took[n..n + of]) - typical(&took[n + of..n + 2 * of])).abs();
    let allowed = (chance(0).max(chance(tried - 2 * of)) + LEAST_MS).min(MOST_MS);
    book.beside(
        &format!("{what}: {name} of the last beside 1.2 × the first"),
        part,
        last,
        1.2 * first,
        (allowed * 100.0).ceil() / 100.0,
        "ms",
    );
    Ok(())
}
