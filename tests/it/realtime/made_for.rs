//! The executions a class is made for, in Rust and in C.
//!
//! Promise: Create and Configure refuse every other execution with the list of those the class is made for,
//! and leave everything as it was.

use std::path::PathBuf;
use std::process::Command;

use serde_json::json;
use trocar_tests::{Grpcurl, HostProcess, Trocar, World, repository, skip};

/// A class, and the executions that its refusals list.
struct Made {
    class: &'static str,
    models: &'static str,
    /// Lowest and highest rate, Hz.
    rates_hz: [u64; 2],
}

impl Made {
    /// The rates as a refusal lists them.
    fn rates(&self) -> String {
        let [low, high] = self.rates_hz;
        format!("{low} Hz to {high} Hz")
    }
}

/// Models that none of these classes is made for.
const MODELS: [&str; 4] = ["on_signal", "continuous", "stream", "none"];
/// Rates that none of these classes is made for, Hz.
const RATES_HZ: [u64; 3] = [3, 30, 10_000];

/// The plugin in C, compiled into the world; `None` without a C compiler.
fn servo_in_c(world: &World) -> Option<PathBuf> {
    let out = world.path("libtrocar_servo.so");
    let mut compiler = Command::new("cc");
    compiler.args(["-std=c11", "-O1", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared"]);
    compiler.args(["-fvisibility=hidden", "-I"]).arg(repository().join("sdk/c"));
    let source = repository().join("tests/it/realtime/servo.c");
    let made = compiler.arg("-o").arg(&out).arg(source).output().ok()?;
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    Some(out)
}

/// Each other execution is refused for `host/x`, over gRPC and on the command line, with what is allowed.
#[track_caller]
fn refused(method: &str, grpc: &Grpcurl, trocar: &Trocar, made: &Made) {
    let class = made.class;
    let models = MODELS.map(|model| {
        let says = format!("class `{class}` is made to run as {}, not as {model}", made.models);
        ("model", json!(model), ["--model".to_owned(), model.to_owned()], says)
    });
    let rates = RATES_HZ.map(|hz| {
        let says = format!("{hz} Hz: class `{class}` is made for {}", made.rates());
        ("rate_hz", json!(hz), ["--rate-hz".to_owned(), hz.to_string()], says)
    });
    for (field, value, flags, says) in models.into_iter().chain(rates) {
        let execution = json!({ field: value });
        let mut body = json!({ "path": "host/x", "execution": execution });
        let mut typed = vec![method.to_lowercase(), "host/x".to_owned()];
        if method == "Create" {
            body["class"] = class.into();
            typed.push(class.to_owned());
        }
        let refused = grpc.refused(&format!("GcmService/{method}"), body);
        let asked = format!("{method} of {class} with {execution}: {refused}");
        assert_eq!(
            (refused.code, refused.reason.as_str()),
            ("INVALID_ARGUMENT", "ARGUMENT_INVALID"),
            "{asked}"
        );
        assert_eq!(refused.violated_fields(), [format!("execution.{field}")], "{asked}");
        assert!(refused.message.contains(&says), "{says:?} is not said: {asked}");
        typed.extend(flags);
        let told = trocar.run(&typed).says(&says);
        assert_ne!(told.code, 0, "{told:?}");
    }
}

#[track_caller]
fn is_run_only_by_what_it_is_made_for(world: &World, made: &Made) {
    let host = HostProcess::start(world);
    let (grpc, trocar) = (host.grpcurl(), Trocar::at(world, host.address()));
    let class = grpc.await_class("host", made.class);
    grpc.await_class("host", "sine");
    let [low, high] = made.rates_hz;
    let described = format!("made for: {}, {low} to {high} Hz", made.models);
    trocar.run(&["describe", &class]).ends_with(0).says(&described);

    refused("Create", &grpc, &trocar, made);
    let none = grpc.refused("GcmService/GetState", json!({ "path": "host/x" }));
    assert_eq!(none.reason, "COMPONENT_NOT_FOUND", "a refused Create makes nothing: {none}");

    // The pace of a component that runs in another one's step is that one's.
    grpc.create_with("host/slow", "sine", json!({}), json!({ "model": "periodic", "rate_hz": 30 }));
    let inside = json!({ "model": "exec_in", "inside": "host/slow" });
    let body = json!({ "path": "host/x", "class": made.class, "execution": inside });
    let refused_inside = grpc.refused("GcmService/Create", body);
    let says =
        format!("30 Hz in the step of `host/slow`: class `{}` is made for {}", made.class, made.rates());
    assert!(refused_inside.message.contains(&says), "{says:?} is not said: {refused_inside}");
    assert_eq!(refused_inside.violated_fields(), ["execution.inside"], "{refused_inside}");

    grpc.create("host/x", made.class, json!({}));
    let execution = || grpc.component("host/x")["execution"].clone();
    let before = execution();
    refused("Configure", &grpc, &trocar, made);
    assert_eq!(execution(), before, "a refused Configure changes nothing");
    for hz in made.rates_hz {
        let allowed = json!({ "path": "host/x", "execution": { "rate_hz": hz } });
        grpc.ok("GcmService/Configure", allowed);
        assert_ne!(execution(), before, "both ends of the range are taken");
    }
}

#[test]
fn classes_that_reckon_with_their_period_are_created_and_configured_only_by_what_they_are_made_for() {
    let classes = [
        ("eyerobot", "eyerobot"),
        ("eyerobot", "free_hand"),
        ("eyerobot", "cooperative"),
        ("bscan", "bscan"),
    ];
    for (plugin, class) in classes {
        let world = World::with_plugins(&["sine", plugin]);
        let models = "periodic or exec_in or exec_out";
        let made = Made { class, models, rates_hz: [100, 8000] };
        is_run_only_by_what_it_is_made_for(&world, &made);
    }
}

#[test]
fn a_class_in_c_is_run_only_by_the_models_and_periods_of_its_manifest() {
    let world = World::with_plugins(&["sine"]);
    let Some(file) = servo_in_c(&world) else { return skip("a plugin in C is made with a C compiler") };
    world.drop_in(&file);
    let made = Made { class: "servo", models: "periodic or exec_in", rates_hz: [50, 1000] };
    is_run_only_by_what_it_is_made_for(&world, &made);
}
