//! Every process, component, connection and port of a system, seen live from outside.

use std::io::{BufRead, BufReader, Lines, Read};
use std::process::{Child, ChildStdout, Command, Stdio};

use serde_json::{Value, json};
use trocar_tests::{Built, eventually};

use super::TWO;
use super::system::{System, kill, pid};

pub(super) fn objects(text: &str) -> Vec<Value> {
    text.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|e| panic!("{e}: {line}"))).collect()
}

pub(super) fn row<'a>(figures: &'a Value, part: &str, key: &str, name: &str) -> &'a Value {
    let rows = figures[part].as_array().unwrap();
    rows.iter().find(|r| r[key] == name).unwrap_or_else(|| panic!("no {name} in {figures}"))
}

/// A source at 1 kHz, an actuator that is too slow for its period, streams, commands and events between three
/// processes.
const THREE: &str = r#"{
  "version": 1,
  "processes": {
    "left": { "plugins": ["plugins"] }, "middle": { "plugins": ["plugins"] }, "right": { "plugins": ["plugins"] }
  },
  "components": {
    "left/s": { "class": "sine/sine" },
    "middle/server": { "class": "example/Server" },
    "middle/late": { "class": "chaos", "config": { "slow_step_ms": 150 }, "execution": { "rate_hz": 10 } },
    "right/e": { "class": "echo" },
    "right/slow": { "class": "echo", "execution": { "model": "periodic", "rate_hz": 5 } },
    "right/client": { "class": "example/Client" }
  },
  "connections": [
    { "client": "right/e/sample", "server": "left/s/value" },
    { "client": "right/slow/sample", "server": "left/s/value", "queue": { "fifo": 2 } },
    { "client": "right/client/Required", "server": "middle/server/Provided" }
  ]
}"#;

pub(super) fn three() -> System {
    System::up_with(&["sine", "example", "fixture_echo", "fixture_chaos"], THREE, &[])
}

/// The figures of `trocar top` over two intervals.
pub(super) fn top(system: &System, of: &str) -> [Value; 2] {
    let mut args = vec!["top"];
    args.extend(Some(of).filter(|of| !of.is_empty()));
    args.extend(["--json", "-n", "2", "--interval", "0.4s"]);
    let top = system.trocar().run(&args).ends_with(0);
    objects(&top.stdout).try_into().unwrap_or_else(|_| panic!("one object for each interval: {top:#?}"))
}

pub(super) fn number(row: &Value, figure: &str) -> f64 {
    row[figure].as_f64().unwrap_or_else(|| panic!("no figure {figure}: {row}"))
}

/// The figures of an interval in which all components of `three` have stepped.
pub(super) fn stepped(three: &System) -> Value {
    let [_, last] = eventually("all have stepped in an interval", || {
        let figures = top(three, "");
        let rows = figures[1]["components"].as_array().unwrap();
        let all = rows.len() == 6
            && rows.iter().all(|c| c["path"] == "middle/server" || c["rate_hz"].as_f64() > Some(0.0));
        let late = row(&figures[1], "components", "path", "middle/late");
        if all && late["overruns_now"].as_u64() > Some(0) { Ok(figures) } else { Err(figures[1].to_string()) }
    });
    last
}

#[test]
fn top_tells_every_figure_of_every_component_of_every_process() {
    let three = three();
    let last = stepped(&three);
    let listed = three.list();
    for name in ["left", "middle", "right"] {
        let (process, told) = (row(&last, "processes", "name", name), three.host(name));
        assert_eq!((&process["state"], &process["restarts"]), (&json!("ATTACHED"), &json!(0)), "{process}");
        assert_eq!((process["pid"].as_u64(), process["last_exit"].as_str()), (Some(pid(&told)), Some("")));
        assert_eq!(process["epoch"].as_u64(), Some(trocar_tests::number(&told["epoch"])), "{process}");
        let here = listed["components"].as_array().unwrap().iter();
        let here = here.filter(|c| c["path"].as_str().unwrap().starts_with(&format!("{name}/"))).count();
        assert_eq!(process["components"].as_u64(), Some(here as u64), "{process}");
        assert!(number(process, "load") > 0.0, "{process}");
    }
    for path in ["left/s", "middle/late", "middle/server", "right/e", "right/slow", "right/client"] {
        let c = row(&last, "components", "path", path);
        assert_eq!((&c["state"], &c["fault"]), (&json!("ACTIVE"), &json!("")), "{c}");
        // What is late on a busy machine says so.
        assert!(["OK", "OVERRUN"].contains(&c["health"].as_str().unwrap()), "{c}");
        assert!(number(c, "load") >= 0.0, "{c}");
        assert!(number(c, "lateness_p99_ns") >= number(c, "lateness_p50_ns"), "{c}");
        for counter in ["skipped", "overruns"] {
            assert!(number(c, counter) >= number(c, &format!("{counter}_now")), "{counter}: {c}");
        }
    }
    let late = row(&last, "components", "path", "middle/late");
    assert_eq!(late["health"], "OVERRUN", "150 ms of work each 100 ms: {late}");
    assert!(number(late, "overruns") > 0.0 && number(late, "overruns_now") > 0.0, "{late}");
    let s = row(&last, "components", "path", "left/s");
    assert!(number(s, "load") > 0.0, "{s}");
}

