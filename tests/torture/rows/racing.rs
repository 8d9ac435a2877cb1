//! Many who ask for the same few things at once, while the GCM is killed: what each was told fits one order.
//!
//! Invariant: a time is taken before a request is given away and after its answer is there, so no order is
//! demanded that nobody could have seen.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, PoisonError};
use std::thread;

use serde_json::json;
use trocar_proto::v1::{
    ConnectOptions, ConnectRequest, CreateRequest, DisconnectRequest, ListResponse, RemoveRequest,
};

use crate::book::{Book, Timed};
use crate::clock::{now_ns, pause_ms};
use crate::invariants::{Desired, agree};
use crate::journal::Journal;
use crate::linear::{ALL, CLIENTS, Call, Event, Group, Said, There, What, explain};
use crate::rpc::{Refused, Rpc, done};
use crate::run::{Row, Run, When};
use crate::site::Site;

pub(crate) const ROWS: &[Row] = &[Row {
    name: "35",
    fault: "64 clients race for the same names, and the GCM is killed",
    when: When::Gate,
    run: race,
}];

const THREADS: usize = 64;
const GROUPS: usize = 4;

/// Place of a component of a group: the clients first; each kind in both processes, so that half of the
/// connections go between them.
pub(super) fn path(group: usize, component: usize) -> String {
    let process = ["a", "b"][component % 2];
    let kind = if component < CLIENTS { "sink" } else { "source" };
    format!("{process}/{kind}-{group}")
}

fn port(group: usize, component: usize) -> String {
    format!("{}/value", path(group, component))
}

pub(super) fn class(component: usize) -> &'static str {
    if component < CLIENTS { "fixture-torture/sink" } else { "fixture-torture/source" }
}

/// Answer to one client.
struct Told {
    id: String,
    group: usize,
    event: Event<Call>,
    /// The GCM that answered, counted by its kills; absent: one was killed while it was asked.
    life: Option<usize>,
}

/// Shared by all clients.
struct Crowd {
    ends: AtomicBool,
    /// Number of GCMs that were killed so far, and whether one is there.
    life: Mutex<(usize, bool)>,
    news: Condvar,
}

impl Crowd {
    /// Waits until a GCM is there, and answers which.
    fn await_gcm(&self) -> usize {
        let life = self.life.lock().unwrap_or_else(PoisonError::into_inner);
        let there = self.news.wait_while(life, |(_, is_there)| !*is_there);
        there.unwrap_or_else(PoisonError::into_inner).0
    }

    /// Number of GCMs that were killed so far.
    fn kills(&self) -> usize {
        self.life.lock().unwrap_or_else(PoisonError::into_inner).0
    }

    fn set(&self, to: impl FnOnce(&mut (usize, bool))) {
        to(&mut self.life.lock().unwrap_or_else(PoisonError::into_inner));
        self.news.notify_all();
    }
}

/// Outcome of one request.
#[derive(Debug)]
pub(super) enum Heard {
    Said(Said, Option<u64>),
    /// The answer was lost with the GCM.
    Lost,
    /// It was not looked at: no process, no time.
    Refused(String),
}

