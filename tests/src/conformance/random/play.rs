//! Plays one seed: changes in one thread, the clients' calls in two more, then the books.
//!
//! Invariant: whatever is refused is refused for a reason that a caller can act on; nothing hangs.

use std::thread;
use std::time::Duration;

use serde_json::json;
use trocar::model::{ConnectOptions, Refusal, Request, Target, Which};

use super::super::answer::Answer;
use super::super::{Call, Lab};
use super::books;
use super::ops::{CLIENTS, Op, SERVERS, Script, draw};

/// How long a client may take for one order, whatever happens meanwhile.
const WATCHDOG: Duration = Duration::from_secs(20);

/// What must not happen to anybody: these mean that something hung or broke.
const NEVER: [&str; 5] = ["INTERNAL", "LCM_TIMEOUT", "BUSY", "PART_TAKEN", "DEADLINE"];

pub(super) fn play(lab: &Lab, seed: u64) {
    let Script { executions, changes, calls } = draw(seed);
    for (name, execution) in SERVERS.iter().chain(&CLIENTS).zip(executions) {
        bear(&format!("making {name}"), carry_out(lab, &Op::Create(name, Box::new(execution))));
    }
    for (client, server) in CLIENTS.iter().zip(SERVERS) {
        let wire = Op::Connect(format!("{client}/peer"), format!("{server}/ctl"), true);
        bear("wiring", carry_out(lab, &wire));
        bear("starting", carry_out(lab, &Op::Start(server)));
        bear("starting", carry_out(lab, &Op::Start(client)));
    }
    thread::scope(|scope| {
        let mut lanes = Vec::new();
        for (client, calls) in CLIENTS.iter().zip(&calls) {
            lanes.push(scope.spawn(move || calls.iter().for_each(|call| ask(lab, client, call))));
        }
        for op in &changes {
            bear(&format!("{op:?}"), carry_out(lab, op));
        }
        for lane in lanes {
            if let Err(why) = lane.join() {
                std::panic::resume_unwind(why);
            }
        }
    });
    books::settle(lab);
    books::close(lab);
}

fn carry_out(lab: &Lab, op: &Op) -> Result<(), Refusal> {
    let targets = |name: &str| vec![Target::One(lab.id(name))];
    let request = match op {
        Op::Create(name, execution) => {
            let class = if SERVERS.contains(name) { "Server" } else { "Client" };
            let config = if SERVERS.contains(name) { lab.gated(json!({})) } else { json!({}) };
            return lab.try_create(name, class, config, (**execution).clone()).map(|_| ());
        }
        Op::Remove(name) => Request::Remove { id: lab.id(name), force: true },
        Op::Connect(client, server, replace) => {
            let options = ConnectOptions { replace: *replace, ..ConnectOptions::default() };
            Request::Connect { client: lab.port(client), server: lab.port(server), options }
        }
        Op::Disconnect(client, server) => {
            Request::Disconnect { which: Which::Pair { client: lab.port(client), server: lab.port(server) } }
        }
        Op::Start(name) => Request::Start { targets: targets(name) },
        Op::Stop(name) => Request::Stop { targets: targets(name) },
        Op::Resume(name) => Request::Resume { targets: targets(name) },
        Op::Reset(name) => Request::Reset { targets: targets(name) },
        Op::Configure(name, factor) => return lab.configure(name, json!({ "factor": factor })),
    };
    lab.ask(request).map(|_| ())
}

fn bear(what: &str, result: Result<(), Refusal>) {
    if let Err(refusal) = result {
        assert!(!NEVER.contains(&refusal.reason()), "{what}: {} {refusal}", refusal.reason());
    }
}

/// Each call came to exactly one outcome, and the client came back.
fn ask(lab: &Lab, client: &str, call: &Call) {
    match lab.order(client, *call, WATCHDOG) {
        Ok(answer) => complete(&answer, call),
        Err(refusal) => {
            assert!(!NEVER.contains(&refusal.reason()), "{client} {call:?}: {} {refusal}", refusal.reason());
        }
    }
}

fn complete(answer: &Answer, call: &Call) {
    let asked = u64::from(call.times) * u64::from(call.threads.max(1));
    assert_eq!(answer.total(), asked, "one outcome for each call: {call:?} {answer:?}");
}
