//! A large system: how long it takes to make, start, list, stop and find it again, and what a change costs
//! beside it.
//!
//! Invariant: each time stands beside the lateness of the machine in that very time; what is made is counted
//! before anything is claimed of it.

use std::thread;
use std::time::Duration;

use serde_json::json;
use tonic::Request;
use trocar_proto::v1::step::Step as Kind;
use trocar_proto::v1::{
    ApplyRequest, ConnectOptions, ConnectRequest, CreateRequest, ListResponse, ProcessState, StartRequest,
    Step, StopRequest,
};

use crate::book::{Book, Timed};
use crate::clock::{Witness, eventually, now_ns, pause_ms};
use crate::rpc::{Answer, Rpc, done_within, state_name};
use crate::run::{Row, Run, When};
use crate::site::Site;

pub(crate) const ROWS: &[Row] = &[Row {
    name: "41",
    fault: "a thousand components, two thousand connections, fifty processes",
    when: When::Times,
    run: large,
}];

const PROCESSES: usize = 50;
const EACH: usize = 20;
const COMPONENTS: usize = PROCESSES * EACH;
/// For what may take long here.
const PATIENCE: Duration = Duration::from_secs(120);

fn name(process: usize) -> String {
    format!("p{process}")
}

fn path(component: usize) -> String {
    let component = component % COMPONENTS;
    format!("{}/c{}", name(component / EACH), component % EACH)
}

/// All of it: each takes samples of the one after it, most of the same process, and calls one of the next
/// process.
fn steps() -> Vec<Step> {
    let create = |n: usize| {
        let class = "fixture-echo/echo".to_owned();
        Kind::Create(CreateRequest { path: path(n), class, ..CreateRequest::default() })
    };
    let connect = |client: String, server: String| {
        Kind::Connect(ConnectRequest { client, server, ..ConnectRequest::default() })
    };
    let samples = |n: usize| connect(format!("{}/sample", path(n)), format!("{}/sample_out", path(n + 1)));
    let calls = |n: usize| connect(format!("{}/peer", path(n)), format!("{}/ctl", path(n + EACH)));
    let all = (0..COMPONENTS).map(create);
    let all = all.chain((0..COMPONENTS).map(samples)).chain((0..COMPONENTS).map(calls));
    all.map(|step| Step { step: Some(step) }).collect()
}

/// A request whose server waits, too.
fn patient<T>(message: T) -> Request<T> {
    let mut request = Request::new(message);
    request.set_timeout(PATIENCE);
    request
}

struct Clock {
    witness: Witness,
}

impl Clock {
    /// Time of something that must succeed.
    fn time<T>(&self, what: &str, act: impl FnOnce() -> Answer<T>) -> Result<(T, Timed), String> {
        self.witness.forget();
        let began = now_ns();
        let done = act().map_err(|refused| format!("{what}: {refused}"))?;
        Ok((done, self.witness.timed(began, now_ns(), 0.0)))
    }
}

fn start_all(rpc: &Rpc) -> Answer<()> {
    let request = StartRequest { path: "**".into(), ..StartRequest::default() };
    done_within(PATIENCE, async { rpc.gcm().start(patient(request)).await }).map(drop)
}

fn stop_all(rpc: &Rpc) -> Answer<()> {
    let request = StopRequest { path: "**".into(), ..StopRequest::default() };
    done_within(PATIENCE, async { rpc.gcm().stop(patient(request)).await }).map(drop)
}

fn count(list: &ListResponse, state: &str) -> usize {
    list.components.iter().filter(|c| state_name(c.state()) == state).count()
}

fn large(_: &Run, book: &mut Book) -> Result<(), String> {
    let names: Vec<String> = (0..PROCESSES).map(name).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let mut site = Site::new(&["fixture_torture", "fixture_echo", "fixture_chaos"], &names)?;
    let (rpc, clock) = (site.rpc.clone(), Clock { witness: Witness::start() });
    let request = ApplyRequest { steps: steps(), ..ApplyRequest::default() };
    let apply = || done_within(PATIENCE, async { rpc.gcm().apply(patient(request)).await });
    let (_, took) = clock.time("Apply", apply)?;
    let list = rpc.brief()?;
    book.at_least("components", 1, list.components.len() as u64, COMPONENTS as u64);
    book.at_least("connections", 1, list.connections.len() as u64, 2 * COMPONENTS as u64);
    book.times("one Apply of all of it", &[took], 10_000.0);
    let (mut starts, mut stops) = (Vec::new(), Vec::new());
    for _ in 0..3 {
        starts.push(clock.time("Start **", || start_all(&rpc))?.1);
        book.at_least("that run after Start **", 1, count(&rpc.brief()?, "ACTIVE") as u64, COMPONENTS as u64);
        stops.push(clock.time("Stop **", || stop_all(&rpc))?.1);
        book.at_least(
            "that stand still after Stop **",
            1,
            count(&rpc.brief()?, "STOPPED") as u64,
            COMPONENTS as u64,
        );
    }
    book.times("Start **", &starts, 2_000.0);
    book.times("Stop **", &stops, 300.0);
    start_all(&rpc).map_err(String::from)?;
    listed(book, &rpc, &clock)?;
    changes(book, &rpc, &clock)?;
    made_safe(book, &site, &clock)?;
    let mut back = Vec::new();
    for _ in 0..3 {
        site.gcm.kill();
        clock.witness.forget();
        let began = now_ns();
        site.gcm_again()?;
        back.push(clock.witness.timed(began, await_all(&site)?, 0.0));
    }
    book.times("a GCM that is started again has all of it", &back, 3_000.0);
    site.down(book)
}

