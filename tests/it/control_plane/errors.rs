//! The error table, one test per row, through real grpcurl: code, reason, and the words a caller needs.
//!
//! Invariant: every reason of `docs/errors.md` is either a row here or named below with why nobody can meet it yet.

use std::collections::BTreeSet;
use std::fs;

use serde_json::{Value, json};
use trocar_tests::{Built, Failure, Grpcurl, HostProcess, World, eventually, replace_in, repository};

/// Reasons that no single call to one host can be answered with in this version.
const NOT_YET: &[(&str, &str)] = &[
    ("FORBIDDEN", "there are no roles before TLS"),
    ("DISABLED", "a caller from outside is told MEMBER_NOT_FOUND when a description withdrew the command"),
    ("WOULD_BLOCK", "only a real-time thread meets it, never a caller from outside"),
    ("UNBOUND", "a caller from outside is always bound to the command it names"),
    ("INTERNAL", "it reports a mistake of trocar itself"),
    ("PROCESS_EXISTS", "a host meets it when it attaches: deployment.rs"),
    (
        "UNREACHABLE",
        "it needs two processes that cannot share memory, or have none: hostile/elsewhere.rs, hostile/limits.rs",
    ),
    ("PROCESS_LOST", "it needs a killed process: deployment.rs"),
    ("READ_ONLY", "only a browser's page meets it: tests/viewer/forms.mjs"),
    ("NOT_SUPERVISED", "it needs a class that is there: processes/isolated.rs"),
    ("PROCESS_NOT_UP", "it needs a process that cannot come up: processes/isolated.rs"),
    ("MANAGED_ELSEWHERE", "it needs a host with another manager: deployment.rs"),
    ("NO_MEMORY", "it needs frames that no machine has the memory for: changing_ports.rs"),
    ("NO_THREAD", "it needs a machine that is out of threads"),
    ("PEER_LOST", "it needs a caller who is waiting: a_caller_whose_component_is_taken_away_gets_an_answer"),
];

/// A host with the plugins that the rows need.
struct Stage {
    grpc: Grpcurl,
    world: World,
    _host: HostProcess,
}

impl Stage {
    fn new(plugins: &[&str]) -> Self {
        let world = World::with_plugins(plugins);
        let host = HostProcess::start(&world);
        let stage = Self { grpc: host.grpcurl(), world, _host: host };
        eventually("the plugins are listed", || {
            let listed = stage.grpc.plugins().len();
            if listed >= plugins.len() { Ok(()) } else { Err(format!("{listed} of {}", plugins.len())) }
        });
        stage
    }

    /// Creates components, `name` and class.
    fn with(self, components: &[(&str, &str)]) -> Self {
        for (name, class) in components {
            self.grpc.create(&format!("host/{name}"), class, json!({}));
        }
        self
    }

    fn started(self, name: &str) -> Self {
        self.grpc.start(&format!("host/{name}"));
        self
    }

    fn connected(self, client: &str, server: &str) -> Self {
        self.grpc.connect(&format!("host/{client}"), &format!("host/{server}"));
        self
    }

    fn refuses(&self, method: &str, body: Value) -> Failure {
        self.grpc.refused(method, body)
    }

    fn refuses_connect(&self, client: &str, server: &str) -> Failure {
        let body = json!({ "client": format!("host/{client}"), "server": format!("host/{server}") });
        self.refuses("GcmService/Connect", body)
    }

    fn refuses_invoke(&self, path: &str, arg: Value) -> Failure {
        self.refuses("InteractService/Invoke", json!({ "path": path, "json": arg, "deadline": "0.2s" }))
    }
}

/// One test per row: name, code, reason, words that must be in the sentence, and how it is met.
macro_rules! rows {
    ($($name:ident $code:literal $reason:literal [$($word:literal),*] $met:expr;)*) => {
        $(#[test] fn $name() {
            let refused: Failure = $met;
            check(&refused, $code, $reason, &[$($word),*]);
        })*
        const ROWS: &[&str] = &[$($reason),*];
    };
}

