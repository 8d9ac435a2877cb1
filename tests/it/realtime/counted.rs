//! What the watchdog tells of steps that are too long, and of one that does not end.
//!
//! Promise: told in time, judged by the cycles that another component executed meanwhile in the same process;
//! counted exactly; the manager answers all the time, and nobody else misses a cycle. Cycles judge what
//! processors were given, so these tests have the machine for themselves.

use serde_json::{Value, json};
use trocar_tests::{Bystander, eventually, number};

use super::phases::Pair;
use super::{Scene, accounts_for_every_period, says};

/// Rounds of which the machine may spoil all but one.
const ROUNDS: usize = 5;
/// Period of the watched component in cycles of the metronome, 1 kHz.
const PERIOD: u64 = 100;

/// A metronome of 1 kHz whose rows reach back 16 s, and a key.
fn beating() -> Scene {
    let scene = Scene::new();
    let metronome = json!({ "rate_hz": 1000, "history": 16_384, "priority": 50 });
    scene.pace("host/metronome", metronome, json!({}));
    scene.grpc.create("host/key", "key", json!({}));
    scene.grpc.start("host/key");
    scene.until("host/metronome", "steps", 1);
    scene
}

/// `host/p` with a period of 100 ms beside it.
fn watched(slow_periods: f64) -> Scene {
    let scene = beating();
    scene.pace("host/p", json!({ "rate_hz": 10 }), json!({ "slow_periods": slow_periods }));
    scene.until("host/p", "steps", 1);
    scene
}

impl Scene {
    /// Steps the metronome had executed at this time.
    fn beats(&self, at_ns: u64) -> u64 {
        let row =
            self.ask("host/metronome", "nearest_ns", at_ns).unwrap_or_else(|e| panic!("{at_ns} ns: {e}"));
        number(&row["json"]["steps"])
    }

    /// Waits until a slow step and the one after it are over; answers when the slow one began and the next
    /// one did, ns.
    fn after_slow(&self, slow_steps: u64) -> (u64, u64) {
        let row = eventually("the step after the slow one", || {
            let row = self.newest("host/p")["json"].clone();
            let over = number(&row["next_began_ns"]) != 0 && number(&row["late"]) >= slow_steps;
            if over { Ok(row) } else { Err(row) }
        });
        (number(&row["slow_began_ns"]), number(&row["next_began_ns"]))
    }

    /// Lets a step hang until it is told, and go on again; what was told, when, and when the step began, ns.
    fn hang_once(&self, path: &str) -> (String, u64, u64) {
        let before = self.count(path, "slow_began_ns");
        let mut events = self.follow(path, "warning");
        self.grpc.invoke(&format!("{path}/ctl/hang"), Value::Null);
        let told = events.until("the hang", |item| says(item, "it has not come back out of its step"));
        self.grpc.invoke("host/key/ctl/release", Value::Null);
        let began_ns = eventually("the step is over", || match self.count(path, "slow_began_ns") {
            now if now == before => Err(self.newest(path)),
            now => Ok(now),
        });
        self.until_health(path, "OK");
        (told["json"].to_string(), number(&told["stampNs"]), began_ns)
    }
}

#[test]
fn an_overrun_is_told_within_the_period_after_it_and_before_the_next_cycle() {
    let scene = watched(2.5);
    let words = "a cycle takes longer than its period (100 ms)";
    let mut rounds = Vec::new();
    for round in 1..=ROUNDS {
        scene.until_health("host/p", "OK");
        let mut events = scene.follow("host/p", "warning");
        scene.grpc.invoke("host/p/ctl/slow", json!(1));
        let told_ns = number(&events.until(words, |item| says(item, words))["stampNs"]);
        let (began_ns, next_ns) = scene.after_slow(round as u64);
        assert!(
            told_ns > began_ns + PERIOD * 1_000_000,
            "not before it took longer: {told_ns} of {began_ns}"
        );
        let beats = scene.beats(told_ns) - scene.beats(began_ns);
        let good = told_ns < next_ns && beats <= 2 * PERIOD;
        rounds.push(format!(
            "told after {beats} cycles of 1 ms, the next step {} ns later",
            next_ns as i64 - told_ns as i64
        ));
        if good {
            return;
        }
    }
    panic!("an overrun is not told within one period:\n{}", rounds.join("\n"));
}

