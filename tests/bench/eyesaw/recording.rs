//! The canonical load while it is recorded: video, 4000 A-scans a second, a robot of 1 kHz that scans, all
//! events and commands.
//!
//! Invariant: what a recorder costs whom it records is the time of their steps with it beside that without,
//! in one running system, turn and turn about: without is nothing connected and the recorder standing still.
//! Each stretch is compared with the one beside it, and the median of all pairs is judged: a second in which
//! the machine did something else is one pair. All stretches of a kind taken together are told beside it:
//! there such a second is all that is seen. Whose steps take microseconds runs on a processor that the disk
//! does not interrupt. Told, too, is what the same bytes cost them when a program does nothing but write
//! them, through the page cache: last, for that has held the robot up for so long that a scan was given up.

use std::thread;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use trocar_tests::eventually;

use super::bare::BareWriter;
use super::control::stolen_s;
use super::disk;
use super::plan::{Plan, RECORDER};
use super::rig::{OFFSET_M, Rig, is_phase, world};
use super::verdicts::{Unit, Verdicts};
use crate::lab::as_number;
use crate::table::median;

/// Those whose steps are timed, beside the stream of A-scans.
const TIMED: [&str; 3] = ["host/camera", "robot/robot", "host/bscan"];
/// Outputs that are recorded, how many samples may wait, and how many come in a second at least; events and
/// commands come as they do.
const OUTPUTS: [(&str, usize, f64); 8] = [
    ("host/camera/image", 64, 30.0),
    ("oct/source/spectra", 64, 1000.0),
    ("oct/ascan/ascan", 64, 1000.0),
    ("oct/surface/distance", 4096, 4000.0),
    ("robot/robot/tap_rows", 512, 1000.0),
    ("robot/robot/tap_commands", 512, 0.0),
    ("robot/robot/tap_events", 512, 0.0),
    ("host/bscan/tap_events", 512, 0.0),
];
/// Its step's thread and its writer's.
const THREADS: &str = "rec";
const SLOWER: f64 = 0.05;
const OF_A_CORE: f64 = 0.35;
/// Of what is to come, what comes at least: the file begins and ends some cycles beside the run.
const AT_LEAST: f64 = 0.9;
const BITS_PER_S: f64 = 1e9;
/// With and without take turns so often, each of them, so that a machine that becomes slower is so for both.
const ROUNDS: u64 = 20;
/// Stretches beside a [`BareWriter`].
const BARE_ROUNDS: u64 = 5;
/// The scan is longer than all of it by so much, s; and by so much for each change from one to the other.
const SPARE_S: f64 = 20.0;
const CHANGE_S: f64 = 3.0;
const LINE_M: f64 = 0.003;
/// After a change, until times are taken.
const SETTLE: Duration = Duration::from_millis(500);

/// What a stretch is: whose times are kept apart.
#[derive(Clone, Copy)]
enum Stretch {
    /// Whatever is not judged.
    Aside,
    /// Without a recorder, and with one, in this round.
    Without(u64),
    With(u64),
    /// Beside a [`BareWriter`].
    Beside,
    /// All without, and all with one.
    AllWithout,
    AllWith,
}

impl Stretch {
    /// Its account at the ledgers.
    fn account(self) -> u64 {
        match self {
            Stretch::Aside => 0,
            Stretch::Beside => 1,
            Stretch::Without(round) => 2 + 2 * round,
            Stretch::With(round) => 3 + 2 * round,
            Stretch::AllWithout => 2 + 2 * ROUNDS,
            Stretch::AllWith => 3 + 2 * ROUNDS,
        }
    }
}

/// Times of steps in a stretch, ns, in the order of [`TIMED`] and then that of one A-scan: percentile 99 and
/// median.
struct Times {
    p99: Vec<f64>,
    p50: Vec<f64>,
}

impl Times {
    fn of(&self, what: &str, at: usize) -> f64 {
        if what == "p99" { self.p99[at] } else { self.p50[at] }
    }
}