#[track_caller]
fn check(refused: &Failure, code: &str, reason: &str, words: &[&str]) {
    assert_eq!((refused.code, refused.reason.as_str()), (code, reason), "{refused}\n{:#?}", refused.details);
    assert_eq!(refused.domain, "trocar.v1", "{refused}");
    for word in words {
        assert!(refused.message.contains(word), "the sentence does not say {word:?}: {refused}");
    }
    assert!(!refused.message.contains('\n'), "one sentence: {refused}");
}

rows! {
    a_path_with_an_empty_part "INVALID_ARGUMENT" "BAD_PATH" ["host//robot"]
        Stage::new(&[]).refuses("GcmService/Start", json!({ "path": "host//robot" }));

    a_process_that_is_not_there "NOT_FOUND" "PROCESS_NOT_FOUND" ["nowhere", "host"]
        Stage::new(&["sine"]).refuses("GcmService/Create", json!({ "path": "nowhere/s", "class": "sine" }));

    a_misspelt_class "NOT_FOUND" "CLASS_NOT_FOUND" ["`sin`", "did you mean `sine`", "There is sine"]
        Stage::new(&["sine"]).refuses("GcmService/Create", json!({ "path": "host/s", "class": "sin" }));

    a_name_that_is_taken "ALREADY_EXISTS" "COMPONENT_EXISTS" ["host/s"]
        Stage::new(&["sine"]).with(&[("s", "sine")])
            .refuses("GcmService/Create", json!({ "path": "host/s", "class": "sine" }));

    a_component_that_is_not_there "NOT_FOUND" "COMPONENT_NOT_FOUND" ["host/t", "host/s"]
        Stage::new(&["sine"]).with(&[("s", "sine")]).refuses("GcmService/Start", json!({ "path": "host/t" }));

    a_glob_that_matches_nothing "NOT_FOUND" "NOTHING_MATCHES" ["robot"]
        Stage::new(&["sine"]).with(&[("s", "sine")]).refuses("GcmService/Start", json!({ "path": "*/robot" }));

    a_missing_interface_lists_what_exists "NOT_FOUND" "INTERFACE_NOT_FOUND" ["Provide", "Provided"]
        Stage::new(&["example"]).with(&[("s", "Server"), ("c", "Client")])
            .refuses_connect("c/Required", "s/Provide");

    an_event_that_is_called "INVALID_ARGUMENT" "WRONG_KIND" ["SetPointReached", "is an event, not a command"]
        Stage::new(&["example"]).with(&[("s", "Server")]).started("s")
            .refuses_invoke("host/s/Provided/SetPointReached", json!(1));

    a_missing_command_of_an_interface "NOT_FOUND" "MEMBER_NOT_FOUND" ["Writ", "Write"]
        Stage::new(&["example"]).with(&[("s", "Server")]).started("s")
            .refuses_invoke("host/s/Provided/Writ", json!(1));

    swapped_ends "INVALID_ARGUMENT" "WRONG_DIRECTION" ["host/s/Provided", "host/c/Required"]
        Stage::new(&["example"]).with(&[("s", "Server"), ("c", "Client")])
            .refuses_connect("s/Provided", "c/Required");

    a_client_end_that_has_a_server "ALREADY_EXISTS" "ALREADY_CONNECTED" ["host/s/Provided"]
        Stage::new(&["example"]).with(&[("s", "Server"), ("t", "Server"), ("c", "Client")])
            .connected("c/Required", "s/Provided").refuses_connect("c/Required", "t/Provided");

    the_same_pair_again "ALREADY_EXISTS" "CONNECTION_EXISTS" ["host/c/Required"]
        Stage::new(&["example"]).with(&[("s", "Server"), ("c", "Client")])
            .connected("c/Required", "s/Provided").refuses_connect("c/Required", "s/Provided");

    a_connection_that_is_not_there "NOT_FOUND" "CONNECTION_NOT_FOUND" ["77"]
        Stage::new(&[]).refuses("GcmService/Disconnect", json!({ "id": 77 }));

    a_server_without_the_command "FAILED_PRECONDITION" "COMMAND_MISSING" ["host/r/arm"]
        Stage::new(&["example", "eyerobot"]).with(&[("r", "eyerobot/eyerobot"), ("c", "Client")])
            .refuses_connect("c/Required", "r/arm");

    a_command_of_another_kind "FAILED_PRECONDITION" "COMMAND_KIND_MISMATCH" ["Read"]
        Stage::new(&["example", "fixture_misfit"]).with(&[("k", "other_kind"), ("c", "Client")])
            .refuses_connect("c/Required", "k/Provided");

    another_unit_names_both "FAILED_PRECONDITION" "TYPE_MISMATCH" ["f", "mN"]
        Stage::new(&["filters", "fixture_misfit"]).with(&[("u", "other_unit"), ("f", "low_pass")])
            .refuses_connect("f/raw", "u/force");

    another_type_names_the_first_difference "FAILED_PRECONDITION" "TYPE_MISMATCH" ["host/f/raw"]
        Stage::new(&["filters", "sine"]).with(&[("s", "sine"), ("f", "low_pass")])
            .refuses_connect("f/raw", "s/value");

    another_format_names_both "FAILED_PRECONDITION" "FORMAT_MISMATCH" ["bayer12", "gray8"]
        Stage::new(&["fixture_misfit"]).with(&[("i", "other_format"), ("g", "one_format")])
            .refuses_connect("g/image", "i/image");

    a_port_for_simulated_devices_only "FAILED_PRECONDITION" "TAG_MISMATCH" ["host/s/tip", "has no tag"]
        Stage::new(&["filters", "force_sensor"]).with(&[("l", "add_latency"), ("s", "force_sensor")])
            .refuses_connect("s/tip", "l/delayed");

    the_truth_reaches_no_actuator "FAILED_PRECONDITION" "TRUTH_TO_ACTUATOR" ["tagged truth", "host/b", "host/r"]
        Stage::new(&["bscan", "eyerobot", "oct"])
            .with(&[("r", "eyerobot/eyerobot"), ("o", "oct_source"), ("b", "bscan/bscan")])
            .connected("b/axis", "r/axis").refuses_connect("b/distance", "o/true_distance");

    a_circle_of_direct_connections "FAILED_PRECONDITION" "SYNC_CYCLE" ["host/a", "host/b"]
        Stage::new(&["sine"]).refuses("GcmService/Apply", json!({ "steps": [
            { "create": { "path": "host/a", "class": "sine", "execution": { "inside": "host/b" } } },
            { "create": { "path": "host/b", "class": "sine", "execution": { "inside": "host/a" } } },
        ]}));

    a_state_that_does_not_allow_it "FAILED_PRECONDITION" "WRONG_STATE" ["READY", "Start"]
        Stage::new(&["sine"]).with(&[("s", "sine")]).refuses("GcmService/Resume", json!({ "path": "host/s" }));

    start_with_open_ends "FAILED_PRECONDITION" "UNCONNECTED" ["raw"]
        Stage::new(&["filters"]).with(&[("f", "low_pass")]).refuses("GcmService/Start", json!({ "path": "host/f" }));

    an_actuator_that_was_cut_off_does_not_resume "FAILED_PRECONDITION" "UNCONNECTED" ["cannot resume", "drive"] {
        let stage = Stage::new(&["fixture_conform"]).with(&[("s", "Server"), ("a", "Arm")])
            .connected("a/drive", "s/ctl").connected("a/set_point", "s/value_out").started("s").started("a");
        stage.grpc.stop("host/a");
        let cut = json!({ "client": "host/a/drive", "server": "host/s/ctl" });
        stage.grpc.ok("GcmService/Disconnect", cut);
        let refused = stage.refuses("GcmService/Resume", json!({ "path": "host/a" }));
        assert_eq!(stage.grpc.state("host/a"), "STOPPED");
        refused
    };

    a_configuration_that_breaks_the_schema "INVALID_ARGUMENT" "CONFIG_INVALID" ["cutoff_hz", "400 Hz"] {
        let body = json!({ "path": "host/f", "class": "low_pass", "config": { "cutoff_hz": 1000, "limit": "high" } });
        let refused = Stage::new(&["filters"]).refuses("GcmService/Create", body);
        let fields = refused.violated_fields();
        for field in ["cutoff_hz", "limit"] {
            assert!(fields.iter().any(|f| f.ends_with(field)), "one violation per pointer, {field} among {fields:?}");
        }
        refused
    };

    a_component_that_refuses "FAILED_PRECONDITION" "COMPONENT_REFUSED" ["host/c"]
        Stage::new(&["fixture_chaos"])
            .refuses("GcmService/Create", json!({ "path": "host/c", "class": "chaos", "config": { "error_in": "configure" } }));

    a_component_that_faults "INTERNAL" "COMPONENT_FAULT" ["panicked"] {
        let stage = Stage::new(&["fixture_chaos"]);
        stage.grpc.create("host/c", "chaos", json!({ "panic_in": "start" }));
        stage.refuses("GcmService/Start", json!({ "path": "host/c" }))
    };

    a_component_in_use "FAILED_PRECONDITION" "IN_USE" ["host/c/Required"]
        Stage::new(&["example"]).with(&[("s", "Server"), ("c", "Client")]).connected("c/Required", "s/Provided")
            .refuses("GcmService/Remove", json!({ "path": "host/s" }));

    a_plugin_of_another_abi "FAILED_PRECONDITION" "PLUGIN_ABI" ["7"] {
        let good = fs::read(Built::plugin("sine")).unwrap();
        create_of_refused_file(&replace_in(&good, b"\"abi\":[1,", b"\"abi\":[7,"), 0o755)
    };

    a_plugin_that_everybody_can_write "FAILED_PRECONDITION" "PLUGIN_UNTRUSTED" ["chmod"] {
        create_of_refused_file(&fs::read(Built::plugin("sine")).unwrap(), 0o777)
    };

    a_plugin_file_that_is_damaged "FAILED_PRECONDITION" "PLUGIN_BAD_FILE" ["truncated"] {
        let good = fs::read(Built::plugin("sine")).unwrap();
        create_of_refused_file(&good[..good.len() / 3], 0o755)
    };

    a_plugin_that_is_not_there "NOT_FOUND" "PLUGIN_NOT_FOUND" ["sin", "sine"]
        Stage::new(&["sine"]).refuses("PluginService/DescribePlugin", json!({ "name": "sin" }));

    a_graph_that_moved_on "ABORTED" "REVISION_CONFLICT" ["1000000"]
        Stage::new(&["sine"]).refuses("GcmService/Create",
            json!({ "path": "host/s", "class": "sine", "expected_revision": 1_000_000 }));

    a_start_that_never_ends_is_taken_back "DEADLINE_EXCEEDED" "LCM_TIMEOUT" ["host"] {
        let stage = Stage::new(&["fixture_chaos"]);
        stage.grpc.create("host/c", "chaos", json!({ "hang_in": "start" }));
        stage.refuses("GcmService/Start", json!({ "path": "host/c" }))
    };

    a_state_that_is_not_reached "DEADLINE_EXCEEDED" "NOT_REACHED" ["host/s", "ACTIVE"]
        Stage::new(&["sine"]).with(&[("s", "sine")])
            .refuses("GcmService/WaitFor", json!({ "path": "host/s", "deadline": "0.1s" }));

    an_event_that_does_not_come "DEADLINE_EXCEEDED" "EVENT_NOT_SEEN" ["host/e/ctl/echoed", "100 ms", "READY"]
        Stage::new(&["fixture_echo"]).with(&[("e", "echo")])
            .refuses("GcmService/WaitFor", json!({ "path": "host/e/ctl/echoed", "deadline": "0.1s" }));

    an_output_without_a_sample "DEADLINE_EXCEEDED" "NO_SAMPLE" ["host/s/value", "its component is READY"]
        Stage::new(&["sine"]).with(&[("s", "sine")])
            .refuses("InteractService/Read", json!({ "path": "host/s/value" }));

    an_interface_that_is_read "INVALID_ARGUMENT" "ARGUMENT_INVALID"
        ["a provided interface", "only outputs can be read", "value"]
        Stage::new(&["sine"]).with(&[("s", "sine")])
            .refuses("InteractService/Read", json!({ "path": "host/s/system" }));

    a_create_with_two_names "INVALID_ARGUMENT" "ARGUMENT_INVALID" ["host/q", "\"z\""]
        Stage::new(&["sine"]).refuses("GcmService/Create",
            json!({ "path": "host/q", "process": "host", "name": "z", "class": "sine" }));

    a_rate_of_zero "INVALID_ARGUMENT" "ARGUMENT_INVALID" ["0 Hz is not a rate"]
        Stage::new(&["sine"]).refuses("GcmService/Create",
            json!({ "path": "host/s", "class": "sine", "execution": { "rate_hz": 0 } }));

    a_rate_beyond_its_limit_is_told_in_hz "INVALID_ARGUMENT" "ARGUMENT_INVALID" ["1000000000000 Hz is outside", "1000000 Hz"]
        Stage::new(&["sine"]).refuses("GcmService/Create",
            json!({ "path": "host/s", "class": "sine", "execution": { "rate_hz": 1e12 } }));

    callbacks_for_a_class_without_a_device "INVALID_ARGUMENT" "ARGUMENT_INVALID" ["on_callback", "would never run"]
        Stage::new(&["sine"]).refuses("GcmService/Create",
            json!({ "path": "host/s", "class": "sine", "execution": { "model": "on_callback" } }));

    a_configure_of_nothing "INVALID_ARGUMENT" "ARGUMENT_INVALID" ["nothing is to change"]
        Stage::new(&["sine"]).with(&[("s", "sine")]).refuses("GcmService/Configure", json!({ "path": "host/s" }));

    an_unknown_setting_that_is_taken_away "INVALID_ARGUMENT" "CONFIG_INVALID" ["x is unknown"]
        Stage::new(&["sine"]).with(&[("s", "sine")])
            .refuses("GcmService/Configure", json!({ "path": "host/s", "config": { "x": null } }));

    an_apply_of_nothing "INVALID_ARGUMENT" "ARGUMENT_INVALID" ["it has no step"]
        Stage::new(&["sine"]).refuses("GcmService/Apply", json!({}));

    an_argument_above_its_maximum "INVALID_ARGUMENT" "ARGUMENT_INVALID" ["300", "100", "mm"]
        Stage::new(&["example"]).with(&[("s", "Server")]).started("s")
            .refuses_invoke("host/s/Provided/Write", json!(300));

    an_argument_of_another_type "INVALID_ARGUMENT" "ARGUMENT_INVALID" ["Write"]
        Stage::new(&["example"]).with(&[("s", "Server")]).started("s")
            .refuses_invoke("host/s/Provided/Write", json!("thirty"));

    a_command_of_a_component_that_does_not_run "FAILED_PRECONDITION" "NOT_ACTIVE" ["READY"]
        Stage::new(&["example"]).with(&[("s", "Server")]).refuses_invoke("host/s/Provided/Write", json!(30));

    a_command_that_fails "ABORTED" "COMMAND_FAILED" ["host/c"] {
        let stage = Stage::new(&["fixture_chaos"]);
        stage.grpc.create("host/c", "chaos", json!({ "error_in": "command" }));
        stage.grpc.start("host/c");
        stage.refuses_invoke("host/c/ctl/poke", json!(null))
    };

    a_command_that_takes_too_long "DEADLINE_EXCEEDED" "DEADLINE" ["host/c", "may still run"] {
        let stage = Stage::new(&["fixture_chaos"]);
        stage.grpc.create("host/c", "chaos", json!({ "hang_in": "command" }));
        stage.grpc.start("host/c");
        stage.refuses_invoke("host/c/ctl/poke", json!(null))
    };

    a_full_queue "RESOURCE_EXHAUSTED" "QUEUE_FULL" ["host/c"] {
        let stage = Stage::new(&["fixture_chaos"]);
        // Patience enough for the queue to fill before the actuator counts as stuck.
        let patient = json!({ "model": "on_signal", "max_step": "600s" });
        stage.grpc.create_with("host/c", "chaos", json!({ "hang_in": "command" }), patient);
        stage.grpc.start("host/c");
        let send = json!({ "path": "host/c/ctl/poke", "send": true });
        eventually("the queue is full", || match stage.grpc.call("InteractService/Invoke", send.clone()) {
            Err(refused) => Ok(refused),
            Ok(answer) => Err(answer),
        })
    };

    what_is_not_built "UNIMPLEMENTED" "NOT_IMPLEMENTED" ["Replace"]
        Stage::new(&["sine"]).with(&[("s", "sine")]).refuses("GcmService/Replace", json!({ "path": "host/s" }));
}