fn await_all(site: &Site) -> Result<u64, String> {
    eventually("a GCM has everybody", || {
        let list = site.rpc.brief()?;
        let attached = list.processes.iter().filter(|p| p.state() == ProcessState::Attached).count();
        let running = count(&list, "ACTIVE");
        if attached == PROCESSES && running >= COMPONENTS {
            return Ok(now_ns());
        }
        // A list of all this takes the GCM long: it is to have time for them.
        pause_ms(50);
        Err(format!("{attached} processes, {running} components that run"))
    })
}

/// The value below which so many of a hundred lie.
fn percentile(times: &[Timed], hundredths: usize) -> Timed {
    let mut times = times.to_vec();
    times.sort_by(|a, b| a.ms.total_cmp(&b.ms));
    let at = (times.len() * hundredths / 100).min(times.len().saturating_sub(1));
    times.get(at).copied().unwrap_or(Timed { ms: f64::INFINITY, late_ms: 0.0 })
}

fn listed(book: &mut Book, rpc: &Rpc, clock: &Clock) -> Result<(), String> {
    for (what, is_brief) in [("List", false), ("List, brief", true)] {
        let ask = || if is_brief { rpc.brief() } else { rpc.list() };
        let times = (0..20).map(|_| clock.time(what, ask).map(|(_, took)| took));
        let times = times.collect::<Result<Vec<Timed>, String>>()?;
        book.times(&format!("{what}: p50 of 20"), &[percentile(&times, 50)], 50.0);
    }
    Ok(())
}

/// Single changes that are on record when they are answered.
fn changes(book: &mut Book, rpc: &Rpc, clock: &Clock) -> Result<(), String> {
    for (path, class) in [("p0/sink", "sink"), ("p0/source", "source"), ("p1/source", "source")] {
        rpc.create(path, &format!("fixture-torture/{class}"), json!({}))?;
    }
    let mut bare = Vec::new();
    for (what, server, bound) in [
        ("Connect inside a process", "p0/source/value", 2.0),
        ("Connect between two processes", "p1/source/value", 5.0),
    ] {
        let mut times = Vec::new();
        for _ in 0..100 {
            let connect = || rpc.connect("p0/sink/value", server, ConnectOptions::default());
            times.push(clock.time(what, connect)?.1);
            rpc.disconnect("p0/sink/value", server)?;
            bare.push(clock.time("GetState", || rpc.component("p0/sink"))?.1);
        }
        let beside = percentile(&bare, 50).ms;
        let words = format!("{what}: p50 of 100 (GetState {beside:.2} ms)");
        book.times(&words, &[percentile(&times, 50)], bound);
    }
    Ok(())
}

/// A Stop of something that moves, while another component of its process takes ten seconds to start.
fn made_safe(book: &mut Book, site: &Site, clock: &Clock) -> Result<(), String> {
    let (rpc, file) = (&site.rpc, site.world.path("arm.book"));
    rpc.create("p0/arm", "fixture-torture/arm", json!({ "book": file.to_string_lossy() }))?;
    rpc.connect("p0/arm/set_point", "p0/source/value", ConnectOptions::default())?;
    rpc.start("p0/source")?;
    rpc.create("p0/slow", "fixture-chaos/chaos", json!({ "slow_start_ms": 10_000 }))?;
    let slow = {
        let rpc = Rpc::at(&rpc.address);
        thread::spawn(move || {
            let request = StartRequest { path: "p0/slow".into(), ..StartRequest::default() };
            done_within(PATIENCE, async { rpc.gcm().start(patient(request)).await }).map(drop)
        })
    };
    let mut times = Vec::new();
    for _ in 0..200 {
        rpc.start("p0/arm")?;
        clock.witness.forget();
        let began = now_ns();
        rpc.stop("p0/arm")?;
        let text = std::fs::read_to_string(&file).map_err(|e| format!("{}: {e}", file.display()))?;
        let safe = text.lines().filter_map(|line| line.parse::<u64>().ok()).find(|at| *at >= began);
        let safe = safe.ok_or("a Stop was answered, and the arm was not made safe")?;
        times.push(clock.witness.timed(began, safe, 0.0));
        if slow.is_finished() {
            break;
        }
    }
    book.at_least("Stops beside a start that takes 10 s", 1, times.len() as u64, 100);
    book.times("from the request of a Stop to make_safe: p99", &[percentile(&times, 99)], 5.0);
    rpc.remove("p0/arm", true)?;
    let ended = slow.join().map_err(|_| "the one who starts panicked")?;
    ended.map_err(|refused| format!("p0/slow: {refused}"))?;
    Ok(rpc.remove("p0/slow", true)?)
}