pub(super) fn measure(verdicts: &mut Verdicts, seconds: u64) {
    let world = world();
    let directory = world.path("");
    let plan = Plan::new().with_accounts().without_rest().with_steps_timed(&TIMED).recorder(&directory);
    let plan = plan.placed(disk::interrupted_processor(&directory));
    let rig = Rig::up(world, plan);
    rig.await_active("host/camera");
    rig.run(RECORDER, "Stop");
    let changes = (2 * ROUNDS + BARE_ROUNDS) as f64;
    let all_s = (4 * seconds) as f64 + changes * CHANGE_S + SPARE_S;
    let scan_m_s = LINE_M / all_s;
    rig.scan_of(LINE_M, scan_m_s, 1.0);
    rig.call("oct/ledger", "ledger/clear", json!(OFFSET_M));

    verdicts.title(&format!("Canonical load recorded for {seconds} s, three processes"));
    turn_to(&rig, Stretch::Aside);
    let bytes_per_s = recorded(verdicts, &rig, seconds);
    let scans = goes_on(&rig, scan_m_s);
    verdicts.at_least("scans that went on all the while", f64::from(u8::from(scans)), 1.0, Unit::Count);

    verdicts.title(&format!("Steps with and without a recorder, {ROUNDS} times {} s each", each_s(seconds)));
    let mut turns = Turns { scan_m_s, ..Turns::default() };
    (0..ROUNDS).for_each(|round| turns.take(&rig, round, each_s(seconds)));
    let bare = directory.join("bare");
    for _ in 0..BARE_ROUNDS {
        let _writes = BareWriter::begin(&bare, bytes_per_s);
        turns.stretch(&rig, Stretch::Beside, each_s(seconds));
    }
    compare(verdicts, &rig);
    verdicts.at_most("samples lost in these recordings", turns.lost, 0.0, 0.0, Unit::Count);
    let all_s = (ROUNDS * each_s(seconds)) as f64;
    let taken = "taken by the machine's host, of a core, recorded; beside it not recorded";
    let [without, with, beside] = turns.of;
    verdicts.tell(taken, with.stolen_s / all_s, Some(without.stolen_s / all_s), Unit::Share);
    let given_up = "scans given up, recorded; beside it not recorded";
    verdicts.at_most(given_up, with.given_up, 0.0, without.given_up, Unit::Count);
    let given_up = "scans given up beside the program that only writes";
    verdicts.tell(given_up, beside.given_up, None, Unit::Count);
    for path in ["robot/robot", "host/bscan"] {
        let skipped = rig.work(path).skipped;
        verdicts.tell(&format!("periods that {path} left out in all of it"), skipped, None, Unit::Count);
    }
    rig.end();
}

fn each_s(seconds: u64) -> u64 {
    seconds.div_ceil(ROUNDS).max(1)
}

/// What came of all stretches of a kind.
#[derive(Clone, Copy, Default)]
struct Of {
    /// Of the processors by the machine's host, s.
    stolen_s: f64,
    /// Scans.
    given_up: f64,
}

/// What came of all turns.
#[derive(Default)]
struct Turns {
    scan_m_s: f64,
    lost: f64,
    /// Without a recorder, with one, beside a [`BareWriter`].
    of: [Of; 3],
}

impl Turns {
    /// The times of so many seconds go to that account. Where the scan was given up meanwhile another one is
    /// begun.
    fn stretch(&mut self, rig: &Rig, stretch: Stretch, seconds: u64) {
        thread::sleep(SETTLE);
        turn_to(rig, stretch);
        let stolen = stolen_s();
        thread::sleep(Duration::from_secs(seconds));
        let stolen = stolen_s() - stolen;
        turn_to(rig, Stretch::Aside);
        let of = &mut self.of[match stretch {
            Stretch::With(_) => 1,
            Stretch::Beside => 2,
            _ => 0,
        }];
        of.stolen_s += stolen;
        of.given_up += f64::from(u8::from(!goes_on(rig, self.scan_m_s)));
    }

    /// A stretch without and one with it, or the other way round.
    fn take(&mut self, rig: &Rig, round: u64, seconds: u64) {
        // Each comes first as often as last.
        let forth = round.is_multiple_of(2);
        if forth {
            self.stretch(rig, Stretch::Without(round), seconds);
        }
        let recording = Recording::begin(rig, &format!("round{round}.mcap"));
        self.stretch(rig, Stretch::With(round), seconds);
        let (lost, dropped, _) = recording.end();
        self.lost += lost + dropped;
        if !forth {
            self.stretch(rig, Stretch::Without(round), seconds);
        }
    }
}

