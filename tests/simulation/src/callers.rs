//! Callers: they ask for changes at random, several at once, and check each answer.
//!
//! Invariant: every request is answered by its deadline, unless its manager ends.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use serde_json::json;
use tokio::task::JoinSet;
use trocar::gcm::{Answer, ExecuteOptions, Executed, Gcm};
use trocar_lcm_api::clock;
use trocar_model::{
    Change, ComponentId, ConnectOptions, ConnectionId, Execution, Name, Pattern, PortId, Refusal, Request,
    State, Target, Which,
};

use crate::ids::Turn;
use crate::truth::{Kind, Truth};
use crate::world::World;

/// Time that an answer may come after its deadline: the way to a process and back, and taking back.
const GRACE: Duration = Duration::from_secs(10);

/// Requests with an id that may be asked again.
const REPEATED: usize = 12;

/// A request as it was asked.
struct Asked {
    event: u64,
    requests: Vec<Request>,
    options: ExecuteOptions,
    turn: Turn,
}

impl Asked {
    fn is_first(&self) -> bool {
        self.turn == Turn::First
    }

    /// Returns the event at which the same was asked first.
    fn first(&self) -> u64 {
        if let Turn::Same(first) = self.turn { first } else { self.event }
    }
}

/// Asks, again and again, until the world is to rest.
pub(crate) async fn ask(world: Arc<World>) {
    let chance = world.chance.clone();
    while !world.is_to_rest() {
        tokio::time::sleep(chance.ms(0, 80)).await;
        let Some((gcm, tasks)) = world.gcm() else { continue };
        let (requests, request_id) = asked(&world, &gcm);
        let within = if chance.once_in(4) { chance.ms(1, 400) } else { chance.ms(500, 10_000) };
        let options = ExecuteOptions {
            validate_only: chance.once_in(30),
            request_id,
            expected_revision: chance.once_in(8).then(|| gcm.graph().revision),
            deadline: Some(clock::now() + within),
            identity: "caller".into(),
        };
        let event = world.truth.event(Kind::Asked, || {
            let ExecuteOptions { validate_only, request_id, expected_revision, .. } = &options;
            format!("{requests:?} {validate_only} {request_id:?} {expected_revision:?}, within {within:?}")
        });
        let id = options.request_id.as_str();
        let is_remembered = !id.is_empty() && !options.validate_only && !is_stop(&requests);
        let turn = match is_remembered {
            true => world.truth.id_asked(id, &requests, world.manager(), event),
            false => Turn::First,
        };
        let asked = Asked { event, requests, options, turn };
        answered(&world, &gcm, &tasks, asked, within).await;
    }
}

/// Returns the next request, and its id, if it has one: sometimes what was asked under that before, and
/// rarely something else.
fn asked(world: &World, gcm: &Gcm) -> (Vec<Request>, String) {
    let (chance, mut repeated) = (&world.chance, world.repeated.lock());
    let again = match (repeated.len(), chance.below(16)) {
        (1.., 0 | 1) => repeated.back().cloned(),
        (known @ 1.., 2) => repeated.get(chance.below(known)).cloned(),
        _ => None,
    };
    match again {
        Some((_, id)) if chance.once_in(12) => (requests(world, gcm), id),
        Some(again) => again,
        None if chance.once_in(6) => {
            let new = (requests(world, gcm), format!("{:x}", chance.number()));
            repeated.push_back(new.clone());
            if repeated.len() > REPEATED {
                repeated.pop_front();
            }
            new
        }
        None => (requests(world, gcm), String::new()),
    }
}

fn is_stop(requests: &[Request]) -> bool {
    requests.iter().all(|request| matches!(request, Request::Stop { .. }))
}