/// The refusal of a Create whose class would have been in a refused file.
fn create_of_refused_file(bytes: &[u8], mode: u32) -> Failure {
    use std::os::unix::fs::PermissionsExt;
    let stage = Stage::new(&[]);
    let file = stage.world.write("plugins/libtrocar_sine.so", bytes);
    fs::set_permissions(&file, fs::Permissions::from_mode(mode)).unwrap();
    eventually("the file is listed as refused", || {
        let listed = stage.grpc.plugins();
        if listed.iter().any(|p| p["refusedReason"].as_str().is_some_and(|r| !r.is_empty())) {
            Ok(())
        } else {
            Err(format!("{listed:?}"))
        }
    });
    stage.refuses("GcmService/Create", json!({ "path": "host/s", "class": "sine" }))
}

#[test]
fn every_call_that_is_not_built_says_so() {
    let stage = Stage::new(&["sine"]).with(&[("s", "sine")]);
    for (method, body) in [
        ("GcmService/Replace", json!({ "path": "host/s" })),
        ("GcmService/Move", json!({ "path": "host/s", "process": "other" })),
        ("InteractService/Emit", json!({ "path": "host/s/value", "json": 1 })),
        ("PluginService/Load", json!({ "name": "sine" })),
        ("PluginService/Unload", json!({ "name": "sine" })),
        ("PluginService/Reload", json!({ "name": "sine" })),
    ] {
        check(&stage.refuses(method, body), "UNIMPLEMENTED", "NOT_IMPLEMENTED", &[]);
    }
}

