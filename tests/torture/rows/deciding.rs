//! Rows about a GCM or a host that is killed in the middle of a change: there is what was before or what was
//! asked for, and never a mix.
//!
//! Invariant: each moment is drawn from the time that the same takes undisturbed, so kills fall before,
//! within and behind the commit.

use std::collections::BTreeSet;
use std::thread;
use std::time::{Duration, Instant};

use rustix::process::Signal;
use serde_json::{Value, json};
use tonic::Code;
use trocar_proto::v1::step::Step as Kind;
use trocar_proto::v1::{
    ApplyRequest, ConnectOptions, ConnectRequest, CreateRequest, ListResponse, RemoveRequest, StartRequest,
    Step,
};

use crate::book::{Book, Timed};
use crate::bystander::Bystander;
use crate::clock::{Witness, eventually, now_ns};
use crate::invariants::{Desired, agree};
use crate::json::{number, to_struct};
use crate::linear::There;
use crate::program::signal_to;
use crate::rpc::{Answer, Rpc, done, state_name};
use crate::run::{Row, Run, When};
use crate::site::Site;

use super::racing::{Heard, any, ask, listed};

pub(crate) const ROWS: &[Row] = &[
    Row {
        name: "6",
        fault: "the GCM is killed around the record of a change",
        when: When::Gate,
        run: records,
    },
    Row { name: "38", fault: "GCM or host is killed in the middle of Apply", when: When::Gate, run: applies },
];

/// Pairs of a sink in `a` and a source in `b`, of each of two systems.
const PAIRS: usize = 7;
/// Their components are started in so many steps: with all that is removed, made and connected, forty.
const STARTS: usize = 5;
/// Times that the same is asked for after a kill, where it takes too long.
const AFTERWARDS: u32 = 5;

fn sink(system: usize, pair: usize) -> String {
    format!("a/sink-{system}-{pair}")
}

fn source(system: usize, pair: usize) -> String {
    format!("b/source-{system}-{pair}")
}

fn components(system: usize) -> Vec<String> {
    (0..PAIRS).flat_map(|pair| [sink(system, pair), source(system, pair)]).collect()
}

/// The forty steps from the other system to this one; the first time there is none to remove.
fn steps(system: usize, is_first: bool) -> Vec<Step> {
    let mut steps = Vec::new();
    let mut add = |step: Kind| steps.push(Step { step: Some(step) });
    for path in components(1 - system).into_iter().filter(|_| !is_first) {
        add(Kind::Remove(RemoveRequest { path, force: true, ..RemoveRequest::default() }));
    }
    for path in components(system) {
        let class = if path.starts_with("a/") { "fixture-torture/sink" } else { "fixture-torture/source" };
        add(Kind::Create(CreateRequest { path, class: class.into(), ..CreateRequest::default() }));
    }
    for pair in 0..PAIRS {
        let (client, server) =
            (format!("{}/value", sink(system, pair)), format!("{}/value", source(system, pair)));
        add(Kind::Connect(ConnectRequest { client, server, ..ConnectRequest::default() }));
    }
    for paths in components(system).chunks((2 * PAIRS).div_ceil(STARTS)) {
        add(Kind::Start(StartRequest { paths: paths.to_vec(), ..StartRequest::default() }));
    }
    steps
}

fn apply(rpc: &Rpc, steps: Vec<Step>) -> Answer<()> {
    let request = ApplyRequest { steps, ..ApplyRequest::default() };
    done(async { rpc.gcm().apply(request).await }).map(drop)
}

/// Both systems as they are listed, or which of them is there.
type Made = BTreeSet<String>;

fn whole(system: usize) -> Made {
    let connection = |pair| format!("{}/value < {}/value", sink(system, pair), source(system, pair));
    let running = components(system).into_iter().map(|path| format!("{path} ACTIVE"));
    running.chain((0..PAIRS).map(connection)).collect()
}