fn race(run: &Run, book: &mut Book) -> Result<(), String> {
    let mut random = run.random(book);
    let mut site = Site::new(&["fixture_torture"], &["a", "b"])?;
    let crowd = Crowd { ends: AtomicBool::new(false), life: Mutex::new((0, true)), news: Condvar::new() };
    let seeds: Vec<u64> = (0..THREADS).map(|_| random.u64(..)).collect();
    let address = site.rpc.address.clone();
    let (began, mut kills, mut went) = (now_ns(), 0, Ok(()));
    let told: Vec<(Vec<Told>, Vec<String>)> = thread::scope(|scope| {
        let one = |(n, seed): (usize, u64)| {
            let (crowd, address) = (&crowd, &address);
            scope.spawn(move || ask_on(n, address, crowd, &mut fastrand::Rng::with_seed(seed)))
        };
        let threads: Vec<_> = seeds.into_iter().enumerate().map(one).collect();
        while went.is_ok() && (kills < 3 || run.full && now_ns() - began < 60_000_000_000) {
            pause_ms(random.u64(if run.full { 200..2_000 } else { 150..400 }));
            went = kill_once(&mut site, &crowd);
            kills += 1;
        }
        pause_ms(200);
        crowd.ends.store(true, Ordering::Relaxed);
        crowd.set(|(_, is_there)| *is_there = true);
        threads.into_iter().filter_map(|thread| thread.join().ok()).collect()
    });
    went?;
    let (told, refused): (Vec<Vec<Told>>, Vec<Vec<String>>) = told.into_iter().unzip();
    let (told, refused): (Vec<Told>, Vec<String>) =
        (told.into_iter().flatten().collect(), refused.into_iter().flatten().collect());
    tell(book, &told, &refused, kills);
    let list = site.rpc.brief()?;
    explained(book, &told, &list);
    on_record(book, &told, &site.journal()?);
    book.check("desired, observed and actual agree (G3)", 1, agree(&site.rpc, &Desired::now(&site.rpc)?));
    book.check("nothing is left in a process that is not listed", 1, each_again(&site.rpc));
    site.down(book)
}

/// Kills the GCM while everybody asks, and has another one go on from its journal.
fn kill_once(site: &mut Site, crowd: &Crowd) -> Result<(), String> {
    // Requests under way are lost; nobody asks where nobody answers.
    crowd.set(|(life, is_there)| (*life, *is_there) = (*life + 1, false));
    site.gcm.kill();
    site.gcm_again()?;
    site.await_all()?;
    crowd.set(|(_, is_there)| *is_there = true);
    Ok(())
}

/// One client: asks for something in its group, again and again. Answers what it was told of the group, and
/// the other refusals.
fn ask_on(n: usize, address: &str, crowd: &Crowd, random: &mut fastrand::Rng) -> (Vec<Told>, Vec<String>) {
    let (rpc, group) = (Rpc::at(address), n % GROUPS);
    let (mut told, mut refused) = (Vec::new(), Vec::new());
    for k in 0.. {
        crowd.await_gcm();
        if crowd.ends.load(Ordering::Relaxed) {
            break;
        }
        let (what, id) = (any(random), format!("{n}-{k}"));
        let began = now_ns();
        let (heard, life) = loop {
            let life = crowd.await_gcm();
            match ask(&rpc, group, what, &id) {
                // Half of them ask again, by the same id.
                Heard::Lost if random.bool() => {}
                heard => break (heard, (crowd.kills() == life).then_some(life)),
            }
        };
        let ended = now_ns();
        let (said, place, is_lost) = match heard {
            Heard::Said(said, place) => (said, place, false),
            Heard::Lost => (Said::Done, None, true),
            Heard::Refused(why) => {
                refused.push(why);
                continue;
            }
        };
        let event = Event { call: Call::Asked(what, said), began, ended, is_lost, place };
        told.push(Told { id, group, event, life });
    }
    (told, refused)
}

/// Anything, of what is there or not.
pub(super) fn any(random: &mut fastrand::Rng) -> What {
    let (client, server) = (random.usize(..CLIENTS), random.usize(CLIENTS..ALL));
    match random.u8(..10) {
        0..3 => What::Create(random.usize(..ALL)),
        3..5 => What::Remove { component: random.usize(..ALL), force: random.bool() },
        5..8 => What::Connect { client, server, replace: random.u8(..4) == 0 },
        _ => What::Disconnect { client, server },
    }
}

