//! Rows about everything that dies at once, and about two managers of one place.
//!
//! Invariant: what is started again is told apart from what was there by its pid and by its samples.

use rustix::process::Signal;
use serde_json::json;
use trocar_proto::v1::{Component, ConnectOptions, StopReason};

use crate::book::Book;
use crate::clock::{Witness, eventually, now_ns, pause_ms};
use crate::invariants::{Desired, agree};
use crate::json::number;
use crate::program::Program;
use crate::rpc::state_name;
use crate::run::{Row, Run, When};
use crate::site::{GCM, Site};

pub(crate) const ROWS: &[Row] = &[
    Row { name: "8", fault: "all processes are killed at once", when: When::Gate, run: all_at_once },
    Row { name: "11", fault: "a second GCM at one directory or port", when: When::Gate, run: second },
];

const ARM: &str = "a/arm";

/// An actuator in `a` that moves by what `b` gives.
fn make(site: &Site) -> Result<(), String> {
    let (rpc, fixture) = (&site.rpc, |class: &str| format!("fixture-torture/{class}"));
    let book = json!({ "book": site.world.text("arm.book") });
    let classes =
        [("a/sink", "sink"), ("b/source", "source"), ("b/server", "server"), ("a/caller", "caller")];
    for (path, class) in classes {
        rpc.create(path, &fixture(class), json!({}))?;
    }
    rpc.create(ARM, &fixture("arm"), book)?;
    let ends = [
        ("a/sink/value", "b/source/value"),
        ("a/arm/set_point", "b/source/value"),
        ("a/arm/drive", "b/server/ctl"),
        ("a/caller/peer", "b/server/ctl"),
    ];
    for (client, server) in ends {
        rpc.connect(client, server, ConnectOptions::default())?;
    }
    for path in ["b/source", "b/server", "a/sink", "a/caller", ARM] {
        rpc.start(path)?;
    }
    Ok(())
}

/// The reason why something stands still, where it does.
fn stands(component: &Component) -> String {
    format!("{} {}", state_name(component.state()), component.stop_reason().as_str_name())
}

fn all_at_once(run: &Run, book: &mut Book) -> Result<(), String> {
    let mut random = run.random(book);
    let (mut site, witness) = (Site::new(&["fixture_torture"], &["a", "b"])?, Witness::start());
    make(&site)?;
    let desired = Desired::now(&site.rpc)?;
    let (rounds, mut back, mut went, mut moved) = (run.times(3, 50), Vec::new(), Ok(()), 0);
    for round in 0..rounds {
        pause_ms(random.u64(0..100));
        let mut orders = [[GCM, "a", "b"], [GCM, "a", "b"]];
        orders.iter_mut().for_each(|order| random.shuffle(order));
        site.kill_all(&orders[0])?;
        witness.forget();
        let began = now_ns();
        site.start_all(&orders[1])?;
        went = restored(&site).map_err(|why| format!("round {round}, {orders:?}: {why}"));
        if went.is_err() {
            break;
        }
        back.push(witness.timed(began, now_ns(), 0.0));
        pause_ms(50);
        let arm = site.rpc.row(ARM)?;
        moved += number(&arm["steps"]);
        eventually("the arm goes on when it is told to", || Ok(site.rpc.resume(ARM)?))?;
        went = agree(&site.rpc, &desired).map_err(|why| format!("round {round}: {why}"));
        if went.is_err() {
            break;
        }
    }
    book.check("all that was wanted is there again, and is as it was (G1, G3)", rounds as usize, went);
    book.at_most("steps of an actuator that nobody had told to go on", rounds as usize, moved, 0);
    book.times("until all of it is there", &back, 3_000.0);
    let journal = site.journal()?;
    book.check("numbers, terms and revisions only grow (G2)", journal.records.len(), journal.grows());
    site.down(book)
}

/// Sensors run, actuators wait.
fn restored(site: &Site) -> Result<(), String> {
    site.await_all()?;
    eventually("all of it is there", || {
        let list = site.rpc.brief()?;
        let stand: Vec<String> =
            list.components.iter().map(|c| format!("{} {}", c.path, stands(c))).collect();
        let is_right = |c: &Component| match c.path.as_str() {
            // It has seen the end of its peer, where that died first.
            ARM => matches!(c.stop_reason(), StopReason::Restarted | StopReason::PeerLost),
            _ => state_name(c.state()) == "ACTIVE",
        };
        let all = list.components.len() == 5 && list.connections.len() == 4;
        if all && list.components.iter().all(is_right) { Ok(()) } else { Err(format!("{stand:?}")) }
    })?;
    eventually("samples flow", || match number(&site.rpc.row("a/sink")?["books"]["taken"]) {
        0 => Err("none".into()),
        _ => Ok(()),
    })
}

fn second(run: &Run, book: &mut Book) -> Result<(), String> {
    let (mut site, witness) = (Site::new(&["fixture_torture"], &["a"])?, Witness::start());
    site.rpc.create("a/source", "fixture-torture/source", json!({}))?;
    site.rpc.start("a/source")?;
    let before = site.rpc.brief()?;
    let (address, state, other) =
        (site.gcm.address.clone(), site.world.text("state/gcm"), site.world.text("state/other"));
    let mut took = Vec::new();
    for round in 0..run.times(2, 20) {
        // A directory that is taken; a port that is taken, also where the other one stands still.
        for (what, listen, state, says) in [
            ("directory", "127.0.0.1:0", &state, "in use by process"),
            ("port", address.as_str(), &other, "is taken by a GCM"),
            ("directory of one that stands still", "127.0.0.1:0", &state, "in use by process"),
        ] {
            let still = what.ends_with("still");
            if still {
                site.gcm.signal(Signal::STOP)?;
            }
            let args = ["gcm", "--listen", listen, "--state", state].map(str::to_owned);
            witness.forget();
            let began = now_ns();
            let mut again = Program::begin(&site.world, &format!("second-{round}"), &args, false)?;
            let status = again.await_end();
            took.push(witness.timed(began, now_ns(), 0.0));
            if still {
                site.gcm.signal(Signal::CONT)?;
            }
            let (status, said) = (status?, again.printed());
            let refused = !status.success() && said.contains(says);
            let is = if refused { Ok(()) } else { Err(format!("{what}: {status}: {said}")) };
            book.check("a second GCM is refused, and is told why", 1, is);
        }
    }
    book.times("it is told", &took, 300.0);
    site.await_all()?;
    let after = site.rpc.brief()?;
    let is_same = (before.term, before.revision) == (after.term, after.revision);
    let same = if is_same { Ok(()) } else { Err(format!("{before:?} became {after:?}")) };
    book.check("the first one is undisturbed (G2)", took.len(), same);
    let goes_on = site.rpc.create("a/sink", "fixture-torture/sink", json!({}));
    book.check("and goes on", 1, goes_on.map_err(String::from));
    let journal = site.journal()?;
    book.check("its journal is whole, and grows (G6)", journal.records.len(), journal.grows());
    // The next one goes on from it.
    site.gcm.kill();
    site.gcm_again()?;
    site.await_all()?;
    let there = site.rpc.state("a/sink").map(drop).map_err(String::from);
    book.check("the next one knows what was decided (G1)", 1, there);
    site.down(book)
}
