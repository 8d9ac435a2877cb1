//! Helps of one reason that say something else in another case: each is followed, too.
//!
//! Invariant: as in the file above this one.

use serde_json::{Value, json};
use trocar_tests::{Told, eventually};

use super::super::stage::Stage;
use super::{Row, Rpc, connect, create, invoke, is_active, play, verb};

groups! {
    helps_about_two_plugins_of_one_stage ["example", "fixture_conform"] {
        a_class_that_two_plugins_have "CLASS_NOT_FOUND"
            |_| create("host/either", "Server", json!({})),
            |_, told, ask| {
                assert!(told.help.contains("with its plugin in front"), "{told:?}");
                let first = told.value("ambiguous").split(',').next().unwrap_or_default().trim().to_owned();
                ask.with(json!({ "class": first }))
            };

        fields_that_only_moved "TYPE_MISMATCH"
            |stage| {
                stage.with(&[("moved-s", "fixture-conform/Server"), ("moved-c", "fixture-conform/Client")]);
                connect("moved-c/turned", "moved-s/value_out")
            },
            |_, told, ask| {
                assert!(told.help.contains("adapt: true"), "{told:?}");
                ask.with(json!({ "options": { "adapt": true } }))
            };

        two_ends_that_both_give "WRONG_DIRECTION"
            |stage| {
                stage.with(&[("gives", "fixture-conform/Server"), ("gives-too", "fixture-conform/Server"),
                    ("takes", "fixture-conform/Client")]);
                connect("gives-too/value_out", "gives/value_out")
            },
            |_, told, _| {
                assert!(told.help.starts_with("An input (client) takes an output (server)"), "{told:?}");
                connect("takes/latest", "gives/value_out")
            };
    }

    helps_about_states_in_other_cases ["fixture_chaos", "fixture_echo", "sine", "stereo"] {
        a_component_that_was_never_configured "WRONG_STATE"
            |stage| {
                stage.grpc.ok("GcmService/Create", json!({ "path": "host/film", "class": "image_source" }));
                verb("GcmService/Start", "host/film")
            },
            |stage, told, ask| {
                assert!(told.help.starts_with("Configure it first"), "{told:?}");
                told.typed(&stage.trocar(), "trocar describe", &[]).says("directory");
                let pairs = two_pictures(stage);
                let config = json!({ "path": "host/film", "config": { "directory": pairs } });
                stage.grpc.ok("GcmService/Configure", config);
                ask
            };

        a_component_in_fault_is_reset_before_it_is_configured "WRONG_STATE"
            |stage| {
                faulted(stage, "unsettled");
                Rpc("GcmService/Configure", json!({ "path": "host/unsettled", "config": { "panic_in": "" } }))
            },
            |stage, told, ask| { told.typed(&stage.trocar(), "trocar reset", &[]); ask };

        a_command_of_what_is_in_fault "NOT_ACTIVE"
            |stage| { faulted(stage, "deaf"); invoke("host/deaf/ctl/poke", Value::Null) },
            |stage, told, ask| { mended(stage, told, "deaf"); ask };

        a_component_in_fault_that_is_waited_for "COMPONENT_FAULT"
            |stage| { faulted(stage, "fallen"); is_active("host/fallen") },
            |stage, told, ask| {
                told.typed(&stage.trocar(), "trocar reset", &[]);
                harmless(stage, "fallen");
                stage.started("fallen");
                ask
            };

        a_state_that_a_reset_brings_about "NOT_REACHED"
            |stage| {
                stage.with(&[("over", "sine")]).started("over").grpc.stop("host/over");
                let states = ["COMPONENT_STATE_READY"];
                is_active("host/over").with(json!({ "states": states, "deadline": "0.1s" }))
            },
            |stage, told, ask| { told.typed(&stage.trocar(), "trocar reset", &[]); ask };

        an_event_of_what_is_resumed "EVENT_NOT_SEEN"
            |stage| {
                stage.with(&[("halted", "echo")]).started("halted").grpc.stop("host/halted");
                Rpc("GcmService/WaitFor", json!({ "path": "host/halted/ctl/echoed", "deadline": "0.1s" }))
            },
            |stage, told, ask| {
                told.typed(&stage.trocar(), "trocar resume", &[]);
                ask.with(json!({ "deadline": "30s", "call": { "path": "host/halted/ctl/write", "json": 1.0 } }))
            };

        an_event_that_is_watched "EVENT_NOT_SEEN"
            |stage| {
                stage.with(&[("quiet", "echo")]).started("quiet");
                Rpc("GcmService/WaitFor", json!({ "path": "host/quiet/ctl/echoed", "deadline": "0.1s" }))
            },
            |stage, told, _| {
                let line = format!("{} --count 1", told.command("trocar echo", &[]));
                let trocar = stage.trocar();
                std::thread::scope(|scope| {
                    let echo = scope.spawn(|| trocar.types(&line));
                    eventually("the event is followed", || {
                        stage.grpc.invoke("host/quiet/ctl/write", json!(1.0));
                        if echo.is_finished() { Ok(()) } else { Err("it waits for it") }
                    });
                    echo.join().unwrap().ends_with(0).says("echoed");
                });
                invoke("host/quiet/ctl/write", json!(1.0))
            };

        an_output_of_what_has_nothing_to_give_on "NO_SAMPLE"
            |stage| { stage.with(&[("empty", "echo")]).started("empty"); verb("InteractService/Read", "host/empty/sample_out") },
            |stage, told, ask| {
                told.typed(&stage.trocar(), "trocar describe", &[]).says("sample");
                stage.with(&[("source", "sine")]).connected("empty/sample", "source/value").started("source");
                ask
            };

        a_setting_of_a_request_that_is_corrected "ARGUMENT_INVALID"
            |stage| {
                stage.with(&[("patient", "sine")]).started("patient");
                is_active("host/patient").with(json!({ "deadline": "-1s" }))
            },
            |_, told, ask| {
                assert!(told.help.contains("Correct it and ask again"), "{told:?}");
                ask.with(json!({ "deadline": "30s" }))
            };
    }
}

/// A component that has panicked in a command.
fn faulted(stage: &Stage, name: &str) {
    stage.grpc.create(&format!("host/{name}"), "chaos", json!({ "panic_in": "command" }));
    stage.started(name);
    let _ = stage.grpc.call("InteractService/Invoke", json!({ "path": format!("host/{name}/ctl/poke") }));
    stage.grpc.await_state(&format!("host/{name}"), "FAULT");
}

/// Takes the cause away.
fn harmless(stage: &Stage, name: &str) {
    let config = json!({ "path": format!("host/{name}"), "config": { "panic_in": "" } });
    stage.grpc.ok("GcmService/Configure", config);
}

/// Does what the help says, and takes the cause away.
fn mended(stage: &Stage, told: &Told, name: &str) {
    told.typed(&stage.trocar(), "trocar reset", &[]);
    harmless(stage, name);
    told.typed(&stage.trocar(), "trocar start", &[]);
}

/// A folder with the smallest stereo pair there is.
fn two_pictures(stage: &Stage) -> std::path::PathBuf {
    let mut bytes = Vec::new();
    let mut writer = png::Encoder::new(&mut bytes, 1, 1).write_header().unwrap();
    writer.write_image_data(&[0]).unwrap();
    writer.finish().unwrap();
    let folder = stage.world.path("pairs");
    std::fs::create_dir(&folder).unwrap();
    for name in ["left1.png", "right1.png"] {
        std::fs::write(folder.join(name), &bytes).unwrap();
    }
    folder
}
