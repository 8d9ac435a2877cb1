//! The error table, one test per group of rows, through real grpcurl: code, reason, and the words a caller
//! needs.
//!
//! Invariant: every reason of `docs/errors.md` is either a row here or named below with why nobody can meet
//! it yet. The rows of a group share a host, each with components of its own; a test names all rows that
//! fail.

use std::collections::BTreeSet;
use std::fs;

use serde_json::json;
use trocar_tests::{Built, Failure, eventually, replace_in, repository};

use super::stage::{Stage, play_all};

/// Reasons that no single call to one host can be answered with in this version.
const NOT_YET: &[(&str, &str)] = &[
    ("PROGRAMS_NOT_ALLOWED", "a class that starts programs meets it: tests/it/devices/video.rs"),
    ("ROLE_FORBIDDEN", "callers from other machines meet it: machines.rs"),
    ("FORBIDDEN", "programs of other users meet it: tests/it/hostile/other_user.rs"),
    ("DISABLED", "a caller from outside is told MEMBER_NOT_FOUND when a description withdrew the command"),
    ("WOULD_BLOCK", "only a real-time thread meets it, never a caller from outside"),
    ("UNBOUND", "a caller from outside is always bound to the command it names"),
    ("INTERNAL", "it reports a mistake of trocar itself"),
    ("PROCESS_EXISTS", "a host meets it when it attaches: deployment.rs"),
    (
        "UNREACHABLE",
        "it needs two processes that cannot share memory, or have none: hostile/elsewhere.rs, hostile/limits.rs",
    ),
    ("BUSY", "it needs a request that is under way: helps.rs"),
    ("PART_TAKEN", "it needs a request that is under way: host/src/gcm/tests/ports.rs"),
    ("PROCESS_LOST", "it needs a killed process: deployment.rs"),
    ("STOP_NOT_TOLD", "it needs a process that stands still: processes/stopping.rs"),
    ("READ_ONLY", "only a browser's page meets it: tests/viewer/forms.mjs"),
    ("SYSTEM_KEPT", "it needs an agent: machines/agents.rs"),
    ("NOT_SUPERVISED", "it needs a class that is there: processes/isolated.rs"),
    ("PROCESS_NOT_UP", "it needs a process that cannot come up: processes/isolated.rs"),
    ("MANAGED_ELSEWHERE", "it needs a host with another manager: deployment.rs"),
    ("NOT_LEADER", "it needs several managers: etcd.rs"),
    ("JOURNAL_UNAVAILABLE", "it needs several managers: etcd.rs"),
    ("NO_MEMORY", "it needs frames that no machine has the memory for: changing_ports.rs"),
    ("NO_THREAD", "it needs a machine that is out of threads"),
    ("PEER_LOST", "it needs a caller who is waiting: a_caller_whose_component_is_taken_away_gets_an_answer"),
];

/// A row: its name, code, reason, words that must be in the sentence, and how it is met.
struct Row {
    name: &'static str,
    code: &'static str,
    reason: &'static str,
    words: &'static [&'static str],
    met: fn(&Stage) -> Failure,
}

/// Makes one test per group: its plugins, and rows that share a host. A row uses components of its own, so
/// that the order of rows means nothing.
macro_rules! groups {
    ($($group:ident [$($plugin:literal),*] {
        $($name:ident $code:literal $reason:literal [$($word:literal),*] |$stage:pat_param| $met:expr;)*
    })*) => {
        $(#[test] fn $group() {
            play(&[$($plugin),*], &[$(Row {
                name: stringify!($name), code: $code, reason: $reason, words: &[$($word),*], met: |$stage| $met,
            }),*]);
        })*
        /// Name and reason of each row.
        const ROWS: &[(&str, &str)] = &[$($((stringify!($name), $reason),)*)*];
    };
}