#[test]
fn a_hang_is_unresponsive_within_five_periods_and_the_manager_answers_all_the_while() {
    let scene = watched(1.5);
    let words = "it has not come back out of its step, which may take 500 ms";
    let mut rounds = Vec::new();
    for round in 1..=ROUNDS {
        scene.until_health("host/p", "OK");
        let executed = number(&scene.stats("host/p")["executed"]);
        let mut events = scene.follow("host/p", "warning");
        scene.grpc.invoke("host/p/ctl/hang", Value::Null);
        let told_ns = number(&events.until(words, |item| says(item, words))["stampNs"]);

        let stuck = scene.grpc.component("host/p");
        assert_eq!(stuck["health"], "HEALTH_UNRESPONSIVE", "{stuck}");
        assert_eq!(
            stuck["state"], "COMPONENT_STATE_ACTIVE",
            "it moves nothing, so it is not in FAULT: {stuck}"
        );
        assert!(number(&stuck["stats"]["executed"]) >= executed, "{stuck}");
        assert_eq!(scene.listed("host/p")["health"], "HEALTH_UNRESPONSIVE");
        let stands = scene.newest("host/p");
        scene.grpc.ok("GcmService/Describe", json!({ "path": "host/p/ctl/poke" }));
        let other = format!("host/other-{round}");
        scene.pace(&other, json!({ "rate_hz": 100 }), json!({}));
        scene.until(&other, "steps", 5);
        scene.grpc.ok("GcmService/Remove", json!({ "path": other, "force": true }));
        assert_eq!(scene.newest("host/p")["seq"], stands["seq"], "it published nothing meanwhile");

        scene.grpc.invoke("host/key/ctl/release", Value::Null);
        let (began_ns, _) = scene.after_slow(round as u64);
        assert!(told_ns > began_ns + 4 * PERIOD * 1_000_000, "not long before: {told_ns} of {began_ns}");
        let beats = scene.beats(told_ns) - scene.beats(began_ns);
        rounds.push(format!("told after {beats} cycles of 1 ms"));
        if beats <= 5 * PERIOD {
            scene.until_health("host/p", "OK");
            return;
        }
    }
    panic!("a hang is not told within five periods:\n{}", rounds.join("\n"));
}

#[test]
fn what_a_step_may_take_is_five_periods_or_50_ms_and_without_a_period_its_max_step() {
    let scene = beating();
    let on_signal = |max_step: &str| json!({ "model": "on_signal", "max_step": max_step });
    let cases = [
        (json!({ "rate_hz": 200 }), 50),
        (json!({ "rate_hz": 90 }), 55),
        (json!({ "rate_hz": 25 }), 200),
        (json!({ "model": "on_signal" }), 50),
        (on_signal("0.02s"), 20),
        (on_signal("0.12s"), 120),
    ];
    for (n, (execution, allowed_ms)) in cases.into_iter().enumerate() {
        let path = format!("host/p-{n}");
        scene.pace(&path, execution.clone(), json!({}));
        scene.until_health(&path, "OK");
        let mut rounds = Vec::new();
        let in_time = (0..ROUNDS).any(|_| {
            let (said, told_ns, began_ns) = scene.hang_once(&path);
            // 90 Hz: five periods are 55.556 ms.
            assert!(said.contains(&format!("its step, which may take {allowed_ms}")), "{execution}: {said}");
            let ahead_ns = (allowed_ms * 20_000).min(1_000_000);
            let least_ns = began_ns + allowed_ms * 1_000_000 - ahead_ns;
            assert!(told_ns >= least_ns, "{execution}, not before: {told_ns} of {began_ns}");
            let beats = scene.beats(told_ns) - scene.beats(began_ns);
            rounds.push(format!("told after {beats} cycles of 1 ms"));
            beats <= allowed_ms + 1
        });
        assert!(in_time, "{execution}: not told within {allowed_ms} ms:\n{}", rounds.join("\n"));
        scene.grpc.ok("GcmService/Remove", json!({ "path": path, "force": true }));
    }
}

