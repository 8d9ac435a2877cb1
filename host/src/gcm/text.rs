//! A plan as lines for people: "+ create …", "~ configure …", "- stop …".
//!
//! Invariant: one line per change, in order; `+` adds or sets going, `~` alters, `-` takes away or stops.

use trocar_model::{Change, Plan, Request, Target, Verb, Which};

use crate::system_file::words::{executions, settings};

/// Returns a plan as lines for people, one for each change.
pub fn lines(plan: &Plan) -> Vec<String> {
    let one = |(at, change): (usize, &Change)| match anew(change, &plan.changes[..at]) {
        Some(from) => line(change) + &from,
        None => line(change),
    };
    plan.changes.iter().enumerate().map(one).collect()
}

/// Returns the differences in execution, when a component is made anew.
fn anew(change: &Change, before: &[Change]) -> Option<String> {
    let Change::Create { id, component } = change else { return None };
    before.iter().rev().find_map(|earlier| match earlier {
        Change::Destroy { id: gone, component: was } if gone == id => {
            Some(braced(&executions(&was.execution, &component.execution)))
        }
        _ => None,
    })
}

/// " {…, …}"; nothing of nothing.
fn braced(changes: &[String]) -> String {
    if changes.is_empty() { String::new() } else { format!(" {{{}}}", changes.join(", ")) }
}

/// Returns the line for a change in a plan or a log.
pub(super) fn line(change: &Change) -> String {
    match change {
        Change::Create { id, component } => format!("+ create {id} ({})", component.class.full_name()),
        Change::Destroy { id, .. } => format!("- remove {id}"),
        Change::Configure { id, from, to, to_state, .. } => {
            format!("~ configure {id}{} → {to_state}", braced(&settings(from, to)))
        }
        Change::Run { id, verb, from, to } => {
            let (sign, word) = match verb {
                Verb::Start => ('+', "start"),
                Verb::Resume => ('+', "resume"),
                Verb::Stop => ('-', "stop"),
                Verb::Reset => ('~', "reset"),
                Verb::Configure => ('~', "configure"),
                Verb::Remove => ('-', "remove"),
            };
            format!("{sign} {word} {id} ({from} → {to})")
        }
        Change::Connect { connection: c } => {
            format!("+ connect {} → {} (connection {})", c.server, c.client, c.id.0)
        }
        Change::Disconnect { connection: c, .. } => {
            format!("- disconnect {} → {} (connection {})", c.server, c.client, c.id.0)
        }
    }
}

/// Returns the name of a change that takes too long: "Start host/robot".
pub(crate) fn asked(change: &Change) -> String {
    match change {
        Change::Create { id, .. } => format!("Create {id}"),
        Change::Destroy { id, .. } => format!("Remove {id}"),
        Change::Configure { id, .. } => format!("Configure {id}"),
        Change::Run { id, verb, .. } => format!("{verb} {id}"),
        Change::Connect { connection: c } => format!("Connect {} to {}", c.client, c.server),
        Change::Disconnect { connection: c, .. } => format!("Disconnect {} from {}", c.client, c.server),
    }
}

/// Returns the name of requests that others wait for: "Start host/robot and 2 more".
pub(super) fn requested(requests: &[Request]) -> String {
    let of = |verb: &str, targets: &[Target]| match targets {
        [] => verb.to_owned(),
        [one] => format!("{verb} {one}"),
        [first, rest @ ..] => format!("{verb} {first} and {} more", rest.len()),
    };
    let one = |request: &Request| match request {
        Request::Create { id, .. } | Request::CreateIsolated { id, .. } => format!("Create {id}"),
        Request::Remove { id, .. } => format!("Remove {id}"),
        Request::Forget { process } => format!("Forget {process}"),
        Request::Configure { id, .. } => format!("Configure {id}"),
        Request::Start { targets } => of("Start", targets),
        Request::Stop { targets } => of("Stop", targets),
        Request::Resume { targets } => of("Resume", targets),
        Request::Reset { targets } => of("Reset", targets),
        Request::Connect { client, server, .. } => format!("Connect {client} to {server}"),
        Request::Disconnect { which: Which::Pair { client, server } } => {
            format!("Disconnect {client} from {server}")
        }
        Request::Disconnect { which: Which::Id(number) } => format!("Disconnect connection {}", number.0),
    };
    match requests {
        [] => "another request".to_owned(),
        [request] => one(request),
        [first, rest @ ..] => format!("{} and {} more requests", one(first), rest.len()),
    }
}
