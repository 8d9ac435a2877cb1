//! The help of every refusal, followed: after doing what it says, what was refused is answered, or what it
//! promises is seen.
//!
//! Invariant: every reason of `docs/errors.md` is a row here or named below with why its help cannot be
//! followed by a test. Commands come out of the help that was answered ([`Told`]); those that only look are
//! typed in every row.

use std::collections::BTreeSet;
use std::fs;
use std::thread;

use serde_json::{Value, json};
use trocar_tests::{Built, Told, eventually, repository};

use super::stage::{Stage, play_all};

/// Reasons whose help is followed elsewhere, or by nobody who is a test.
const ELSEWHERE: &[(&str, &str)] = &[
    ("PROCESS_EXISTS", "a host meets it when it starts: processes/helps.rs"),
    ("NOT_SUPERVISED", "it needs a supervisor to go to: processes/helps.rs"),
    ("PROCESS_NOT_UP", "what ends a process is outside of trocar, as what is to be corrected"),
    ("PLUGIN_ABI", "a plugin is built again: plugin_loading/helps.rs"),
    ("PLUGIN_UNTRUSTED", "plugin_loading/helps.rs"),
    ("PLUGIN_BAD_FILE", "plugin_loading/helps.rs"),
    ("COMMAND_KIND_MISMATCH", "its help is for the author of a class"),
    ("FORMAT_MISMATCH", "its help is for the author of a class"),
    ("PROGRAMS_NOT_ALLOWED", "devices/video.rs starts the host as it says"),
    ("ROLE_FORBIDDEN", "machines.rs asks with the certificates that it names"),
    ("FORBIDDEN", "hostile/other_user.rs asks with what `trocar token` prints"),
    ("STOP_NOT_TOLD", "its help is to wait for a process that stands still: processes/stopping.rs"),
    ("NOT_LEADER", "it needs several managers: etcd.rs"),
    ("JOURNAL_UNAVAILABLE", "its help is to wait: etcd.rs"),
    ("READ_ONLY", "only a browser's page meets it: tests/viewer/forms.mjs"),
    ("NO_MEMORY", "it needs frames that no machine has the memory for: changing_ports.rs"),
    ("NO_THREAD", "it needs a machine that is out of threads"),
    ("SYSTEM_KEPT", "it needs an agent: machines/agents.rs"),
    ("UNREACHABLE", "it needs processes of other users or machines: hostile/elsewhere.rs"),
    ("REPLACED", "its help says that nothing is to be done; errors.rs meets it"),
    ("QUEUE_FULL", "its help is to wait; errors.rs fills a queue that nobody empties"),
    ("PEER_LOST", "it needs a caller who is waiting when a process ends"),
    ("PART_TAKEN", "its help is to wait; host/src/gcm/tests/ports.rs meets it"),
    ("DISABLED", "a caller from outside is told MEMBER_NOT_FOUND"),
    ("WOULD_BLOCK", "only a real-time thread meets it"),
    ("UNBOUND", "a caller from outside is always bound"),
    ("INTERNAL", "it reports a mistake of trocar itself"),
];

/// A request.
#[derive(Clone, Debug)]
enum Ask {
    /// A method and its message.
    Rpc(&'static str, Value),
    /// A command line, without `trocar`, of which the same is true.
    Typed(String),
}

use Ask::{Rpc, Typed};

impl Ask {
    /// The same with other fields; null takes one away.
    fn with(&self, fields: Value) -> Ask {
        let Rpc(method, body) = self else { panic!("{self:?} has no fields") };
        let mut body = body.clone();
        for (key, value) in fields.as_object().cloned().unwrap_or_default() {
            match value {
                Value::Null => drop(body.as_object_mut().unwrap().remove(&key)),
                value => body[key] = value,
            }
        }
        Rpc(method, body)
    }

