//! Calls that wait while something happens to their server.
//!
//! Invariant: it happens when the call is known to wait, in a queue or for whoever is inside, and not before.

use std::fs;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;

use serde_json::json;
use trocar::model::{ConnectOptions, State};

use super::world::PATIENCE;
use super::{Answer, Call, Function, Lab, Reach, Way, cases};
use crate::eventually;

/// What happens to the server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum While {
    Cut,
    Stopped,
    Removed,
    Failed,
}

/// Does it while `call`, made from a thread of the client's own, waits; answers what the call came to.
pub(super) fn ended(way: &Way, lab: &Lab, call: Call, what: While) -> Answer {
    let reach = way.reach();
    if reach == Reach::Thread {
        if what == While::Failed {
            lab.perform(Call::call(Function::Crash, 0.0));
            return lab.perform(call);
        }
        let caller = Caller::client(lab);
        return thread::scope(|scope| {
            let answer = scope.spawn(|| caller.calls(call));
            caller.await_waiting();
            end(lab, what, &caller);
            answer.join().expect("the client performs")
        });
    }
    let caller = Caller::of(reach, lab);
    lab.close_gate();
    if what == While::Failed {
        lab.configure("server", json!({ "mood": "hold" })).expect("mood is live");
    }
    thread::scope(|scope| {
        let inside = if what == While::Failed { "server/ctl/crash" } else { "server/ctl/hold" };
        let inside = scope.spawn(move || lab.invoke(inside, None, false));
        let _opens = lab.opens_at_end();
        lab.await_waiting();
        let answer = scope.spawn(|| caller.calls(call));
        caller.await_waiting();
        thread::scope(|scope| {
            let ending = scope.spawn(|| end(lab, what, &caller));
            await_begun(lab, what, &caller);
            lab.open_gate();
            ending.join().expect("it is carried out");
        });
        let answer = answer.join().expect("the client performs");
        // What is inside when its server goes comes to whatever it comes to.
        let _ = inside.join();
        answer
    })
}

/// Does it while `call` is inside the server, in the client's own thread where that runs it.
pub(super) fn begun(way: &Way, lab: &Lab, call: Call, what: While) -> Answer {
    let caller = Caller::client(lab);
    let waits = call.wait && way.reach().queues();
    let call = if waits { call.from_threads(1) } else { call };
    lab.close_gate();
    thread::scope(|scope| {
        let answer = scope.spawn(|| lab.perform(call));
        let _opens = lab.opens_at_end();
        lab.await_waiting();
        let ending = scope.spawn(|| end(lab, what, &caller));
        await_begun(lab, what, &caller);
        lab.open_gate();
        ending.join().expect("it is carried out");
        answer.join().expect("the client performs")
    })
}

/// Removes the client while `call`, made from a thread of its own, waits; answers what the call came to.
pub(super) fn leaving(way: &Way, lab: &Lab, call: Call) -> Answer {
    let reach = way.reach();
    let caller = Caller::of(reach, lab);
    let left = || {
        thread::scope(|scope| {
            let answer = scope.spawn(|| caller.calls(call));
            caller.await_waiting();
            lab.remove(&caller.name);
            assert_eq!(lab.stands(&caller.name), None, "it is gone");
            answer.join().expect("the client performs")
        })
    };
    // Where both share a thread, nobody is inside: that thread waits for the one that calls.
    if reach == Reach::Thread { left() } else { lab.occupied(left) }
}

fn end(lab: &Lab, what: While, caller: &Caller<'_>) {
    match what {
        While::Cut => lab.disconnect(&format!("{}/peer", caller.name), "server/ctl"),
        While::Stopped => lab.stop("server"),
        While::Removed => lab.remove("server"),
        // What is inside does it as soon as the gate opens.
        While::Failed => {}
    }
}

/// Waits until it can be seen at the server; then whoever is inside may go on.
fn await_begun(lab: &Lab, what: While, caller: &Caller<'_>) {
    eventually("it happens to the server", || {
        let server = lab.inventory().components.into_iter().find(|c| c.id == lab.id("server"));
        let stands = server.map(|c| c.state);
        let done = match what {
            While::Cut => {
                !lab.graph().connections.values().any(|c| c.client.component == lab.id(&caller.name))
            }
            While::Stopped | While::Removed => stands != Some(State::Active),
            While::Failed => true,
        };
        if done { Ok(()) } else { Err(format!("{stands:?}")) }
    });
}