fn made(list: &ListResponse) -> Made {
    let ours = |path: &str| path.contains("/sink-") || path.contains("/source-");
    let components = list.components.iter().filter(|c| ours(&c.path));
    let components = components.map(|c| format!("{} {}", c.path, state_name(c.state())));
    let connections = list.connections.iter().filter(|c| ours(&c.client));
    components.chain(connections.map(|c| format!("{} < {}", c.client, c.server))).collect()
}

/// Waits until one of the systems is there, and answers which.
fn await_whole(rpc: &Rpc) -> Result<usize, String> {
    eventually("one of both systems is there, and nothing of the other", || {
        let made = made(&rpc.brief()?);
        (0..2).find(|system| made == whole(*system)).ok_or_else(|| format!("{made:?}"))
    })
}

/// A system that is changed from one to the other while something is killed.
struct Switched {
    site: Site,
    /// Which is there.
    now: usize,
    /// Time of an Apply, undisturbed.
    takes: Duration,
    /// Outcomes: told that it was done, told that it was not, lost and done, lost and not done.
    outcomes: [u64; 4],
    back: Vec<Timed>,
    /// Applies that were not done in time, though nothing was killed.
    too_late: u64,
}

impl Switched {
    fn new() -> Result<Switched, String> {
        let site = Site::new(&["fixture_torture", "fixture_chaos"], &["a", "b", "c", "d"])?;
        apply(&site.rpc, steps(0, true))?;
        let (mut now, mut took) = (0, Vec::new());
        for _ in 0..5 {
            let began = Instant::now();
            apply(&site.rpc, steps(1 - now, false))?;
            took.push(began.elapsed());
            now = 1 - now;
        }
        took.sort();
        Ok(Switched {
            site,
            now,
            takes: took[took.len() / 2],
            outcomes: [0; 4],
            back: Vec::new(),
            too_late: 0,
        })
    }

    /// An Apply, and what is done meanwhile; then everything is started again that was killed. What was
    /// answered is so, and what is there is one of both, in each process.
    fn round(
        &mut self,
        witness: &Witness,
        kill: impl FnOnce(&mut Site) -> Result<(), String>,
        again: impl FnOnce(&mut Site) -> Result<(), String>,
    ) -> Result<(), String> {
        let (to, rpc) = (1 - self.now, self.site.rpc.clone());
        let applying = thread::spawn(move || apply(&rpc, steps(to, false)));
        kill(&mut self.site)?;
        let answer = applying.join().map_err(|_| "the one who applies panicked")?;
        witness.forget();
        let began = now_ns();
        again(&mut self.site)?;
        self.back.push(witness.timed(began, self.site.await_all()?, 0.0));
        let there = await_whole(&self.site.rpc)?;
        let outcome = match &answer {
            Ok(()) if there == to => 0,
            Err(refused) if !refused.reason.is_empty() && there == self.now => 1,
            Err(refused) if refused.reason.is_empty() => {
                if there == to {
                    2
                } else {
                    3
                }
            }
            answer => {
                return Err(format!(
                    "it was answered with {answer:?}, and system {there} is there, not {to}"
                ));
            }
        };
        self.outcomes[outcome] += 1;
        agree(&self.site.rpc, &Desired::now(&self.site.rpc)?)?;
        if there != to {
            // No process has anything of it left. One that takes too long is taken back, and asked again.
            let mut tries = AFTERWARDS;
            loop {
                let answer = apply(&self.site.rpc, steps(to, false));
                let is_late = answer.as_ref().is_err_and(|refused| refused.code == Code::DeadlineExceeded);
                let there = await_whole(&self.site.rpc).map_err(|e| format!("afterwards: {e}"))?;
                if there == to {
                    break;
                }
                tries -= 1;
                self.too_late += u64::from(is_late);
                if !is_late || tries == 0 {
                    return Err(format!("the same cannot be done afterwards: {answer:?}"));
                }
            }
        }
        self.now = to;
        Ok(())
    }

    /// Number of listed components of the system that is to come.
    fn progress(rpc: &Rpc, to: usize) -> Result<usize, String> {
        let made = made(&rpc.brief()?);
        Ok(components(to)
            .iter()
            .filter(|path| made.iter().any(|m| m.starts_with(&format!("{path} "))))
            .count())
    }
}

