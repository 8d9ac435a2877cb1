//! What must add up when nothing moves any more.
//!
//! Invariant: every figure is the host's own; nothing is estimated.

use std::collections::BTreeMap;
use std::fs;

use serde_json::json;
use trocar::lcm::Inventory;
use trocar::model::{ConnectOptions, Queue, Request, State, Target};
use trocar_sdk::Outcome;

use super::super::answer::whole;
use super::super::world::PATIENCE;
use super::super::{Call, Function, Lab, Samples};
use super::ops::{CLIENTS, SERVERS, own_thread};
use crate::eventually;

/// What the GCM wants is what the LCM has: components, their states, connections.
fn desired_is_observed(lab: &Lab) {
    eventually("desired and observed agree", || {
        let graph = lab.graph();
        let Inventory { components, .. } = lab.inventory();
        let desired: BTreeMap<_, _> = graph.components.iter().map(|(id, c)| (id.clone(), c.state)).collect();
        let observed: BTreeMap<_, _> = components.into_iter().map(|c| (c.id, c.state)).collect();
        if desired != observed {
            return Err(format!("desired {desired:?}, observed {observed:?}"));
        }
        // Of a connection between two processes each has its half.
        let halves = |near: bool| if near { 1 } else { 2 };
        let wanted = graph.connections.iter().flat_map(|(id, c)| vec![id.0; halves(c.is_near())]);
        let wanted: Vec<u64> = wanted.collect();
        let mut had: Vec<u64> = lab.links().iter().map(|l| l.connection).collect();
        had.sort_unstable();
        if wanted == had { Ok(()) } else { Err(format!("connections {wanted:?}, wired {had:?}")) }
    });
}

/// Waits until the servers have taken whatever was sent to them, a `crash` among it perhaps.
pub(super) fn settle(lab: &Lab) {
    for server in SERVERS {
        // A drain takes what was there when it began: after the second of these nothing older is left.
        for _ in 0..3 {
            // Refused by a server that is gone or stands still; what matters is that it has come back.
            let _ = lab.invoke(&format!("{server}/ctl/poke"), None, false);
        }
    }
    desired_is_observed(lab);
}

/// Mends the world by requests, has both pairs account for everything once, and takes it down.
pub(super) fn close(lab: &Lab) {
    for (client, server) in CLIENTS.iter().zip(SERVERS) {
        mend(lab, server, "Server");
        mend(lab, client, "Client");
    }
    for (client, server) in CLIENTS.iter().zip(SERVERS) {
        wire(lab, client, server);
        commands_add_up(lab, client, server);
        events_add_up(lab, client, server);
        samples_add_up(lab, client, server);
    }
    // Whatever a client still holds may be of either server.
    for client in CLIENTS {
        let_frames_go(lab, client);
    }
    for (client, server) in CLIENTS.iter().zip(SERVERS) {
        frames_add_up(lab, client, server);
    }
    for name in CLIENTS.iter().chain(&SERVERS) {
        lab.remove(name);
    }
    assert!(lab.links().is_empty(), "no component, no connection: {:?}", lab.links());
}

/// ACTIVE again; made anew where the thread it ran in is gone.
fn mend(lab: &Lab, name: &str, class: &str) {
    let start = || lab.ask(Request::Start { targets: vec![Target::One(lab.id(name))] });
    match lab.stands(name).map(|(state, _)| state) {
        Some(State::Active) => return,
        Some(State::Fault) => lab.reset(name),
        _ => {}
    }
    if lab.stands(name).is_some() {
        if start().is_ok() {
            return;
        }
        lab.remove(name);
    }
    let config = if class == "Server" { lab.gated(json!({})) } else { json!({}) };
    lab.create(name, class, config, own_thread());
    start().unwrap_or_else(|refusal| panic!("{name}, made anew, does not start: {refusal}"));
}

fn wire(lab: &Lab, client: &str, server: &str) {
    let options = ConnectOptions { replace: true, ..ConnectOptions::default() };
    let queue = Some(Queue::Fifo { depth: 8, drop_oldest: true });
    lab.connect_with(&format!("{client}/peer"), &format!("{server}/ctl"), options.clone());
    let options = ConnectOptions { queue, ..options };
    lab.connect_with(&format!("{client}/fifo"), &format!("{server}/value_out"), options.clone());
    lab.connect_with(&format!("{client}/frame"), &format!("{server}/frame_out"), options);
}