fn play(plugins: &[&str], rows: &[Row]) {
    let stage = Stage::new(plugins);
    let each = |row: &Row| check(&(row.met)(&stage), row.code, row.reason, row.words);
    play_all(rows, |row| row.name, each);
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

groups! {
    refusals_that_need_one_class_at_most ["sine"] {
        a_path_with_an_empty_part "INVALID_ARGUMENT" "BAD_PATH" ["host//robot"]
            |stage| stage.refuses("GcmService/Start", json!({ "path": "host//robot" }));

        a_process_that_is_not_there "NOT_FOUND" "PROCESS_NOT_FOUND" ["nowhere", "host"]
            |stage| stage.refuses("GcmService/Create", json!({ "path": "nowhere/s", "class": "sine" }));

        a_process_that_runs "FAILED_PRECONDITION" "PROCESS_RUNS" ["`host` runs", "only one that has ended"]
            |stage| stage.refuses("GcmService/Forget", json!({ "process": "host" }));

        a_misspelt_class "NOT_FOUND" "CLASS_NOT_FOUND" ["`sin`", "did you mean `sine`", "There is sine"]
            |stage| stage.refuses("GcmService/Create", json!({ "path": "host/misspelt", "class": "sin" }));

        a_name_that_is_taken "ALREADY_EXISTS" "COMPONENT_EXISTS" ["host/taken"]
            |stage| stage.with(&[("taken", "sine")])
                .refuses("GcmService/Create", json!({ "path": "host/taken", "class": "sine" }));

        a_component_that_is_not_there "NOT_FOUND" "COMPONENT_NOT_FOUND" ["host/lonley", "host/lonely"]
            |stage| stage.with(&[("lonely", "sine")])
                .refuses("GcmService/Start", json!({ "path": "host/lonley" }));

        a_glob_that_matches_nothing "NOT_FOUND" "NOTHING_MATCHES" ["robot"]
            |stage| stage.with(&[("no-match", "sine")])
                .refuses("GcmService/Start", json!({ "path": "*/robot" }));

        a_connection_that_is_not_there "NOT_FOUND" "CONNECTION_NOT_FOUND" ["77"]
            |stage| stage.refuses("GcmService/Disconnect", json!({ "id": 77 }));

        a_circle_of_direct_connections "FAILED_PRECONDITION" "SYNC_CYCLE" ["host/round-a", "host/round-b"]
            |stage| stage.refuses("GcmService/Apply", json!({ "steps": [
                { "create": { "path": "host/round-a", "class": "sine", "execution": { "inside": "host/round-b" } } },
                { "create": { "path": "host/round-b", "class": "sine", "execution": { "inside": "host/round-a" } } },
            ]}));

        a_state_that_does_not_allow_it "FAILED_PRECONDITION" "WRONG_STATE" ["READY", "Start"]
            |stage| stage.with(&[("never-ran", "sine")])
                .refuses("GcmService/Resume", json!({ "path": "host/never-ran" }));

        a_plugin_that_is_not_there "NOT_FOUND" "PLUGIN_NOT_FOUND" ["sin", "sine"]
            |stage| stage.refuses("PluginService/DescribePlugin", json!({ "name": "sin" }));

        a_graph_that_moved_on "ABORTED" "REVISION_CONFLICT" ["1000000"]
            |stage| stage.refuses("GcmService/Create",
                json!({ "path": "host/outdated", "class": "sine", "expected_revision": 1_000_000 }));

        a_state_that_is_not_reached "DEADLINE_EXCEEDED" "NOT_REACHED" ["host/unmoved", "ACTIVE"]
            |stage| stage.with(&[("unmoved", "sine")])
                .refuses("GcmService/WaitFor", json!({ "path": "host/unmoved", "deadline": "0.1s" }));

        an_output_without_a_sample "DEADLINE_EXCEEDED" "NO_SAMPLE" ["host/silent/value", "its component is READY"]
            |stage| stage.with(&[("silent", "sine")])
                .refuses("InteractService/Read", json!({ "path": "host/silent/value" }));

        an_interface_that_is_read "INVALID_ARGUMENT" "ARGUMENT_INVALID"
            ["a provided interface", "only outputs can be read", "value"]
            |stage| stage.with(&[("unread", "sine")])
                .refuses("InteractService/Read", json!({ "path": "host/unread/system" }));

        a_create_with_two_names "INVALID_ARGUMENT" "ARGUMENT_INVALID" ["host/q", "\"z\""]
            |stage| stage.refuses("GcmService/Create",
                json!({ "path": "host/q", "process": "host", "name": "z", "class": "sine" }));

        a_rate_of_zero "INVALID_ARGUMENT" "ARGUMENT_INVALID" ["0 Hz is not a rate"]
            |stage| stage.refuses("GcmService/Create",
                json!({ "path": "host/no-rate", "class": "sine", "execution": { "rate_hz": 0 } }));

        a_rate_beyond_its_limit_is_told_in_hz "INVALID_ARGUMENT" "ARGUMENT_INVALID"
            ["1000000000000 Hz is outside", "1000000 Hz"]
            |stage| stage.refuses("GcmService/Create",
                json!({ "path": "host/too-fast", "class": "sine", "execution": { "rate_hz": 1e12 } }));

        callbacks_for_a_class_without_a_device "INVALID_ARGUMENT" "ARGUMENT_INVALID" ["on_callback", "would never run"]
            |stage| stage.refuses("GcmService/Create",
                json!({ "path": "host/no-device", "class": "sine", "execution": { "model": "on_callback" } }));

        a_configure_of_nothing "INVALID_ARGUMENT" "ARGUMENT_INVALID" ["nothing is to change"]
            |stage| stage.with(&[("unchanged", "sine")])
                .refuses("GcmService/Configure", json!({ "path": "host/unchanged" }));

        an_unknown_setting_that_is_taken_away "INVALID_ARGUMENT" "CONFIG_INVALID" ["x is unknown"]
            |stage| stage.with(&[("no-setting", "sine")])
                .refuses("GcmService/Configure", json!({ "path": "host/no-setting", "config": { "x": null } }));

        an_apply_of_nothing "INVALID_ARGUMENT" "ARGUMENT_INVALID" ["it has no step"]
            |stage| stage.refuses("GcmService/Apply", json!({}));

        what_is_not_built "UNIMPLEMENTED" "NOT_IMPLEMENTED" ["Replace"]
            |stage| stage.with(&[("kept", "sine")])
                .refuses("GcmService/Replace", json!({ "path": "host/kept" }));
    }

    refusals_between_a_client_and_a_server ["example"] {
        a_missing_interface_lists_what_exists "NOT_FOUND" "INTERFACE_NOT_FOUND" ["Provide", "Provided"]
            |stage| stage.with(&[("listed", "Server"), ("lists", "Client")])
                .refuses_connect("lists/Required", "listed/Provide");

        an_event_that_is_called "INVALID_ARGUMENT" "WRONG_KIND" ["SetPointReached", "is an event, not a command"]
            |stage| stage.with(&[("emits", "Server")]).started("emits")
                .refuses_invoke("host/emits/Provided/SetPointReached", json!(1));

        a_missing_command_of_an_interface "NOT_FOUND" "MEMBER_NOT_FOUND" ["Writ", "Write"]
            |stage| stage.with(&[("obeys", "Server")]).started("obeys")
                .refuses_invoke("host/obeys/Provided/Writ", json!(1));

        swapped_ends "INVALID_ARGUMENT" "WRONG_DIRECTION" ["host/swap-s/Provided", "host/swap-c/Required"]
            |stage| stage.with(&[("swap-s", "Server"), ("swap-c", "Client")])
                .refuses_connect("swap-s/Provided", "swap-c/Required");

        a_client_end_that_has_a_server "ALREADY_EXISTS" "ALREADY_CONNECTED" ["host/first/Provided"]
            |stage| stage.with(&[("first", "Server"), ("second", "Server"), ("faithful", "Client")])
                .connected("faithful/Required", "first/Provided")
                .refuses_connect("faithful/Required", "second/Provided");

        the_same_pair_again "ALREADY_EXISTS" "CONNECTION_EXISTS" ["host/pair-c/Required"]
            |stage| stage.with(&[("pair-s", "Server"), ("pair-c", "Client")])
                .connected("pair-c/Required", "pair-s/Provided")
                .refuses_connect("pair-c/Required", "pair-s/Provided");

        a_component_in_use "FAILED_PRECONDITION" "IN_USE" ["host/user/Required"]
            |stage| stage.with(&[("used", "Server"), ("user", "Client")])
                .connected("user/Required", "used/Provided")
                .refuses("GcmService/Remove", json!({ "path": "host/used" }));

        an_argument_above_its_maximum "INVALID_ARGUMENT" "ARGUMENT_INVALID" ["300", "100", "mm"]
            |stage| stage.with(&[("bounded", "Server")]).started("bounded")
                .refuses_invoke("host/bounded/Provided/Write", json!(300));

        an_argument_of_another_type "INVALID_ARGUMENT" "ARGUMENT_INVALID" ["Write"]
            |stage| stage.with(&[("typed", "Server")]).started("typed")
                .refuses_invoke("host/typed/Provided/Write", json!("thirty"));

        a_command_of_a_component_that_does_not_run "FAILED_PRECONDITION" "NOT_ACTIVE" ["READY"]
            |stage| stage.with(&[("rests", "Server")]).refuses_invoke("host/rests/Provided/Write", json!(30));
    }

    refusals_of_what_does_not_fit
        ["bscan", "example", "eyerobot", "filters", "fixture_misfit", "force_sensor", "oct", "sine"]
    {
        a_server_without_the_command "FAILED_PRECONDITION" "COMMAND_MISSING" ["host/lacks/arm"]
            |stage| stage.with(&[("lacks", "eyerobot/eyerobot"), ("misses", "Client")])
                .refuses_connect("misses/Required", "lacks/arm");

        a_command_of_another_kind "FAILED_PRECONDITION" "COMMAND_KIND_MISMATCH" ["Read"]
            |stage| stage.with(&[("kind-s", "other_kind"), ("kind-c", "Client")])
                .refuses_connect("kind-c/Required", "kind-s/Provided");

        another_unit_names_both "FAILED_PRECONDITION" "TYPE_MISMATCH" ["f", "mN"]
            |stage| stage.with(&[("unit-s", "other_unit"), ("unit-c", "low_pass")])
                .refuses_connect("unit-c/raw", "unit-s/force");

        another_type_names_the_first_difference "FAILED_PRECONDITION" "TYPE_MISMATCH" ["host/type-c/raw"]
            |stage| stage.with(&[("type-s", "sine"), ("type-c", "low_pass")])
                .refuses_connect("type-c/raw", "type-s/value");

        another_format_names_both "FAILED_PRECONDITION" "FORMAT_MISMATCH" ["bayer12", "gray8"]
            |stage| stage.with(&[("format-s", "other_format"), ("format-c", "one_format")])
                .refuses_connect("format-c/image", "format-s/image");

        a_port_for_simulated_devices_only "FAILED_PRECONDITION" "TAG_MISMATCH" ["host/tag-c/tip", "has no tag"]
            |stage| stage.with(&[("tag-s", "add_latency"), ("tag-c", "force_sensor")])
                .refuses_connect("tag-c/tip", "tag-s/delayed");

        the_truth_reaches_no_actuator "FAILED_PRECONDITION" "TRUTH_TO_ACTUATOR"
            ["tagged truth", "host/told", "host/moves"]
            |stage| stage
                .with(&[("moves", "eyerobot/eyerobot"), ("knows", "oct_source"), ("told", "bscan/bscan")])
                .connected("told/axis", "moves/axis").refuses_connect("told/distance", "knows/true_distance");

        start_with_open_ends "FAILED_PRECONDITION" "UNCONNECTED" ["raw"]
            |stage| stage.with(&[("open", "low_pass")]).refuses("GcmService/Start", json!({ "path": "host/open" }));

        a_configuration_that_breaks_the_schema "INVALID_ARGUMENT" "CONFIG_INVALID" ["cutoff_hz", "400 Hz"] |stage| {
            let config = json!({ "cutoff_hz": 1000, "limit": "high" });
            let body = json!({ "path": "host/broken", "class": "low_pass", "config": config });
            let refused = stage.refuses("GcmService/Create", body);
            let fields = refused.violated_fields();
            for field in ["cutoff_hz", "limit"] {
                let named = fields.iter().any(|f| f.ends_with(field));
                assert!(named, "one violation per pointer, {field} among {fields:?}");
            }
            refused
        };
    }

    refusals_of_components_that_fail_or_hang ["fixture_chaos", "fixture_conform", "fixture_echo"] {
        an_actuator_that_was_cut_off_does_not_resume "FAILED_PRECONDITION" "UNCONNECTED"
            ["cannot resume", "drive"] |stage|
        {
            stage.with(&[("drives", "Server"), ("arm", "Arm")]).connected("arm/drive", "drives/ctl")
                .connected("arm/set_point", "drives/value_out").started("drives").started("arm");
            stage.grpc.stop("host/arm");
            let cut = json!({ "client": "host/arm/drive", "server": "host/drives/ctl" });
            stage.grpc.ok("GcmService/Disconnect", cut);
            let refused = stage.refuses("GcmService/Resume", json!({ "path": "host/arm" }));
            assert_eq!(stage.grpc.state("host/arm"), "STOPPED");
            refused
        };

        a_component_that_refuses "FAILED_PRECONDITION" "COMPONENT_REFUSED" ["host/refuses"] |stage| {
            let config = json!({ "error_in": "configure" });
            stage.refuses("GcmService/Create", json!({ "path": "host/refuses", "class": "chaos", "config": config }))
        };

        a_component_that_faults "INTERNAL" "COMPONENT_FAULT" ["panicked"] |stage| {
            stage.grpc.create("host/faults", "chaos", json!({ "panic_in": "start" }));
            stage.refuses("GcmService/Start", json!({ "path": "host/faults" }))
        };

        a_start_that_never_ends_is_taken_back "DEADLINE_EXCEEDED" "LCM_TIMEOUT" ["host"] |stage| {
            stage.grpc.create("host/endless", "chaos", json!({ "hang_in": "start" }));
            stage.refuses("GcmService/Start", json!({ "path": "host/endless" }))
        };

        an_event_that_does_not_come "DEADLINE_EXCEEDED" "EVENT_NOT_SEEN"
            ["host/mute/ctl/echoed", "100 ms", "READY"]
            |stage| stage.with(&[("mute", "echo")])
                .refuses("GcmService/WaitFor", json!({ "path": "host/mute/ctl/echoed", "deadline": "0.1s" }));

        a_command_that_fails "ABORTED" "COMMAND_FAILED" ["host/fails"] |stage| {
            stage.grpc.create("host/fails", "chaos", json!({ "error_in": "command" }));
            stage.grpc.start("host/fails");
            stage.refuses_invoke("host/fails/ctl/poke", json!(null))
        };

        a_command_that_takes_too_long "DEADLINE_EXCEEDED" "DEADLINE" ["host/hangs", "may still run"] |stage| {
            stage.grpc.create("host/hangs", "chaos", json!({ "hang_in": "command" }));
            stage.grpc.start("host/hangs");
            let soon = json!({ "path": "host/hangs/ctl/poke", "deadline": "0.2s" });
            stage.refuses("InteractService/Invoke", soon)
        };

        a_goal_that_a_newer_one_replaced "ABORTED" "REPLACED" ["host/slow/ctl/write_latest"] |stage| {
            // The server looks for commands five times a second.
            let slow = json!({ "model": "periodic", "rate_hz": 5 });
            stage.grpc.create_with("host/slow", "Server", json!({}), slow);
            stage.grpc.start("host/slow");
            let goal = json!({ "path": "host/slow/ctl/write_latest", "json": 1.0 });
            let call = || stage.grpc.call("InteractService/Invoke", goal.clone());
            eventually("two goals came within one period", || {
                std::thread::scope(|scope| {
                    let calls = [scope.spawn(call), scope.spawn(call), scope.spawn(call)];
                    let answers = calls.map(|call| call.join().unwrap());
                    answers.into_iter().find_map(Result::err).ok_or("all were carried out")
                })
            })
        };

        a_full_queue "RESOURCE_EXHAUSTED" "QUEUE_FULL" ["host/full"] |stage| {
            // Patience enough for the queue to fill before the actuator counts as stuck.
            let patient = json!({ "model": "on_signal", "max_step": "600s" });
            stage.grpc.create_with("host/full", "chaos", json!({ "hang_in": "command" }), patient);
            stage.grpc.start("host/full");
            let send = json!({ "path": "host/full/ctl/poke", "send": true });
            let mut taken = 0;
            eventually("the queue is full", || match stage.grpc.call("InteractService/Invoke", send.clone()) {
                Err(refused) => Ok(refused),
                Ok(_) => {
                    taken += 1;
                    Err(format!("{taken} were taken"))
                }
            })
        };
    }

    refusals_of_plugin_files [] {
        a_plugin_of_another_abi "FAILED_PRECONDITION" "PLUGIN_ABI" ["7"]
            |stage| stage.refuses_create_of_file("newer", &replace_in(&good(), b"\"abi\":[1,", b"\"abi\":[7,"), 0o755);

        a_plugin_that_everybody_can_write "FAILED_PRECONDITION" "PLUGIN_UNTRUSTED" ["chmod"]
            |stage| stage.refuses_create_of_file("writable", &good(), 0o777);

        a_plugin_file_that_is_damaged "FAILED_PRECONDITION" "PLUGIN_BAD_FILE" ["truncated"] |stage| {
            let good = good();
            stage.refuses_create_of_file("cut", &good[..good.len() / 3], 0o755)
        };
    }
}

/// The bytes of a plugin file that is taken as it is.
fn good() -> Vec<u8> {
    fs::read(Built::plugin("sine")).unwrap()
}

#[test]
fn every_call_that_is_not_built_says_so() {
    let stage = Stage::new(&["sine"]);
    stage.with(&[("s", "sine")]);
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
    let met = ROWS.iter().map(|(_, reason)| *reason).chain(NOT_YET.iter().map(|(reason, _)| *reason));
    let met: BTreeSet<&str> = met.collect();
    let missing: Vec<_> = documented.difference(&met).collect();
    assert!(missing.is_empty(), "reasons without a row: {missing:?}");
    let unknown: Vec<_> = met.difference(&documented).collect();
    assert!(unknown.is_empty(), "rows of reasons that do not exist: {unknown:?}");
    let names: BTreeSet<&str> = ROWS.iter().map(|(name, _)| *name).collect();
    assert_eq!(names.len(), ROWS.len(), "each row has a name of its own");
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