/// The clock of a moment, which a thread that is woken would miss.
fn spin(until: Instant) {
    if let Some(far) = until.checked_duration_since(Instant::now() + Duration::from_millis(1)) {
        thread::sleep(far);
    }
    while Instant::now() < until {
        std::hint::spin_loop();
    }
}

fn applies(run: &Run, book: &mut Book) -> Result<(), String> {
    let mut random = run.random(book);
    let (mut switched, witness) = (Switched::new()?, Witness::start());
    let flow = Flow::start(&switched.site, "c/untouched", "d/untouched")?;
    let bystander = Bystander::start(&switched.site.world, &switched.site.rpc, "d/late")?;
    let rounds = run.times(5, 300);
    let mut went = Ok(());
    for round in 0..rounds {
        let moment = switched.takes.mul_f64(random.f64() * 1.3);
        let kill = |site: &mut Site| {
            spin(Instant::now() + moment);
            site.gcm.kill();
            Ok(())
        };
        let done = switched.round(&witness, kill, Site::gcm_again);
        went = done.map_err(|why| format!("round {round}, the GCM killed after {moment:?}: {why}"));
        if went.is_err() {
            break;
        }
    }
    book.check("old or new, never a mix, when the GCM is killed (G1, G3)", rounds as usize, went.clone());
    went?;
    tell_outcomes(book, "GCM", &mut switched);
    host_dies(run, book, &mut switched, &witness)?;
    step_fails(run, book, &mut switched)?;
    book.at_most_in_time(
        "Applies afterwards that were not done in time",
        rounds as usize,
        switched.too_late,
        0,
    );
    flow.tell(book, &switched.site)?;
    bystander.tell(book)?;
    let journal = switched.site.journal()?;
    book.check("numbers, terms and revisions only grow (G2)", journal.records.len(), journal.grows());
    switched.site.down(book)
}

fn tell_outcomes(book: &mut Book, who: &str, switched: &mut Switched) {
    let [ok, refused, lost_done, lost_not] = std::mem::take(&mut switched.outcomes);
    let words = format!("{who} killed: {ok} done, {refused} refused, {lost_done} lost and done");
    let rounds = (ok + refused + lost_done + lost_not) as usize;
    book.at_least(&format!("{words}; Applies that were not done"), rounds, refused + lost_not, 1);
    book.times(&format!("{who} killed: attached again"), &std::mem::take(&mut switched.back), 1000.0);
}

/// The process that gets half of it dies when so many components of it are there.
fn host_dies(run: &Run, book: &mut Book, switched: &mut Switched, witness: &Witness) -> Result<(), String> {
    let mut random = run.random(book);
    let every = if run.full { 1 } else { 4 };
    let (mut tried, mut went) = (0, Ok(()));
    for k in (0..=2 * PAIRS).step_by(every) {
        let (to, pause) = (1 - switched.now, Duration::from_micros(random.u64(0..1_500)));
        let kill = |site: &mut Site| {
            let rpc = site.rpc.clone();
            // It may be over before it is looked at.
            let until = Instant::now() + Duration::from_secs(1);
            while Switched::progress(&rpc, to)? < k && Instant::now() < until {}
            spin(Instant::now() + pause);
            site.host("b")?.kill();
            Ok(())
        };
        let done = switched.round(witness, kill, |site| site.host_again("b"));
        tried += 1;
        went = done.map_err(|why| format!("b killed when {k} components were there: {why}"));
        if went.is_err() {
            break;
        }
    }
    book.check("old or new, never a mix, when a host is killed (G3)", tried, went.clone());
    went?;
    tell_outcomes(book, "host", switched);
    Ok(())
}