    fn refused(&self, stage: &Stage) -> Result<Told, String> {
        match self {
            Rpc(method, body) => match stage.grpc.call(method, body.clone()) {
                Err(refused) => Ok(Told::by(&refused)),
                Ok(answer) => Err(format!("{self:?} was answered {answer}")),
            },
            Typed(line) => match stage.trocar().types(&format!("trocar --json {line}")) {
                refused if refused.code != 0 => Ok(Told::on_the_terminal(&refused)),
                answered => Err(format!("{answered:?}")),
            },
        }
    }

    fn answered(&self, stage: &Stage) {
        match self {
            Rpc(method, body) => drop(stage.grpc.ok(method, body.clone())),
            Typed(line) => drop(stage.trocar().types(&format!("trocar {line}")).ends_with(0)),
        }
    }
}

/// A row: its name, the reason, what is refused, and what the help makes of the request.
struct Row {
    name: &'static str,
    reason: &'static str,
    asked: fn(&Stage) -> Ask,
    /// Does what the help says; what is asked then, and answered.
    done: fn(&Stage, &Told, Ask) -> Ask,
}

macro_rules! groups {
    ($($group:ident [$($plugin:literal),*] {
        $($name:ident $reason:literal |$stage:pat_param| $asked:expr, |$again:pat_param, $told:pat_param, $ask:pat_param| $done:expr;)*
    })*) => {
        $(#[test] fn $group() {
            play(&[$($plugin),*], &[$(Row {
                name: stringify!($name), reason: $reason, asked: |$stage| $asked, done: |$again, $told, $ask| $done,
            }),*]);
        })*
        pub(super) const ROWS: &[(&str, &str)] = &[$($((stringify!($name), $reason),)*)*];
    };
}

// Behind the macro, which it uses.
#[path = "helps/branches.rs"]
mod branches;

fn play(plugins: &[&str], rows: &[Row]) {
    let stage = Stage::new(plugins);
    play_all(rows, |row| row.name, |row| follow(&stage, row));
}

fn follow(stage: &Stage, row: &Row) {
    let ask = (row.asked)(stage);
    let told = eventually("it is refused as this row says", || match ask.refused(stage) {
        Ok(told) if told.reason == row.reason => Ok(told),
        Ok(told) => Err(format!("{told:?}")),
        Err(answered) => Err(answered),
    });
    told.looked(&stage.trocar());
    (row.done)(stage, &told, ask).answered(stage);
}

fn create(path: &str, class: &str, config: Value) -> Ask {
    Rpc("GcmService/Create", json!({ "path": path, "class": class, "config": config }))
}

fn verb(method: &'static str, path: &str) -> Ask {
    Rpc(method, json!({ "path": path }))
}

fn connect(client: &str, server: &str) -> Ask {
    Rpc(
        "GcmService/Connect",
        json!({ "client": format!("host/{client}"), "server": format!("host/{server}") }),
    )
}

fn invoke(path: &str, arg: Value) -> Ask {
    Rpc("InteractService/Invoke", json!({ "path": path, "json": arg, "deadline": "30s" }))
}

/// That it is ACTIVE is what the help promised.
fn is_active(path: &str) -> Ask {
    Rpc("GcmService/WaitFor", json!({ "path": path }))
}