fn commands_add_up(lab: &Lab, client: &str, server: &str) {
    let (before, rejected) = (lab.count(server, "pokes"), lab.link(&format!("{client}/peer")).dropped);
    let answer = lab.order(client, Call::send(Function::Poke, 0.0).from_threads(2).times(20), PATIENCE);
    let answer = answer.unwrap_or_else(|refusal| panic!("{client} does not answer: {refusal}"));
    let taken = answer.count(Outcome::Queued) + answer.count(Outcome::Executed);
    let full = answer.count(Outcome::QueueFull);
    assert_eq!(taken + full, 40, "{answer:?}");
    lab.await_count(server, "pokes", |n| n == before + taken);
    let counted = lab.link(&format!("{client}/peer")).dropped - rejected;
    assert_eq!(counted, full, "every refusal is counted");
}

fn events_add_up(lab: &Lab, client: &str, server: &str) {
    outside(lab, &format!("{client}/run/clear"), None);
    let before = lab.link(&format!("{client}/peer")).dropped;
    outside(lab, &format!("{server}/ctl/burst"), Some(20.0));
    eventually(&format!("each event of {server} was heard by {client} or counted as lost"), || {
        let (heard, lost) =
            (lab.count(client, "ticks"), lab.link(&format!("{client}/peer")).dropped - before);
        if heard + lost == 20 { Ok(()) } else { Err(format!("{heard} heard, {lost} lost")) }
    });
}

fn samples_add_up(lab: &Lab, client: &str, server: &str) {
    // Whatever the client saw before, it has now seen the newest.
    outside(lab, &format!("{server}/ctl/publish"), Some(1.0));
    collect(lab, client);
    let before = lab.link(&format!("{client}/fifo")).dropped;
    outside(lab, &format!("{server}/ctl/publish"), Some(20.0));
    let seen = collect(lab, client);
    assert_eq!(seen.count + seen.gaps, 20, "{seen:?}");
    let dropped = lab.link(&format!("{client}/fifo")).dropped - before;
    assert_eq!(dropped, seen.gaps, "the gaps are the drops: {seen:?}");
}

/// Slots of a server's pool of frames.
const SLOTS: u64 = 4;

/// Whatever the play left in hands, in queues or on the way comes back: all slots can be lent at once, again
/// and again.
fn frames_add_up(lab: &Lab, client: &str, server: &str) {
    let whole_pool = || {
        outside(lab, &format!("{server}/ctl/publish_frames"), Some(1.0));
        outside(lab, &format!("{client}/run/take_frame"), None);
        // One is in its hands: with the three other slots the queue keeps two frames and leaves one free,
        // with fewer only one.
        match frames_made(lab, client, server, SLOTS) {
            (2, _) => Ok(()),
            (_, told) => Err(told),
        }
    };
    // A cycle under way may still look at what was cut.
    eventually("every slot of the pool can be lent at once", whole_pool);
    // More than there is room for: what is not taken has its count.
    frames_made(lab, client, server, 5 * SLOTS);
    match lab.is_parted() {
        false => whole_pool().unwrap_or_else(|told| panic!("a slot has not come back: {told}")),
        // The writer's process has to notice first.
        true => eventually("every slot has come back", whole_pool),
    }
}

/// Has frames made and taken: those that were asked for were made or found no slot; made, they were taken or
/// dropped. How many were taken, and the sums.
fn frames_made(lab: &Lab, client: &str, server: &str, asked: u64) -> (u64, String) {
    let figures = || {
        let link = lab.link(&format!("{client}/frame"));
        [
            lab.count(server, "samples"),
            lab.count(server, "exhausted"),
            link.passed,
            link.dropped + link.skipped,
        ]
    };
    let before = figures();
    outside(lab, &format!("{server}/ctl/publish_frames"), Some(asked as f64));
    let mut seqs = let_frames_go(lab, client);
    if lab.is_parted() {
        // The first frame of a pool comes when that memory is mapped.
        eventually("each frame is taken or counted", || {
            seqs.extend(let_frames_go(lab, client));
            let [.., passed, dropped] = figures();
            let now = passed + dropped - before[2] - before[3];
            if now == asked { Ok(()) } else { Err(format!("{now} of {asked}")) }
        });
    }
    let after = figures();
    let [made, exhausted, passed, dropped] = [0, 1, 2, 3].map(|i| after[i] - before[i]);
    let taken = seqs.len() as u64;
    let told = format!(
        "{asked} asked of {server}: {made} made, {exhausted} without a slot, {passed} passed, {dropped} dropped; \
         {client} took {seqs:?}"
    );
    assert_eq!(made + exhausted, asked, "each was made or counted: {told}");
    assert_eq!((passed, passed + dropped), (taken, asked), "each was taken or counted as dropped: {told}");
    assert!(seqs.is_sorted_by(|a, b| a < b), "in order, and none twice: {told}");
    (taken, told)
}