#[test]
fn overruns_by_half_a_period_and_by_nine_are_counted_exactly_and_nobody_else_misses_a_cycle() {
    for (slow_periods, times) in [(1.5, 6), (10.0, 3)] {
        let scene = Scene::new();
        let bystander = Bystander::start(&scene.grpc, "s");
        let mut slow = 0;
        scene.pace("host/p", json!({ "rate_hz": 20 }), json!({ "slow_periods": slow_periods }));
        bystander.undisturbed_by(&format!("steps of {slow_periods} periods"), || {
            for _ in 0..times {
                slow += 1;
                scene.grpc.invoke("host/p/ctl/slow", json!(1));
                scene.until("host/p", "late", slow);
                scene.until_health("host/p", "OVERRUN");
            }
        });
        scene.until_health("host/p", "OK");
        scene.grpc.stop("host/p");
        accounts_for_every_period(&scene, "host/p");
        let row = scene.newest("host/p")["json"].clone();
        let (overruns, late, perhaps) =
            (number(&scene.stats("host/p")["overruns"]), number(&row["late"]), number(&row["perhaps_late"]));
        // The host reads its clock a moment after the component; only in a moment of the machine's do they
        // differ.
        assert!(overruns >= late && overruns <= perhaps, "{late} to {perhaps} were late: {overruns}, {row}");
        assert!(late >= slow, "{slow} slow steps: {row}");
        let skipped = number(&scene.stats("host/p")["skipped"]);
        let least = slow * (slow_periods as u64).saturating_sub(1);
        assert!(skipped >= least, "each left out {} at least: {skipped}", slow_periods as u64 - 1);
    }
}

#[test]
fn a_step_of_ten_periods_of_what_moves_nothing_is_overrun_then_unresponsive_then_well_again() {
    let scene = watched(10.0);
    let mut events = scene.follow("host/p", "warning");
    let mut well = scene.follow("host/p", "status");
    scene.grpc.invoke("host/p/ctl/slow", json!(1));
    let overrun = events.until("the overrun", |item| says(item, "a cycle takes longer than its period"));
    let stuck = events.until("the hang", |item| says(item, "it has not come back out of its step"));
    let again = well.until("its end", |item| says(item, "recovered"));
    let stamps = [overrun, stuck, again].map(|item| number(&item["stampNs"]));
    assert!(stamps.is_sorted(), "in this order: {stamps:?}");
    let (began_ns, next_ns) = scene.after_slow(1);
    assert!(began_ns < stamps[0] && stamps[1] < next_ns, "both while it lasted: {stamps:?}");
    assert_eq!(scene.grpc.state("host/p"), "ACTIVE", "what moves nothing is not in FAULT");
}

#[test]
fn a_hang_costs_nobody_else_a_cycle_and_every_period_of_it_is_skipped() {
    let scene = Scene::new();
    let bystander = Bystander::start(&scene.grpc, "s");
    scene.pace("host/p", json!({ "rate_hz": 200 }), json!({}));
    scene.grpc.create("host/key", "key", json!({}));
    scene.grpc.start("host/key");
    bystander.undisturbed_by("a hang and its end", || {
        let (said, ..) = scene.hang_once("host/p");
        assert!(said.contains("its step, which may take 50 ms"), "five periods are 25 ms: {said}");
    });
    scene.grpc.stop("host/p");
    accounts_for_every_period(&scene, "host/p");
    let stats = scene.stats("host/p");
    // 50 ms without progress are ten periods of 5 ms.
    assert!(number(&stats["skipped"]) >= 8 && number(&stats["overruns"]) >= 1, "{stats}");
    assert!(scene.host.printed().contains("host/p"), "the log names it");
}

/// Samples that are looked at, of each connection.
const SAMPLES: u64 = 5_000;

#[test]
fn two_components_of_one_rate_lose_no_more_than_two_that_were_set_half_a_period_apart() {
    let pair = Pair::new();
    let at = |phase: &str| json!({ "phase": phase });
    pair.add(1, json!({}), json!({}));
    pair.add(2, at("0s"), at("0.0005s"));
    let figures = |n: u32| {
        let list = pair.grpc.ok("GcmService/List", json!({}));
        let all = list["connections"].as_array().cloned().unwrap_or_default();
        let client = format!("host/sensor{n}/tip");
        let one = all.into_iter().find(|c| c["client"] == client.as_str()).unwrap();
        ["passed", "skipped", "dropped"].map(|field| number(&one[field]))
    };
    // A round in which the machine was taken away tells nothing.
    let rounds = (0..ROUNDS).map(|_| {
        let before = [1, 2].map(figures);
        eventually("samples pass", || match [1, 2].map(figures) {
            now if (0..2).all(|i| now[i][0] >= before[i][0] + SAMPLES) => Ok(()),
            now => Err(format!("{now:?}")),
        });
        let after = [1, 2].map(figures);
        [0, 1].map(|i| after[i][1] + after[i][2] - before[i][1] - before[i][2])
    });
    let rounds: Vec<[u64; 2]> = rounds.collect();
    let beyond = |[auto, control]: &[u64; 2]| auto.saturating_sub(*control) <= SAMPLES / 50;
    assert!(rounds.iter().any(beyond), "lost of {SAMPLES}, beside half a period: {rounds:?}");
}