groups! {
    helps_about_one_component_or_process ["sine"] {
        a_path_as_it_is_written "BAD_PATH"
            |stage| { stage.with(&[("spelt", "sine")]); verb("GcmService/Start", "host//spelt") },
            |_, _, _| verb("GcmService/Start", "host/spelt");

        a_process_that_is_started_by_hand "PROCESS_NOT_FOUND"
            |_| create("added/s", "sine", json!({})),
            |stage, told, ask| { by_hand(stage, told, "added"); ask };

        a_process_that_runs_is_ended "PROCESS_RUNS"
            |stage| { stage.with_process("ending", "sine"); Rpc("GcmService/Forget", json!({ "process": "ending" })) },
            |stage, told, ask| { told.typed(&stage.trocar(), "kill", &[]); stage.await_lost("ending"); ask };

        a_lost_process_is_started_again "PROCESS_LOST"
            |stage| {
                stage.with_process("lost", "sine").killed("lost");
                create("lost/s", "sine", json!({}))
            },
            |stage, told, ask| { by_hand(stage, told, "lost"); ask };

        a_lost_process_is_forgotten "PROCESS_LOST"
            |stage| {
                stage.with_process("unwanted", "sine").killed("unwanted");
                create("unwanted/s", "sine", json!({}))
            },
            |stage, told, _| {
                told.typed(&stage.trocar(), "trocar forget", &[]);
                let list = stage.grpc.ok("GcmService/List", json!({ "brief": true }));
                assert!(!list["processes"].to_string().contains("unwanted"), "{list}");
                Rpc("GcmService/List", json!({}))
            };

        a_request_at_a_managed_host_goes_to_its_manager "MANAGED_ELSEWHERE"
            |stage| {
                let address = stage.with_process("managed", "sine").address_of("managed");
                Typed(format!("create managed/s sine --gcm {address}"))
            },
            |_, told, _| Typed(format!("create managed/s sine {}", told.command("--gcm", &[])));

        a_component_whose_rider_is_removed "IN_USE"
            |stage| {
                stage.with(&[("carries", "sine")]);
                let inside = json!({ "inside": "host/carries" });
                stage.grpc.create_with("host/rides", "sine", json!({}), inside);
                verb("GcmService/Remove", "host/carries")
            },
            |stage, _, ask| { stage.grpc.ok("GcmService/Remove", json!({ "path": "host/rides" })); ask };

        a_class_that_was_misspelt "CLASS_NOT_FOUND"
            |_| create("host/misspelt", "sin", json!({})),
            |_, told, ask| ask.with(json!({ "class": told.value("nearest") }));

        a_class_whose_file_is_put_there "CLASS_NOT_FOUND"
            |_| create("host/robot", "eyerobot/eyerobot", json!({})),
            |stage, _, ask| {
                stage.world.drop_in(&Built::plugin("eyerobot"));
                stage.grpc.await_class("host", "eyerobot/eyerobot");
                ask
            };

        a_name_that_is_taken_is_made_free "COMPONENT_EXISTS"
            |stage| { stage.with(&[("taken", "sine")]); create("host/taken", "sine", json!({})) },
            |stage, told, ask| { told.typed(&stage.trocar(), "trocar rm", &[]); ask };

        a_component_is_created_first "COMPONENT_NOT_FOUND"
            |_| verb("GcmService/Start", "host/later"),
            |stage, _, ask| { stage.with(&[("later", "sine")]); ask };

        a_pattern_that_matches "NOTHING_MATCHES"
            |stage| { stage.with(&[("matched", "sine")]); verb("GcmService/Start", "match*/matched") },
            |_, _, _| verb("GcmService/Start", "*/matched");

        a_circle_with_one_thread_more "SYNC_CYCLE"
            |_| Rpc("GcmService/Apply", json!({ "steps": [
                { "create": { "path": "host/round-a", "class": "sine", "execution": { "inside": "host/round-b" } } },
                { "create": { "path": "host/round-b", "class": "sine", "execution": { "inside": "host/round-a" } } },
            ]})),
            |_, _, ask| ask.with(json!({ "steps": [
                { "create": { "path": "host/round-a", "class": "sine", "execution": { "inside": "host/round-b" } } },
                { "create": { "path": "host/round-b", "class": "sine" } },
            ]}));

        what_never_ran_is_started_not_resumed "WRONG_STATE"
            |stage| { stage.with(&[("never-ran", "sine")]); verb("GcmService/Resume", "host/never-ran") },
            |stage, told, _| { told.typed(&stage.trocar(), "trocar start", &[]); is_active("host/never-ran") };

        a_plugin_that_was_misspelt "PLUGIN_NOT_FOUND"
            |_| Rpc("PluginService/DescribePlugin", json!({ "name": "sin" })),
            |_, told, ask| ask.with(json!({ "name": told.value("nearest") }));

        a_request_for_whatever_is_there "REVISION_CONFLICT"
            |_| create("host/outdated", "sine", json!({})).with(json!({ "expected_revision": 1_000_000 })),
            |_, _, ask| ask.with(json!({ "expected_revision": null }));

        a_state_that_is_brought_about "NOT_REACHED"
            |stage| {
                stage.with(&[("unmoved", "sine")]);
                is_active("host/unmoved").with(json!({ "deadline": "0.1s" }))
            },
            |stage, told, ask| { told.typed(&stage.trocar(), "trocar start", &[]); ask };

        another_state_that_is_brought_about "NOT_REACHED"
            |stage| {
                stage.with(&[("runs", "sine")]).started("runs");
                let states = ["COMPONENT_STATE_STOPPED"];
                is_active("host/runs").with(json!({ "states": states, "deadline": "0.1s" }))
            },
            |stage, told, ask| { told.typed(&stage.trocar(), "trocar stop", &[]); ask };

        an_output_of_what_runs "NO_SAMPLE"
            |stage| { stage.with(&[("silent", "sine")]); verb("InteractService/Read", "host/silent/value") },
            |stage, told, ask| { told.typed(&stage.trocar(), "trocar start", &[]); ask };

        a_setting_of_the_execution_that_is_corrected "ARGUMENT_INVALID"
            |_| create("host/no-rate", "sine", json!({})).with(json!({ "execution": { "rate_hz": 0 } })),
            |_, _, ask| ask.with(json!({ "execution": { "rate_hz": 10 } }));

        a_setting_its_class_describes "CONFIG_INVALID"
            |_| create("host/no-setting", "sine", json!({ "amplitud": 1.0 })),
            |stage, told, ask| {
                told.typed(&stage.trocar(), "trocar describe", &[("CLASS", "sine/sine")]).says("amplitude");
                ask.with(json!({ "config": { "amplitude": 1.0 } }))
            };

        what_is_not_built_is_done_in_steps "NOT_IMPLEMENTED"
            |stage| { stage.with(&[("replaced", "sine")]); verb("GcmService/Replace", "host/replaced") },
            |stage, told, _| {
                assert!(told.help.contains("stop, remove and create"), "{told:?}");
                stage.grpc.stop("host/replaced");
                stage.grpc.ok("GcmService/Remove", json!({ "path": "host/replaced" }));
                create("host/replaced", "sine", json!({}))
            };
    }

    helps_about_a_client_and_a_server ["example"] {
        an_interface_that_is_there "INTERFACE_NOT_FOUND"
            |stage| { stage.with(&[("listed", "Server"), ("lists", "Client")]); connect("lists/Required", "listed/Provide") },
            |_, told, ask| ask.with(json!({ "server": format!("host/listed/{}", told.value("nearest")) }));

        a_command_that_is_there "MEMBER_NOT_FOUND"
            |stage| { stage.with(&[("obeys", "Server")]).started("obeys"); invoke("host/obeys/Provided/Writ", json!(1)) },
            |_, told, ask| ask.with(json!({ "path": format!("host/obeys/Provided/{}", told.value("nearest")) }));

        an_event_that_is_followed "WRONG_KIND"
            |stage| {
                stage.with(&[("emits", "Server")]).started("emits");
                invoke("host/emits/Provided/SetPointReached", json!(1))
            },
            |stage, told, _| {
                let line = format!("{} --count 1", told.command("trocar echo", &[]));
                let trocar = stage.trocar();
                thread::scope(|scope| {
                    let echo = scope.spawn(|| trocar.types(&line));
                    eventually("the event is followed", || {
                        stage.grpc.invoke("host/emits/Provided/Write", json!(1));
                        if echo.is_finished() { Ok(()) } else { Err("it waits for it") }
                    });
                    echo.join().unwrap().ends_with(0).says("SetPointReached");
                });
                invoke("host/emits/Provided/Write", json!(1))
            };

        a_command_that_is_called "WRONG_KIND"
            |stage| {
                stage.with(&[("called", "Server")]).started("called");
                verb("GcmService/WaitFor", "host/called/Provided/Read")
            },
            |stage, told, _| {
                told.typed(&stage.trocar(), "trocar call", &[]);
                invoke("host/called/Provided/Read", Value::Null)
            };

        ends_that_are_exchanged "WRONG_DIRECTION"
            |stage| { stage.with(&[("swap-s", "Server"), ("swap-c", "Client")]); connect("swap-s/Provided", "swap-c/Required") },
            |_, _, _| connect("swap-c/Required", "swap-s/Provided");

        a_client_end_that_is_disconnected "ALREADY_CONNECTED"
            |stage| {
                stage.with(&[("first", "Server"), ("second", "Server"), ("cut", "Client")])
                    .connected("cut/Required", "first/Provided");
                connect("cut/Required", "second/Provided")
            },
            |stage, told, ask| { told.typed(&stage.trocar(), "trocar disconnect", &[]); ask };

        a_connection_that_is_replaced "ALREADY_CONNECTED"
            |stage| {
                stage.with(&[("former", "Server"), ("next", "Server"), ("rewired", "Client")])
                    .connected("rewired/Required", "former/Provided");
                connect("rewired/Required", "next/Provided")
            },
            |_, told, ask| {
                assert!(told.help.contains("options.replace: true"), "{told:?}");
                ask.with(json!({ "options": { "replace": true } }))
            };

        a_connection_that_is_undone "CONNECTION_EXISTS"
            |stage| {
                stage.with(&[("pair-s", "Server"), ("pair-c", "Client")]).connected("pair-c/Required", "pair-s/Provided");
                connect("pair-c/Required", "pair-s/Provided")
            },
            |stage, told, ask| { told.typed(&stage.trocar(), "trocar disconnect", &[]); ask };

        a_connection_whose_options_change "CONNECTION_EXISTS"
            |stage| {
                stage.with(&[("same-s", "Server"), ("same-c", "Client")]).connected("same-c/Required", "same-s/Provided");
                connect("same-c/Required", "same-s/Provided")
            },
            |_, told, _| {
                let replace = told.command("--replace", &[]);
                Typed(format!("connect host/same-c/Required host/same-s/Provided --mailbox 8 {replace}"))
            };

        a_connection_by_its_number "CONNECTION_NOT_FOUND"
            |stage| {
                stage.with(&[("numbered-s", "Server"), ("numbered-c", "Client")])
                    .connected("numbered-c/Required", "numbered-s/Provided");
                Rpc("GcmService/Disconnect", json!({ "id": 77_777 }))
            },
            |_, told, ask| {
                let known = told.value("known").split(',').find(|c| c.contains("numbered-c")).unwrap_or_default();
                let id: u64 = known.split(':').next().and_then(|id| id.parse().ok()).unwrap_or_default();
                ask.with(json!({ "id": id }))
            };

        a_component_in_use_that_goes_all_the_same "IN_USE"
            |stage| {
                stage.with(&[("used", "Server"), ("user", "Client")]).connected("user/Required", "used/Provided");
                verb("GcmService/Remove", "host/used")
            },
            |stage, told, _| {
                told.typed(&stage.trocar(), "trocar rm --force", &[]);
                create("host/used", "Server", json!({}))
            };

        a_component_whose_user_is_disconnected "IN_USE"
            |stage| {
                stage.with(&[("held", "Server"), ("holds", "Client")]).connected("holds/Required", "held/Provided");
                verb("GcmService/Remove", "host/held")
            },
            |stage, told, ask| {
                let number = told.value("by").split(' ').nth(1).unwrap_or_default();
                stage.trocar().run(&["disconnect", number]).ends_with(0);
                ask
            };

        an_argument_within_its_limits "ARGUMENT_INVALID"
            |stage| { stage.with(&[("bounded", "Server")]).started("bounded"); invoke("host/bounded/Provided/Write", json!(300)) },
            |stage, told, ask| {
                told.typed(&stage.trocar(), "trocar describe", &[]).says("0…100");
                ask.with(json!({ "json": 100 }))
            };

        an_option_of_a_connection_that_is_corrected "ARGUMENT_INVALID"
            |stage| {
                stage.with(&[("carried", "Server"), ("carries", "Client")]);
                connect("carries/Required", "carried/Provided").with(json!({ "options": { "carrier": "pigeon" } }))
            },
            |_, _, ask| ask.with(json!({ "options": { "carrier": "heap" } }));

        a_command_of_what_is_started "NOT_ACTIVE"
            |stage| { stage.with(&[("rests", "Server")]); invoke("host/rests/Provided/Write", json!(30)) },
            |stage, told, ask| { told.typed(&stage.trocar(), "trocar start", &[]); ask };

        a_command_of_what_is_resumed "NOT_ACTIVE"
            |stage| {
                stage.with(&[("paused", "Server")]).started("paused").grpc.stop("host/paused");
                invoke("host/paused/Provided/Write", json!(30))
            },
            |stage, told, ask| { told.typed(&stage.trocar(), "trocar resume", &[]); ask };
    }

    helps_about_what_does_not_fit
        ["bscan", "example", "eyerobot", "filters", "fixture_misfit", "force_sensor", "oct"]
    {
        a_server_that_has_the_command "COMMAND_MISSING"
            |stage| {
                stage.with(&[("lacks", "eyerobot/eyerobot"), ("has", "example/Server"), ("misses", "Client")]);
                connect("misses/Required", "lacks/arm")
            },
            |_, _, ask| ask.with(json!({ "server": "host/has/Provided" }));

        a_server_of_the_same_type "TYPE_MISMATCH"
            |stage| {
                stage.with(&[("unit-s", "other_unit"), ("type-s", "low_pass"), ("unit-c", "low_pass")]);
                connect("unit-c/raw", "unit-s/force")
            },
            |_, _, ask| ask.with(json!({ "server": "host/type-s/filtered" }));

        a_port_that_is_tagged_sim "TAG_MISMATCH"
            |stage| {
                stage.with(&[("tag-s", "add_latency"), ("simulated", "eyerobot/eyerobot"), ("tag-c", "force_sensor")]);
                connect("tag-c/tip", "tag-s/delayed")
            },
            |_, _, ask| ask.with(json!({ "server": "host/simulated/tip" }));

        what_sensors_measure_for_the_controller "TRUTH_TO_ACTUATOR"
            |stage| {
                stage.with(&[("moves", "eyerobot/eyerobot"), ("knows", "oct_source"), ("tracks", "surface_tracker")])
                    .with(&[("told", "bscan/bscan")]).connected("told/axis", "moves/axis");
                connect("told/distance", "knows/true_distance")
            },
            |_, _, ask| ask.with(json!({ "server": "host/tracks/distance" }));
    }

    helps_about_what_fails_or_hangs ["fixture_chaos", "fixture_conform", "fixture_echo"] {
        what_is_connected_starts "UNCONNECTED"
            |stage| {
                stage.with(&[("drives", "Server"), ("arm", "Arm")]).connected("arm/set_point", "drives/value_out");
                verb("GcmService/Start", "host/arm")
            },
            |stage, _, ask| { stage.connected("arm/drive", "drives/ctl"); ask };

        what_a_component_refused_is_corrected "COMPONENT_REFUSED"
            |_| create("host/refuses", "chaos", json!({ "error_in": "configure" })),
            |_, _, ask| ask.with(json!({ "config": {} }));

        a_component_is_reset_and_its_cause_removed "COMPONENT_FAULT"
            |stage| {
                stage.grpc.create("host/faults", "chaos", json!({ "panic_in": "start" }));
                verb("GcmService/Start", "host/faults")
            },
            |stage, told, ask| {
                told.typed(&stage.trocar(), "trocar reset", &[]);
                let config = json!({ "path": "host/faults", "config": { "panic_in": "" } });
                stage.grpc.ok("GcmService/Configure", config);
                ask
            };

        a_component_in_fault_is_reset_and_started "WRONG_STATE"
            |stage| {
                stage.grpc.create("host/broken", "chaos", json!({ "panic_in": "command" }));
                stage.started("broken");
                let _ = stage.grpc.call("InteractService/Invoke", json!({ "path": "host/broken/ctl/poke" }));
                stage.grpc.await_state("host/broken", "FAULT");
                verb("GcmService/Resume", "host/broken")
            },
            |stage, told, _| {
                told.typed(&stage.trocar(), "trocar reset", &[]);
                told.typed(&stage.trocar(), "trocar start", &[]);
                is_active("host/broken")
            };

        what_may_not_change_while_it_runs_changes_when_it_stands "WRONG_STATE"
            |stage| {
                stage.with(&[("running", "chaos")]).started("running");
                Rpc("GcmService/Configure", json!({ "path": "host/running", "config": { "flood": 1 } }))
            },
            |stage, told, ask| { told.typed(&stage.trocar(), "trocar stop", &[]); ask };

        a_slow_start_gets_a_longer_deadline "LCM_TIMEOUT"
            |stage| {
                stage.grpc.create("host/slow", "chaos", json!({ "slow_start_ms": 1500 }));
                Typed("start host/slow --timeout 0.3s".into())
            },
            |_, told, _| {
                assert!(told.help.contains("a longer deadline"), "{told:?}");
                Typed("start host/slow --timeout 30s".into())
            };

        what_waits_in_line_gets_a_longer_deadline "BUSY"
            |stage| {
                stage.grpc.create("host/busy", "chaos", json!({ "slow_start_ms": 3000 }));
                let trocar = stage.trocar();
                thread::spawn(move || trocar.types("trocar start host/busy --timeout 30s"));
                Typed("reset host/busy --timeout 0.1s".into())
            },
            |_, told, _| {
                assert!(told.message.contains("Start host/busy is still being carried out"), "{told:?}");
                Typed("reset host/busy --timeout 30s".into())
            };

        an_event_of_what_is_started "EVENT_NOT_SEEN"
            |stage| {
                stage.with(&[("mute", "echo")]);
                Rpc("GcmService/WaitFor", json!({ "path": "host/mute/ctl/echoed", "deadline": "0.1s" }))
            },
            |stage, told, ask| {
                told.typed(&stage.trocar(), "trocar start", &[]);
                ask.with(json!({ "deadline": "30s", "call": { "path": "host/mute/ctl/write", "json": 1.0 } }))
            };

        a_command_that_is_given_what_it_needs "COMMAND_FAILED"
            |stage| { stage.with(&[("picky", "echo")]).started("picky"); invoke("host/picky/ctl/refuse", json!("bad")) },
            |_, _, _| invoke("host/picky/ctl/write", json!(1.0));

        a_slow_command_gets_a_longer_deadline "DEADLINE"
            |stage| {
                // The server looks for commands five times a second.
                let slow = json!({ "model": "periodic", "rate_hz": 5, "wake": "poll" });
                stage.grpc.create_with("host/takes-long", "Server", json!({}), slow);
                stage.started("takes-long");
                invoke("host/takes-long/ctl/write_latest", json!(1.0)).with(json!({ "deadline": "0.001s" }))
            },
            |_, _, ask| ask.with(json!({ "deadline": "30s" }));
    }
}

/// Types what the help says starts a process under the GCM that was asked.
fn by_hand(stage: &Stage, told: &Told, name: &str) {
    let plugins = stage.world.plugins().display().to_string();
    let command = told.command("trocar host", &[("ADDR", stage.address()), ("DIR", &plugins)]);
    let words: Vec<&str> = command.split(' ').skip(1).collect();
    stage.joined(name, &words, "sine");
}

#[test]
fn the_help_of_every_reason_is_followed_here_or_named_with_why_not() {
    let text = fs::read_to_string(repository().join("docs/errors.md")).unwrap();
    let documented: BTreeSet<&str> = text.lines().filter_map(|line| line.strip_prefix("## ")).collect();
    let rows = ROWS.iter().chain(branches::ROWS);
    let followed: BTreeSet<&str> = rows.map(|(_, reason)| *reason).collect();
    let named: BTreeSet<&str> = ELSEWHERE.iter().map(|(reason, _)| *reason).collect();
    let all: BTreeSet<&str> = followed.union(&named).copied().collect();
    assert_eq!(all, documented);
    let both: Vec<_> = followed.intersection(&named).collect();
    assert!(both.is_empty(), "followed, and named as not followed: {both:?}");
}