/// Takes all frames there are and hands the last one back, too; their sequence numbers.
fn let_frames_go(lab: &Lab, client: &str) -> Vec<u64> {
    let mut seqs = Vec::new();
    loop {
        let frame = outside(lab, &format!("{client}/run/take_frame"), None);
        if whole(&frame["at"]) == 0 {
            outside(lab, &format!("{client}/run/release_frame"), None);
            return seqs;
        }
        seqs.push(whole(&frame["seq"]));
    }
}

fn outside(lab: &Lab, member: &str, arg: Option<f64>) -> serde_json::Value {
    let reply = lab.invoke(member, arg.map(|x| json!(x)), false);
    reply.unwrap_or_else(|refusal| panic!("{member}: {refusal}")).value.unwrap_or_default()
}

fn collect(lab: &Lab, client: &str) -> Samples {
    Samples::of(&outside(lab, &format!("{client}/run/collect"), None))
}

/// Threads and open files of this process.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Resources {
    threads: usize,
    files: usize,
}

impl Resources {
    pub(super) fn now() -> Resources {
        let entries = |dir: &str| fs::read_dir(dir).map(Iterator::count).unwrap_or_default();
        Resources { threads: entries("/proc/self/task"), files: entries("/proc/self/fd") }
    }

    /// Waits until there are no more than these; the runtime's own helpers come and go.
    pub(super) fn await_again(&self) {
        eventually("threads and files are given back", || {
            let now = Resources::now();
            let fits = now.threads <= self.threads + SLACK && now.files <= self.files + SLACK;
            if fits { Ok(()) } else { Err(format!("{self:?} before, {now:?} now: {:?}", open_files())) }
        });
    }
}

/// Frame pools, links and rows in memory that other processes may be given.
pub(super) fn shared_memory() -> usize {
    open_files().iter().filter(|(to, _)| to.starts_with("/memfd:trocar-")).map(|(_, n)| n).sum()
}

/// Waits until there are no more of them than `before` there was a component: a removed one keeps none.
pub(super) fn await_shared_memory(before: usize) {
    eventually("shared memory is given back", || match shared_memory() {
        now if now <= before => Ok(()),
        now => Err(format!("{before} before, {now} now: {:?}", open_files())),
    });
}

/// Memory of this process after each seed.
#[derive(Default)]
pub(super) struct Growth {
    /// Resident, kB.
    kb: Vec<u64>,
}

/// Seeds from which on a growth can be told from what is made once and kept.
const ENOUGH: usize = 200;
/// Memory that a thousand seeds may leave behind, kB: pages of the allocator's, spread over threads that come
/// and go.
const LEFT_KB: u64 = 4096;

impl Growth {
    pub(super) fn look(&mut self) {
        let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
        let line = status.lines().find_map(|l| l.strip_prefix("VmRSS:")).unwrap_or_default();
        self.kb.push(line.trim().trim_end_matches("kB").trim().parse().unwrap_or_default());
    }

    /// Compares the least of the last quarter with the least of the third: a leak lifts each, while the
    /// allocator's own pages, spread over threads that come and go, have settled in the first half.
    ///
    /// # Panics
    /// It has grown by more than the allocator explains.
    pub(super) fn judge(&self, who: &str) {
        let seeds = self.kb.len();
        if seeds < ENOUGH {
            return;
        }
        let least = |quarter: usize| {
            let part = &self.kb[seeds * quarter / 4..seeds * (quarter + 1) / 4];
            part.iter().copied().min().unwrap_or_default()
        };
        let (then, now) = (least(2), least(3));
        let allowed = LEFT_KB * (seeds as u64).div_ceil(1000);
        println!("{who}: {seeds} seeds, {then} kB resident in the third quarter, {now} kB in the last");
        // What the thread sanitizer keeps of threads that have ended is not the host's.
        assert!(
            cfg!(feature = "tsan") || now <= then + allowed,
            "{who}: {then} kB became {now} kB over {} seeds",
            seeds / 4
        );
    }
}

/// How many open files point where.
fn open_files() -> BTreeMap<String, usize> {
    let mut files = BTreeMap::new();
    for entry in fs::read_dir("/proc/self/fd").into_iter().flatten().flatten() {
        let to = fs::read_link(entry.path()).unwrap_or_default().display().to_string();
        *files.entry(to).or_default() += 1;
    }
    files
}

/// Blocking threads of the tokio runtime that idle for a while before they end.
const SLACK: usize = 12;