/// One step of the forty fails, each in turn.
fn step_fails(run: &Run, book: &mut Book, switched: &mut Switched) -> Result<(), String> {
    let (rpc, to) = (&switched.site.rpc, 1 - switched.now);
    let (all, mut tried, mut went) = (steps(to, false), 0, Ok(()));
    let revision = rpc.brief()?.revision;
    for k in (0..=all.len()).step_by(if run.full { 1 } else { 8 }) {
        let config = Some(to_struct(&json!({ "error_in": "configure" })));
        let (path, class) = ("a/fails".to_owned(), "fixture-chaos/chaos".to_owned());
        let fails = Kind::Create(CreateRequest { path, class, config, ..CreateRequest::default() });
        let mut steps = all.clone();
        steps.insert(k, Step { step: Some(fails) });
        let answer = apply(rpc, steps);
        tried += 1;
        let refused = answer.as_ref().is_err_and(|refused| refused.reason == "COMPONENT_REFUSED");
        let same = await_whole(rpc)? == switched.now && rpc.brief()?.revision == revision;
        if !refused || !same {
            went = Err(format!("step {k}: {answer:?}; {:?}", made(&rpc.brief()?)));
            break;
        }
    }
    book.check("a step that fails leaves what was there, and its revision", tried, went);
    Ok(())
}

/// Samples from one process to another with which nothing is done.
pub(super) struct Flow {
    ends: [(String, Value); 2],
    /// Pids and epochs.
    processes: Vec<(String, u32, u64)>,
}

impl Flow {
    pub(super) fn start(site: &Site, source: &str, sink: &str) -> Result<Flow, String> {
        let rpc = &site.rpc;
        rpc.create(source, "fixture-torture/source", json!({}))?;
        rpc.create(sink, "fixture-torture/sink", json!({}))?;
        let ends = (format!("{sink}/value"), format!("{source}/value"));
        rpc.connect(&ends.0, &ends.1, ConnectOptions::default())?;
        rpc.start(sink)?;
        rpc.start(source)?;
        let taken = eventually("samples flow", || match rpc.row(sink)? {
            row if number(&row["books"]["taken"]) > 10 => Ok(row),
            row => Err(row["books"]["taken"].to_string()),
        })?;
        let processes = Flow::processes(site, &[source, sink])?;
        Ok(Flow { ends: [(source.to_owned(), rpc.row(source)?), (sink.to_owned(), taken)], processes })
    }

    fn processes(site: &Site, ends: &[&str]) -> Result<Vec<(String, u32, u64)>, String> {
        let all = site.rpc.brief()?.processes;
        let is_of = |name: &str| ends.iter().any(|end| end.split('/').next() == Some(name));
        Ok(all.into_iter().filter(|p| is_of(&p.name)).map(|p| (p.name, p.pid, p.epoch)).collect())
    }

    /// Nobody was started again, and nothing was missed.
    pub(super) fn tell(&self, book: &mut Book, site: &Site) -> Result<(), String> {
        let [(source, gave), (sink, took)] = &self.ends;
        let (gives, takes) = (site.rpc.row(source)?, site.rpc.row(sink)?);
        let is_same = gives["instance"] == gave["instance"]
            && Flow::processes(site, &[source, sink])? == self.processes
            && takes["books"]["instances"] == took["books"]["instances"];
        let same = if is_same { Ok(()) } else { Err(format!("{gave} became {gives}; {takes}")) };
        book.check("what is not touched was not started again (G4)", 1, same);
        let more = |key: &str| number(&takes["books"][key]).saturating_sub(number(&took["books"][key]));
        let (taken, missed) = (more("taken"), more("gaps"));
        book.at_least("samples that flowed meanwhile", 1, taken, 100);
        book.at_most_in_time(&format!("of {taken} samples beside it: missed (G4)"), 1, missed, 0);
        let wrong = more("disorder") + more("old") + more("torn");
        book.at_most(&format!("of {taken} samples beside it: twice, torn or old"), 1, wrong, 0);
        Ok(())
    }
}

