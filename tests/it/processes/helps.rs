//! Helps that take a supervisor or a second program, followed.
//!
//! Promise: after doing what the help says, what was refused is answered.

use serde_json::json;
use trocar_tests::{HostProcess, Told, Trocar, World, eventually};

use super::TWO;
use super::system::{System, kill, pid};

#[test]
fn what_a_supervisor_gave_up_or_never_had_is_brought_back_as_the_help_says() {
    let policy = "\"right\": { \"restart\": { \"within_s\": 1000 },";
    let two = System::up(&TWO.replacen("\"right\": {", policy, 1), &[]);
    two.kill_until_failed("right");
    let start = json!({ "path": "right/off" });
    let told = Told::by(&two.grpc.refused("GcmService/Start", start.clone()));
    assert_eq!(told.reason, "PROCESS_LOST", "{told:?}");
    told.looked(&two.trocar());
    told.typed(&two.trocar(), "trocar restart", &[]);
    two.grpc.ok("GcmService/Start", start);

    let args =
        ["host", "--name", "alone", "--listen", "127.0.0.1:0", "--json", "--gcm", two.process.address()];
    let _alone = HostProcess::spawn(&two.world, "alone", &args.map(Into::into));
    two.grpc.await_class("alone", "sine");
    let isolated =
        |process: &str| json!({ "process": process, "name": "x", "class": "sine", "isolation": "process" });
    let told = Told::by(&two.grpc.refused("GcmService/Create", isolated("alone")));
    assert_eq!(told.reason, "NOT_SUPERVISED", "{told:?}");
    assert!(told.help.contains("create the component without isolation"), "{told:?}");
    two.grpc.create("alone/x", "sine", json!({}));
    let made = two.grpc.ok("GcmService/Create", isolated(told.value("known").split(',').next().unwrap()));
    assert_eq!(made["path"], "left.x/x", "one that has a supervisor gets it: {made}");
}

#[test]
fn what_is_being_started_again_answers_when_the_help_says_so() {
    // The second start waits, and what is asked meanwhile is answered by how it stands.
    let policy = "\"right\": { \"restart\": { \"max\": 1000, \"backoff_ms\": 3000 },";
    let two = System::up(&TWO.replacen("\"right\": {", policy, 1), &[]);
    let start = json!({ "path": "right/off" });
    let refused_while_restarting = |method: &str, body: &serde_json::Value, words: &str| {
        let mut last = 0;
        eventually(&format!("{method} meets it while it is started again"), || {
            let process = two.host("right");
            if process["state"] == "PROCESS_STATE_ATTACHED" && pid(&process) != last {
                last = pid(&process);
                kill("-KILL", last);
            }
            let refused = two.grpc.call(method, body.clone()).map_err(|refused| Told::by(&refused));
            match refused {
                Err(told) if told.help.contains(words) => Ok(told),
                other => Err(format!("{other:?}")),
            }
        })
    };
    let told = refused_while_restarting("GcmService/Start", &start, "Ask again in a moment");
    assert_eq!(told.reason, "PROCESS_LOST", "{told:?}");
    told.looked(&two.trocar());
    let forget = json!({ "process": "right" });
    let told = refused_while_restarting("GcmService/Forget", &forget, "ATTACHED or FAILED");
    assert_eq!(told.reason, "PROCESS_RUNS", "{told:?}");
    eventually("`trocar ls` shows it ATTACHED", || {
        let line = two.trocar().run(&["ls", "right"]).ends_with(0);
        if line.stdout.contains("ATTACHED") { Ok(()) } else { Err(format!("{line:?}")) }
    });
    eventually("its components are made anew", || match two.grpc.call("GcmService/Start", start.clone()) {
        Ok(_) => Ok(()),
        // A Start that came between two restarts was carried out, and a sensor goes on after the next one.
        Err(refused) if refused.reason == "WRONG_STATE" && two.grpc.state("right/off") == "ACTIVE" => Ok(()),
        Err(refused) => Err(format!("{refused:?}")),
    });
}

#[test]
fn a_host_whose_name_is_taken_starts_beside_the_other_or_after_it_as_the_help_says() {
    let world = World::with_plugins(&["sine"]);
    let mut first = HostProcess::start(&world);
    let address = first.address().to_owned();
    let plugins = world.plugins().display().to_string();
    let taken = ["--json", "host", "--listen", &address, "--plugins", &plugins];
    let refused = Trocar::new(&world).run(&taken);
    let told = Told::on_the_terminal(&refused.ends_with(1));
    assert_eq!(told.reason, "PROCESS_EXISTS", "{told:?}");
    let beside = told.command("--listen", &[]);
    let words = ["host", "--plugins", &plugins].into_iter().chain(beside.split(' '));
    let beside = HostProcess::spawn(&world, "beside", &words.map(Into::into).collect::<Vec<_>>());
    drop(beside);
    told.typed(&Trocar::new(&world), "kill", &[]);
    eventually("it has ended", || if first.is_alive() { Err("it runs") } else { Ok(()) });
    let words = ["host", "--listen", &address, "--plugins", &plugins];
    drop(HostProcess::spawn(&world, "after", &words.map(Into::into)));
}