/// Whether the scan still goes on; where it was given up another one is begun.
fn goes_on(rig: &Rig, scan_m_s: f64) -> bool {
    let goes_on = is_phase(&rig.progress(), "SCAN", 2);
    if !goes_on {
        rig.scan_of(LINE_M, scan_m_s, 1.0);
    }
    goes_on
}

/// The components that keep the times.
fn ledgers() -> impl Iterator<Item = String> {
    TIMED.iter().map(|path| format!("{path}-ends")).chain(["oct/ledger".to_owned()])
}

fn turn_to(rig: &Rig, stretch: Stretch) {
    ledgers().for_each(|path| drop(rig.call(&path, "ledger/account", json!(stretch.account()))));
}

fn times(rig: &Rig, stretch: Stretch) -> Times {
    turn_to(rig, stretch);
    let figures: Vec<Value> = ledgers().map(|path| rig.call(&path, "ledger/figures", Value::Null)).collect();
    let all = |key: &str| figures.iter().map(|figures| as_number(&figures[key])).collect();
    Times { p99: all("p99"), p50: all("p50") }
}

/// Of all these stretches together, which hold nothing afterwards.
fn together(rig: &Rig, stretch: Stretch, of: impl Fn(u64) -> Stretch) -> Times {
    turn_to(rig, stretch);
    for path in ledgers() {
        for round in 0..ROUNDS {
            rig.call(&path, "ledger/gather", json!(of(round).account()));
        }
    }
    times(rig, stretch)
}

fn compare(verdicts: &mut Verdicts, rig: &Rig) {
    let pairs: Vec<[Times; 2]> = (0..ROUNDS)
        .map(|round| [Stretch::Without(round), Stretch::With(round)].map(|stretch| times(rig, stretch)))
        .collect();
    let beside = times(rig, Stretch::Beside);
    let all_without = together(rig, Stretch::AllWithout, Stretch::Without);
    let all_with = together(rig, Stretch::AllWith, Stretch::With);
    let names = TIMED.iter().map(|path| format!("step of {path}")).chain(["time of one A-scan".into()]);
    for (at, name) in names.enumerate() {
        for what in ["p99", "p50"] {
            let all = |side: usize| pairs.iter().map(move |pair| pair[side].of(what, at));
            let longer = median(all(1).zip(all(0)).map(|(with, without)| with / without - 1.0).collect());
            // What stretches without one differ by, each from that of the round before.
            let control = all(0).skip(1).zip(all(0)).map(|(now, before)| (now / before - 1.0).abs());
            let control = median(control.collect());
            let (with, without) = (median(all(1).collect()), median(all(0).collect()));
            let by = format!("{name}, {what}, longer by");
            match what {
                "p99" => verdicts.at_most(&by, longer, SLOWER, 0.0, Unit::Share),
                _ => verdicts.tell(&by, longer, Some(control), Unit::Share),
            }
            verdicts.tell(
                &format!("{name}, {what}, recorded; beside it not recorded"),
                with,
                Some(without),
                Unit::Ns,
            );
            if what == "p99" {
                let means = all(1).sum::<f64>() / all(0).sum::<f64>() - 1.0;
                let by = format!(
                    "{name}, {what}, longer by, of the means; beside it what neighbours without differ by"
                );
                verdicts.tell(&by, means, Some(control), Unit::Share);
            }
            let by = format!("{name}, {what}, longer by, of all stretches together");
            verdicts.tell(&by, all_with.of(what, at) / all_without.of(what, at) - 1.0, None, Unit::Share);
            let bare = format!("{name}, {what}, longer by, beside a program that only writes the bytes");
            verdicts.tell(&bare, beside.of(what, at) / without - 1.0, None, Unit::Share);
        }
    }
}