/// Asks once.
pub(super) fn ask(rpc: &Rpc, group: usize, what: What, id: &str) -> Heard {
    let (mut gcm, request_id) = (rpc.gcm(), id.to_owned());
    let ends = |client, server| (port(group, client), port(group, server));
    let answer = match what {
        What::Create(component) => {
            let (path, class) = (path(group, component), class(component).to_owned());
            let request = CreateRequest { path, class, request_id, ..CreateRequest::default() };
            done(async { gcm.create(request).await }).map(|it| (it.plan, it.revision))
        }
        What::Remove { component, force } => {
            let path = path(group, component);
            let request = RemoveRequest { path, force, request_id, ..RemoveRequest::default() };
            done(async { gcm.remove(request).await }).map(|it| (it.plan, it.revision))
        }
        What::Connect { client, server, replace } => {
            let (client, server) = ends(client, server);
            let options = Some(ConnectOptions { replace, ..ConnectOptions::default() });
            let request = ConnectRequest { client, server, options, request_id, ..ConnectRequest::default() };
            done(async { gcm.connect(request).await }).map(|it| (it.plan, it.revision))
        }
        What::Disconnect { client, server } => {
            let (client, server) = ends(client, server);
            let request = DisconnectRequest { client, server, request_id, ..DisconnectRequest::default() };
            done(async { gcm.disconnect(request).await }).map(|it| (it.plan, it.revision))
        }
    };
    match answer {
        // A request with nothing to do has no revision of its own.
        Ok((plan, _)) if plan.is_empty() => Heard::Said(Said::Nothing, None),
        Ok((_, revision)) => Heard::Said(Said::Done, Some(revision)),
        Err(refused) => heard(group, &refused),
    }
}

fn heard(group: usize, refused: &Refused) -> Heard {
    let named = (0..ALL).find(|component| path(group, *component) == refused.component);
    let said = match (refused.reason.as_str(), named) {
        ("COMPONENT_EXISTS", _) => Said::Exists,
        ("COMPONENT_NOT_FOUND", Some(component)) => Said::Missing(component),
        ("IN_USE", _) => Said::InUse,
        ("CONNECTION_EXISTS", _) => Said::ConnectionExists,
        ("ALREADY_CONNECTED", _) => Said::AlreadyConnected,
        ("CONNECTION_NOT_FOUND", _) => Said::NoConnection,
        // Nobody has said why: the connection ended.
        ("", _) => return Heard::Lost,
        _ => return Heard::Refused(refused.to_string()),
    };
    Heard::Said(said, None)
}

/// Number of attempts, without which the claims beside it would show nothing.
fn tell(book: &mut Book, told: &[Told], refused: &[String], kills: usize) {
    let lost = told.iter().filter(|told| told.event.is_lost).count();
    let done = told.iter().filter(|told| told.event.place.is_some()).count();
    book.at_least("requests that changed something", told.len(), done as u64, 200);
    book.at_least(
        "requests that were refused for what was there",
        told.len(),
        (told.len() - done) as u64,
        200,
    );
    book.at_least("requests that were lost with their GCM", kills, lost as u64, 1);
    // A busy machine may take a process for lost for a moment.
    let other =
        refused.iter().find(|why| !["PROCESS_LOST", "BUSY"].iter().any(|reason| why.contains(reason)));
    let only = other.map_or(Ok(()), |why| Err(why.clone()));
    book.check("refused for no other reason than what is there", told.len() + refused.len(), only);
    book.at_most_in_time("requests that found no process, or no time", told.len(), refused.len() as u64, 0);
    let slowest = told.iter().map(|told| (told.event.ended - told.event.began) as f64 / 1e6);
    let mut took: Vec<f64> = slowest.collect();
    took.sort_by(f64::total_cmp);
    let p99 = took.get(took.len() * 99 / 100).copied().unwrap_or(f64::INFINITY);
    book.times("99 of 100 are answered", &[Timed { ms: p99, late_ms: 0.0 }], 100.0);
}