#[test]
fn every_reason_is_met_here_or_named_as_out_of_reach() {
    let text = fs::read_to_string(repository().join("docs/errors.md")).unwrap();
    let headings = text.lines().filter_map(|line| line.strip_prefix("## "));
    let documented: BTreeSet<&str> = headings.map(str::trim).collect();
    assert!(documented.len() > 20, "docs/errors.md has a heading per reason");
    let met: BTreeSet<&str> = ROWS.iter().copied().chain(NOT_YET.iter().map(|(reason, _)| *reason)).collect();
    let missing: Vec<_> = documented.difference(&met).collect();
    assert!(missing.is_empty(), "reasons without a row: {missing:?}");
    let unknown: Vec<_> = met.difference(&documented).collect();
    assert!(unknown.is_empty(), "rows of reasons that do not exist: {unknown:?}");
}

/// Removing the component under a waiting caller answers the caller; it does not hang.
#[test]
fn a_caller_whose_component_is_taken_away_gets_an_answer() {
    let stage = Stage::new(&["fixture_chaos"]);
    stage.grpc.create("host/c", "chaos", json!({ "slow_step_ms": 500 }));
    stage.grpc.start("host/c");
    let grpc = stage.grpc.clone();
    let caller = std::thread::spawn(move || {
        grpc.call("InteractService/Invoke", json!({ "path": "host/c/ctl/poke", "deadline": "30s" }))
    });
    stage.grpc.ok("GcmService/Remove", json!({ "path": "host/c", "force": true }));
    match caller.join().unwrap() {
        // Its turn may have come before the removal.
        Ok(_) => {}
        Err(refused) => {
            let known = ["PEER_LOST", "NOT_ACTIVE", "COMPONENT_NOT_FOUND"];
            assert!(known.contains(&refused.reason.as_str()), "{refused}");
        }
    }
}