/// Single changes, one after the other, of which the GCM is killed in the middle.
fn records(run: &Run, book: &mut Book) -> Result<(), String> {
    let mut random = run.random(book);
    let mut site = Site::new(&["fixture_torture"], &["a", "b"])?;
    let flow = Flow::start(&site, "a/untouched", "b/untouched")?;
    let witness = Witness::start();
    let (mut there, mut took, mut changes) = (There::default(), Vec::new(), 0u64);
    let (mut lost, mut back, mut went) = ([0u64; 2], Vec::new(), Ok(()));
    let rounds = run.times(20, 1_000);
    for round in 0..rounds {
        // A change that nothing disturbs tells how long it takes.
        for n in 0..if round == 0 { 40 } else { random.u64(0..4) } {
            let (what, began) = (any(&mut random), Instant::now());
            let (said, after) = there.asked(what);
            let heard = ask(&site.rpc, 0, what, &format!("{round}-{n}"));
            if !matches!(&heard, Heard::Said(as_expected, _) if *as_expected == said) {
                went = Err(format!("round {round}: {what:?} of {there:?} was answered with {heard:?}"));
            }
            if let Some(after) = after {
                (there, changes) = (after, changes + 1);
                took.push(began.elapsed());
            }
        }
        if went.is_err() {
            break;
        }
        took.sort();
        let moment = took[took.len() / 2].mul_f64(random.f64() * 1.4);
        let cut = killed_within(&mut site, &mut random, &mut there, moment, &format!("{round}-killed"));
        witness.forget();
        let began = now_ns();
        site.gcm_again()?;
        back.push(witness.timed(began, site.await_all()?, 0.0));
        went = match settled(&site, &mut there, &mut lost, cut) {
            Ok(()) => Ok(()),
            Err(why) => Err(format!("round {round}, killed after {moment:?}: {why}")),
        };
    }
    book.check(
        "what was answered is there, what was lost is done or not (G1)",
        rounds as usize,
        went.clone(),
    );
    let words = format!("beside {changes} changes: lost and done {}; lost and not done", lost[0]);
    book.at_least(&words, rounds as usize, lost[1], 1);
    book.times("attached again", &back, 1000.0);
    flow.tell(book, &site)?;
    let journal = site.journal()?;
    book.check("numbers, terms and revisions only grow (G2)", journal.records.len(), journal.grows());
    site.down(book)
}

/// The change that a request would have made that was not answered.
type Cut = Option<There>;

/// Asks for a change, with the GCM killed that long after.
fn killed_within(
    site: &mut Site,
    random: &mut fastrand::Rng,
    there: &mut There,
    moment: Duration,
    id: &str,
) -> Result<Cut, String> {
    // One that changes something.
    let (what, said, after) = std::iter::repeat_with(|| any(random))
        .map(|what| (what, there.asked(what)))
        .find_map(|(what, (said, after))| after.map(|after| (what, said, after)))
        .ok_or("nothing can be changed")?;
    let pid = site.gcm.pid();
    let heard = thread::scope(|scope| {
        let until = Instant::now() + moment;
        let killing = scope.spawn(move || {
            spin(until);
            signal_to(pid, Signal::KILL)
        });
        let heard = ask(&site.rpc, 0, what, id);
        killing.join().map_err(|_| "the one who kills panicked".to_owned()).flatten().map(|()| heard)
    })?;
    site.gcm.kill();
    match heard {
        Heard::Said(is, _) if is == said => {
            *there = after;
            Ok(None)
        }
        Heard::Lost => Ok(Some(after)),
        other => Err(format!("{what:?} of {there:?} was answered with {other:?}")),
    }
}

/// The next GCM lists all that was answered, and all or nothing of each request that was lost.
fn settled(
    site: &Site,
    there: &mut There,
    lost: &mut [u64; 2],
    cut: Result<Cut, String>,
) -> Result<(), String> {
    let after = cut?;
    let is = listed(0, &site.rpc.brief()?);
    match after {
        Some(after) if is == after => {
            lost[0] += 1;
            *there = after;
        }
        Some(_) if is == *there => lost[1] += 1,
        None if is == *there => {}
        _ => return Err(format!("{there:?} became {is:?}")),
    }
    agree(&site.rpc, &Desired::now(&site.rpc)?)
}