/// A recording that goes on, of all [`OUTPUTS`].
struct Recording<'r> {
    rig: &'r Rig,
    file: String,
    /// Samples its queues had dropped when it began: those that came between the connection and that moment,
    /// which are no loss of it.
    dropped: Vec<f64>,
}

impl<'r> Recording<'r> {
    fn begin(rig: &'r Rig, file: &str) -> Recording<'r> {
        rig.run(RECORDER, "Start");
        for (at, (output, fifo, _)) in OUTPUTS.iter().enumerate() {
            rig.connect(&format!("{RECORDER}/in_{}", at + 1), output, *fifo);
        }
        let recording = Recording { rig, file: file.to_owned(), dropped: Vec::new() };
        recording.ctl("start", json!({ "path": file, "delay": 0, "duration": 0 }));
        eventually("it records", || {
            let status = recording.ctl("status", Value::Null);
            if as_number(&status["messages"]) > 0.0 { Ok(()) } else { Err(status.to_string()) }
        });
        Recording { dropped: recording.drops(), ..recording }
    }

    fn ctl(&self, member: &str, arg: Value) -> Value {
        self.rig.call(RECORDER, &format!("ctl/{member}"), arg)
    }

    fn drops(&self) -> Vec<f64> {
        (1..=OUTPUTS.len()).map(|n| self.rig.dropped(&format!("{RECORDER}/in_{n}"))).collect()
    }

    /// Closes its file, and leaves nothing of it: samples lost as the recorder counts, samples its queues
    /// dropped, whether it was whole.
    fn end(self) -> (f64, f64, bool) {
        self.ctl("stop", Value::Null);
        let last = eventually("its file is closed", || {
            let last = self.ctl("last", Value::Null);
            let closed = last["path"].as_str().is_some_and(|path| path.ends_with(&self.file));
            if closed { Ok(last) } else { Err(last.to_string()) }
        });
        let dropped = self.drops().iter().zip(&self.dropped).map(|(after, before)| after - before).sum();
        self.rig.run(RECORDER, "Stop");
        for (at, (output, ..)) in OUTPUTS.iter().enumerate() {
            self.rig.disconnect(&format!("{RECORDER}/in_{}", at + 1), output);
        }
        let path = last["path"].as_str().unwrap_or_default();
        std::fs::remove_file(path).unwrap_or_else(|e| panic!("{path}: {e}"));
        (as_number(&last["lost"]), dropped, last["whole"] == true)
    }
}

/// One recording of so many seconds; the bytes it writes in a second.
fn recorded(verdicts: &mut Verdicts, rig: &Rig, seconds: u64) -> f64 {
    let recording = Recording::begin(rig, "load.mcap");
    let spent_s = rig.processor_s("host", THREADS);
    let begun = (Instant::now(), as_number(&recording.ctl("status", Value::Null)["bytes"]));
    thread::sleep(Duration::from_secs(seconds));
    let took_s = begun.0.elapsed().as_secs_f64();
    let spent_s = rig.processor_s("host", THREADS) - spent_s;
    let bytes = as_number(&recording.ctl("status", Value::Null)["bytes"]) - begun.1;
    for (at, (output, _, rate)) in OUTPUTS.iter().enumerate() {
        let kept = as_number(&recording.ctl("topic", json!(at))["kept"]);
        let what = format!("{output} in the file");
        match *rate > 0.0 {
            true => verdicts.at_least(&what, kept, AT_LEAST * rate * seconds as f64, Unit::Count),
            false => verdicts.tell(&what, kept, None, Unit::Count),
        }
    }
    let (lost, dropped, whole) = recording.end();
    verdicts.at_most("samples lost, as the recorder counts", lost, 0.0, 0.0, Unit::Count);
    verdicts.at_most("samples its full queues dropped", dropped, 0.0, 0.0, Unit::Count);
    verdicts.at_least("its file is whole", f64::from(u8::from(whole)), 1.0, Unit::Count);
    let what = "processor of the recorder's threads, of a core";
    verdicts.at_most(what, spent_s / took_s, OF_A_CORE, 0.0, Unit::Share);
    verdicts.at_least("bits written", 8.0 * bytes / took_s, BITS_PER_S, Unit::PerSecond);
    bytes / took_s
}