/// One order explains what all of each group were told, and leads to what is listed in the end.
fn explained(book: &mut Book, told: &[Told], list: &ListResponse) {
    for group in 0..GROUPS {
        let events = told.iter().filter(|told| told.group == group);
        let mut events: Vec<Event<Call>> = events.map(|told| told.event.clone()).collect();
        let (began, place, is_lost) = (now_ns(), None, false);
        let call = Call::Listed(listed(group, list));
        events.push(Event { call, began, ended: began + 1, is_lost, place });
        let explained = explain::<Group>(There::default(), &events);
        let explained = explained.map_err(|why| format!("group {group}: {why}"));
        book.check(
            "what all were told is explained by one order that ends as listed",
            events.len(),
            explained,
        );
    }
}

pub(super) fn listed(group: usize, list: &ListResponse) -> There {
    let mut there = There::default();
    for component in 0..ALL {
        there.components[component] = list.components.iter().any(|c| c.path == path(group, component));
    }
    for client in 0..CLIENTS {
        let source = |server: &usize| {
            let ends = (port(group, client), port(group, *server));
            list.connections.iter().any(|c| (&c.client, &c.server) == (&ends.0, &ends.1))
        };
        there.sources[client] = (CLIENTS..ALL).find(source);
    }
    there
}

/// The journal has what was answered, once, with the revision of the answer.
fn on_record(book: &mut Book, told: &[Told], journal: &Journal) {
    book.check("numbers, terms and revisions only grow (G2)", journal.records.len(), journal.grows());
    let by_request = journal.by_request();
    // Records of one GCM stand behind the requests that it was asked before.
    let mut last = BTreeMap::new();
    let placed = told.iter().filter(|told| told.event.place.is_some());
    for (told, life) in placed.filter_map(|told| Some((told, told.life?))) {
        let began = last.entry(life).or_insert(0);
        *began = told.event.began.max(*began);
    }
    let one = |told: &Told| {
        let records = by_request.get(told.id.as_str()).map_or(&[][..], Vec::as_slice);
        let revisions: Vec<u64> = records.iter().filter_map(|record| record["revision"].as_u64()).collect();
        let is_right = match (told.event.is_lost, told.event.place) {
            (true, _) => records.len() <= 1,
            (false, Some(place)) => records.len() == 1 && revisions == [place],
            // A refusal is not waited for: it may be lost with what came last.
            (false, None) => {
                let last = told.life.and_then(|life| last.get(&life));
                let may_be_lost = last.is_none_or(|began| told.event.ended >= *began);
                revisions.is_empty() && (records.len() == 1 || may_be_lost && records.is_empty())
            }
        };
        if is_right { Ok(()) } else { Err(format!("{} {:?}: {records:?}", told.id, told.event)) }
    };
    let all = told.iter().map(one).collect::<Result<Vec<()>, String>>().map(drop);
    book.check("one record for each answer, with its revision (G1, G6)", told.len(), all);
}

/// Everything can be taken away, made, connected and taken away again: no process has what nobody knows of.
fn each_again(rpc: &Rpc) -> Result<(), String> {
    let gone = |refused: Refused| match refused.reason.as_str() {
        "COMPONENT_NOT_FOUND" => Ok(()),
        _ => Err(refused.to_string()),
    };
    let paths: Vec<(usize, usize)> = (0..GROUPS).flat_map(|g| (0..ALL).map(move |c| (g, c))).collect();
    paths.iter().try_for_each(|(g, c)| rpc.remove(&path(*g, *c), true).or_else(gone))?;
    for (g, c) in &paths {
        rpc.create(&path(*g, *c), class(*c), json!({}))?;
    }
    for (g, client) in paths.iter().filter(|(_, c)| *c < CLIENTS) {
        for server in CLIENTS..ALL {
            let (client, server) = (port(*g, *client), port(*g, server));
            rpc.connect(&client, &server, ConnectOptions::default())?;
            rpc.disconnect(&client, &server)?;
        }
    }
    paths.iter().try_for_each(|(g, c)| Ok(rpc.remove(&path(*g, *c), false)?))
}
