//! Every process, component, connection and port of a system, seen live from outside.

use serde_json::Value;
use trocar_tests::eventually;

use super::TWO;
use super::system::{System, kill, pid};

fn objects(text: &str) -> Vec<Value> {
    text.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|e| panic!("{e}: {line}"))).collect()
}

fn row<'a>(figures: &'a Value, part: &str, key: &str, name: &str) -> &'a Value {
    let rows = figures[part].as_array().unwrap();
    rows.iter().find(|r| r[key] == name).unwrap_or_else(|| panic!("no {name} in {figures}"))
}

#[test]
fn top_tells_rate_and_load_of_everything_once_an_interval() {
    let file = r#"{
      "version": 1,
      "processes": { "left": { "plugins": ["plugins"] }, "right": { "plugins": ["plugins"] } },
      "components": {
        "left/s": { "class": "sine" },
        "right/server": { "class": "Server" }, "right/client": { "class": "Client" }
      },
      "connections": [ { "client": "right/client/Required", "server": "right/server/Provided" } ]
    }"#;
    let two = System::up(file, &[]);
    let top = two.trocar().run(&["top", "--json", "-n", "2", "--interval", "0.3s"]).ends_with(0);
    let figures = objects(&top.stdout);
    assert_eq!(figures.len(), 2, "one object for each interval: {top:#?}");
    let last = &figures[1];
    let s = row(last, "components", "path", "left/s");
    assert_eq!(
        (s["state"].as_str(), s["rate_hz"].as_f64().is_some_and(|hz| hz > 0.0)),
        (Some("ACTIVE"), true),
        "{s}"
    );
    let left = row(last, "processes", "name", "left");
    assert!(left["load"].as_f64().is_some_and(|load| load > 0.0) && left["components"] == 1, "{left}");
    let connection = &last["connections"][0];
    assert_eq!(
        (&connection["client"], &connection["server"]),
        (&"right/client/Required".into(), &"right/server/Provided".into())
    );
    assert!(!connection["carrier"].as_str().unwrap_or_default().is_empty(), "{connection}");
    let text = two.trocar().run(&["top", "-n", "1", "--interval", "0.1s", "--sort", "rate"]).ends_with(0);
    let text = text.says("left/s").says("right/server").says("PROCESS").says("CONNECTION");
    assert!(!text.stdout.contains('\u{1b}'), "no terminal, no escape codes: {text:#?}");
    two.trocar().run(&["top", "left", "-n", "1", "--interval", "0.1s"]).ends_with(0);
    two.trocar().run(&["top", "nobody", "-n", "1"]).ends_with(1).says("nobody");
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
    let echo =
        two.trocar().run(&["echo", "left/s/value", "right/s/value", "--json", "-n", "40"]).ends_with(0);
    let from = |path: &str| objects(&echo.stdout).iter().filter(|item| item["path"] == path).count();
    assert!(from("left/s/value") > 0 && from("right/s/value") > 0, "{echo:#?}");
    let hz = eventually("both are measured", || {
        let hz = two.trocar().run(&["hz", "left/s/value", "right/s/value", "--json", "-n", "1"]).ends_with(0);
        let lines = objects(&hz.stdout);
        if lines.iter().all(|l| l["seen"].as_u64() > Some(2)) { Ok(lines) } else { Err(format!("{hz:#?}")) }
    });
    for line in &hz {
        let (seen, sent) = (line["seen"].as_u64().unwrap(), line["sent"].as_u64().unwrap());
        assert!(line["rate_hz"].as_f64().is_some_and(|hz| hz > 0.0 && hz < 1100.0), "{line}");
        assert!(seen <= sent, "what was not seen is counted: {line}");
    }
    two.trocar().run(&["hz", "left/s"]).ends_with(2).says("trocar describe left/s");
    two.trocar().run(&["hz", "left/s/valeu", "-n", "1"]).ends_with(1).says("value");
}