/// Calls a command of the slot `left` while the configuration that takes the slot away is under way; then
/// puts it back.
pub(super) fn through_configure(way: &Way, lab: &Lab, call: Call) -> Answer {
    let caller = Caller::slotted(way.reach(), lab);
    let answer = changing(lab, || {
        thread::scope(|scope| {
            let answer = scope.spawn(|| caller.calls(call));
            if call.wait {
                caller.await_waiting();
            } else {
                eventually("it is sent", || if answer.is_finished() { Ok(()) } else { Err("not yet") });
            }
            lab.open_gate();
            answer.join().expect("the client performs")
        })
    });
    restore(lab, &caller.name);
    answer
}

/// Calls it again and again, beside a configuration that takes it away.
pub(super) fn beside_configure(lab: &Lab, call: Call) -> Answer {
    let answer = changing(lab, || {
        thread::scope(|scope| {
            let answer = scope.spawn(|| lab.perform(call.times(200_000)));
            lab.open_gate();
            answer.join().expect("the client performs")
        })
    });
    restore(lab, "client");
    answer
}

/// Calls it in the first step after a configuration that takes it away.
pub(super) fn after_configure(lab: &Lab, call: Call) -> Answer {
    let before = lab.count("client", "scheduled");
    let answer = changing(lab, || {
        lab.schedule(call);
        lab.open_gate();
        lab.await_scheduled(before)
    });
    restore(lab, "client");
    answer
}

/// While a configuration that takes the slot away waits at the gate; it is finished when this comes back.
fn changing(lab: &Lab, f: impl FnOnce() -> Answer) -> Answer {
    lab.close_gate();
    thread::scope(|scope| {
        let gone = lab.gated(json!({ "slots": [] }));
        let change = scope.spawn(move || lab.configure("server", gone));
        let _opens = lab.opens_at_end();
        lab.await_waiting();
        let answer = f();
        change.join().expect("it comes back").expect("slots is live");
        answer
    })
}

fn restore(lab: &Lab, client: &str) {
    lab.configure("server", json!({ "slots": ["left"] })).expect("slots is live");
    let options = ConnectOptions { replace: true, ..ConnectOptions::default() };
    lab.connect_with("client/peer", "server/slot_left", options.clone());
    if client != "client" {
        lab.remove(client);
    }
}

/// Who calls, from a thread of its own.
struct Caller<'a> {
    lab: &'a Lab,
    name: String,
    /// Taken by the server's queues before it called; nothing where it waits without a queue.
    passed: Option<u64>,
}

static NEXT: AtomicU64 = AtomicU64::new(0);

impl<'a> Caller<'a> {
    fn client(lab: &'a Lab) -> Caller<'a> {
        Caller { lab, name: "client".into(), passed: Some(passed(lab)) }
    }

    fn of(reach: Reach, lab: &'a Lab) -> Caller<'a> {
        match reach {
            Reach::Caller => Caller::known_by_its_threads(lab, "server/ctl"),
            _ => Caller::client(lab),
        }
    }

    fn slotted(reach: Reach, lab: &'a Lab) -> Caller<'a> {
        match reach {
            Reach::Caller => Caller::known_by_its_threads(lab, "server/slot_left"),
            _ => Caller::client(lab),
        }
    }

    /// Another client with a name that no other component of this process has, and so its threads.
    fn known_by_its_threads(lab: &'a Lab, server: &str) -> Caller<'a> {
        let name = format!("waiter{}", NEXT.fetch_add(1, Ordering::Relaxed));
        lab.create(&name, "Client", json!({}), cases::own_thread());
        lab.connect(&format!("{name}/peer"), server);
        lab.start(&name);
        Caller { lab, name, passed: None }
    }

    fn calls(&self, call: Call) -> Answer {
        let call = if call.wait { call.from_threads(1) } else { call };
        let answer = self.lab.order(&self.name, call, PATIENCE);
        answer.unwrap_or_else(|refusal| panic!("{} did not perform {call:?}: {refusal}", self.name))
    }

    /// Its call is in the queue, or waits with its thread for whoever is inside.
    fn await_waiting(&self) {
        eventually("the call waits", || match self.passed {
            Some(before) => match passed(self.lab) {
                now if now > before => Ok(()),
                now => Err(format!("{now} entries have passed, as {before} before; {:?}", self.lab.links())),
            },
            None => match asleep(&self.name) {
                own @ ..2 => Err(format!("{own} threads named {} sleep", self.name)),
                _ => Ok(()),
            },
        });
    }
}

fn passed(lab: &Lab) -> u64 {
    lab.links().iter().map(|l| l.passed).sum()
}

/// How many threads of this name sleep: the component's own, and that which it has started.
fn asleep(name: &str) -> usize {
    let tasks = fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let sleeps = |stat: &str| {
        let (named, rest) = stat.split_once(") ").unwrap_or_default();
        named.ends_with(&format!("({name}")) && rest.starts_with('S')
    };
    tasks.filter(|t| fs::read_to_string(t.path().join("stat")).is_ok_and(|stat| sleeps(&stat))).count()
}