async fn answered(
    world: &World,
    gcm: &Gcm,
    tasks: &Arc<parking_lot::Mutex<JoinSet<Answer>>>,
    asked: Asked,
    within: Duration,
) {
    let truth = &world.truth;
    let moves = moves(&asked.requests);
    let is_done = asked.is_first() && !asked.options.validate_only;
    if is_done && !moves.is_empty() {
        truth.start_asked(asked.event, moves.clone());
    }
    if is_done {
        truth.end_asked(asked.event, &asked.requests);
    }
    let (tell, told) = tokio::sync::oneshot::channel();
    let (requests, options, working) = (asked.requests.clone(), asked.options.clone(), gcm.clone());
    tasks.lock().spawn(async move {
        let answer = working.execute(requests, options).await;
        // The caller may have gone.
        let _ = tell.send(answer.clone());
        answer
    });
    let answer = match tokio::time::timeout(within + GRACE, told).await {
        Ok(Ok(answer)) if !world.has_lost(gcm) => answer,
        // Its manager was killed.
        Ok(_) => return nobody_knows(truth, &asked),
        Err(_) => return truth.violated(format!("{:?} was not answered within {within:?}", asked.requests)),
    };
    truth.event(Kind::Answered, || format!("event {}: {answer:?}", asked.event));
    truth.counts(kind(&asked, &answer));
    if asked.options.validate_only {
        return;
    }
    if !asked.options.request_id.is_empty() && !is_stop(&asked.requests) {
        truth.id_answered(&asked.options.request_id, asked.turn, &answer);
    }
    // A process that is lost gives its orders up with its lease, and takes back what it has done.
    let is_open = match answer {
        Err(Refusal::ProcessLost { .. }) => true,
        Err(Refusal::LcmTimeout { .. }) => world.is_new(),
        _ => false,
    };
    if !is_open {
        truth.start_answered(asked.event);
    }
    // A removal may come at any time.
    if !matches!(answer, Err(Refusal::ProcessLost { .. } | Refusal::LcmTimeout { .. })) {
        truth.end_answered(asked.event);
    }
    match &answer {
        Ok(done) => accepted(world, &asked, done),
        // It was taken back, or is, as far as that can be done.
        Err(Refusal::Internal { text }) => truth.violated(format!("{:?}: {text}", asked.requests)),
        Err(refusal) => {
            if let ([Request::Stop { targets }], false) = (asked.requests.as_slice(), is_not_told(refusal)) {
                truth.stopped(asked.event, targets.clone(), BTreeSet::new(), BTreeSet::new());
            }
            if has_begun(&asked.requests, refusal) {
                nobody_knows(truth, &asked);
            }
        }
    }
}

/// Names the kind of a request, and what became of it.
fn kind(asked: &Asked, answer: &Answer) -> String {
    let verb = match asked.requests.as_slice() {
        _ if asked.options.validate_only => "dry run".into(),
        _ if !asked.is_first() => "asked again".into(),
        [one] => format!("{one:?}").split([' ', '{']).next().unwrap_or_default().to_owned(),
        _ => "several".into(),
    };
    let outcome = match answer {
        Ok(done) if !done.failed.is_empty() => "OK, but for some",
        Ok(done) if done.plan.changes.is_empty() => "OK, nothing changed",
        Ok(_) => "OK",
        Err(refusal) => refusal.reason(),
    };
    format!("{verb}: {outcome}")
}

/// Tells whether something may have been done of a request that was refused so.
fn has_begun(requests: &[Request], refusal: &Refusal) -> bool {
    match refusal {
        Refusal::Busy { .. } | Refusal::RevisionConflict { .. } => false,
        Refusal::ComponentNotFound { .. } | Refusal::ComponentExists { .. } => requests.len() > 1,
        _ => true,
    }
}

/// Tells whether a Stop that failed so may have left something moving.
fn is_not_told(refusal: &Refusal) -> bool {
    matches!(refusal.reason(), "STOP_NOT_TOLD" | "LCM_TIMEOUT" | "PROCESS_LOST")
}

fn accepted(world: &World, asked: &Asked, done: &Executed) {
    let truth = &world.truth;
    if let [Request::Stop { targets }] = asked.requests.as_slice() {
        let failed = done.failed.iter().filter(|(_, refusal)| is_not_told(refusal));
        let failed = failed.flat_map(|(target, _)| match target {
            Target::One(id) => Some(id.clone()),
            Target::Glob(_) => None,
        });
        let stopped = done.plan.changes.iter().map(|change| match change {
            Change::Run { id, .. } => Some(id.clone()),
            _ => None,
        });
        let skipped = done.plan.skipped.iter().map(|skipped| Some(skipped.id.clone()));
        let told = stopped.chain(skipped).flatten().collect();
        return truth.stopped(asked.event, targets.clone(), failed.collect(), told);
    }
    if done.plan.changes.is_empty() {
        return;
    }
    // Otherwise it is an earlier answer.
    if asked.is_first() {
        let what = format!("the request of event {}", asked.event);
        truth.accepted(done.revision, asked.options.expected_revision, &what, world.is_on_record());
    }
    let mut seen = BTreeSet::new();
    for change in done.plan.changes.iter().rev() {
        match change {
            Change::Destroy { id, .. } if seen.insert(id) => {
                truth.left(id, asked.first(), done.revision, None)
            }
            Change::Create { id, component } if seen.insert(id) => {
                truth.left(id, asked.first(), done.revision, component.config["gain"].as_f64());
            }
            Change::Configure { id, to, .. } if seen.insert(id) => {
                truth.left(id, asked.first(), done.revision, to["gain"].as_f64());
            }
            Change::Run { id, to: State::Active, .. } => truth.started(id, asked.first(), asked.is_first()),
            Change::Connect { connection } => truth.connected(connection, asked.first()),
            _ => {}
        }
    }
}