#[test]
fn top_tells_every_figure_of_every_connection_between_processes() {
    let three = three();
    let clients = ["right/e/sample", "right/slow/sample", "right/client/Required"];
    let last = eventually("all are flowing", || {
        let [_, last] = top(&three, "");
        let rows = last["connections"].as_array().unwrap();
        let flows = rows.len() == 3 && rows.iter().all(|c| c["rate_hz"].as_f64() > Some(0.0));
        if flows { Ok(last) } else { Err(last.to_string()) }
    });
    for client in clients {
        let c = row(&last, "connections", "client", client);
        assert_eq!((&c["carrier"], &c["linked"]), (&json!("memfd"), &json!(true)), "{c}");
        assert!(number(c, "bytes_per_s") >= 0.0, "{c}");
        // It is of samples.
        assert_eq!(number(c, "latency_p50_ns") > 0.0, client.ends_with("/sample"), "{c}");
        assert!(number(c, "latency_p99_ns") >= number(c, "latency_p50_ns"), "{c}");
        for counter in ["dropped", "rejected", "failed"] {
            assert!(number(c, counter) >= number(c, &format!("{counter}_now")), "{counter}: {c}");
        }
    }
    let stream = row(&last, "connections", "client", "right/e/sample");
    assert_eq!(stream["server"], "left/s/value", "{stream}");
    // A Scalar is 16 bytes.
    let per_sample = number(stream, "bytes_per_s") / number(stream, "rate_hz");
    assert!((per_sample - 16.0).abs() < 0.01, "{stream}");
    // Two of a thousand in a second fit into its queue each time it looks, which is five times.
    let slow = row(&last, "connections", "client", "right/slow/sample");
    assert!(number(slow, "dropped") > 0.0 && number(slow, "dropped_now") > 0.0, "{slow}");
    let listed = three.list();
    let now = row(&listed, "connections", "client", "right/slow/sample");
    assert!(
        trocar_tests::number(&now["dropped"]) as f64 >= number(slow, "dropped"),
        "the same count: {now} {slow}"
    );
}

#[test]
fn top_shows_a_part_and_one_text_for_pipes() {
    let three = three();
    let [_, left] = top(&three, "left");
    let names = |part: &str, key: &str| {
        let rows = left[part].as_array().unwrap().iter();
        rows.map(|r| r[key].as_str().unwrap().to_owned()).collect::<Vec<_>>()
    };
    assert_eq!(
        (names("processes", "name"), names("components", "path")),
        (vec!["left".into()], vec!["left/s".into()])
    );
    let text = three.trocar().run(&["top", "-n", "1", "--interval", "0.1s", "--sort", "rate"]).ends_with(0);
    let text = text.says("left/s").says("right/client").says("PROCESS").says("CONNECTION").says("memfd");
    assert!(!text.stdout.contains('\u{1b}'), "no terminal, no escape codes: {text:#?}");
    three.trocar().run(&["top", "nobody", "-n", "1"]).ends_with(1).says("nobody");
}

#[test]
fn top_shows_a_restart_and_counts_what_was_made_anew_from_zero() {
    let two = System::up(TWO, &[]);
    let before = two.host("right");
    kill("-KILL", pid(&before));
    two.await_back("right", &before);
    let top = two.trocar().run(&["top", "--json", "-n", "1", "--interval", "0.2s"]).ends_with(0);
    let figures = &objects(&top.stdout)[0];
    let right = row(figures, "processes", "name", "right");
    assert_eq!(
        (right["restarts"].as_u64(), right["last_exit"].as_str()),
        (Some(1), Some("was killed by SIGKILL"))
    );
    let actuator = row(figures, "components", "path", "right/c");
    assert_eq!(
        (actuator["state"].as_str(), actuator["rate_hz"].as_f64()),
        (Some("STOPPED{restarted}"), Some(0.0))
    );
}

#[test]
fn echo_and_hz_follow_ports_of_several_processes_at_once() {
    let two = System::up(TWO, &[]);
    // Within so many samples of one port the other one may not come to its turn.
    eventually("both are followed", || {
        let ports = ["left/s/value", "right/s/value"];
        let echo = two.trocar().run(&["echo", ports[0], ports[1], "--json", "-n", "40"]).ends_with(0);
        let from = ports.map(|path| objects(&echo.stdout).iter().filter(|item| item["path"] == path).count());
        assert_eq!(from.iter().sum::<usize>(), 40, "nothing else: {echo:#?}");
        if from.contains(&0) { Err(format!("{from:?}")) } else { Ok(()) }
    });
    let hz = eventually("both are measured", || {
        let hz = two.trocar().run(&["hz", "left/s/value", "right/s/value", "--json", "-n", "1"]).ends_with(0);
        let lines = objects(&hz.stdout);
        if lines.iter().all(|l| l["seen"].as_u64() > Some(2)) { Ok(lines) } else { Err(format!("{hz:#?}")) }
    });
    for line in &hz {
        let (seen, sent) = (line["seen"].as_u64().unwrap(), line["sent"].as_u64().unwrap());
        assert!(line["rate_hz"].as_f64().is_some_and(|hz| hz > 0.0), "{line}");
        assert!(seen <= sent, "what was not seen is counted: {line}");
    }
}

#[test]
fn ports_that_are_not_there_are_refused_with_what_is() {
    let two = System::up(TWO, &[]);
    for verb in ["hz", "echo"] {
        let ask = |path: &str| two.trocar().run(&[verb, path, "-n", "1"]);
        ask("left/s/valeu").ends_with(1).says("did you mean `value`");
        ask("left/nobody/value").ends_with(1).says("left/s");
        ask("nobody/s/value").ends_with(1).says("there are left, right");
        ask("left//value").ends_with(1).says("is not a path");
        two.trocar().run(&[verb, "left/s/value", "left/s/valeu", "-n", "1"]).ends_with(1).says("valeu");
    }
    two.trocar().run(&["hz", "left/s"]).ends_with(2).says("trocar describe left/s");
}

#[test]
fn a_port_of_a_stopped_component_is_silent_and_one_of_a_lost_process_is_refused() {
    let never = TWO.replacen("\"right\": {", "\"right\": { \"restart\": \"never\",", 1);
    let two = System::up(&never, &[]);
    two.grpc.stop("left/s");
    two.trocar()
        .run(&["hz", "left/s/value", "-n", "1", "--window", "0.2s"])
        .ends_with(0)
        .says("nothing came");
    two.trocar().run(&["echo", "left/s", "-n", "1"]).ends_with(0).says("STOPPED");
    let mut echo = Following::of(&two, &["echo", "left/s/value", "-n", "1"]);
    two.grpc.start("left/s");
    assert!(echo.next().is_some_and(|item| item["path"] == "left/s/value"), "it comes when that goes on");
    kill("-KILL", pid(&two.host("right")));
    eventually("right is FAILED", || match two.host("right") {
        right if right["state"] == "PROCESS_STATE_FAILED" => Ok(()),
        right => Err(right.to_string()),
    });
    for verb in ["hz", "echo"] {
        let lost = two.trocar().run(&[verb, "right/s/value", "-n", "1"]).ends_with(1);
        lost.says("right").says("failed").says("SIGKILL");
    }
}

#[test]
fn what_is_followed_ends_with_its_process_and_says_so() {
    let two = System::up(TWO, &[]);
    let before = two.host("right");
    let mut ending = [["hz", "right/s/value"], ["echo", "right/s/value"], ["echo", "right/s"]]
        .map(|args| Following::of(&two, &args));
    let both = ["hz", "left/s/value", "right/s/value", "--window", "0.2s"];
    let mut both = Following::of(&two, &both);
    for following in &mut ending {
        assert!(following.next().is_some(), "it follows");
    }
    both.until(|line| line["path"] == "right/s/value" && line["seen"].as_u64() > Some(0));
    kill("-KILL", pid(&before));
    for following in ending {
        let (code, said) = following.ended();
        assert_eq!(code, Some(0), "{said}");
        assert!(said.contains("nothing more comes"), "{said}");
    }
    both.until(|line| line["path"] == "right/s/value" && line["seen"] == 0);
    both.until(|line| line["path"] == "left/s/value" && line["seen"].as_u64() > Some(0));
    two.await_back("right", &before);
    two.trocar().run(&["echo", "right/s/value", "-n", "1"]).ends_with(0).says("right/s/value");
}

/// A `trocar` that follows something, until it ends or this is dropped.
struct Following {
    child: Child,
    lines: Lines<BufReader<ChildStdout>>,
}

impl Following {
    fn of(system: &System, args: &[&str]) -> Following {
        let mut child = Command::new(Built::trocar())
            .args(args)
            .arg("--json")
            .env("TROCAR_GCM", system.process.address())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        Following { child, lines }
    }

    /// What it prints next; `None`: it has ended.
    fn next(&mut self) -> Option<Value> {
        self.lines.next().map(|line| objects(&line.unwrap()).remove(0))
    }

    fn until(&mut self, wanted: impl Fn(&Value) -> bool) {
        while !wanted(&self.next().expect("it goes on")) {}
    }

    /// How it ended by itself, and what it said about that.
    fn ended(mut self) -> (Option<i32>, String) {
        while self.next().is_some() {}
        let mut said = String::new();
        self.child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
        (self.child.wait().unwrap().code(), said)
    }
}

impl Drop for Following {
    fn drop(&mut self) {
        // It may have ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