/// Notes what a request may have changed that was not accepted.
fn nobody_knows(truth: &Truth, asked: &Asked) {
    // An earlier request is known as well as then.
    let requests = if asked.is_first() { asked.requests.as_slice() } else { &[] };
    for request in requests {
        match request {
            Request::Create { id, .. } | Request::Remove { id, .. } | Request::Configure { id, .. } => {
                truth.unknown(id);
            }
            _ => {}
        }
    }
}

/// Returns what requests would set in motion.
fn moves(requests: &[Request]) -> Vec<Target> {
    let of = |request: &Request| match request {
        Request::Start { targets } | Request::Resume { targets } => targets.clone(),
        _ => Vec::new(),
    };
    requests.iter().flat_map(of).collect()
}

/// Returns what is asked next.
fn requests(world: &World, gcm: &Gcm) -> Vec<Request> {
    let number = match world.chance.once_in(8) {
        true => 2 + world.chance.below(4),
        false => 1,
    };
    let requests: Vec<Request> = (0..number).map(|_| request(world, gcm)).collect();
    // A Stop beside other requests is part of their plan, and no order of its own.
    match is_stop(&requests) {
        true => requests.into_iter().take(1).collect(),
        false => requests,
    }
}

fn request(world: &World, gcm: &Gcm) -> Request {
    let chance = &world.chance;
    let (id, execution) = (component(world), Execution::default());
    match chance.below(100) {
        0..18 => {
            let class = if chance.once_in(2) { "toy/arm" } else { "toy/filter" };
            let config = chance.once_in(2).then(|| json!({ "gain": chance.below(9) as f64 }));
            Request::Create { id, class: class.into(), config, execution }
        }
        18..26 => Request::Remove { id, force: !chance.once_in(3) },
        26..36 => {
            let patch = json!({ "gain": chance.below(9) as f64 });
            Request::Configure { id, patch, execution: None }
        }
        36..58 => Request::Start { targets: targets(world) },
        58..74 => Request::Stop { targets: targets(world) },
        74..78 => Request::Resume { targets: targets(world) },
        78..81 => Request::Reset { targets: targets(world) },
        81..94 => {
            let (client, server) = ends(world);
            let options = ConnectOptions { replace: chance.once_in(3), ..ConnectOptions::default() };
            Request::Connect { client, server, options }
        }
        _ => {
            let known: Vec<ConnectionId> = gcm.graph().connections.keys().copied().collect();
            let which = match known.as_slice() {
                [] => Which::Id(ConnectionId(chance.below(100) as u64)),
                known => Which::Id(*chance.one_of(known)),
            };
            Request::Disconnect { which }
        }
    }
}

fn component(world: &World) -> ComponentId {
    let process = world.chance.one_of(&world.names).clone();
    ComponentId { process, component: world.chance.one_of(&world.components).clone() }
}

fn ends(world: &World) -> (PortId, PortId) {
    let port = |port: &Name| PortId { component: component(world), port: port.clone() };
    let [input, value, robot, arm] = &world.ports;
    match world.chance.once_in(2) {
        true => (port(input), port(value)),
        false => (port(robot), port(arm)),
    }
}

pub(crate) fn targets(world: &World) -> Vec<Target> {
    let glob = |text: &str| Pattern::parse(text).map(Target::Glob).ok();
    let process = world.chance.one_of(&world.names);
    let all = match world.chance.below(12) {
        0 => glob("**"),
        1 => glob(&format!("{process}/*")),
        _ => None,
    };
    match all {
        Some(glob) => vec![glob],
        None => (0..=world.chance.below(2)).map(|_| Target::One(component(world))).collect(),
    }
}
